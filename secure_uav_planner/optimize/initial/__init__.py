"""
Initial trajectories, from which the methods start.

`visibility_graph` finds routes around obstacles, `flights` flies along them, `projection` moves
flights strictly inside all limits, `feasibility` asks whether there are flights and says why not,
and `trajectories` calls these in turn.
"""

from .flights import build_flights, fly_around
from .projection import move_inside, project
from .trajectories import adapt_plan, constant_powers, fly_hover_fly_positions, is_similar
from .visibility_graph import find_free_places

__all__ = ['adapt_plan', 'build_flights', 'constant_powers', 'find_free_places',
           'fly_around', 'fly_hover_fly_positions', 'is_similar', 'move_inside', 'project']
