"""Initial flights and powers: fly-hover-fly or an earlier plan's, or why a mission has none."""

from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import replace
from functools import cache, partial
from itertools import chain, product
import math
from typing import NamedTuple, NoReturn

import numpy as np
import shapely

from .flights import build_flights, fly_direct, generate_direct_flights, list_hovering_places
from .projection import find_flights_near
from ..deadline import DeadlineCheck
from ...errors import (
    InfeasibleMissionError, OptionError, PlanError, ScenarioError, TimeLimitError)
from ...mission.consistency import refuse_duration, refuse_slow_uavs
from ...mission.fields import raise_all
from ...mission.kinematics import DURATION, find_shortest_duration, UTILISATION_TOLERANCE
from ...mission.scenario import Array, Scenario, Uav
from ...model.airspace import GEOFENCE
from ...model.grid import resample
from ...model.limits import EnergyLimit, NormLimit
from ...model.problem import Problem
from ...plan.plan import Plan

_LONGEST = 2**8  # Largest duration that is tried, as a multiple of the mission's.
_ACCURACY = 1e-6  # Relative accuracy of a duration limited by speed and acceleration.
_ACCURACY_AROUND = 2e-4  # Relative accuracy of a duration limited by obstacles.
_FINER = (2, 4, 8, 16)  # Multiples of the number of slots that are tried.
_LONGER = (1, 4)  # Multiples of the duration that are tried.
_ROUNDING = 1e-4  # Move [m] by which retract repairs rounding errors.


def check_durations(problem: Problem, raise_if_over: DeadlineCheck) -> None:
    """
    Raise an error unless each UAV, if it were alone, has the time from start to goal.

    :raises InfeasibleMissionError: for the slowest UAV, naming a duration that is enough for all,
        or that none is; `further` has the errors of the other slow UAVs. No duration is named if
        raise_if_over raises TimeLimitError during its search.
    """
    scenario, least_flights = problem.scenario, problem.grid.least_flights
    utilisations = least_flights.find_utilisations(scenario, raise_if_over)
    slow = [uav for uav, utilisation in zip(scenario.uavs, utilisations, strict=True)
            if not utilisation <= 1 + UTILISATION_TOLERANCE]
    if not slow:
        return

    def measure_utilisation(uavs: Sequence[Uav], duration: float) -> float:
        step = duration / scenario.slots
        return max(least_flights.find(uav.vehicle, scenario.slots, step, raise_if_over)[0]
                   for uav in uavs)

    try:
        shortest = [find_shortest_duration(partial(measure_utilisation, [uav]), scenario.duration,
                                           _ACCURACY) for uav in slow]
        if None not in shortest:
            slowest = max(range(len(slow)), key=lambda index: shortest[index] or 0.0)
            # More time is not always easier for flights with velocities at their ends.
            shortest[slowest] = find_shortest_duration(
                partial(measure_utilisation, scenario.uavs), shortest[slowest] or 0.0, _ACCURACY)
    except TimeLimitError:
        shortest = [math.nan] * len(slow)
    raise_all(refuse_slow_uavs(scenario.duration, zip(slow, shortest, strict=True)))


def _search_flights(problem: Problem, raise_if_over: DeadlineCheck) -> Array | None:
    """Return flights (U, N+2, 2) in m near fly-hover-fly, else near direct flights, or None."""
    places = problem.find_free_places(list_hovering_places(problem.scenario), raise_if_over)
    wanted = build_flights(problem, places, raise_if_over=raise_if_over)
    answers = (find_flights_near(problem, flights, raise_if_over) for flights in chain(
        [wanted], generate_direct_flights(problem, raise_if_over)))
    return next((flights for flights in answers if flights is not None), None)


def _find_duration_around(scenario: Scenario, duration: float, raise_if_over: DeadlineCheck
                          ) -> float | None:
    """Return the shortest duration [s] found that has flights and is >= `duration`, or None."""
    longest = min(_LONGEST * scenario.duration, DURATION.high)

    @cache
    def measure_utilisation(duration: float) -> float:
        """Return 0.5 if flights of a duration [s] are found, else 2: only the side of 1 counts."""
        longer = Problem(replace(scenario, duration=duration))
        utilisations = longer.grid.least_flights.find_utilisations(longer.scenario, raise_if_over)
        has_time = (utilisations <= 1 + UTILISATION_TOLERANCE).all()
        is_flyable = has_time and _search_flights(longer, raise_if_over) is not None
        return 0.5 if is_flyable else 2.0

    # Longer is always easier for a flight from rest to rest.
    if (all(uav.start_velocity == uav.goal_velocity == (0.0, 0.0) for uav in scenario.uavs)
            and measure_utilisation(longest) > 1):
        return None
    return find_shortest_duration(measure_utilisation, duration, _ACCURACY_AROUND, longest)


class _Obstruction(NamedTuple):
    """
    Reason why a UAV has no flight even if it is alone.

    :ivar shortest: a duration in s that is long enough; NaN if unknown, infinite if there is none.
    :ivar text: the way around obstacles of a flight of that duration; the whole reason if there is
        no such duration.
    """

    uav: Uav
    number: int
    shortest: float
    text: str

    def describe(self, duration: float) -> InfeasibleMissionError:
        """Return the error of this obstruction for a mission of a duration [s]."""
        if math.isinf(self.shortest):
            return InfeasibleMissionError(self.text, ('uavs', self.number))
        return refuse_duration(duration, self.uav, self.shortest, self.text)


def _raise_infeasibility(problem: Problem, raise_if_over: DeadlineCheck) -> NoReturn:
    """
    Raise the InfeasibleMissionError that says why no flights were found.

    Each UAV without a flight even if it is alone has an error. An error of all UAVs together comes
    first if there is no such UAV, or if all need longer together than each alone.
    """
    scenario, obstructions = problem.scenario, list[_Obstruction]()
    try:
        for number in range(len(scenario.uavs)):
            obstructions += _find_obstructions(scenario, number, raise_if_over)
    except TimeLimitError:
        if not obstructions:
            raise
    obstructions.sort(key=lambda obstruction: -obstruction.shortest)
    each = obstructions[0].shortest if obstructions else scenario.duration
    errors = []
    if math.isfinite(each):  # Some duration [s] suffices for each UAV alone.
        try:
            together = _find_duration_around(scenario, each, raise_if_over)
        except TimeLimitError:
            together = None
            obstructions = [obstruction._replace(shortest=math.nan)
                            for obstruction in obstructions]
        if not obstructions or together != each and not math.isnan(obstructions[0].shortest):
            errors.append(_refuse_all(problem, together, raise_if_over))
    raise_all([*errors, *(obstruction.describe(scenario.duration)
                          for obstruction in obstructions)])
    raise AssertionError('there is at least one error')


def _refuse_all(problem: Problem, enough: float | None, raise_if_over: DeadlineCheck
                ) -> InfeasibleMissionError:
    """
    Return the error of UAVs that cannot fly together.

    :param enough: a duration [s] in which flights were found, or None.
    """
    scenario = problem.scenario
    names = ' and '.join(uav.name for uav in scenario.uavs)
    kept = {field: text for field, text, applies in (
        ('separation', f'keep the separation of {scenario.separation:g} m',
         problem.airspace.separations.any()),
        ('geofence', f'stay inside {GEOFENCE}', scenario.geofence is not None),
        ('no_fly_zones', 'avoid the no-fly zones', scenario.no_fly_zones)) if applies}
    more = (_advise_slots(scenario, raise_if_over) if enough is None else
            f'; with a duration of {enough:g} s, some were')
    return InfeasibleMissionError(
        f'duration is {scenario.duration:g} s; no flights of {names} were found that '
        f'{" and ".join(kept.values())}{more}', (next(iter(kept)),))


def _find_obstructions(scenario: Scenario, number: int,
                       raise_if_over: DeadlineCheck) -> Iterator[_Obstruction]:
    """Yield the reason why a UAV has no flight even if it is alone; yield nothing if it has."""
    uav = scenario.uavs[number]
    alone = Problem(replace(scenario, uavs=(uav,), separation=0.0))
    names = _name_obstacles(alone)
    if fly_direct(alone, 0) is None:
        yield _Obstruction(uav, number, math.inf, (
            f'no way leads {uav.name} from start to goal: {names} is in its way'
            f'{_advise_slots(alone.scenario, raise_if_over)}'))
    elif (names or scenario.geofence is not None) and (
            _search_flights(alone, raise_if_over) is None):
        around = f' around {names}' if names else ''
        if scenario.geofence is not None and GEOFENCE not in names:
            around += f' inside {GEOFENCE}'
        try:
            shortest = _find_duration_around(alone.scenario, scenario.duration, raise_if_over)
        except TimeLimitError:
            searched = 'in the time for the search'
        else:
            searched = 'however long'
            if shortest is not None:
                yield _Obstruction(uav, number, shortest, around)
                return
        yield _Obstruction(uav, number, math.inf, (
            f'no flight was found that takes {uav.name} from start to goal{around} '
            f'at {uav.limits_text}, {searched}{_advise_slots(alone.scenario, raise_if_over)}'))


def _advise_slots(scenario: Scenario, raise_if_over: DeadlineCheck) -> str:
    """Return advice on more slots, perhaps with a longer duration, that have flights, or ''."""
    # A slot's piece of a flight is straight, and may be too long for a narrow gap.
    with suppress(TimeLimitError):
        for longer, factor in product(_LONGER, _FINER):
            slots, duration = factor * scenario.slots, longer * scenario.duration
            with suppress(ScenarioError):  # Too many slots, or too long a duration.
                finer = Problem(replace(scenario, slots=slots, duration=duration))
                if all(fly_direct(finer, number) is not None
                       for number in range(len(scenario.uavs))) and (
                           _search_flights(finer, raise_if_over) is not None):
                    more = '' if longer == 1 else f' and a duration of {duration:g} s'
                    return (f'; slots are {scenario.slot_duration:g} s long, and with {slots} '
                            f'slots{more} such flights were found')
    return ''


def _name_obstacles(problem: Problem) -> str:
    """Return names of the obstacles on the line from UAV 0's start to its goal; if none, all."""
    uav, obstacles = problem.scenario.uavs[0], problem.airspace.obstacles[0]
    line = shapely.LineString([uav.start, uav.goal])
    crossed = [obstacle for obstacle in obstacles
               if shapely.Polygon(obstacle.vertices).intersects(line)]
    return ' or '.join(dict.fromkeys(obstacle.name for obstacle in crossed or obstacles))


def fly_hover_fly_positions(problem: Problem,
                            raise_if_over: DeadlineCheck = lambda: None) -> Array:
    """
    Return straight flights at full speed to a hovering place and on to the goal, (U, N+2, 2) in m.

    list_hovering_places chooses the places. A UAV without the time to reach its place flies
    towards it and turns back at the last moment from which it reaches the goal. With zones, a
    fence or a separation, flights that keep all limits are sought near these, then near direct
    flights from start to goal.

    :raises InfeasibleMissionError: if no flights that keep all limits are found, naming the UAVs,
        the obstacles or limits, and a duration with which flights are found; `further` has the
        errors of more UAVs. No duration is named if raise_if_over raises TimeLimitError during its
        search.
    """
    check_durations(problem, raise_if_over)
    if problem.airspace.is_open:
        return build_flights(problem, list_hovering_places(problem.scenario))
    flights = _search_flights(problem, raise_if_over)
    if flights is None:
        _raise_infeasibility(problem, raise_if_over)
    return flights


def constant_powers(scenario: Scenario) -> Array:
    """Return the average powers in every slot, (U, N) in W."""
    return np.repeat(scenario.average_powers[:, None], scenario.slots, axis=1)


def is_similar(scenario: Scenario, previous: Scenario) -> bool:
    """
    Return True if a plan for the previous scenario is a good start for a scenario.

    The numbers of UAVs and receivers are equal, durations differ by at most 10%, and no start,
    goal or receiver has moved by more than the lowest altitude, over which gains change little.
    """
    if (len(scenario.uavs) != len(previous.uavs)
            or len(scenario.eavesdroppers) != len(previous.eavesdroppers)
            or len(scenario.ground_nodes) != len(previous.ground_nodes)
            or abs(scenario.duration - previous.duration) > 0.1 * previous.duration):
        return False
    moves = _list_landmarks(scenario) - _list_landmarks(previous)
    return bool(np.linalg.norm(moves, axis=-1).max() <= scenario.altitudes.min())


def _list_landmarks(scenario: Scenario) -> Array:
    """Return starts, goals and receivers at the start, middle and end, (K, 2) in m."""
    grounds, centres, _ = scenario.receivers_at(
        [0.0, scenario.duration / 2, scenario.duration])
    return np.concatenate([scenario.starts, scenario.goals, *grounds, *centres])


def adapt_plan(problem: Problem, plan: Plan,
               raise_if_over: DeadlineCheck = lambda: None) -> tuple[Array | None, Array]:
    """
    Return positions (U, N+2, 2) in m and powers (U, N) in W of a plan adapted to another problem.

    Slots are matched by their share of the duration. The moves of starts and goals are blended
    over the whole flight. Flights that break limits are replaced: by find_flights_near, or if this
    fails by Problem.retract. If neither keeps all limits, the positions are None.

    :raises OptionError: when the number of UAVs differs.
    :raises InfeasibleMissionError: when a UAV has not the time from start to goal.
    :raises TimeLimitError: when the time is over and Problem.retract does not keep all limits.
    """
    scenario = problem.scenario
    if len(plan.scenario.uavs) != len(scenario.uavs):
        raise OptionError(f'initial is a plan for {len(plan.scenario.uavs)} UAVs; '
                          f'it must be one for {len(scenario.uavs)}', ('initial',))
    positions = plan.positions
    if scenario.slots != plan.scenario.slots:
        # Interpolated control points would double accelerations in every second slot; points of
        # the curve keep them.
        positions = plan.curve.at(np.linspace(0, plan.times[-1], scenario.slots + 2)).positions
    share = np.linspace(0, 1, scenario.slots + 2)
    ends = np.stack([scenario.starts, scenario.goals], axis=1) - positions[:, [0, -1]]
    positions = positions + (1 - share)[:, None] * ends[:, :1] + share[:, None] * ends[:, 1:]
    powers = problem.retract_powers(resample(plan.powers.T, scenario.slots, inner=True).T)
    if not problem.keeps_motion(positions):
        check_durations(problem, raise_if_over)
    retracted = problem.retract(positions)
    clear = problem.is_clear(retracted)
    if clear and np.abs(retracted - positions).max() < _ROUNDING:
        return retracted, powers
    try:
        feasible = find_flights_near(problem, positions, raise_if_over)
    except TimeLimitError:
        if not clear:
            raise
        feasible = None
    if feasible is None and clear:
        feasible = retracted
    try:
        for limit in problem.limits:
            # Flights near a plan keep the limits of motion; solvers may exceed energy limits.
            if feasible is not None and not isinstance(limit, (EnergyLimit, NormLimit)):
                limit.validate(feasible, powers)
    except PlanError:
        feasible = None
    return feasible, powers
