"""Make numbers that are nearly feasible, or were feasible for another scenario, feasible."""

import math

import numpy as np

from ..channel import guaranteed_rates


def straight_line(scenario):
    """Return flights at constant speed from start to goal, (U, N+2, 2) in m."""
    share = np.linspace(0, 1, scenario.slots + 2)[:, None]
    return np.stack([(1 - share) * uav.start + share * np.array(uav.goal)
                     for uav in scenario.uavs])


def feasible_positions(scenario, positions):
    """
    Return the positions blended with the straight line as far as the largest step asks for.

    No flight has shorter steps than the straight line; when a mission leaves no slack it is the
    only one. An exceedance of 1e-8 costs a share of about 1e-8 of the way towards it.
    """
    line = straight_line(scenario)
    positions = np.concatenate([line[:, :1], positions[:, 1:-1], line[:, -1:]], axis=1)
    share = np.zeros(len(positions))
    longest = np.linalg.norm(np.diff(positions, axis=1), axis=-1).max(axis=1)
    shortest = np.linalg.norm(line[:, 1] - line[:, 0], axis=-1)
    excess = longest - scenario.max_step
    over = excess > 0
    slack = np.maximum(scenario.max_step - shortest, 0)
    share[over] = excess[over] / (excess[over] + slack[over])
    blended = positions + share[:, None, None] * (line - positions)
    blended[:, [0, -1]] = line[:, [0, -1]]
    return blended


def feasible_powers(scenario, powers):
    """Return the powers clipped to their peak and scaled down to their average, (U, N) in W."""
    peak = np.array([uav.peak_power for uav in scenario.uavs])[:, None]
    average = np.array([uav.average_power for uav in scenario.uavs])[:, None]
    powers = np.clip(powers, 0, peak)
    mean = powers.mean(axis=1, keepdims=True)
    return powers * np.minimum(1.0, average / np.maximum(mean, 1e-300))


def silence_losing_slots(scenario, positions, powers):
    """Return the powers with the transmitter silent where its guaranteed rate is negative."""
    losing = guaranteed_rates(scenario, positions, powers) < 0
    powers = powers.copy()
    powers[0, losing] = 0.0
    return powers


def similar(scenario, other):
    """
    Return whether a plan for one scenario is a good start for the other.

    That is so when the same UAVs fly for about as long among places that are not further apart
    than the UAVs are high: over such distances the gains change little.
    """
    if (len(scenario.uavs) != len(other.uavs)
            or len(scenario.eavesdroppers) != len(other.eavesdroppers)
            or abs(scenario.duration - other.duration) > 0.1 * other.duration):
        return False
    reach = min(uav.altitude for uav in scenario.uavs)
    return all(math.dist(place, before) <= reach
               for place, before in zip(_places(scenario), _places(other)))


def _places(scenario):
    return [scenario.ground_node, *(eve.position for eve in scenario.eavesdroppers),
            *(place for uav in scenario.uavs for place in (uav.start, uav.goal))]


def adapted(scenario, plan):
    """
    Return the positions and powers of a plan for another scenario, bent to be feasible in it.

    Slots are matched by their share of the duration; new starts and goals bend the whole way.

    :raises ValueError: when the number of UAVs differs.
    """
    if len(plan.scenario.uavs) != len(scenario.uavs):
        raise ValueError(f'initial is a plan for {len(plan.scenario.uavs)} UAVs; '
                         f'it must be one for {len(scenario.uavs)}')
    points = np.linspace(0, 1, scenario.slots + 2)
    old_points = np.linspace(0, 1, plan.scenario.slots + 2)
    positions = np.stack([
        np.stack([np.interp(points, old_points, path[:, axis]) for axis in range(2)], axis=-1)
        for path in plan.positions])
    ends = straight_line(scenario)[:, [0, -1]] - positions[:, [0, -1]]
    positions += (1 - points)[:, None] * ends[:, :1] + points[:, None] * ends[:, 1:]
    powers = np.stack([np.interp(points[1:-1], old_points[1:-1], power) for power in plan.powers])
    return feasible_positions(scenario, positions), feasible_powers(scenario, powers)
