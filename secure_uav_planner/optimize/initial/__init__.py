"""
First flights, from which the methods start: the door of all that the search for them needs.

`visibility_graph` finds ways around what may not be entered, `flights` flies along them,
`projection` moves flights strictly inside all limits, `infeasibility` says why there are none, and
`trajectories` asks these in turn.
"""

from .flights import flights_to, route
from .projection import flights_near, projected, settled
from .trajectories import constant_powers, fly_hover_fly_positions
from .visibility_graph import Check, free_places

__all__ = ['Check', 'constant_powers', 'flights_near', 'flights_to',
           'fly_hover_fly_positions', 'free_places', 'projected', 'route', 'settled']
