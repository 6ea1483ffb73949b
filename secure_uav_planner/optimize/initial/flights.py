"""Flights to hovering places and on to the goals, also around what may not be entered."""

from collections.abc import Iterator
from itertools import islice, product
import math

import numpy as np

from .visibility_graph import Check, MOST_WAYS, VisibilityGraph, ways_through
from ...mission.kinematics import Vehicle
from ...mission.scenario import Array, Scenario, Uav
from ...model.limits import is_open, repaired

_TURNS = 25  # Places on the way out at which a UAV may turn back.


def flights_to(scenario: Scenario, hover: Array,
               ways: tuple[tuple[int, int], ...] | None = None,
               check: Check = lambda: None) -> Array:
    """
    Return fly-hover-fly flights to hovering places.

    Where a zone, a fence or another UAV is in the way they may break the limits still.

    :param hover: hovering places, (U, 2) in m.
    :param ways: which ways each UAV takes to its place and back; by default the shortest.
    :return: positions, (U, N+2, 2) in m.
    """
    positions = np.empty((len(scenario.uavs), scenario.slots + 2, 2))
    for number, (uav, place) in enumerate(zip(scenario.uavs, hover, strict=True)):
        check()
        around = route(scenario, number, place, *(ways[number] if ways else ()))
        positions[number] = _fly_hover_fly(scenario, uav, place) if around is None else around
    if np.isfinite(scenario.max_accelerations).any() and is_open(scenario):
        positions, _ = repaired(scenario, positions, np.zeros((len(positions), scenario.slots)))
    return positions


def route(scenario: Scenario, uav: int, place: Array, out: int = 0,
          back: int = 0) -> Array | None:
    """
    Return the flight of a UAV to a hovering place and back around what is in its way.

    It may still cut corners and need more acceleration than there is, which the projection mends.
    A UAV without the time to reach its place turns back on the way.

    :param out: which of the ways there, the shortest first, as back is from there to the goal.
    :return: (N+2, 2) in m, or None where there is no such way, or nothing is in its way.
    """
    one, step = scenario.uavs[uav], float(scenario.max_step[uav])
    goal = np.array(one.goal)
    graph, ways = ways_through(scenario, uav, (np.array(one.start), place, goal),
                               1 + max(out, back))
    if graph is None or len(ways[0]) <= out or len(ways[1]) <= back:
        return None
    legs = ways[0][out], ways[1][back]
    count = scenario.slots + 1
    # Slots that a leg takes longer because of the acceleration to full speed and back.
    lag = one.max_speed / one.vehicle.max_acceleration / scenario.slot_duration
    reach = (count - 2 * lag) * step
    if _length(legs[0]) + _length(legs[1]) > reach:
        turned = _turned_back(graph, legs[0], goal, reach)
        if turned is None:
            return direct(scenario, uav, out)
        legs = turned
    number = np.arange(count + 1.0)
    there = np.clip((number - lag / 2) * step, 0, _length(legs[0]))
    left = np.clip((count - number - lag / 2) * step, 0, _length(legs[1]))
    leaving = left < _length(legs[1])
    return np.where(leaving[:, None], _at(legs[1], _length(legs[1]) - left),
                    _at(legs[0], there))


def direct(scenario: Scenario, uav: int, way: int = 0) -> Array | None:
    """Return the flight of least effort on one of the ways from start to goal, as route does."""
    one = scenario.uavs[uav]
    graph, [ways] = ways_through(
        scenario, uav, (np.array(one.start), np.array(one.goal)), 1 + way)
    if graph is None:
        return one.start + one.vehicle.least_effort(
            scenario.slots, scenario.slot_duration)[1] if way == 0 else None
    if len(ways) <= way:
        return None
    return _at(ways[way], _least_effort(one, _length(ways[way]), scenario))


def direct_flights(scenario: Scenario, check: Check) -> Iterator[Array]:
    """Give flights (U, N+2, 2) in m straight from start to goal, or on the ways around."""
    ways = []
    for uav in range(len(scenario.uavs)):
        check()
        found = (direct(scenario, uav, way) for way in range(MOST_WAYS))
        ways.append([flight for flight in found if flight is not None])
    # Of many UAVs, there are too many combinations: only the shortest ways together.
    for chosen in islice(product(*ways), None if len(ways) <= 3 else 1):
        yield np.stack(chosen)


def _least_effort(uav: Uav, length: float, scenario: Scenario) -> Array:
    """Return distances flown along a way, (N+2,) in m."""
    vehicle = Vehicle((length, 0.0), uav.max_speed, uav.vehicle.max_acceleration,
                      start_velocity=(0.0, 0.0), goal_velocity=(0.0, 0.0))
    return vehicle.least_effort(scenario.slots, scenario.slot_duration)[1][:, 0]


def _turned_back(graph: VisibilityGraph, out: Array, goal: Array,
                 reach: float) -> tuple[Array, Array] | None:
    """Return the longest part of a way out from which the goal is within reach, and back."""
    flown = np.linspace(0, _length(out), _TURNS)
    places = _at(out, flown)
    late = flown + graph.distances(places, goal) > reach
    last = int(late.argmax()) - 1
    if last < 1:
        return None
    back = graph.ways(places[last], goal, 1)
    if not back:
        return None
    kept = out[:-1][np.append(0.0, np.cumsum(_lengths(out)))[:-1] < flown[last]]
    return np.concatenate([kept, places[[last]]]), back[0]


def _lengths(way: Array) -> Array:
    return np.linalg.norm(np.diff(way, axis=0), axis=1)


def _length(way: Array) -> float:
    return float(_lengths(way).sum())


def _at(way: Array, flown: Array) -> Array:
    """Return the places some distances along a way, (M, 2)."""
    known = np.append(0.0, np.cumsum(_lengths(way)))
    return np.stack([np.interp(flown, known, column) for column in way.T], axis=-1)


def _straight(start: Array, goal: Array, place: Array, step: float, slots: int) -> Array:
    """Return the points of a UAV without a limit of acceleration, (N+2, 2)."""
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


def _fly_hover_fly(scenario: Scenario, uav: Uav, place: Array) -> Array:
    """
    Return the points of a UAV that flies straight to its hovering place and on, (N+2, 2).

    Where it has a limit, a mean of its velocities over some slots makes it accelerate evenly for
    so long. Where it turns without hovering this is not enough, which is left to the repair.
    """
    slots, duration = scenario.slots, scenario.slot_duration
    start, goal = np.array(uav.start), np.array(uav.goal)
    step = uav.max_speed * duration
    if uav.max_acceleration is None:
        return _straight(start, goal, place, step, slots)
    width = math.ceil(uav.max_speed / (uav.vehicle.max_acceleration * duration))
    first, last = (np.array(velocity or (0.0, 0.0)) * duration
                   for velocity in (uav.start_velocity, uav.goal_velocity))
    begin, end = start + first * (width - 1) / 2, goal - last * (width - 1) / 2
    if width > slots or math.dist(begin, end) > (slots + 2 - width) * step:
        return start + uav.vehicle.least_effort(slots, duration)[1]
    moves = np.concatenate([
        np.tile(first, (width - 1, 1)),
        np.diff(_straight(begin, end, place, step, slots + 1 - width), axis=0),
        np.tile(last, (width - 1, 1))])
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
