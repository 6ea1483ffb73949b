"""
The upper bound: a proven limit of what any feasible plan of a scenario can reach.

`proof` must be right: it makes a bound of any multipliers. `certificate` separates the UAVs (lemma
1), prices power (lemma 3) and puts the bound together (lemma 4), `potential` pays for speed and
acceleration (lemmas 2 and 8), `boxes` and `reachable_set` find the maxima (lemmas 5 and 6),
`detours` bounds the ways around zones (lemma 9), `rounding` the effect of tolerances and floating
point (lemma 7), and `subset` chooses eavesdroppers.

`search` may be wrong: it looks for good multipliers, and the bound is valid whatever it finds.
`method` ties the two together.
"""

from .method import explain_refusal, upper_bound

__all__ = ['explain_refusal', 'upper_bound']
