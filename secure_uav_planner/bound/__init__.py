"""
The upper bound: a proven limit of what any feasible plan of a scenario can reach.

`proof` must be right: it makes a bound of any multipliers. `conjugate` separates the UAVs (lemma
1) and prices power (lemma 3), `potential` pays for speed and acceleration (lemmas 2 and 10),
`certificate` and `chords` put the bound together (lemma 4), `jammer_shares` divides what several
jammers do (lemma 8), `boxes` and `reachable_set` find the maxima (lemmas 5 and 6), `detours` says
how long ways around zones take (lemma 11), `rounding` what tolerances and floating point cost
(lemma 7), `subset` chooses who listens and `team` who jams (lemma 9).

`search` may be wrong: it looks for good multipliers, and whatever it finds, the bound is valid.
`upper_bound` ties the two together.
"""

from .upper_bound import upper_bound

__all__ = ['upper_bound']
