"""
Polygons of KML 2.0 to 2.3.

Every element `coordinates` of a file is the outline of a polygon that is read, or the file is
refused.
"""

from collections.abc import Iterator
import re
from typing import Any
from xml.etree import ElementTree

from .areas import Area, checked_corners
from ..geography import Origin
from ...errors import quote, ScenarioError

# Namespaces of KML and of Google's extensions, which have the prefix gx.
_NAMESPACE = re.compile(
    r'\{https?://(www\.opengis\.net|earth\.google\.com|www\.google\.com)/kml/[^}]*\}')

_COLLECTIONS = {'MultiGeometry', 'GeometryCollection'}
_GEOMETRIES = {'Polygon', 'Point', 'LineString', 'LinearRing', 'Model', 'Track', 'MultiTrack'}

_NUMBER = r'[-+]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][-+]?[0-9]+)?'
_CORNER = re.compile(f'{_NUMBER}(,{_NUMBER}){{1,2}}')

_TRUTHS = {'1': True, 'true': True, '0': False, 'false': False}


class _Builder(ElementTree.TreeBuilder):
    """Refuses a document type, by which entities can grow and name other files."""

    def doctype(self, *_: Any) -> None:
        raise ScenarioError('it has a document type or entities; it must not')


def list_placemarks(data: bytes) -> list[tuple[Any, Any]]:
    """Return (name, element) of each placemark; refuse links, times, and areas outside of one."""
    root = ElementTree.fromstring(data, ElementTree.XMLParser(target=_Builder()))
    namespace = root.tag[:-3] if root.tag.endswith('}kml') else None
    for element in root.iter():
        space, _, name = element.tag.rpartition('}')
        if f'{space}}}' == namespace or _NAMESPACE.fullmatch(f'{space}}}'):
            element.tag = name
    kinds = _find_placemark_kinds(root)
    for element in root.iter():
        if element.tag in ('NetworkLink', 'Update'):
            raise ScenarioError(f'{_describe(element)}: it is in another file; save all in one')
        if element.tag in {'Folder', 'Document'} | kinds and any(
                element.find(tag) is not None for tag in ('TimeSpan', 'TimeStamp')):
            raise ScenarioError(f'{_describe(element)}: it has a time of validity; zones hold at '
                                'all times')
    placemarks, rest = [], [root]
    while rest:
        element = rest.pop()
        if element.tag in kinds:
            placemarks.append((_strip(element.findtext('name')), element))
            continue
        for child in element:
            if _is_coordinates(child):
                raise ScenarioError(f'{_describe(element)}: it has coordinates outside of a '
                                    f'Placemark, {_quote_text(child)}; they must be in one')
        rest.extend(reversed(element))
    return placemarks


def _find_placemark_kinds(root: ElementTree.Element) -> set[str]:
    """Return 'Placemark' and the tags that a Schema of KML 2.0 derives from it."""
    kinds = {'Placemark'}
    for schema in root.iter('Schema'):
        if _strip(schema.get('parent') or schema.findtext('parent')) in kinds:
            kinds.add(_strip(schema.get('name') or schema.findtext('name')))
    return kinds


def read_polygons(placemark: ElementTree.Element, origin: Origin) -> Iterator[Area]:
    """Yield the areas of a placemark; refuse holes, other shapes and stray coordinates."""
    shapes, rest = [], [*reversed(placemark)]
    while rest:
        element = rest.pop()
        if element.tag in _COLLECTIONS:
            rest.extend(reversed(element))
        elif element.tag in _GEOMETRIES:
            shapes.append(element)
    wrong = {element.tag for element in shapes} - {'Polygon'}
    if wrong or not shapes:
        raise ScenarioError(f'it is a {min(wrong, default="placemark")}; it must be a Polygon')
    if any(polygon.find('innerBoundaryIs') is not None for polygon in shapes):
        raise ScenarioError('it has a hole; cut it into polygons without one')
    outlines = [polygon.find('outerBoundaryIs/LinearRing/coordinates') for polygon in shapes]
    read = {*outlines}
    for element in placemark.iter():
        if _is_coordinates(element) and element not in read:
            raise ScenarioError(f'it has coordinates that are not read, {_quote_text(element)}; '
                                'a Polygon must have one outerBoundaryIs with one LinearRing')
    for polygon, outline in zip(shapes, outlines, strict=True):
        corners = [] if outline is None else _parse_corners(outline)
        yield Area(checked_corners([corner[:2] for corner in corners], 1),
                   ceiling=_find_ceiling(polygon, corners, origin))


def _parse_corners(outline: ElementTree.Element) -> list[list[float]]:
    """Return [longitude, latitude] or [longitude, latitude, altitude] of each corner of a ring."""
    text = ','.join(part.strip() for part in ''.join(outline.itertext()).split(','))
    for corner in text.split():
        if not _CORNER.fullmatch(corner):
            raise ScenarioError(f'a corner is {quote(corner)}; it must be longitude,latitude or '
                                'longitude,latitude,altitude')
    return [[*map(float, corner.split(','))] for corner in text.split()]


def _find_ceiling(polygon: ElementTree.Element, corners: list[list[float]], origin: Origin
                  ) -> float | None:
    """Return the highest corner [m above ground] as ceiling; None, no limit, if clamped."""
    mode = _strip(polygon.findtext('altitudeMode')) or 'clampToGround'
    for element in polygon.iter('altitudeMode'):
        if _strip(element.text) != mode:
            raise ScenarioError(f'it has the altitudeModes {quote(mode)} and '
                                f'{quote(_strip(element.text))}; it must have one')
    for element in polygon.iter('altitudeOffset'):
        if not re.fullmatch(r'[-+]?0*\.?0*', _strip(element.text)):
            raise ScenarioError(f'its altitudeOffset is {quote(_strip(element.text))}; it must be '
                                '0: add it to the altitudes')
    extrude = _strip(polygon.findtext('extrude', '0'))
    if extrude not in _TRUTHS or len(polygon.findall('extrude')) > 1:
        raise ScenarioError(f'its extrude is {quote(extrude)}; it must be 1, true, 0 or false')
    if mode == 'clampToGround':
        return None
    ground = {'relativeToGround': 0.0, 'absolute': origin.altitude}.get(mode)
    if ground is None or not _TRUTHS[extrude]:
        raise ScenarioError(f'its altitudeMode is {quote(mode)}; it must be clampToGround, or '
                            'extruded and relativeToGround, or absolute with the altitude of the '
                            'origin, that of the ground')
    return max((corner[2] for corner in corners if len(corner) > 2), default=0.0) - ground


def _is_coordinates(element: ElementTree.Element) -> bool:
    """Return True for an element coordinates of any name space."""
    return element.tag.rpartition('}')[2].lower() == 'coordinates'


def _describe(element: ElementTree.Element) -> str:
    return quote(_strip(element.findtext('name')) or element.tag)[1:-1]


def _quote_text(element: ElementTree.Element) -> str:
    return quote(' '.join((element.text or '').split()))


def _strip(text: str | None) -> str:
    return (text or '').strip()
