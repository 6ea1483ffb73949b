"""
Sources of the compiled kernel, and its import; setup.py runs this file by itself.

The kernel of the bound stands in `bound/kernel/`, and is compiled into the same module.
"""

import hashlib
from importlib import import_module
from pathlib import Path
from typing import Any

_PACKAGE = Path(__file__).resolve().parents[2]
FOLDERS = ('model/kernel', 'bound/kernel')
"""Folders of the sources in the package; an #include names a header without its folder."""


def list_sources(pattern: str) -> list[str]:
    """Return the paths of the sources whose names match a pattern, relative to the package."""
    return sorted(path.relative_to(_PACKAGE).as_posix() for folder in FOLDERS
                  for path in (_PACKAGE / folder).glob(pattern))


def find_digest() -> str:
    """Return the SHA-256 of the paths and texts of all C++ sources of the kernel, in hex."""
    digest = hashlib.sha256()
    for path in list_sources('*.[ch]pp'):
        digest.update(path.encode() + b'\0' + (_PACKAGE / path).read_bytes())
    return digest.hexdigest()


def load_kernel() -> Any:
    """
    Return the compiled module.

    :raises ImportError: if it cannot be loaded, or was built from other sources.
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
