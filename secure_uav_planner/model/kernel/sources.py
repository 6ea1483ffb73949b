"""What the kernel is compiled from; setup.py runs this file by itself."""

import hashlib
from pathlib import Path

FOLDER = Path(__file__).resolve().parent
UNITS = tuple(sorted(path.name for path in FOLDER.glob('*.cpp')))
"""The files to compile, which include the headers."""


def find_digest() -> str:
    """Return a digest of all sources, to check that a kernel was built from them."""
    digest = hashlib.sha256()
    for path in sorted(FOLDER.glob('*.[ch]pp')):
        digest.update(path.name.encode() + b'\0' + path.read_bytes())
    return digest.hexdigest()
