"""
Initial trajectories, from which the methods start.

`flights` flies along routes around obstacles, `projection` moves flights strictly inside all
limits, and `trajectories` calls these in turn, or says why there are no flights.
"""

from .flights import build_flights, fly_around, list_orders
from .projection import move_inside, project
from .trajectories import adapt_plan, constant_powers, fly_hover_fly_positions, is_similar

__all__ = ['adapt_plan', 'build_flights', 'constant_powers', 'fly_around',
           'fly_hover_fly_positions', 'is_similar', 'list_orders', 'move_inside', 'project']
