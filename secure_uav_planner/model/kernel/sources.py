"""Sources of the compiled kernel, and its import; setup.py runs this file by itself."""

import hashlib
from importlib import import_module
from pathlib import Path
from typing import Any

FOLDER = Path(__file__).resolve().parent
UNITS = tuple(sorted(path.name for path in FOLDER.glob('*.cpp')))
"""The files to compile, which include the headers."""


def find_digest() -> str:
    """Return a digest of all sources, to check that a kernel was built from them."""
    digest = hashlib.sha256()
    for path in sorted(FOLDER.glob('*.[ch]pp')):
        digest.update(path.name.encode() + b'\0' + path.read_bytes())
    return digest.hexdigest()


def load_kernel() -> Any:
    """
    Return the compiled module.

    :raises ImportError: where there is none, or it was built from other sources.
    """
    try:
        module = import_module('_secure_uav_planner_kernel')
    except ImportError as error:
        raise ImportError(
            f'secure_uav_planner needs its compiled kernel, which cannot be loaded ({error}); a '
            "source tree must be built: run 'pip install .' in it, which brings a compiler where "
            "there is none, or 'colcon build' in its workspace", name=error.name) from error
    if getattr(module, 'sources', None) != find_digest():
        raise ImportError('the compiled kernel belongs to another version of secure_uav_planner '
                          "than these files; run 'pip install .' or 'colcon build' again",
                          name=module.__name__)
    return module
