"""
The paper's algorithm, Section III: powers and trajectories in turn, as convex problems.

CVXPY is imported here and nowhere below, as that takes a second.
"""

from .method import alternate

__all__ = ['alternate']
