"""Inconsistencies of a mission whose fields are right, each by itself, and their refusals."""

from collections.abc import Iterable, Iterator
from functools import partial
from itertools import combinations
import math
from operator import itemgetter
from typing import TYPE_CHECKING

from .kinematics import DURATION, find_shortest_duration, UTILISATION_TOLERANCE
from .participants import Eavesdropper, GroundNode, Uav
from .polygons import depth, Vertices
from .validation import round_down
from ..errors import InfeasibleMissionError, quote, ScenarioError

if TYPE_CHECKING:
    from .scenario import Scenario

POSITION_TOLERANCE = 1e-6
"""Largest violation of a limit by a place in m, for rounding."""

MAX_COUPLINGS = 10**7
"""The most pairs of variables of a slot, slots * (3 uavs)^2: a step then takes about 1 s."""

_DEFAULT_NAMES = (  # Several may have it.
    ('eavesdroppers', Eavesdropper.name), ('ground_nodes', GroundNode.name))


def find_inconsistencies(scenario: 'Scenario') -> Iterator[ScenarioError]:
    """Yield the errors of names, sizes and vehicles, of ends of flights, and of the duration."""
    yield from _check_size(scenario)
    yield from _check_accelerations(scenario)
    yield from _check_ends(scenario)
    yield from _check_durations(scenario)


def _check_size(scenario: 'Scenario') -> Iterator[ScenarioError]:
    """Yield the errors of names and of the number of variables."""
    for field in ('uavs', 'eavesdroppers', 'ground_nodes'):
        names = [member.name for member in getattr(scenario, field)]
        for number, name in enumerate(names):
            if name in names[:number] and (field, name) not in _DEFAULT_NAMES:
                yield ScenarioError(f'{field} are named {quote(names)}; the names must be '
                                    'unique', (field, number, 'name'))
    nodes, starts = len(scenario.ground_nodes), scenario.head_starts
    if len(starts) not in (0, nodes):
        yield ScenarioError(f'head_starts is {quote(starts)}; it must be a number for each of the '
                            f'{nodes} ground_nodes, or empty', ('head_starts',))
    most = MAX_COUPLINGS // (3 * len(scenario.uavs))**2
    if scenario.slots > most:
        yield ScenarioError(f'slots is {scenario.slots}; with {len(scenario.uavs)} uavs it must '
                            f'be at most {most}, or a plan would take too long and too much '
                            'memory', ('slots',))


def _check_accelerations(scenario: 'Scenario') -> Iterator[ScenarioError]:
    """Yield an error where some UAVs have a limit of acceleration and some have none."""
    limited = [uav.max_acceleration is not None for uav in scenario.uavs]
    if any(limited) and not all(limited):
        first, without = limited.index(True), limited.index(False)
        yield ScenarioError(
            f'all uavs have a max_acceleration or none: {scenario.uavs[without].name} has none, '
            f'{scenario.uavs[first].name} has {scenario.uavs[first].max_acceleration:g} m/s^2',
            ('uavs', without, 'max_acceleration'))


def _check_ends(scenario: 'Scenario') -> Iterator[ScenarioError]:
    """Yield the errors of the ends of flights: zones, fence and separation."""
    close, fence = [], None
    try:
        fence = scenario.keep_in
    except ScenarioError as error:
        yield error
    for field in ('start', 'goal'):
        # The curve may leave its first and last control point by its bend. The start of the
        # tail of a plan may itself violate a limit by rounding.
        slacks = [2 * POSITION_TOLERANCE + uav.end_deviation(field, scenario.slot_duration)
                  for uav in scenario.uavs]
        for number, slack in enumerate(slacks):
            yield from _check_end(scenario, number, field, slack, fence)
        for (first, slack1), (second, slack2) in combinations(zip(scenario.uavs, slacks), 2):
            distance = math.hypot(math.dist(getattr(first, field), getattr(second, field)),
                                  first.altitude - second.altitude)
            if distance < scenario.keep_apart - slack1 - slack2:
                close.append((distance, field, first.name, second.name))
    if close:
        distance, field, *names = min(close, key=itemgetter(0))
        most = round_down(max(distance - 2 * scenario.tracking_margin, 0.0))
        margin = f'{scenario.margin_text[1:]} ' if scenario.tracking_margin else ''
        yield ScenarioError(
            f'separation is {scenario.separation:g} m; {margin}it must be at most {most:g} m, the '
            f'distance between the {field}s of {" and ".join(names)}'
            + (' less twice the margin' if margin else ''), ('separation',))


def _check_end(scenario: 'Scenario', number: int, field: str, slack: float,
               fence: Vertices | None) -> Iterator[ScenarioError]:
    """Yield the errors of the start or the goal of a UAV: zones and fence."""
    uav = scenario.uavs[number]
    place = getattr(uav, field)
    for vertices, name in scenario.keep_out(uav.altitude):
        if depth(vertices, place) > slack:
            yield ScenarioError(
                f'{uav.name}.{field} is {quote(place)} at {uav.altitude:g} m, inside '
                f'{name}{scenario.margin_text}; it must be outside all no_fly_zones',
                ('uavs', number, field))
    if fence is not None and depth(fence, place) < -slack:
        yield ScenarioError(
            f'{uav.name}.{field} is {quote(place)}, outside the geofence{scenario.margin_text}; '
            'it must be inside', ('uavs', number, field))


def _check_durations(scenario: 'Scenario') -> Iterator[ScenarioError]:
    """
    Yield an error for each UAV that needs more time for the straight line.

    Where a velocity at an end leads a UAV away from it, optimize.initial asks for all of them.
    """
    if not all(uav.vehicle.is_straight for uav in scenario.uavs):
        return

    def measure_utilisation(uav: Uav, duration: float) -> float:
        return uav.vehicle.straight_utilisation(scenario.slots, duration / scenario.slots)

    yield from refuse_slow_uavs(scenario.duration, (
        (uav, find_shortest_duration(partial(measure_utilisation, uav), scenario.duration))
        for uav in scenario.uavs
        if not measure_utilisation(uav, scenario.duration) <= 1 + UTILISATION_TOLERANCE))


def refuse_slow_uavs(duration: float, slow: Iterable[tuple[Uav, float | None]]
                     ) -> list[InfeasibleMissionError]:
    """
    Return the errors of UAVs that need more time, the slowest first.

    :param duration: the mission's in s.
    :param slow: each UAV with a duration in s that suffices, NaN for an unknown one, and None if
        no allowed one does.
    """
    order = sorted(slow, key=lambda item: -(math.inf if item[1] is None else item[1]))
    return [refuse_duration(duration, uav, shortest) for uav, shortest in order]


def refuse_duration(duration: float, uav: Uav, shortest: float | None, way: str = ''
                    ) -> InfeasibleMissionError:
    """Return the error of a UAV; its `way` may be such as ' around tower'."""
    if shortest is None:
        needs = f'none of up to {DURATION.high:g} s takes {uav.name}'
    else:
        time = 'longer' if math.isnan(shortest) else f'at least {shortest:g} s'
        needs = f'{uav.name} needs {time}'
    return InfeasibleMissionError(
        f'duration is {duration:g} s; {needs} from start to goal{way} at {uav.limits_text}',
        ('duration',))
