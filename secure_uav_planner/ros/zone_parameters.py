"""Parameters of the airspace: separation, no-fly zones, the geofence and their margin."""

from collections.abc import Mapping, Sequence
import math
from typing import Any

from .parameters import NO_LIMIT
from .spec import Spec
from ..errors import ParameterError, shown
from ..mission.participants import NoFlyZone
from ..mission.polygons import checked_polygon, MAX_VERTICES
from ..mission.scenario import LIMITS, Point

_POLYGON = (6, 2 * MAX_VERTICES)  # How many numbers it has.


def zone_parameters(name: str) -> dict[str, Spec]:
    """Return the parameters of one no-fly zone by name."""
    return {
        f'{name}.vertices': Spec(
            [], 'Vertices of the polygon in m, one after the other as [x1, y1, x2, y2, ...]. It '
            'need not be convex.', LIMITS['coordinate'], length=_POLYGON),
        f'{name}.floor': Spec(
            LIMITS['floor'][0], 'Lowest altitude in m that is forbidden.', LIMITS['floor']),
        f'{name}.ceiling': Spec(
            NO_LIMIT, 'Highest altitude in m that is forbidden; 0 for no limit.',
            (NO_LIMIT, LIMITS['altitude'][1]))}


def airspace_from(values: Mapping[str, Any]) -> dict[str, Any]:
    """
    Return separation, margin, zones and geofence of a Scenario, as the parameter values say.

    :raises PlanningError: for a zone or a fence that is no polygon; the text names the parameter.
    """
    fence = values['geofence']
    return {
        'separation': values['separation'],
        'tracking_margin': values['tracking_margin'],
        'no_fly_zones': tuple(_zone(values, name) for name in values['no_fly_zones']),
        'geofence': checked_polygon('', 'geofence', _points('geofence', fence)) if fence else None}


def _zone(values: Mapping[str, Any], name: str) -> NoFlyZone:
    return NoFlyZone(
        _points(f'{name}.vertices', values[f'{name}.vertices']), values[f'{name}.floor'],
        values[f'{name}.ceiling'] or math.inf, name)


def _points(field: str, numbers: Sequence[float]) -> tuple[Point, ...]:
    """Return x1, y1, x2, y2, ... as points."""
    if len(numbers) % 2:
        raise ParameterError(f'{field} is {shown(list(numbers))}; it must have an even number of '
                             'coordinates x1, y1, x2, y2, ...')
    return tuple(zip(numbers[::2], numbers[1::2], strict=True))
