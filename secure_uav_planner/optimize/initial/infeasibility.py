"""Why a mission with zones, a fence or a separation cannot be flown, and how long it takes."""

from collections.abc import Iterator
from dataclasses import replace
import math
from typing import NoReturn

import shapely

from .flights import direct, direct_flights
from .projection import flights_near
from .visibility_graph import Check
from ...errors import InfeasibleMissionError, TimeLimitError
from ...mission.scenario import Scenario
from ...mission.validation import RANGES
from ...model.airspace import airspace_of, GEOFENCE
from ...model.limits import SeparationLimit

_SHARE = 0.05  # Of its slack that a flight leaves which shows that there is one.
_DOUBLINGS, _HALVINGS = 8, 12


def refuse(scenario: Scenario, check: Check) -> NoReturn:
    """
    Say why no flights were found for a scenario.

    Where check raises TimeLimitError in the search for a duration, none is named.

    :raises InfeasibleMissionError: naming the UAVs, what is in their way or must be kept, and the
        shortest duration with which flights were found; `others` are those of further UAVs.
    """
    problems: list[InfeasibleMissionError] = []
    try:
        for number in range(len(scenario.uavs)):
            problems += _of_one(scenario, number, check)
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
        shortest = _shortest(scenario, check)
    except TimeLimitError:
        shortest = None
    more = ('' if shortest is None else
            f'; with a duration of {_text(shortest)} s, some were')
    raise InfeasibleMissionError(
        f'duration is {scenario.duration:g} s; no flights of {names} were found that '
        f'{" and ".join(kept.values())}{more}', (next(iter(kept)),))


def _of_one(scenario: Scenario, number: int, check: Check) -> Iterator[InfeasibleMissionError]:
    """Yield why a UAV has no flight, even if it were alone."""
    uav = scenario.uavs[number]
    alone = replace(scenario, uavs=(uav,), separation=0.0)
    names = _in_the_way(alone)
    if direct(alone, 0) is None:
        yield InfeasibleMissionError(
            f'no way leads {uav.name} from start to goal: {names} is in its way',
            ('uavs', number))
    elif (names or scenario.geofence is not None) and not _is_flown(alone, check):
        around = f' around {names}' if names else ''
        if scenario.geofence is not None and GEOFENCE not in names:
            around += f' inside {GEOFENCE}'
        try:
            shortest = _shortest(alone, check)
        except TimeLimitError:
            searched = 'in the time for the search'
        else:
            searched = 'however long'
            if shortest is not None:
                yield InfeasibleMissionError(
                    f'duration is {scenario.duration:g} s; {uav.name} needs at least '
                    f'{_text(shortest)} s from start to goal{around} at '
                    f'{uav.limits_text}',
                    ('duration',))
                return
        yield InfeasibleMissionError(
            f'no flight was found that takes {uav.name} from start to goal{around} '
            f'at {uav.limits_text}, {searched}', ('uavs', number))


def _in_the_way(scenario: Scenario) -> str:
    """Return the names of the obstacles that the straight line crosses, or of all if none."""
    uav, pieces = scenario.uavs[0], airspace_of(scenario).pieces[0]
    line = shapely.LineString([uav.start, uav.goal])
    met = [piece for piece in pieces if shapely.Polygon(piece.vertices).intersects(line)]
    return ' or '.join(dict.fromkeys(piece.name for piece in met or pieces))


def _is_flown(scenario: Scenario, check: Check, duration: float | None = None) -> bool:
    """Return whether flights from start to goal are found in a duration, by default its own."""
    asked = scenario if duration is None else replace(scenario, duration=duration)
    return any(flights_near(asked, flights, check, _SHARE) is not None
               for flights in direct_flights(asked, check))


def _shortest(scenario: Scenario, check: Check) -> float | None:
    """Return a duration with which flights are found, close to the shortest, or None."""
    low = scenario.duration
    longest = min(low * 2**_DOUBLINGS, RANGES['duration'][1])
    at_rest = all(uav.start_velocity == uav.goal_velocity == (0.0, 0.0) for uav in scenario.uavs)
    # From rest to rest, a longer flight is always easier.
    if at_rest and not _is_flown(scenario, check, longest):
        return None
    high = min(2 * low, longest)
    while not _is_flown(scenario, check, high):
        if high >= longest:
            return None
        low, high = high, min(2 * high, longest)
    for _ in range(_HALVINGS):
        middle = math.sqrt(low * high)
        if _is_flown(scenario, check, middle):
            high = middle
        else:
            low = middle
    return high


def _text(duration: float) -> str:
    return f'{math.ceil(duration * 1000) / 1000:g}'
