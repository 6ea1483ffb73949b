"""
The compiled kernel: Newton steps of `joint`, the proof of the worst case, and of the bound.

A channel model has a class here and one in Python; `link_gains.hpp` says what the kernel asks of
it, and `limit.hpp` of limits.
"""

from typing import TYPE_CHECKING

from .sources import load_kernel

if TYPE_CHECKING:
    from . import core
else:
    core = load_kernel()

__all__ = ['core']
