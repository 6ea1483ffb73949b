"""
What costs most time, compiled: the Newton steps of `joint` and the search for the worst case.

Limits and channel models have a form here and one in Python; `limit.hpp` and `channel.hpp` say
what the kernel asks of them.
"""

from .loading import core

__all__ = ['core']
