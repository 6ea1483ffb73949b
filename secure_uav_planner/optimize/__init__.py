"""The optimisation: baselines, convex subproblems, methods."""

from .solve import fly_hover_fly, METHODS, solve

__all__ = ['METHODS', 'fly_hover_fly', 'solve']
