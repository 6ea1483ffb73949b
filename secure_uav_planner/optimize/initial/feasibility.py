"""Whether a mission can be flown: first flights, or the reasons why there are none."""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import replace
from functools import cache, partial
from itertools import chain
import math
from typing import NamedTuple, NoReturn

import shapely

from .flights import build_flights, fly_direct, generate_direct_flights, list_hovering_places
from .projection import find_flights_near
from ..deadline import Check
from ...errors import InfeasibleMissionError, TimeLimitError
from ...mission.consistency import refuse_duration, refuse_slow_uavs
from ...mission.fields import raise_all
from ...mission.kinematics import DURATION, find_shortest_duration, UTILISATION_TOLERANCE
from ...mission.scenario import Array, Scenario, Uav
from ...model.airspace import GEOFENCE
from ...model.least_utilisation import find_least_utilisations, minimise_utilisation
from ...model.problem import Problem

_SHARE = 0.05  # Of its slack that a flight must leave to count.
_LONGEST = 2**8  # Ratio of the durations that are tried and the mission's.
_ACCURACY = 1e-6  # Of durations that the limits of speed and acceleration ask for,
_ACCURACY_AROUND = 2e-4  # and of those around obstacles.


def check_durations(scenario: Scenario, check: Check) -> None:
    """
    Raise an error unless all UAVs have the time from start to goal, as if each were alone.

    :param check: called now and then; what it raises is passed on, as everywhere here.
    :raises InfeasibleMissionError: of the slowest UAV, naming a duration with which all have it;
        `further` are the errors of the rest. None is named where check raises TimeLimitError in
        the search for it.
    """
    utilisations = find_least_utilisations(scenario, check)
    slow = [uav for uav, utilisation in zip(scenario.uavs, utilisations, strict=True)
            if not utilisation <= 1 + UTILISATION_TOLERANCE]
    if not slow:
        return

    def measure_utilisation(uavs: Sequence[Uav], duration: float) -> float:
        step = duration / scenario.slots
        return max(minimise_utilisation(uav.vehicle, scenario.slots, step, check)[0]
                   for uav in uavs)

    try:
        shortest = [find_shortest_duration(partial(measure_utilisation, [uav]), scenario.duration,
                                           _ACCURACY) for uav in slow]
        if None not in shortest:
            slowest = max(range(len(slow)), key=lambda index: shortest[index] or 0.0)
            # With velocities at the ends, more time is not always easier.
            shortest[slowest] = _find_duration(partial(measure_utilisation, scenario.uavs),
                                               shortest[slowest] or 0.0, accuracy=_ACCURACY)
    except TimeLimitError:
        shortest = [math.nan] * len(slow)
    raise_all(refuse_slow_uavs(scenario.duration, zip(slow, shortest, strict=True)))


def find_flights(problem: Problem, check: Check) -> Array:
    """
    Return flights (U, N+2, 2) in m that keep all limits, near fly-hover-fly where they can be.

    :raises InfeasibleMissionError: where none are found, naming the UAVs, the obstacles or limits,
        and a duration with which flights are found; `further` are the errors of more UAVs. None
        is named where check raises TimeLimitError in the search for it.
    """
    flights = _search_flights(problem, check)
    if flights is None:
        _raise_infeasibility(problem, check)
    return flights


def _find_duration(utilisation: Callable[[float], float], duration: float, **options: float
                   ) -> float | None:
    """Return a duration if its utilisation is at most 1, or else find the shortest."""
    return (duration if utilisation(duration) <= 1 else
            find_shortest_duration(utilisation, duration, **options))


def _search_flights(problem: Problem, check: Check) -> Array | None:
    """Return flights near fly-hover-fly, or else near the direct ones, or None."""
    places = problem.routes.find_free_places(list_hovering_places(problem.scenario), check)
    wanted = build_flights(problem, places, check=check)
    return _find_first(find_flights_near(problem, flights, check) for flights in chain(
        [wanted], generate_direct_flights(problem, check)))


def _search_direct_flights(problem: Problem, check: Check) -> Array | None:
    """Return flights from start to goal that are well inside all limits, or None."""
    return _find_first(find_flights_near(problem, flights, check, _SHARE)
                       for flights in generate_direct_flights(problem, check))


def _find_first(answers: Iterable[Array | None]) -> Array | None:
    return next((flights for flights in answers if flights is not None), None)


def _find_duration_around(scenario: Scenario, duration: float, check: Check,
                          search: Callable[[Problem, Check], Array | None]) -> float | None:
    """Return a duration of at least the given one in which a search finds flights, or None."""
    longest = min(_LONGEST * scenario.duration, DURATION.high)

    @cache
    def measure_utilisation(duration: float) -> float:
        longer = replace(scenario, duration=duration)
        has_time = (find_least_utilisations(longer, check) <= 1 + UTILISATION_TOLERANCE).all()
        return 0.5 if has_time and search(Problem(longer), check) is not None else 2.0

    # From rest to rest, a longer flight is always easier.
    if (all(uav.start_velocity == uav.goal_velocity == (0.0, 0.0) for uav in scenario.uavs)
            and measure_utilisation(longest) > 1):
        return None
    return _find_duration(
        measure_utilisation, duration, accuracy=_ACCURACY_AROUND, longest=longest)


class _Obstruction(NamedTuple):
    """
    Why a UAV has no flight even if it is alone.

    :ivar shortest: a duration in s with which it has one, NaN for an unknown one, infinite for
        none.
    :ivar text: the way that it takes in that duration, or else the whole reason.
    """

    uav: Uav
    number: int
    shortest: float
    text: str

    def describe(self, duration: float) -> InfeasibleMissionError:
        """Return the error, for the mission's duration in s."""
        if math.isinf(self.shortest):
            return InfeasibleMissionError(self.text, ('uavs', self.number))
        return refuse_duration(duration, self.uav, self.shortest, self.text)


def _raise_infeasibility(problem: Problem, check: Check) -> NoReturn:
    """Raise the reason why no flights were found; see find_flights."""
    scenario, obstructions = problem.scenario, list[_Obstruction]()
    try:
        for number in range(len(scenario.uavs)):
            obstructions += _find_obstructions(scenario, number, check)
    except TimeLimitError:
        if not obstructions:
            raise
    obstructions.sort(key=lambda obstruction: -obstruction.shortest)
    least = obstructions[0].shortest if obstructions else scenario.duration
    errors = []
    if math.isfinite(least):
        # What each UAV needs alone may not be enough for all.
        try:
            enough = _find_duration_around(scenario, least, check, _search_flights)
        except TimeLimitError:
            enough = None
            obstructions = [obstruction._replace(shortest=math.nan)
                            for obstruction in obstructions]
        if not obstructions or enough != least and not math.isnan(obstructions[0].shortest):
            errors.append(_refuse_all(problem, enough))
    raise_all([*errors, *(obstruction.describe(scenario.duration)
                          for obstruction in obstructions)])
    raise AssertionError('there is at least one error')


def _refuse_all(problem: Problem, enough: float | None) -> InfeasibleMissionError:
    """Return the error of UAVs that cannot fly together; a duration in s may be enough."""
    scenario = problem.scenario
    names = ' and '.join(uav.name for uav in scenario.uavs)
    kept = {field: text for field, text, applies in (
        ('separation', f'keep the separation of {scenario.separation:g} m',
         problem.airspace.separations.any()),
        ('geofence', f'stay inside {GEOFENCE}', scenario.geofence is not None),
        ('no_fly_zones', 'avoid the no-fly zones', scenario.no_fly_zones)) if applies}
    more = '' if enough is None else f'; with a duration of {enough:g} s, some were'
    return InfeasibleMissionError(
        f'duration is {scenario.duration:g} s; no flights of {names} were found that '
        f'{" and ".join(kept.values())}{more}', (next(iter(kept)),))


def _find_obstructions(scenario: Scenario, number: int,
                       check: Check) -> Iterator[_Obstruction]:
    """Yield the reason why a UAV has no flight even if it is alone, if so."""
    uav = scenario.uavs[number]
    alone = Problem(replace(scenario, uavs=(uav,), separation=0.0))
    names = _name_obstacles(alone)
    if fly_direct(alone, 0) is None:
        yield _Obstruction(uav, number, math.inf, (
            f'no way leads {uav.name} from start to goal: {names} is in its way'))
    elif (names or scenario.geofence is not None) and (
            _search_direct_flights(alone, check) is None):
        around = f' around {names}' if names else ''
        if scenario.geofence is not None and GEOFENCE not in names:
            around += f' inside {GEOFENCE}'
        try:
            shortest = _find_duration_around(
                alone.scenario, scenario.duration, check, _search_direct_flights)
        except TimeLimitError:
            searched = 'in the time for the search'
        else:
            searched = 'however long'
            if shortest is not None:
                yield _Obstruction(uav, number, shortest, around)
                return
        yield _Obstruction(uav, number, math.inf, (
            f'no flight was found that takes {uav.name} from start to goal{around} '
            f'at {uav.limits_text}, {searched}'))


def _name_obstacles(problem: Problem) -> str:
    """Return the names of the obstacles that the straight line crosses, or of all if none."""
    uav, obstacles = problem.scenario.uavs[0], problem.airspace.obstacles[0]
    line = shapely.LineString([uav.start, uav.goal])
    crossed = [obstacle for obstacle in obstacles
               if shapely.Polygon(obstacle.vertices).intersects(line)]
    return ' or '.join(dict.fromkeys(obstacle.name for obstacle in crossed or obstacles))
