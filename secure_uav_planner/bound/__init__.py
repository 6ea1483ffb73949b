"""
The upper bound: a proven limit of what any feasible plan of a scenario can reach.

`proof` must be right: it makes a bound of any multipliers. `conjugate` separates the UAVs (lemma
1) and prices power (lemma 3), `potential` pays for speed and acceleration (lemmas 2 and 8),
`certificate` and `chords` put the bound together (lemma 4), `boxes` and `reachable_set` find the
maxima (lemmas 5 and 6), `detours` says how long ways around zones take (lemma 9), `rounding` what
tolerances and floating point cost (lemma 7), and `subset` chooses who listens.

`search` may be wrong: it looks for good multipliers, and whatever it finds, the bound is valid.
`upper_bound` ties the two together.
"""

from .upper_bound import explain_refusal, upper_bound

__all__ = ['explain_refusal', 'upper_bound']
