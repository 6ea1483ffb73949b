"""Flights that stay farthest from the limits, towards which others are bent to be feasible."""

from functools import lru_cache

import numpy as np

from ..grid import Grid
from ...mission.scenario import Array, read_only, Scenario


def reference_flight(grid: Grid) -> Array:
    """
    Return the flights of least effort on a grid, (U, N+2, 2) in m, read-only.

    Without a limit of acceleration they are straight, at constant speed.
    """
    return _reference_flight(grid.scenario, grid.slots)


@lru_cache(maxsize=64)
def _reference_flight(scenario: Scenario, slots: int) -> Array:
    step = Grid.of(scenario, slots).slot_duration
    flights = np.stack([
        uav.start + uav.vehicle.least_effort(slots, step)[1] for uav in scenario.uavs])
    flights[:, -1] = scenario.goals
    return read_only(flights)
