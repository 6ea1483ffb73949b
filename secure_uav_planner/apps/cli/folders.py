"""Folders for results."""

from pathlib import Path
import tempfile

from ...errors import OptionError


def writable(folder: Path) -> Path:
    """
    Return a folder after it has been made and tried; the work before would be in vain.

    :raises OptionError: when it cannot be written to.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            return folder
    except OSError as error:
        raise OptionError(
            f'{folder} cannot be written to: {error.strerror or error}; choose another folder '
            'with --out') from None
