"""The answer: a plan, its file and bound, its playback in time, and the tracking of UAVs."""

from .plan import Plan
from .results import Bound, Iteration

__all__ = ['Bound', 'Iteration', 'Plan']
