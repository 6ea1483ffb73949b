"""
The upper bound: a proven limit of what any feasible plan of a scenario can reach.

`proof` must be right: it makes a bound of any multipliers. `conjugate` separates the UAVs (lemma
1) and prices power (lemma 3), `potential` pays for speed (lemma 2), `certificate` and `chords`
put the bound together (lemmas 4 and 8), `boxes`, `curvature` and `reachable_set` find its maxima
(lemmas 5 and 6), `rounding` says what tolerances and floating point cost (lemma 7), `subset`
chooses who listens and `team` who jams (lemma 9).

`search` may be wrong: it looks for good multipliers, and whatever it finds, the bound is valid.
`upper_bound` ties the two together.
"""

from .upper_bound import upper_bound

__all__ = ['upper_bound']
