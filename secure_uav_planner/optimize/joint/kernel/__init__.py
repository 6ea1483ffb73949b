"""
The barrier method compiled, where the package was built with a compiler.

KernelBarrier does what barrier.Barrier does, which states the method. `make_barrier` chooses.
"""

from .barrier import KernelBarrier, make_barrier

__all__ = ['KernelBarrier', 'make_barrier']
