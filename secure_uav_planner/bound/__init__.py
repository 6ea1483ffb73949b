"""
The upper bound: a proven limit of what any feasible plan of a scenario can reach.

How to read it: `conjugate` separates the UAVs (lemma 1) and prices power (lemma 3), `potential`
pays for speed (lemma 2), `certificate` and `chords` put the bound together (lemmas 4 and 8),
`boxes`, `curvature` and `lens` find its maxima (lemmas 5 and 6), `rounding` says what tolerances
and floating point cost (lemma 7), `witnesses` chooses who listens and `team` who jams (lemma 9).
These must be right. `reference`, `guess`, `columns`, `dual`, `newton`, `search` and `nodes` look
for good `multipliers`: whatever they find, the bound is valid.
"""

from .bound import Bound, Progress, STATUSES
from .upper_bound import upper_bound
from ..choices import OBJECTIVES

__all__ = ['Bound', 'OBJECTIVES', 'Progress', 'STATUSES', 'upper_bound']
