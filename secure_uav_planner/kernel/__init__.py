"""
What costs most time, compiled, where the package was built with a compiler.

The C++ here does what NumPy code does that states it: `optimize/joint/barrier.py` with the limits,
and the search of discs in `channel/`. These choose.
"""

from .loading import compiled, SWITCH

__all__ = ['SWITCH', 'compiled']
