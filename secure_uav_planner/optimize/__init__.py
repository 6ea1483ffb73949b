"""
The optimisation: methods and baselines, from a scenario to a plan.

| algorithm | module |
| --- | --- |
| primal-dual interior-point method, banded steps | `joint/interior_point.py`, `model/kernel/` |
| multistart, refinement from coarse to fine grids | `joint/multistart.py`, `joint/starts.py` |
| starts for limits of energy; rising prices (penalties) | `joint/energy.py`, `model/kernel/` |
| exchange of constraints (semi-infinite programming) | `joint/exchange.py` |
| alternating successive convex approximation, the paper's | `alternating.py` |
| projection by sequential convex programming | `initial/projection.py` |
| shortest paths in a visibility graph | `model/airspace/routes.py` |

`methods.py` runs a method by its name. An `Incumbent` keeps the best feasible iterate of a call,
whichever method proposes it, and a `Deadline` ends it. `rejoin.py` finds the beginning of a replan
in flight.
"""

from .methods import fly_hover_fly, METHODS, solve

__all__ = ['METHODS', 'fly_hover_fly', 'solve']
