"""Why a mission with zones, a fence or a separation cannot be flown, and how long it takes."""

from collections.abc import Callable
from dataclasses import replace
import math
from typing import NoReturn

import shapely

from .detours import direct, direct_flights, fitted
from ..airspace import airspace_of
from ..errors import InfeasibleMissionError
from ..fields import LIMITS
from ..scenario import Scenario

_DOUBLINGS, _HALVINGS = 8, 12


def refuse(scenario: Scenario, is_over: Callable[[], bool]) -> NoReturn:
    """
    Say why no flights were found for a scenario.

    :param is_over: returns whether the time for the search is over; a duration that is named is
        then longer than it need be, or none is.
    :raises InfeasibleMissionError: naming the UAVs, what is in their way, and the shortest
        duration with which flights were found.
    """
    for uav in scenario.uavs:
        alone = replace(scenario, uavs=(uav,), separation=0.0)
        names = _in_the_way(alone)
        if direct(alone, 0) is None:
            raise InfeasibleMissionError(
                f'no way leads {uav.name} from start to goal: {names} is in its way')
        if names and not _is_flown(alone, is_over):
            shortest = _shortest(alone, is_over)
            limits = f'{uav.max_speed:g} m/s' + (
                '' if uav.max_acceleration is None else f' and {uav.max_acceleration:g} m/s^2')
            if shortest is None:
                searched = 'in the time for the search' if is_over() else 'however long'
                raise InfeasibleMissionError(
                    f'no flight was found that takes {uav.name} from start to goal around '
                    f'{names} at {limits}, {searched}')
            raise InfeasibleMissionError(
                f'duration is {scenario.duration:g} s; {uav.name} needs at least '
                f'{_text(shortest)} s from start to goal around {names} at {limits}')
    names = ' and '.join(uav.name for uav in scenario.uavs)
    shortest = _shortest(scenario, is_over)
    more = ('' if shortest is None else
            f'; with a duration of {_text(shortest)} s, some were')
    raise InfeasibleMissionError(
        f'duration is {scenario.duration:g} s; no flights of {names} were found that keep the '
        f'separation of {scenario.separation:g} m{more}')


def _in_the_way(scenario: Scenario) -> str:
    """Return the names of what is on the straight way of the only UAV, or else of all."""
    uav, pieces = scenario.uavs[0], airspace_of(scenario).pieces[0]
    line = shapely.LineString([uav.start, uav.goal])
    met = [piece for piece in pieces if shapely.Polygon(piece.vertices).intersects(line)]
    return ' or '.join(dict.fromkeys(piece.name for piece in met or pieces))


def _is_flown(scenario: Scenario, is_over: Callable[[], bool]) -> bool:
    """Return whether flights from start to goal are found in time."""
    return any(not is_over() and fitted(scenario, flights) is not None
               for flights in direct_flights(scenario))


def _shortest(scenario: Scenario, is_over: Callable[[], bool]) -> float | None:
    """Return a duration with which flights are found, close to the shortest, or None."""
    low = scenario.duration
    longest = min(low * 2**_DOUBLINGS, LIMITS['duration'][1])
    if not _is_flown_in(scenario, longest, is_over):
        return None
    high = low
    while high < longest:
        high = min(2 * high, longest)
        if is_over() or _is_flown_in(scenario, high, is_over):
            break
        low = high
    if is_over():
        return longest
    for _ in range(_HALVINGS):
        middle = math.sqrt(low * high)
        if is_over():
            break
        if _is_flown_in(scenario, middle, is_over):
            high = middle
        else:
            low = middle
    return high


def _is_flown_in(scenario: Scenario, duration: float, is_over: Callable[[], bool]) -> bool:
    return _is_flown(replace(scenario, duration=duration), is_over)


def _text(duration: float) -> str:
    return f'{math.ceil(duration * 1000) / 1000:g}'
