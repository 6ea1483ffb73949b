"""Checks of a mission's fields against each other, after each was checked by itself."""

from collections.abc import Iterable, Iterator, Sequence
from functools import partial
from itertools import combinations
import math
from operator import itemgetter

from .kinematics import DURATION, find_shortest_duration, UTILISATION_TOLERANCE
from .participants import Boundaries, Eavesdropper, GroundNode, Uav
from .polygons import depth, Vertices
from .validation import round_down
from ..errors import InfeasibleMissionError, quote, ScenarioError

POSITION_TOLERANCE = 1e-6
"""Largest distance in m by which a place may violate a limit, for rounding."""

MAX_COUPLINGS = 10**7
"""Largest slots * (3 uavs)^2, the pairs of variables in a slot; a step then takes about 1 s."""

_DEFAULT_NAMES = (  # Names that several members may share.
    ('eavesdroppers', Eavesdropper.name), ('ground_nodes', GroundNode.name))


def check_names(uavs: Sequence[Uav], eavesdroppers: Sequence[Eavesdropper],
                ground_nodes: Sequence[GroundNode]) -> Iterator[ScenarioError]:
    """Yield an error for each repeated name of a kind; default names may repeat."""
    for field, members in (('uavs', uavs), ('eavesdroppers', eavesdroppers),
                           ('ground_nodes', ground_nodes)):
        names = [member.name for member in members]
        for number, name in enumerate(names):
            if name in names[:number] and (field, name) not in _DEFAULT_NAMES:
                yield ScenarioError(f'{field} are named {quote(names)}; the names must be '
                                    'unique', (field, number, 'name'))


def check_sizes(uavs: Sequence[Uav], slots: int, ground_nodes: Sequence[GroundNode],
                head_starts: Sequence[float]) -> Iterator[ScenarioError]:
    """Yield an error for a wrong number of head_starts, and one for slots over the limit."""
    nodes = len(ground_nodes)
    if len(head_starts) not in (0, nodes if nodes > 1 else 0):
        allowed = (f'a number for each of the {nodes} ground_nodes, or empty' if nodes > 1 else
                   'empty, as there is a single ground node')
        yield ScenarioError(f'head_starts is {quote(head_starts)}; it must be {allowed}',
                            ('head_starts',))
    most = MAX_COUPLINGS // (3 * len(uavs))**2
    if slots > most:
        yield ScenarioError(f'slots is {slots}; with {len(uavs)} uavs it must be at most {most}, '
                            'or a plan would take too long and too much memory', ('slots',))


def check_accelerations(uavs: Sequence[Uav]) -> Iterator[ScenarioError]:
    """Yield an error if some UAVs have a limit of acceleration and some have none."""
    limited = [uav.max_acceleration is not None for uav in uavs]
    if any(limited) and not all(limited):
        first, without = limited.index(True), limited.index(False)
        yield ScenarioError(
            f'all uavs have a max_acceleration or none: {uavs[without].name} has none, '
            f'{uavs[first].name} has {uavs[first].max_acceleration:g} m/s^2',
            ('uavs', without, 'max_acceleration'))


def check_ends(uavs: Sequence[Uav], slot_duration: float, separation: float,
               boundaries: Boundaries) -> Iterator[ScenarioError]:
    """Yield errors of starts and goals: zones, fence, then the closest pair if it is too close."""
    close, fence = [], None
    try:
        fence = boundaries.keep_in
    except ScenarioError as error:
        yield error
    for field in ('start', 'goal'):
        # The flown curve passes the start and the goal at a distance of up to end_deviation.
        # A plan's tail may start beyond a limit by POSITION_TOLERANCE, from rounding.
        slacks = [2 * POSITION_TOLERANCE + uav.end_deviation(field, slot_duration)
                  for uav in uavs]
        for number, slack in enumerate(slacks):
            yield from _check_end(uavs[number], ('uavs', number, field), slack, boundaries, fence)
        for (first, slack1), (second, slack2) in combinations(zip(uavs, slacks), 2):
            distance = math.hypot(math.dist(getattr(first, field), getattr(second, field)),
                                  first.altitude - second.altitude)
            if distance < boundaries.keep_apart - slack1 - slack2:
                close.append((distance, field, first.name, second.name))
    if close:
        distance, field, *names = min(close, key=itemgetter(0))
        most = round_down(max(distance - 2 * boundaries.margin, 0.0))
        margin = f'{boundaries.margin_text[1:]} ' if boundaries.margin else ''
        yield ScenarioError(
            f'separation is {separation:g} m; {margin}it must be at most {most:g} m, '
            f'the distance between the {field}s of {" and ".join(names)}'
            + (' less twice the margin' if margin else ''), ('separation',))


def _check_end(uav: Uav, path: tuple[str, int, str], slack: float, boundaries: Boundaries,
               fence: Vertices | None) -> Iterator[ScenarioError]:
    """
    Yield the errors of a UAV's start or goal inside a zone or outside the fence.

    :param path: path of the start or the goal, such as ('uavs', 0, 'start').
    :param slack: largest allowed distance [m] of the place inside a zone, or outside the fence.
    """
    field = path[-1]
    place = getattr(uav, field)
    for vertices, name in boundaries.keep_out(uav.altitude):
        if depth(vertices, place) > slack:
            yield ScenarioError(
                f'{uav.name}.{field} is {quote(place)} at {uav.altitude:g} m, inside '
                f'{name}{boundaries.margin_text}; it must be outside all no_fly_zones', path)
    if fence is not None and depth(fence, place) < -slack:
        yield ScenarioError(
            f'{uav.name}.{field} is {quote(place)}, outside the geofence{boundaries.margin_text}; '
            'it must be inside', path)


def check_durations(uavs: Sequence[Uav], duration: float, slots: int
                    ) -> Iterator[ScenarioError]:
    """
    Yield an error for each UAV that needs more time for a straight flight, the slowest first.

    Nothing is checked if an end velocity bends the flight of any UAV: the first flights in
    optimize.initial then check all UAVs.
    """
    if not all(uav.vehicle.is_straight_optimal for uav in uavs):
        return

    def measure_utilisation(uav: Uav, duration: float) -> float:
        return uav.vehicle.straight_utilisation(slots, duration / slots)

    yield from refuse_slow_uavs(duration, (
        (uav, find_shortest_duration(partial(measure_utilisation, uav), duration))
        for uav in uavs if not measure_utilisation(uav, duration) <= 1 + UTILISATION_TOLERANCE))


def refuse_slow_uavs(duration: float, slow: Iterable[tuple[Uav, float | None]]
                     ) -> list[InfeasibleMissionError]:
    """
    Return the errors of UAVs that need more time, the slowest first.

    :param duration: duration of the mission in s.
    :param slow: (UAV, duration in s that suffices). The duration is None if no allowed duration
        suffices. It is NaN for all UAVs if it is not known; their order is then kept.
    """
    order = sorted(slow, key=lambda item: -(math.inf if item[1] is None else item[1]))
    return [refuse_duration(duration, uav, shortest) for uav, shortest in order]


def refuse_duration(duration: float, uav: Uav, shortest: float | None, way: str = ''
                    ) -> InfeasibleMissionError:
    """
    Return the error of a UAV that needs more time than the mission's duration [s].

    :param shortest: duration that the UAV needs [s], NaN if unknown, None if none suffices.
    :param way: words after 'from start to goal', such as ' around tower'.
    """
    if shortest is None:
        needs = f'none of up to {DURATION.high:g} s takes {uav.name}'
    else:
        time = 'longer' if math.isnan(shortest) else f'at least {shortest:g} s'
        needs = f'{uav.name} needs {time}'
    return InfeasibleMissionError(
        f'duration is {duration:g} s; {needs} from start to goal{way} at {uav.limits_text}',
        ('duration',))
