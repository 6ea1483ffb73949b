"""Files that are there whole or not at all."""

import os
from pathlib import Path
import uuid


def write_atomically(path, text):
    """
    Write a text file so that a reader sees the old one or the new one, never a part.

    :raises OSError: when it cannot be written; an old one is left as it was.
    """
    path = Path(path)
    part = path.with_name(f'{path.name}.{uuid.uuid4().hex}.part')
    try:
        with open(part, 'x', encoding='utf-8') as file:
            file.write(text)
            file.flush()
            os.fsync(file.fileno())
        os.replace(part, path)
    except BaseException:
        part.unlink(missing_ok=True)
        raise
