"""Airspace files: zones and a fence from GeoJSON, plans of QGroundControl, and KML."""

from collections.abc import Iterator, Mapping, Sequence
import json
import math
import os
from pathlib import Path
import re
from typing import Any, TypeAlias
from xml.etree import ElementTree

import numpy as np

from .documents import FileProblem, make_file_error
from ..fields import ErrorList, MAX_DISTANCE
from ..files import checked_path, read_text
from ..geography import Origin
from ..participants import NoFlyZone
from ..polygons import checked_polygon, Vertices
from ..validation import checked_kind, is_sequence, to_number
from ...errors import brief, OptionError, prefix_path, quote, ScenarioError

MOST_BYTES = 2**22
MOST_FEATURES = 1000

_CORNERS = 32  # Of the polygon for a circle.
_LARGEST_BEND = 0.1  # m, of an edge that is straight in degrees, in the local frame.

# Names of properties: times of validity, and altitudes that are not above the ground.
_UNKEPT = re.compile(
    r'(?P<time>valid|applicab|expir|schedule|(start|end|begin|from|to)_?(date_?)?time)|'
    r'(?<!^floor_)(?<!^ceiling_)amsl|_msl|^(upper|lower|altitude|vertical)', re.I)

_Area: TypeAlias = tuple[Sequence[Any], Any, Any, bool]
"""Corners (latitude, longitude) in degrees, floor and ceiling in m, and whether to stay inside."""


def read_zones(path: str | os.PathLike[str], origin: Origin
               ) -> tuple[tuple[NoFlyZone, ...], Vertices | None]:
    """
    Read no-fly zones and a geofence from a file, converted as the origin's autopilot does.

    :param path: of GeoJSON (.geojson or .json: Polygon and MultiPolygon, as features with name,
        floor and ceiling in m above the ground, or floor_amsl and ceiling_amsl); of a plan of
        QGroundControl (.plan: its fence); or of KML (.kml: polygons).
    :return: the zones, and the vertices of the geofence in m; None where the file has none.
    :raises OSError: when the file cannot be read, is no regular file, or is too large.
    :raises MissionFileError: naming the file, the feature, and what is allowed.
    """
    checked_kind('origin', origin, Origin)
    errors, zones, fences = ErrorList(), [], []
    for number, (name, feature, read) in enumerate(_list_features(path), start=1):
        label = quote(name)[1:-1] if name and isinstance(name, str) else f'feature {number}'
        with errors.collecting(owner=f'{label}: '):
            for corners, floor, ceiling, is_fence in read(feature, origin):
                vertices = _convert_ring(corners, origin)
                if is_fence:
                    with prefix_path('geofence'):
                        fences.append(checked_polygon(vertices))
                else:
                    zones.append(NoFlyZone(vertices, floor, ceiling, name or ''))
    if len(fences) > 1:
        errors.append(ScenarioError(f'it has {len(fences)} areas to stay in, more than one'))
    if not (errors or zones or fences):
        errors.append(ScenarioError('it has no area'))
    if errors:
        raise make_file_error(path, [FileProblem(None, brief(error)) for error in errors])
    return tuple(zones), fences[0] if fences else None


def _list_features(path: str | os.PathLike[str]) -> list[tuple[Any, Any, Any]]:
    """Return the name and the content of each feature, and the function that reads its areas."""
    try:
        suffix = Path(checked_path(path)).suffix.lower()
        if suffix not in _FORMATS:
            raise ScenarioError(f'its path must have the ending {" or ".join(_FORMATS)}')
        list_named, read = _FORMATS[suffix]
        features = list_named(read_text(path, MOST_BYTES).removeprefix('\ufeff'))
        if len(features) > MOST_FEATURES:
            raise ScenarioError(f'it has {len(features)} features, more than {MOST_FEATURES}')
        return [(name, feature, read) for name, feature in features]
    except RecursionError:
        reason = 'it has too many levels'
    except (ValueError, ElementTree.ParseError) as error:
        reason = brief(error)
    raise make_file_error(path, [FileProblem(None, reason)])


def _convert_ring(corners: Sequence[Any], origin: Origin) -> Vertices:
    """
    Convert a polygon whose edges are straight in degrees, as autopilots take them, to m.

    Edges that would bend by more than _LARGEST_BEND get corners between.
    """
    begins = np.array(corners[:-1] if len(corners) > 3 and corners[0] == corners[-1] else corners)
    edges = np.roll(begins, -1, axis=0) - begins
    edges[:, 1] = (edges[:, 1] + 180) % 360 - 180
    try:
        ends, middles = (np.stack(origin.to_local(*places.T), axis=1)
                         for places in (begins, begins + edges / 2))
        bends = np.linalg.norm(middles - (ends + np.roll(ends, -1, axis=0)) / 2, axis=1)
        pieces = np.maximum(np.ceil(np.sqrt(bends / _LARGEST_BEND)), 1).astype(int)
        vertices = np.stack(origin.to_local(*np.concatenate([
            begin + edge * np.arange(count)[:, None] / count
            for begin, edge, count in zip(begins, edges, pieces)]).T), axis=1)
    except OptionError as error:
        raise ScenarioError(str(error)) from None
    return tuple((x, y) for x, y in vertices.tolist())


def _field(item: Any, name: str, kind: type[Any], noun: str) -> Any:
    """Return a field of a mapping; raise ScenarioError unless it is of a class."""
    value = item.get(name) if isinstance(item, Mapping) else None
    if not isinstance(value, kind):
        raise ScenarioError(f'{name} is {quote(value)}; it must be {noun}')
    return value


def _checked_corners(corners: Any, latitude: int, has_hole: bool = False
                     ) -> list[tuple[float, float]]:
    """
    Return the corners of a polygon in degrees, latitude first.

    :param latitude: index of the latitude in each; a third number is a height and must be 0.
    """
    if has_hole:
        raise ScenarioError('it has a hole; cut it into polygons without one')
    if not is_sequence(corners) or len(corners) < 3:
        raise ScenarioError(f'a polygon is {quote(corners)}; it must have at least three corners')
    checked = []
    for corner in corners:
        numbers = [*map(to_number, corner)] if is_sequence(corner) else []
        if not 2 <= len(numbers) <= 3 or not all(map(math.isfinite, numbers)):
            raise ScenarioError(f'a corner is {quote(corner)}; it must be two numbers in degrees')
        if any(numbers[2:]):
            raise ScenarioError(f'a corner has the altitude {numbers[2]:g} m, which is not above '
                                'the ground; give floor and ceiling')
        checked.append((numbers[latitude], numbers[1 - latitude]))
    return checked


def _list_geojson(text: str) -> list[tuple[Any, Any]]:
    data = json.loads(text)
    kind = _field(data, 'type', str, 'a type of GeoJSON')
    features = [data] if kind == 'Feature' else [{'geometry': data}]
    if kind == 'FeatureCollection':
        features = _field(data, 'features', list, 'a list')
    return [(_properties(feature).get('name'), feature) for feature in features]


def _properties(feature: Any) -> Mapping[str, Any]:
    properties = feature.get('properties') if isinstance(feature, Mapping) else None
    return properties if isinstance(properties, Mapping) else {}


def _read_geojson(feature: Any, origin: Origin) -> Iterator[_Area]:
    """Yield the areas of a feature of GeoJSON, RFC 7946: longitude first."""
    properties, geometry = _properties(feature), _field(feature, 'geometry', Mapping, 'a polygon')
    _check_properties(properties)
    kind = geometry.get('type')
    if kind not in ('Polygon', 'MultiPolygon'):
        raise ScenarioError(f'it is a {quote(kind)}; it must be a Polygon or a MultiPolygon')
    polygons = _field(geometry, 'coordinates', list, 'a list')
    floor, ceiling = (_read_height(properties, name, origin) for name in ('floor', 'ceiling'))
    for rings in polygons if kind == 'MultiPolygon' else [polygons]:
        ring, *holes = rings if is_sequence(rings) and rings else [None]
        yield _checked_corners(ring, 1, bool(holes)), floor or 0.0, ceiling, False


def _read_height(properties: Mapping[str, Any], name: str, origin: Origin) -> Any:
    """Return a floor or ceiling in m above the ground, None if there is none."""
    height = properties.get(f'{name}_amsl')
    if height is None:
        return properties.get(name)
    above = to_number(height)
    if origin.altitude is None or not math.isfinite(above):
        raise ScenarioError(f'{name}_amsl is {quote(height)}; it must be a number in m, and the '
                            'origin must have the altitude of the ground')
    return max(above - origin.altitude, 0.0 if name == 'floor' else -math.inf)


def _check_properties(properties: Mapping[str, Any]) -> None:
    """Refuse properties, also those of a block in them, that a zone cannot keep."""
    for name, value in properties.items():
        if isinstance(value, Mapping):
            _check_properties(value)
        elif value not in (None, '') and (match := _UNKEPT.search(name)):
            meaning = 'a time; zones hold at all times' if match['time'] else (
                'a height that may be above sea level; give floor and ceiling above the ground')
            raise ScenarioError(f'it has {quote(name)}, {meaning}')


def _list_plan(text: str) -> list[tuple[Any, Any]]:
    fence = _field(json.loads(text), 'geoFence', Mapping, 'the fence of a plan')
    return [(f'{kind} {number}', item) for kind in ('polygon', 'circle')
            for number, item in enumerate(
                _field({f'{kind}s': [], **fence}, f'{kind}s', list, 'a list'), start=1)]


def _read_plan(item: Any, origin: Origin) -> Iterator[_Area]:
    """Yield the area of a polygon or circle of QGroundControl: latitude first."""
    is_fence = _field(item, 'inclusion', bool, 'true or false')
    if 'circle' not in item:
        yield _checked_corners(item.get('polygon'), 0), 0.0, None, is_fence
        return
    circle = _field(item, 'circle', Mapping, 'a circle')
    (latitude, longitude), *_ = _checked_corners([circle.get('center')] * 3, 0)
    radius = to_number(circle.get('radius'))
    if not 0 < radius <= MAX_DISTANCE / 2:
        raise ScenarioError(f'radius is {quote(circle.get("radius"))}; it must be above 0 and at '
                            f'most {MAX_DISTANCE / 2:g} m')
    # On the safe side: inside a circle to stay in, around one to stay out of.
    reach = radius if is_fence else radius / math.cos(math.pi / _CORNERS)
    angles = 2 * np.pi * np.arange(_CORNERS) / _CORNERS
    centre = Origin(latitude, longitude, origin.projection)
    yield [*zip(*(values.tolist() for values in centre.to_geographic(
        reach * np.cos(angles), reach * np.sin(angles))))], 0.0, None, is_fence


def _list_kml(text: str) -> list[tuple[Any, Any]]:
    if re.search('<!(DOCTYPE|ENTITY)', text, re.I):
        raise ScenarioError('it has a document type or entities; it must not')
    root = ElementTree.fromstring(text)
    for element in root.iter():
        element.tag = element.tag.rpartition('}')[2]
    for element in root.iter():
        name = quote(element.findtext('name') or element.tag)[1:-1]
        if element.tag == 'NetworkLink':
            raise ScenarioError(f'{name}: it is in another file; save all in one')
        if element.tag in ('Placemark', 'Folder', 'Document') and any(
                element.find(tag) is not None for tag in ('TimeSpan', 'TimeStamp')):
            raise ScenarioError(f'{name}: it has a time of validity; zones hold at all times')
    return [(placemark.findtext('name'), placemark) for placemark in root.iter('Placemark')]


def _read_kml(placemark: ElementTree.Element, origin: Origin) -> Iterator[_Area]:
    """Yield the areas of a placemark of KML 2.2: longitude, latitude, altitude."""
    polygons, wrong = [*placemark.iter('Polygon')], {
        element.tag for element in placemark.iter()} & {'Point', 'LineString', 'Model', 'Track'}
    if wrong or not polygons:
        raise ScenarioError(f'it is a {min(wrong, default="placemark")}; it must be a Polygon')
    for polygon in polygons:
        has_hole = polygon.find('innerBoundaryIs') is not None
        text = polygon.findtext('outerBoundaryIs/LinearRing/coordinates') or ''
        try:
            corners = [[*map(float, corner.split(','))] for corner in text.split()]
        except ValueError as error:
            raise ScenarioError(f'coordinates: {error}') from None
        mode = (polygon.findtext('altitudeMode') or 'clampToGround').strip()
        grounds = {'relativeToGround': 0.0, 'absolute': origin.altitude}
        ground, ceiling = grounds.get(mode), None
        if ground is not None and (polygon.findtext('extrude') or '').strip() == '1':
            ceiling = max((corner[2] for corner in corners if len(corner) > 2),
                          default=0.0) - ground
        elif mode != 'clampToGround':
            raise ScenarioError(f'its altitudeMode is {quote(mode)}; it must be clampToGround, or '
                                'extruded and relativeToGround, or absolute with the altitude of '
                                'the origin, that of the ground')
        yield _checked_corners([place[:2] for place in corners], 1, has_hole), 0.0, ceiling, False


_FORMATS = {'.geojson': (_list_geojson, _read_geojson), '.json': (_list_geojson, _read_geojson),
            '.plan': (_list_plan, _read_plan), '.kml': (_list_kml, _read_kml)}
"""By suffix: a function that lists the features in a text, and one that reads their areas."""
