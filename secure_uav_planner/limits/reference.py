"""Flights that stay farthest from the limits, towards which others are bent to be feasible."""

import numpy as np

from ..scenario import Array, Scenario


def straight_line(scenario: Scenario) -> Array:
    """Return flights at constant speed from start to goal, (U, N+2, 2) in m."""
    share = np.linspace(0, 1, scenario.slots + 2)[:, None]
    return ((1 - share) * scenario.starts[:, None] + share * scenario.goals[:, None])
