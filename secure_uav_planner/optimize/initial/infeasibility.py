"""Reasons why a mission with zones, a fence or a separation cannot be flown."""

from collections.abc import Iterator
from dataclasses import replace
import math
from typing import NoReturn

import shapely

from .flights import fly_direct, generate_direct_flights
from .projection import find_flights_near
from .visibility_graph import Check
from ...errors import InfeasibleMissionError, TimeLimitError
from ...mission.scenario import Scenario
from ...mission.validation import RANGES
from ...model.airspace import GEOFENCE, get_airspace
from ...model.limits import SeparationLimit

_SHARE = 0.05  # Of its slack that a flight must leave to count.
_DOUBLINGS, _HALVINGS = 8, 12


def raise_infeasibility(scenario: Scenario, check: Check) -> NoReturn:
    """
    Raise the reason why no flights were found for a scenario.

    No duration is named where check raises TimeLimitError in the search for it.

    :raises InfeasibleMissionError: naming the UAVs, the obstacles or limits, and the shortest
        duration with which flights were found; `others` are the errors of further UAVs.
    """
    problems: list[InfeasibleMissionError] = []
    try:
        for number in range(len(scenario.uavs)):
            problems += _find_problems(scenario, number, check)
    except TimeLimitError:
        if not problems:
            raise
    if problems:
        problems[0].further = tuple(problems[1:])
        raise problems[0]
    names = ' and '.join(uav.name for uav in scenario.uavs)
    kept = {field: text for field, text, applies in (
        ('separation', f'keep the separation of {scenario.separation:g} m',
         SeparationLimit.applies_to(scenario)),
        ('geofence', f'stay inside {GEOFENCE}', scenario.geofence is not None),
        ('no_fly_zones', 'avoid the no-fly zones', scenario.no_fly_zones)) if applies}
    try:
        shortest = _find_shortest_duration(scenario, check)
    except TimeLimitError:
        shortest = None
    more = ('' if shortest is None else
            f'; with a duration of {_round_up(shortest)} s, some were')
    raise InfeasibleMissionError(
        f'duration is {scenario.duration:g} s; no flights of {names} were found that '
        f'{" and ".join(kept.values())}{more}', (next(iter(kept)),))


def _find_problems(scenario: Scenario, number: int,
                   check: Check) -> Iterator[InfeasibleMissionError]:
    """Yield the reason why a UAV has no flight even if it is alone, if so."""
    uav = scenario.uavs[number]
    alone = replace(scenario, uavs=(uav,), separation=0.0)
    names = _name_obstacles(alone)
    if fly_direct(alone, 0) is None:
        yield InfeasibleMissionError(
            f'no way leads {uav.name} from start to goal: {names} is in its way',
            ('uavs', number))
    elif (names or scenario.geofence is not None) and not _has_flights(alone, check):
        around = f' around {names}' if names else ''
        if scenario.geofence is not None and GEOFENCE not in names:
            around += f' inside {GEOFENCE}'
        try:
            shortest = _find_shortest_duration(alone, check)
        except TimeLimitError:
            searched = 'in the time for the search'
        else:
            searched = 'however long'
            if shortest is not None:
                yield InfeasibleMissionError(
                    f'duration is {scenario.duration:g} s; {uav.name} needs at least '
                    f'{_round_up(shortest)} s from start to goal{around} at '
                    f'{uav.limits_text}',
                    ('duration',))
                return
        yield InfeasibleMissionError(
            f'no flight was found that takes {uav.name} from start to goal{around} '
            f'at {uav.limits_text}, {searched}', ('uavs', number))


def _name_obstacles(scenario: Scenario) -> str:
    """Return the names of the obstacles that the straight line crosses, or of all if none."""
    uav, obstacles = scenario.uavs[0], get_airspace(scenario).obstacles[0]
    line = shapely.LineString([uav.start, uav.goal])
    crossed = [obstacle for obstacle in obstacles
               if shapely.Polygon(obstacle.vertices).intersects(line)]
    return ' or '.join(dict.fromkeys(obstacle.name for obstacle in crossed or obstacles))


def _has_flights(scenario: Scenario, check: Check, duration: float | None = None) -> bool:
    """Return True if flights from start to goal are found in a duration, by default its own."""
    if duration is not None:
        scenario = replace(scenario, duration=duration)
    return any(find_flights_near(scenario, flights, check, _SHARE) is not None
               for flights in generate_direct_flights(scenario, check))


def _find_shortest_duration(scenario: Scenario, check: Check) -> float | None:
    """Return a duration with which flights are found, close to the shortest, or None."""
    low = scenario.duration
    longest = min(low * 2**_DOUBLINGS, RANGES['duration'][1])
    at_rest = all(uav.start_velocity == uav.goal_velocity == (0.0, 0.0) for uav in scenario.uavs)
    # From rest to rest, a longer flight is always easier.
    if at_rest and not _has_flights(scenario, check, longest):
        return None
    high = min(2 * low, longest)
    while not _has_flights(scenario, check, high):
        if high >= longest:
            return None
        low, high = high, min(2 * high, longest)
    for _ in range(_HALVINGS):
        middle = math.sqrt(low * high)
        if _has_flights(scenario, check, middle):
            high = middle
        else:
            low = middle
    return high


def _round_up(duration: float) -> str:
    return f'{math.ceil(duration * 1000) / 1000:g}'
