"""
What a plan is worth when the world differs from what it was made for: Monte Carlo.

`world` says how the world may differ and draws worlds, `monte_carlo` evaluates the plan in each.
"""

from .monte_carlo import assess, Assessment
from .world import World

__all__ = ['Assessment', 'World', 'assess']
