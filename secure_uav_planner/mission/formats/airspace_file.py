"""Airspace files: zones and a fence from GeoJSON, plans of QGroundControl, and KML."""

from collections.abc import Callable, Iterator
import os
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import shapely

from .areas import Area
from .documents import FileProblem, make_file_error
from .geojson_file import list_features, read_feature
from .kml_file import list_placemarks, read_polygons
from .qgc_file import list_fence, read_area
from ..fields import ErrorList
from ..files import checked_path, decode_text, read_bytes
from ..geography import convert_ring, Origin, unwrap
from ..participants import NoFlyZone
from ..polygons import checked_polygon, Vertices
from ..validation import checked_kind
from ...errors import brief, OptionError, prefix_path, quote, ScenarioError

MOST_BYTES = 2**22
MOST_FEATURES = 1000


def read_zones(path: str | os.PathLike[str], origin: Origin
               ) -> tuple[tuple[NoFlyZone, ...], Vertices | None]:
    """
    Read no-fly zones and a geofence from a file, converted as the origin's autopilot does.

    :param path: file of GeoJSON (.geojson or .json: Polygon and MultiPolygon in WGS84, as features
        with name, floor and ceiling in m above the ground, or floor_amsl and ceiling_amsl; or a
        map that Plan.to_geojson wrote), plan of QGroundControl (.plan: the fence), or file of KML
        (.kml: polygons).
    :return: the zones, and the vertices of the geofence in m, None if the file has no fence.
    :raises OSError: when the file cannot be read, is no regular file, or is too large.
    :raises MissionFileError: naming the file, the feature, and what is allowed.
    """
    checked_kind('origin', origin, Origin)
    errors, zones, fences = ErrorList(), [], []
    for number, (name, feature, read) in enumerate(_list_features(path), start=1):
        label = quote(name)[1:-1] if name and isinstance(name, str) else f'feature {number}'
        with errors.collecting(owner=f'{label}: '):
            for area in _join_areas([*read(feature, origin)], origin):
                try:
                    vertices = convert_ring(area.corners, origin)
                except OptionError as error:
                    raise ScenarioError(str(error)) from None
                if area.is_fence:
                    with prefix_path('geofence'):
                        fences.append(checked_polygon(vertices))
                    continue
                zone = NoFlyZone(vertices, area.floor, area.ceiling, name or '')
                if not zone.ceiling:
                    raise ScenarioError('its ceiling is 0 m above the ground, so that it holds '
                                        'nowhere; it must be above 0')
                zones.append(zone)
    if len(fences) > 1:
        errors.append(ScenarioError(f'it has {len(fences)} areas to stay in, more than one'))
    if not (errors or zones or fences):
        errors.append(ScenarioError('it has no area'))
    if errors:
        raise make_file_error(path, [FileProblem(None, brief(error)) for error in errors])
    return tuple(zones), fences[0] if fences else None


def _list_features(path: str | os.PathLike[str]) -> list[tuple[Any, Any, Any]]:
    """
    Return (name, content, function that yields the areas in content) of each feature.

    :raises OSError: as read_bytes does.
    :raises MissionFileError: if the path or the content is wrong, or has too many features.
    """
    try:
        suffix = Path(checked_path(path)).suffix.lower()
        if suffix not in _FORMATS:
            raise ScenarioError(f'its path must have the ending {" or ".join(_FORMATS)}')
        list_named, read = _FORMATS[suffix]
        features = list_named(read_bytes(path, MOST_BYTES))
        if len(features) > MOST_FEATURES:
            raise ScenarioError(f'it has {len(features)} features, more than {MOST_FEATURES}')
        return [(name, feature, read) for name, feature in features]
    except RecursionError:
        reason = 'it has too many levels'
    except UnicodeDecodeError as error:
        reason = f'it is not UTF-8 text: {error.reason} at byte {error.start}'
    except (ValueError, LookupError, ElementTree.ParseError) as error:
        reason = brief(error)
    raise make_file_error(path, [FileProblem(None, reason)])


def _join_areas(areas: list[Area], origin: Origin) -> list[Area]:
    """
    Join the areas of a feature that the meridian of 180 degrees cuts (RFC 7946, 3.1.9).

    Two parts would leave a way between them, since plans may touch the edges of zones. Areas are
    returned as they are if none has a corner at 180 degrees, or if they differ in floor, ceiling
    or is_fence.
    """
    if not any(abs(place[1]) == 180 for area in areas for place in area.corners) or any(
            area[1:] != areas[0][1:] for area in areas):
        return areas
    polygons = [shapely.Polygon(unwrap(area.corners, origin)) for area in areas]
    if not all(polygon.is_valid for polygon in polygons):
        return areas  # checked_polygon refuses their outlines.
    joined = shapely.get_parts(shapely.union_all(polygons))
    if any(polygon.interiors for polygon in joined):
        raise ScenarioError('it has a hole; cut it into polygons without one')
    return [areas[0]._replace(corners=polygon.exterior.coords[:-1]) for polygon in joined]


def _decoded(list_named: Callable[[str], list[tuple[Any, Any]]]
             ) -> Callable[[bytes], list[tuple[Any, Any]]]:
    return lambda data: list_named(decode_text(data))


_GEOJSON: tuple[Callable[[bytes], list[tuple[Any, Any]]],
                Callable[[Any, Origin], Iterator[Area]]] = (_decoded(list_features), read_feature)
_FORMATS = {'.geojson': _GEOJSON, '.json': _GEOJSON, '.plan': (_decoded(list_fence), read_area),
            '.kml': (list_placemarks, read_polygons)}
"""By suffix: a function that lists the features in a file, and one that reads their areas."""
