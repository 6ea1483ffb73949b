"""
Gains and rates: the paper's formulas, and their derivatives.

Positions are (U, N+2, 2) in m and powers (U, N) in W throughout, as in Plan, for any N; gains are
divided by the noise power, so they are SNRs per watt.
"""

from collections.abc import Callable

from .rates import (
    find_node_rates, find_rate_scale, ground_gains, ground_rates, ground_squared_distances,
    guaranteed_gains, guaranteed_node_rates, guaranteed_rates, guaranteed_squared_distances,
    node_ground_rates, secrecy_node_rates, secrecy_rates)
from .worst_case import (
    leak_maximisers, worst_case_node_rates, worst_case_places, worst_case_rates)
from ...mission import Objective
from ...mission.scenario import Array

NODE_RATES: dict[Objective, Callable[..., Array]] = {
    'guaranteed': guaranteed_node_rates, 'worst_case': worst_case_node_rates}
"""The function that returns the rates of the ground nodes, for each objective."""

__all__ = ['NODE_RATES', 'find_node_rates', 'find_rate_scale', 'ground_gains', 'ground_rates',
           'ground_squared_distances', 'guaranteed_gains', 'guaranteed_node_rates',
           'guaranteed_rates', 'guaranteed_squared_distances', 'leak_maximisers',
           'node_ground_rates', 'secrecy_node_rates', 'secrecy_rates', 'worst_case_node_rates',
           'worst_case_places', 'worst_case_rates']
