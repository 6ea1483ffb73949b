"""
The compiled kernel: Newton steps of `joint`, the proof of the worst case, and of the bound.

Limits and channel models have a class here and one in Python; `limit.hpp` and `channel.hpp` say
what the kernel asks of them.
"""

from importlib import import_module
from typing import Any, TYPE_CHECKING

from .sources import find_digest


def _load() -> Any:
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


if TYPE_CHECKING:
    from . import core
else:
    core = _load()

__all__ = ['core']
