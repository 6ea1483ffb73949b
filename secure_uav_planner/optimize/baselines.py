"""Fly-hover-fly with constant powers, Section IV: the baseline, and where the methods start."""

from collections.abc import Callable
from functools import lru_cache
import math

import numpy as np

from .detours import direct_flights, fitted, free_places, route
from .refusal import refuse
from ..limits import is_open, repaired
from ..scenario import Array, read_only, Scenario, Uav


_SHARE = 1e-3  # Of its slack that a flight around others leaves, where it can.


def fly_hover_fly_positions(scenario: Scenario,
                            is_over: Callable[[], bool] = lambda: False) -> Array:
    """
    Return straight flights at full speed to a hovering place and on to the goal, as late.

    The transmitter hovers above the ground node, the jammers above the eavesdroppers in turn. A
    UAV without the time to reach its hovering place flies towards it and turns back at the last
    moment that still reaches the goal. Flights go around what may not be entered, and keep their
    separation.

    :param is_over: returns whether the time for a search around what is in the way is over.
    :return: positions, (U, N+2, 2) in m.
    :raises InfeasibleMissionError: when no flights are found that keep the limits.
    """
    eves = scenario.eavesdropper_positions
    jammers = np.arange(len(scenario.uavs) - 1)
    hover = np.concatenate([[scenario.ground_node], eves[jammers % len(eves)]])
    if is_open(scenario):
        return flights_to(scenario, hover)
    known = _known_flights(scenario)
    if not known:
        known.append(read_only(_flights_around(scenario, hover, is_over)))
    return known[0].copy()


@lru_cache(maxsize=16)
def _known_flights(_scenario: Scenario) -> list[Array]:
    """Return the list that remembers the flights of a scenario."""
    return []


def _flights_around(scenario: Scenario, hover: Array, is_over: Callable[[], bool]) -> Array:
    found = fitted(scenario, flights_to(scenario, free_places(scenario, hover)), _SHARE)
    if found is not None:
        return found
    for flights in direct_flights(scenario):
        if is_over():
            break
        found = fitted(scenario, flights, _SHARE)
        if found is not None:
            return found
    refuse(scenario, is_over)


def flights_to(scenario: Scenario, hover: Array,
               ways: tuple[tuple[int, int], ...] | None = None) -> Array:
    """
    Return fly-hover-fly flights to hovering places.

    Where a zone, a fence or another UAV is in the way they may break the limits still.

    :param hover: hovering places, (U, 2) in m.
    :param ways: which ways each UAV takes to its place and back; by default the shortest.
    :return: positions, (U, N+2, 2) in m.
    """
    positions = np.empty((len(scenario.uavs), scenario.slots + 2, 2))
    for number, (uav, place) in enumerate(zip(scenario.uavs, hover, strict=True)):
        around = route(scenario, number, place, *(ways[number] if ways else ()))
        if around is None:
            around = (_smooth_fly_hover_fly(uav, place, scenario)
                      if uav.max_acceleration is not None else
                      _fly_hover_fly(np.array(uav.start), np.array(uav.goal), place,
                                     float(scenario.max_step[number]), scenario.slots))
        positions[number] = around
    if np.isfinite(scenario.max_accelerations).any() and is_open(scenario):
        positions, _ = repaired(scenario, positions, np.zeros((len(positions), scenario.slots)))
    return positions


def constant_powers(scenario: Scenario, transmitting: float = 1.0, jamming: float = 1.0,
                    slots: int | None = None) -> Array:
    """
    Return the same powers in every slot, (U, N) in W.

    :param transmitting: share of its average power that the transmitter has.
    :param jamming: share of theirs that the jammers have.
    :param slots: N, by default the scenario's.
    """
    shares = np.full(len(scenario.uavs), jamming)
    shares[0] = transmitting
    return np.repeat((shares * scenario.average_powers)[:, None],
                     scenario.slots if slots is None else slots, axis=1)


def _fly_hover_fly(start: Array, goal: Array, place: Array, step: float, slots: int) -> Array:
    """Return the points of one UAV, (N+2, 2)."""
    turn = _turning_place(start, goal, place, (slots + 1) * step)
    points = np.empty((slots + 2, 2))
    points[:] = start + (turn - start)
    # As far from the start as the points that are counted from behind are from the goal.
    flown = np.arange(slots + 2.0) * step
    for end, one_way in ((start, points), (goal, points[::-1])):
        length = math.dist(end, turn)
        moving = np.searchsorted(flown, length)
        if moving:
            one_way[:moving] = end + (flown[:moving] / length)[:, None] * (turn - end)
    return points


def _smooth_fly_hover_fly(uav: Uav, place: Array, scenario: Scenario) -> Array:
    """
    Return the points of a UAV with a limit of acceleration, (N+2, 2).

    A mean of its velocities over some slots makes it accelerate evenly for so long. Where it
    turns without hovering this is not enough, which is left to the repair.
    """
    slots, duration = scenario.slots, scenario.slot_duration
    start, goal = np.array(uav.start), np.array(uav.goal)
    step = uav.max_speed * duration
    width = math.ceil(uav.max_speed / (uav.vehicle.max_acceleration * duration))
    if width > slots:
        return start + uav.vehicle.least_effort(slots, duration)[1]
    ends = [np.zeros(2) if velocity is None else np.array(velocity) * duration
            for velocity in (uav.start_velocity, uav.goal_velocity)]
    begin, end = start + ends[0] * (width - 1) / 2, goal - ends[1] * (width - 1) / 2
    if math.dist(begin, end) > (slots + 2 - width) * step:
        return start + uav.vehicle.least_effort(slots, duration)[1]
    moves = np.diff(_fly_hover_fly(begin, end, place, step, slots + 1 - width), axis=0)
    moves = np.concatenate([[ends[0]] * (width - 1), moves, [ends[1]] * (width - 1)]
                           ) if width > 1 else moves
    sums = np.concatenate([np.zeros((1, 2)), np.cumsum(moves, axis=0)])
    means = (sums[width:] - sums[:-width]) / width
    points = start + np.concatenate([np.zeros((1, 2)), np.cumsum(means, axis=0)])
    return points + np.linspace(0, 1, slots + 2)[:, None] * (goal - points[-1])


def _turning_place(start: Array, goal: Array, place: Array, reach: float) -> Array:
    """Return the place nearest to `place` on the way there from which `goal` is in reach."""
    outward = math.dist(start, place)
    if outward + math.dist(place, goal) <= reach:
        return place
    # |start + s u - goal| = reach - s, solved for the s at which to turn.
    direction = (place - start) / outward if outward > 0 else np.zeros(2)
    back = start - goal
    denominator = 2 * (reach + float(back @ direction))
    slack = max(0.0, reach**2 - float(back @ back))
    # Straight towards the goal with no slack, turning earlier or later is the same flight.
    along = min(outward, reach, slack / denominator if denominator > 1e-12 * reach else reach)
    return start + along * direction
