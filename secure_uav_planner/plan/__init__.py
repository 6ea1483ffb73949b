"""What is answered: a plan, its file and bound, its course in time, and UAVs beside it."""

from .bound import Bound
from .plan import Iteration, Plan

__all__ = ['Bound', 'Iteration', 'Plan']
