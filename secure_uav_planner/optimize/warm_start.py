"""An earlier plan as a start: whether it is a good one, and bent to be feasible."""

import math

import numpy as np

from .initial import Check, flights_near, fly_hover_fly_positions
from ..errors import OptionError
from ..mission.scenario import Array, Point, Scenario
from ..model.grid import resampled, resampled_flights
from ..model.limits import is_clear, repaired
from ..plan.plan import Plan


def similar(scenario: Scenario, other: Scenario) -> bool:
    """
    Return whether a plan for one scenario is a good start for the other.

    That is so when the same UAVs fly for about as long among positions that are not further
    apart than the UAVs are high: over such distances the gains change little.
    """
    if (len(scenario.uavs) != len(other.uavs)
            or len(scenario.eavesdroppers) != len(other.eavesdroppers)
            or abs(scenario.duration - other.duration) > 0.1 * other.duration):
        return False
    reach = float(scenario.altitudes.min())
    return all(math.dist(now, before) <= reach for now, before in zip(
        _landmarks(scenario), _landmarks(other), strict=True))


def _landmarks(scenario: Scenario) -> list[Point]:
    return [scenario.ground_node, *(eve.position for eve in scenario.eavesdroppers),
            *(end for uav in scenario.uavs for end in (uav.start, uav.goal))]


def adapted(scenario: Scenario, plan: Plan,
            check: Check = lambda: None) -> tuple[Array, Array]:
    """
    Return the positions and powers of a plan for another scenario, bent to be feasible in it.

    Slots are matched by their share of the duration; new starts and goals bend the whole way.
    Where zones, fence or separation allow no flights near those, fly-hover-fly takes their place.

    :param check: as for fly_hover_fly_positions.
    :raises OptionError: when the number of UAVs differs.
    """
    if len(plan.scenario.uavs) != len(scenario.uavs):
        raise OptionError(f'initial is a plan for {len(plan.scenario.uavs)} UAVs; '
                          f'it must be one for {len(scenario.uavs)}')
    positions = resampled_flights(plan.positions, scenario.slots)
    share = np.linspace(0, 1, scenario.slots + 2)
    ends = np.stack([scenario.starts, scenario.goals], axis=1) - positions[:, [0, -1]]
    positions = positions + (1 - share)[:, None] * ends[:, :1] + share[:, None] * ends[:, 1:]
    powers = resampled(plan.powers.T, scenario.slots, inner=True).T
    positions, powers = repaired(scenario, positions, powers)
    if not is_clear(scenario, positions):
        found = flights_near(scenario, positions, check)
        positions = fly_hover_fly_positions(scenario, check) if found is None else found
    return positions, powers
