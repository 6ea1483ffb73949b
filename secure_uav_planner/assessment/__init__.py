"""
What a plan is worth when the world differs from its assumptions, and how far a flight kept it.

`world` says how the world may differ and draws worlds, `monte_carlo` evaluates the plan in each.
`flown` compares the logs of a flight with the plan.
"""

from .flown import compare, Comparison, FlownFlight, read_flight
from .monte_carlo import assess, Assessment
from .world import World

__all__ = ['Assessment', 'Comparison', 'FlownFlight', 'World', 'assess', 'compare', 'read_flight']
