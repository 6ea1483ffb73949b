"""Files that are there whole or not at all."""

from contextlib import contextmanager
import os
from pathlib import Path
import uuid


@contextmanager
def atomic_file(path, binary=False):
    """
    Open a file to write such that a reader sees the old one or the new one, never a part.

    :raises OSError: when it cannot be written; an old one is left as it was, as it is when the
        body of the with statement raises.
    """
    path = Path(path)
    part = path.with_name(f'{path.name}.{uuid.uuid4().hex}.part')
    try:
        with open(part, 'xb' if binary else 'x', encoding=None if binary else 'utf-8') as file:
            yield file
            file.flush()
            os.fsync(file.fileno())
        os.replace(part, path)
    except BaseException:
        part.unlink(missing_ok=True)
        raise
