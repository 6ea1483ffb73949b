"""The rows of a campaign in a file that grows by a line whenever a mission is finished."""

from collections.abc import Iterator
import fcntl
import json
from pathlib import Path
from typing import Any

from ...errors import OptionError
from ...mission.files import naming


class Journal:
    """
    A file with one row a line as JSON, that only one process at a time adds to.

    It is a context. A line that a stopped process left unfinished is removed.

    :param path: the file; made if it is not there.
    :raises OSError: when it cannot be written.
    :raises OptionError: when another process has it open.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._file = open(path, 'ab')
        try:
            fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            self._file.close()
            raise OptionError(f'{path} is being written by another sweep') from None
        with open(path, 'rb+') as file:
            file.truncate(sum(len(line) for line in file if line.endswith(b'\n')))

    def __enter__(self) -> 'Journal':
        return self

    def __exit__(self, *_: object) -> None:
        self._file.close()

    def add(self, row: dict[str, Any]) -> None:
        """Write a row, and hand it to the operating system at once."""
        with naming(self._path):
            self._file.write(json.dumps(row, allow_nan=False).encode() + b'\n')
            self._file.flush()

    def rows(self) -> Iterator[dict[str, Any]]:
        """Yield all rows in the order in which they were finished."""
        with open(self._path, encoding='utf-8') as file:
            for line in file:
                yield json.loads(line)
