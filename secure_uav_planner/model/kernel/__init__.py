"""
The compiled kernel: Newton steps of `joint`, the proof of the worst case, and of the bound.

Limits and channel models have a class here and one in Python; `limit.hpp` and `link_gains.hpp` say
what the kernel asks of them.
"""

from typing import TYPE_CHECKING

from .sources import load_kernel

if TYPE_CHECKING:
    from . import core
else:
    core = load_kernel()

__all__ = ['core']
