"""The compiled module, if it is there and fits."""

from functools import cache
from importlib import import_module
import logging
import os
from typing import Any

from .sources import digest

SWITCH = 'SECURE_UAV_PLANNER_KERNEL'
"""Environment variable; with the value 0 the kernel is not used."""

_LOG = logging.getLogger(__name__)


@cache
def compiled() -> Any:
    """Return the compiled module, or None, with a line in the log, where it cannot be used."""
    if os.environ.get(SWITCH) == '0':
        return None
    try:
        module = import_module('_secure_uav_planner_kernel')
        sources = module.sources
    # Whatever a kernel of another Python or of another machine raises.
    except Exception as error:
        _LOG.warning('the planner runs without its compiled kernel: %s', error)
        return None
    if sources != digest():
        _LOG.warning('the planner runs without its compiled kernel, which belongs to another '
                     'version of the package; install the package again')
        return None
    return module
