"""What the kernel is compiled from; setup.py runs this file by itself."""

import hashlib
from pathlib import Path

FOLDER = Path(__file__).resolve().parent
UNITS = tuple(sorted(path.name for path in FOLDER.glob('*.cpp')))
"""What is compiled; everything else is included by these."""


def digest() -> str:
    """Return a digest of all sources, by which a kernel and its package know each other."""
    found = hashlib.sha256()
    for path in sorted(FOLDER.glob('*.[ch]pp')):
        found.update(path.name.encode() + b'\0' + path.read_bytes())
    return found.hexdigest()
