"""Atomic writing of files, and the checked reading of small ones."""

from collections.abc import Iterator
from contextlib import contextmanager, suppress
import io
import os
from pathlib import Path
import stat
from typing import Any, IO
import uuid

from ..errors import OptionError, quote


@contextmanager
def atomic_file(path: str | os.PathLike[str], binary: bool = False) -> Iterator[IO[Any]]:
    """
    Open a file for writing such that a reader sees the old content or the new, never a part.

    A symbolic link is followed: its target is replaced. The new file has the permissions of the
    old file. Without an old file, the umask decides. An old file is left unchanged after an error,
    also an error in the body of the with statement.

    :raises OSError: when the file cannot be written, or is a folder or a device.
    """
    path = Path(os.path.realpath(checked_path(path)))
    if path.exists() and not path.is_file():
        raise OSError(f'{path} is not a regular file and cannot be replaced')
    # The name of the part stays below 255 bytes, the limit of file systems.
    part = path.with_name(f'{path.name[:50]}.{uuid.uuid4().hex}.part')
    is_new = not path.exists()
    mode = 0o666 if is_new else path.stat().st_mode & 0o777
    try:
        with naming(path, part):
            with open(part, 'xb' if binary else 'x', encoding=None if binary else 'utf-8',
                      opener=lambda name, flags: os.open(name, flags, mode)) as file:
                if not is_new:
                    os.fchmod(file.fileno(), mode)  # os.open has applied the umask.
                yield file
                file.flush()
                os.fsync(file.fileno())
            os.replace(part, path)
    except BaseException:
        part.unlink(missing_ok=True)
        raise
    _sync_folder(path.parent)


@contextmanager
def naming(path: str | os.PathLike[str], part: Path | None = None) -> Iterator[None]:
    """Put `path` into a system error whose filename is missing (a full disk) or is `part`."""
    try:
        yield
    except OSError as error:
        if error.errno is not None and error.filename in (None, part and os.fspath(part)):
            raise OSError(error.errno, error.strerror, os.fspath(path)) from None
        raise


def read_text(path: str | os.PathLike[str], most_bytes: int) -> str:
    """
    Return the text of a regular file, without a byte order mark.

    :raises OSError: as read_bytes does.
    :raises UnicodeDecodeError: when it is not UTF-8.
    """
    return decode_text(read_bytes(path, most_bytes))


def read_bytes(path: str | os.PathLike[str], most_bytes: int) -> bytes:
    """
    Return the content of a regular file.

    :raises OSError: when it cannot be read, is not a regular file, or is larger than most_bytes.
    """
    checked_path(path)
    status = os.stat(path)  # Before opening: opening a pipe would wait for its other end.
    if not stat.S_ISREG(status.st_mode):
        raise OSError(f'{path} is not a regular file')
    if status.st_size > most_bytes:
        raise OSError(f'{path} has {status.st_size} bytes; at most {most_bytes} are read')
    with open(path, 'rb') as file:
        return file.read(most_bytes)


def decode_text(data: bytes) -> str:
    """Return UTF-8 text without a byte order mark, and with the line ends of Python."""
    with io.TextIOWrapper(io.BytesIO(data), encoding='utf-8-sig') as text:
        return text.read()


def checked_path(path: Any) -> str | os.PathLike[str]:
    """Return the path of a file; raise OptionError for anything else, such as a number."""
    if not isinstance(path, (str, os.PathLike)):
        raise OptionError(f'path is {quote(path)}; it must be a string or a path', ('path',))
    return path


def _sync_folder(folder: Path) -> None:
    """Make the new name survive a loss of power, if the file system supports it."""
    with suppress(OSError):
        descriptor = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(descriptor)
        finally:
            os.close(descriptor)
