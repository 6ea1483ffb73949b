"""Polygons of GeoJSON, RFC 7946, with the `crs` of its version of 2008; and maps of plans."""

from collections.abc import Iterator, Mapping
from contextlib import suppress
import math
import re
from typing import Any

from .areas import Area, checked_corners, checked_field, parse_json
from ..geography import Origin
from ..validation import to_number
from ...errors import OptionError, quote, ScenarioError

# Properties that a zone cannot keep: times of validity, and heights not above the ground.
_UNKEPT = re.compile(
    r'(?P<time>valid|applicab|expir|schedule|(start|end|begin|from|to)_?(date_?)?time)|'
    r'(?<!^floor_)(?<!^ceiling_)amsl|_msl|^(upper|lower|altitude|vertical)', re.I)

_AREAS = ('Polygon', 'MultiPolygon')

# Names of WGS84 with the longitude first.
_CRS84 = re.compile(r'(urn:(x-)?ogc:def:crs:)?OGC:([0-9.]*:)?CRS84|'
                    r'https?://www\.opengis\.net/def/crs/OGC/[0-9.]+/CRS84', re.I)
# Names of WGS84 whose files have the longitude or the latitude first.
_EPSG = re.compile(r'(urn:(x-)?ogc:def:crs:)?EPSG:([0-9.]*:)?(4326|4979)|'
                   r'https?://www\.opengis\.net/(def/crs/EPSG/[0-9.]+/|gml/srs/epsg\.xml#)'
                   r'(4326|4979)', re.I)

MAP_PROPERTIES = {'path': {'altitude', 'times', 'powers'}, 'ground_node': set(), 'zone': {
    'floor', 'ceiling'}, 'eavesdropper': {'error_radius'}, 'track': {'times', 'radii'},
    'geofence': set()}
"""Properties beside kind and name of each kind of feature in the map of a plan."""


def list_features(text: str) -> list[tuple[Any, Any]]:
    """
    Return (name, (feature, is_ambiguous)) of each feature, for read_feature.

    It is ambiguous if the file's crs allows latitude or longitude first. Of a plan's map, only
    zones and the fence are returned.

    :raises ScenarioError: for a polygon outside of features, or a crs other than WGS84.
    """
    data = parse_json(text)
    kind = checked_field(data, 'type', str, 'a type of GeoJSON')
    features = [data] if kind == 'Feature' else [{'geometry': data}]
    if kind == 'FeatureCollection':
        features = checked_field(data, 'features', list, 'a list')
    read = {id(geometry) for feature in features if isinstance(feature, Mapping)
            for geometry in _list_geometries(feature.get('geometry'))}
    is_ambiguous = False  # Whether the latitude may come first in the coordinates.
    for item in _list_objects(data):
        if item.get('type') in _AREAS and id(item) not in read:
            raise ScenarioError(f'it has a {item["type"]} that is not the geometry of a feature')
        if 'crs' in item:
            is_ambiguous |= _may_begin_with_latitude(item['crs'])
    named = [(_find_name(_properties(feature)), feature) for feature in features]
    return [(name, (feature, is_ambiguous)) for name, feature in named
            if _find_map_kind(feature) in (None, 'zone', 'geofence')]


def _list_geometries(geometry: Any) -> Iterator[Any]:
    """Yield a geometry itself, or the geometries in a GeometryCollection at any depth."""
    if isinstance(geometry, Mapping) and geometry.get('type') == 'GeometryCollection':
        for part in checked_field(geometry, 'geometries', list, 'a list'):
            yield from _list_geometries(part)
    else:
        yield geometry


def _list_objects(value: Any) -> Iterator[Mapping[str, Any]]:
    """Yield the objects in a value; `properties` and `crs`, which are no geometry, are skipped."""
    if isinstance(value, Mapping):
        yield value
        for name, item in value.items():
            if name not in ('properties', 'crs'):
                yield from _list_objects(item)
    elif isinstance(value, list):
        for item in value:
            if isinstance(item, (Mapping, list)):
                yield from _list_objects(item)


def _may_begin_with_latitude(crs: Any) -> bool:
    """Return True for EPSG:4326 or EPSG:4979, False for CRS84; refuse any other crs."""
    name = crs
    if isinstance(crs, Mapping):
        name = crs.get('properties')
        if crs.get('type') == 'name' and isinstance(name, Mapping):
            name = name.get('name')
    if isinstance(name, str) and _EPSG.fullmatch(name):
        return True  # Some files have the latitude first, and some the longitude.
    if not isinstance(name, str) or not _CRS84.fullmatch(name):
        raise ScenarioError(f'crs is {quote(name)}; it must be CRS84, EPSG:4326 or EPSG:4979 '
                            '(WGS84): convert the file')
    return False


def _find_name(properties: Mapping[str, Any]) -> Any:
    name = properties.get('name')
    return str(name) if isinstance(name, (int, float)) and not isinstance(name, bool) else name


def _properties(feature: Any) -> Mapping[str, Any]:
    properties = feature.get('properties') if isinstance(feature, Mapping) else None
    return properties if isinstance(properties, Mapping) else {}


def _find_map_kind(feature: Any) -> str | None:
    """
    Return the kind of a feature that a plan's map contains, None for a feature of another source.

    A plan's map has exactly the properties kind, name and MAP_PROPERTIES[kind]. In it, paths,
    ground nodes and tracks are no polygons, and the fence has no name.
    """
    kind = (properties := _properties(feature)).get('kind')
    if not isinstance(kind, str) or kind not in MAP_PROPERTIES or (
            properties.keys() != {'kind', 'name'} | MAP_PROPERTIES[kind]):
        return None
    geometry = feature.get('geometry')
    is_area = isinstance(geometry, Mapping) and geometry.get('type') in _AREAS
    is_of_map = not is_area if kind in ('path', 'ground_node', 'track') else (
        kind != 'geofence' or properties['name'] == '')
    return kind if is_of_map else None


def read_feature(item: Any, origin: Origin) -> Iterator[Area]:
    """Yield the areas of an item of list_features; refuse a hole, another shape, or no area."""
    feature, is_ambiguous = item
    properties, is_fence = _properties(feature), _find_map_kind(feature) == 'geofence'
    geometry = checked_field(feature, 'geometry', Mapping, 'a polygon')
    _check_properties(properties)
    floor, ceiling = (_read_height(properties, name, origin) for name in ('floor', 'ceiling'))
    polygons = [rings for part in _list_geometries(geometry) for rings in _list_polygons(part)]
    if not polygons:
        raise ScenarioError('it has no polygon')
    for rings in polygons:
        ring, *holes = rings if isinstance(rings, list) and rings else [None]
        if holes:
            raise ScenarioError('it has a hole; cut it into polygons without one')
        yield Area(_order_corners(ring, origin) if is_ambiguous else checked_corners(ring, 1),
                   floor or 0.0, ceiling, is_fence)


def _list_polygons(geometry: Any) -> list[Any]:
    """Return each polygon of a Polygon or MultiPolygon as its list of rings, outline first."""
    kind = geometry.get('type') if isinstance(geometry, Mapping) else geometry
    if kind not in _AREAS:
        raise ScenarioError(f'it is a {quote(kind)}; it must be a Polygon or a MultiPolygon')
    polygons = checked_field(geometry, 'coordinates', list, 'a list')
    return list(polygons) if kind == 'MultiPolygon' else [polygons]


def _order_corners(ring: Any, origin: Origin) -> list[tuple[float, float]]:
    """
    Return the corners of a ring, latitude first, from the order that lies near the origin.

    GeoJSON of 2008 has the longitude first, EPSG's definition the latitude. Files have either.
    If no order lies within 100 km of the origin, the longitude is taken to be first. If both do,
    as where latitude and longitude are nearly equal, a ScenarioError is raised.
    """
    near = []
    for latitude_index in (1, 0):
        with suppress(ScenarioError, OptionError):
            corners = checked_corners(ring, latitude_index)
            origin.to_local(*zip(*corners))
            near.append(corners)
    if len(near) == 2 and near[0] != near[1]:
        raise ScenarioError('its crs does not say whether its places have latitude or longitude '
                            'first, and both lie near the origin; write the crs '
                            'urn:ogc:def:crs:OGC:1.3:CRS84 and the longitude first')
    return near[0] if near else checked_corners(ring, 1)


def _read_height(properties: Mapping[str, Any], name: str, origin: Origin) -> Any:
    """
    Return the property floor or ceiling (`name`) in m above the ground, or None without it.

    The property <name>_amsl is above sea level instead. Below the ground, a floor becomes 0.
    """
    height = properties.get(f'{name}_amsl')
    if height is None:
        return properties.get(name)
    if properties.get(name) is not None:
        raise ScenarioError(f'it has {name} and {name}_amsl; it must have one of them')
    above = to_number(height)
    if origin.altitude is None or not math.isfinite(above):
        raise ScenarioError(f'{name}_amsl is {quote(height)}; it must be a number in m, and the '
                            'origin must have the altitude of the ground')
    return max(above - origin.altitude, 0.0 if name == 'floor' else -math.inf)


def _check_properties(properties: Mapping[str, Any]) -> None:
    """Refuse names of times, or of heights that may be above sea level, at any depth of blocks."""
    for name, value in properties.items():
        if isinstance(value, Mapping):
            _check_properties(value)
        elif value not in (None, '') and (match := _UNKEPT.search(name)):
            meaning = 'a time; zones hold at all times' if match['time'] else (
                'a height that may be above sea level; give floor and ceiling above the ground')
            raise ScenarioError(f'it has {quote(name)}, {meaning}')
