"""
The upper bound: a proven limit of what any feasible plan of a scenario can reach.

`proof` must be right: it makes a bound of any multipliers. `certificate` separates the UAVs (lemma
1), prices power (lemma 3) and puts the bound together (lemma 4). `terms` pays for speed and
acceleration by potentials (lemmas 2 and 8) and bounds each UAV's term (lemma 5) over its
`reachable_set` (lemma 6); `detours` bounds the paths around zones (lemma 9), and `relaxation` the
effect of tolerances (lemma 7), of floating point and of what is left out.

`search` may be wrong: it looks for good multipliers, and the bound is valid whatever it finds.
`method` ties the two together. `shortest` finds the shortest flight that delivers, and proves it.
"""

from .method import explain_refusal, upper_bound
from .shortest import shortest_duration

__all__ = ['explain_refusal', 'shortest_duration', 'upper_bound']
