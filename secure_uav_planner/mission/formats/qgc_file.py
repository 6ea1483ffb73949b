"""The fence of a plan of QGroundControl."""

from collections.abc import Iterator, Mapping
import math
from typing import Any

import numpy as np

from .areas import Area, checked_corners, checked_field, checked_place, parse_json
from ..fields import MAX_DISTANCE
from ..geography import Origin
from ..validation import to_number
from ...errors import quote, ScenarioError

_CORNERS = 32  # Corners of the polygon for a circle.

# Versions that QGroundControl 3.3 to 5 write; its fences of version 1 have other fields.
_FENCE_VERSION = 2
_AREA_VERSIONS = (None, 1)

_FENCE_FIELDS = {'version', 'polygons', 'circles', 'breachReturn'}


def list_fence(text: str) -> list[tuple[Any, Any]]:
    """Return (name, JSON object) of each area of a QGroundControl plan's fence, for read_area."""
    fence = checked_field(parse_json(text), 'geoFence', Mapping, 'the fence of a plan')
    if (version := fence.get('version')) != _FENCE_VERSION:
        raise ScenarioError(f'the version of geoFence is {quote(version)}; it must be '
                            f'{_FENCE_VERSION}, which QGroundControl writes since 3.3')
    if (unread := sorted(name for name in fence.keys() - _FENCE_FIELDS if fence[name])):
        raise ScenarioError(f'geoFence has {quote(unread[0])}, which is not read; it must have '
                            'polygons and circles')
    return [(f'{kind} {number}', item) for kind in ('polygon', 'circle')
            for number, item in enumerate(
                checked_field({f'{kind}s': [], **fence}, f'{kind}s', list, 'a list'), start=1)]


def read_area(item: Any, origin: Origin) -> Iterator[Area]:
    """Yield the area of a polygon, or of a circle as a polygon; places have latitude first."""
    is_fence = checked_field(item, 'inclusion', bool, 'true or false')
    if (version := item.get('version')) not in _AREA_VERSIONS:
        raise ScenarioError(f'version is {quote(version)}; it must be 1')
    if 'circle' not in item:
        yield Area(checked_corners(item.get('polygon'), 0), is_fence=is_fence)
        return
    if 'polygon' in item:
        raise ScenarioError('it is a polygon and a circle; it must be one of them')
    circle = checked_field(item, 'circle', Mapping, 'a circle')
    place = checked_place('the centre', circle.get('center'), 0)
    radius = to_number(circle.get('radius'))
    if not 0 < radius <= MAX_DISTANCE / 2:
        raise ScenarioError(f'radius is {quote(circle.get("radius"))}; it must be above 0 and at '
                            f'most {MAX_DISTANCE / 2:g} m')
    try:
        origin.to_local(*place)  # A centre beyond 100 km is refused.
        centre = Origin(*place, origin.projection)
    except ValueError as error:
        raise ScenarioError(str(error).replace('origin.', 'the centre: ')) from None
    # The polygon is on the safe side: inside the circle of a fence, around the circle of a zone.
    reach = radius if is_fence else radius / math.cos(math.pi / _CORNERS)
    angles = 2 * np.pi * np.arange(_CORNERS) / _CORNERS
    yield Area([*zip(*(values.tolist() for values in centre.to_geographic(
        reach * np.cos(angles), reach * np.sin(angles))))], is_fence=is_fence)
