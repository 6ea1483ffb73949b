"""Flights to hovering places and on to the goals, around what may not be entered."""

from collections.abc import Iterator
from itertools import product

import numpy as np

from .fitting import Fitting
from .routes import Roadmap, roadmap_of
from ..airspace import airspace_of
from ..grid import Grid
from ..kinematics import Vehicle
from ..limits import is_clear
from ..scenario import Array, Scenario, Uav

_DISTANCES = (0.2, 0.01)  # That ways keep from what is in their way, in steps, where they can.
_TURNS = 25  # Places on the way out at which a UAV may turn back.
_INSIDE = 0.1  # How far hovering places are within the fence, in steps.


def free_places(scenario: Scenario, places: Array) -> Array:
    """Return the nearest places to some (..., U, 2) in m where each UAV may be."""
    normals, offsets = airspace_of(scenario).hull
    found = places.copy()
    for uav, step in enumerate(scenario.max_step.tolist()):
        road = roadmap_of(scenario, uav, _DISTANCES[0] * step)
        for index in np.ndindex(places.shape[:-2]):
            at = (*index, uav)
            found[at] = _into(found[at], normals, offsets - _INSIDE * step)
            if road is not None:
                found[at] = road.nearest_free(found[at])
    return found


def route(scenario: Scenario, uav: int, place: Array, out: int = 0,
          back: int = 0) -> Array | None:
    """
    Return the flight of a UAV to a hovering place and back around what is in its way.

    It may still cut corners and need more acceleration than there is, which a Fitting mends. A
    UAV without the time to reach its place turns back on the way.

    :param out: which of the ways there, the shortest first.
    :param back: which of the ways from there to the goal.
    :return: (N+2, 2) in m, or None where there is no such way, or nothing is in its way.
    """
    one, step = scenario.uavs[uav], float(scenario.max_step[uav])
    start, goal = np.array(one.start), np.array(one.goal)
    road = roadmap_of(scenario, uav, _DISTANCES[0] * step)
    if road is None:
        return None
    ways = road.ways(start, place), road.ways(place, goal)
    if not all(ways):
        road = roadmap_of(scenario, uav, _DISTANCES[1] * step) or road
        ways = road.ways(start, place), road.ways(place, goal)
    if len(ways[0]) <= out or len(ways[1]) <= back:
        return None
    legs = ways[0][out], ways[1][back]
    count = scenario.slots + 1
    # Slots that a leg takes longer because of the acceleration to full speed and back.
    lag = 0.0 if one.max_acceleration is None else (
        one.max_speed / one.max_acceleration / scenario.slot_duration)
    reach = (count - 2 * lag) * step
    if _length(legs[0]) + _length(legs[1]) > reach:
        turned = _turned_back(road, legs[0], goal, reach)
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
    for distance in _DISTANCES:
        road = roadmap_of(scenario, uav, distance * float(scenario.max_step[uav]))
        if road is None:
            return one.start + one.vehicle.least_effort(
                scenario.slots, scenario.slot_duration)[1] if way == 0 else None
        ways = road.ways(np.array(one.start), np.array(one.goal))
        if ways:
            break
    if len(ways) <= way:
        return None
    return _at(ways[way], _least_effort(one, _length(ways[way]), scenario))


def direct_flights(scenario: Scenario) -> Iterator[Array]:
    """Give flights (U, N+2, 2) in m straight from start to goal, or on the ways around."""
    ways = [[flight for flight in (direct(scenario, uav, way) for way in range(3))
             if flight is not None] for uav in range(len(scenario.uavs))]
    if not all(ways):
        return
    yield np.stack([found[0] for found in ways])
    if len(ways) <= 3:
        for chosen in list(product(*ways))[1:]:
            yield np.stack(chosen)


def fitted(scenario: Scenario, positions: Array, share: float = 0.05) -> Array | None:
    """
    Return flights near others that are strictly inside all limits, or None if none are found.

    :param positions: (U, N+2, 2) in m.
    :param share: of the slack that is left where it can be.
    """
    fitting = Fitting(Grid.of(scenario), share)
    for other_way in (False, True):
        found = fitting.near(positions, other_way)
        if found.excess < 0 and is_clear(scenario, found.positions):
            return found.positions
    return None


def _least_effort(uav: Uav, length: float, scenario: Scenario) -> Array:
    """Return distances flown along a way, (N+2,) in m."""
    limited = uav.max_acceleration is not None
    vehicle = Vehicle((length, 0.0), uav.max_speed, uav.vehicle.max_acceleration,
                      *((0.0, 0.0) if limited else None,) * 2)
    flown: Array = vehicle.least_effort(scenario.slots, scenario.slot_duration)[1][:, 0]
    return flown


def _turned_back(road: Roadmap, out: Array, goal: Array,
                 reach: float) -> tuple[Array, Array] | None:
    """Return the longest part of a way out from which the goal is within reach, and back."""
    flown = np.linspace(0, _length(out), _TURNS)
    places = _at(out, flown)
    late = flown + road.distances(places, goal) > reach
    last = int(late.argmax()) - 1
    if last < 1:
        return None
    back = road.ways(places[last], goal, 1)
    if not back:
        return None
    kept = out[:-1][np.append(0.0, np.cumsum(_lengths(out)))[:-1] < flown[last]]
    return np.concatenate([kept, places[[last]]]), back[0]


def _lengths(way: Array) -> Array:
    found: Array = np.linalg.norm(np.diff(way, axis=0), axis=1)
    return found


def _length(way: Array) -> float:
    return float(_lengths(way).sum())


def _at(way: Array, flown: Array) -> Array:
    """Return the places some distances along a way, (M, 2)."""
    known = np.append(0.0, np.cumsum(_lengths(way)))
    return np.stack([np.interp(flown, known, column) for column in way.T], axis=-1)


def _into(place: Array, normals: Array, offsets: Array) -> Array:
    """Return a place moved into half-planes, by projections in turn."""
    for _ in range(100):
        beyond = normals @ place - offsets
        if not len(beyond) or beyond.max() <= 0:
            break
        worst = int(beyond.argmax())
        place = place - beyond[worst] * normals[worst]
    return place
