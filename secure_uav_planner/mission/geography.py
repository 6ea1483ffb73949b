"""
Places on Earth: degrees to and from a mission's metres, as each autopilot converts them.

Autopilots do not use WGS84 in their local frames. PX4 projects a sphere (`MapProjection`),
ArduPilot scales degrees (`Location::get_distance_NE`). A zone in m is where the autopilot has it
only if both convert degrees in the same way.
"""

from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .fields import Checked, checked_by, Choice, MAX_DISTANCE, number, RefusedPlace
from .validation import Array, checked_array, to_number
from ..errors import OptionError, quote

_RADIUS = {'px4': 6_371_000.0, 'ardupilot': 6_378_100.0}
"""Radius of the Earth in m of each projection."""

_DECIMALS = 6
"""
Decimals of places in m. Further decimals are noise of degrees in doubles, about 1e-9 m, and may
lead a method to another plan, metres away.
"""

_LARGEST_BEND = 0.1  # Bend [m] in the local frame of an edge that is straight in degrees.

_MOST_LEVELS = 6  # Nested levels: mission, eavesdroppers, eavesdropper, track, knot, place.


@dataclass(frozen=True)
class Origin(Checked):
    """
    The place on Earth of the point (0, 0) of a mission.

    :param latitude: in degrees, from -85 to 85.
    :param longitude: in degrees, from -180 to 180.
    :param projection: 'px4', azimuthal equidistant on a sphere of radius 6,371,000 m; or
        'ardupilot', equirectangular by the mean latitude on a sphere of radius 6,378,100 m.
    :param altitude: altitude of the ground in m above sea level, which is height 0 in the
        mission; None if it is not known.
    :raises ScenarioError: naming the field, its value and what is allowed.
    """

    latitude: float = field(metadata=number(-85.0, 85.0, 'degrees'))
    longitude: float = field(metadata=number(-180.0, 180.0, 'degrees'))
    projection: str = field(default='px4', metadata=checked_by(Choice(tuple(_RADIUS))))
    altitude: float | None = field(default=None, metadata=number(-500.0, 9000.0, 'm'))

    _OWNER = 'origin.'

    def to_local(self, latitude: ArrayLike, longitude: ArrayLike) -> tuple[Array, Array]:
        """
        Convert places to the local frame.

        :param latitude: in degrees, from -90 to 90.
        :param longitude: in degrees, from -180 to 180; its shape broadcasts with the latitude's.
        :return: distances to the east and to the north of the origin in m.
        :raises OptionError: for degrees out of range, or a place beyond 100 km from the origin.
        """
        latitude = checked_array('latitude', latitude)
        longitude = checked_array('longitude', longitude)
        if not ((np.abs(latitude) <= 90) & (np.abs(longitude) <= 180)).all():
            raise OptionError(f'latitude is {quote(latitude)} and longitude {quote(longitude)}; '
                              'they must be from -90 to 90 and -180 to 180 degrees')
        east, north = self._convert(latitude, longitude)
        _check_distance(east, north)
        return east, north

    def _convert(self, latitude: Array, longitude: Array) -> tuple[Array, Array]:
        """Return (east, north) [m] of places [degrees], unchecked; longitudes may exceed 180."""
        centre, target = np.radians(self.latitude), np.radians(latitude)
        turn = np.radians((longitude - self.longitude + 180) % 360 - 180)
        if self.projection == 'px4':
            cosine = (np.sin(centre) * np.sin(target)
                      + np.cos(centre) * np.cos(target) * np.cos(turn))
            # The scale is radius * angle / sin(angle), which is the radius at angle 0.
            scale = _RADIUS['px4'] / np.sinc(np.arccos(np.clip(cosine, -1, 1)) / np.pi)
            north = scale * (np.cos(centre) * np.sin(target)
                             - np.sin(centre) * np.cos(target) * np.cos(turn))
            east = scale * np.cos(target) * np.sin(turn)
        else:
            north = (target - centre) * _RADIUS['ardupilot'] + 0 * turn
            east = turn * _RADIUS['ardupilot'] * np.cos((target + centre) / 2)
        return east, north

    def to_geographic(self, east: ArrayLike, north: ArrayLike) -> tuple[Array, Array]:
        """
        Convert points of the local frame to places; the inverse of to_local.

        :param east: distances to the east of the origin in m.
        :param north: distances to the north in m, in a shape that broadcasts with `east`.
        :return: latitudes from -90 to 90 and longitudes from -180 to 180 in degrees.
        :raises OptionError: for points more than 100 km from the origin.
        """
        east, north = checked_array('east', east), checked_array('north', north)
        _check_distance(east, north)
        centre = np.radians(self.latitude)
        if self.projection == 'px4':
            angle = np.hypot(east, north) / _RADIUS['px4']
            scale = np.sinc(angle / np.pi) / _RADIUS['px4']
            latitude = np.arcsin(np.cos(angle) * np.sin(centre) + north * scale * np.cos(centre))
            turn = np.arctan2(east * scale,
                              np.cos(centre) * np.cos(angle) - north * scale * np.sin(centre))
        else:
            latitude = centre + north / _RADIUS['ardupilot'] + 0 * east
            turn = east / (_RADIUS['ardupilot'] * np.cos((latitude + centre) / 2))
        longitude = (self.longitude + np.degrees(turn) + 180) % 360 - 180
        return np.degrees(latitude), longitude


def _check_distance(east: Array, north: Array) -> None:
    """Raise OptionError for a point (east, north) [m] beyond MAX_DISTANCE from the origin."""
    distances = np.hypot(east, north)
    if not (distances <= MAX_DISTANCE).all():
        raise OptionError(f'a place is {np.max(distances) / 1e3:.4g} km from the origin, east and '
                          f'north; it must be at most {MAX_DISTANCE / 1e3:g} km')


def unwrap(places: ArrayLike, origin: Origin) -> Array:
    """Return places (K, 2) in degrees, each longitude within 180 degrees of the origin's."""
    latitudes, longitudes = np.array(places, float).T
    return np.column_stack([latitudes, longitudes + 360 * np.round(
        (origin.longitude - longitudes) / 360)])


def convert_ring(corners: ArrayLike, origin: Origin) -> tuple[tuple[float, float], ...]:
    """
    Convert a polygon from degrees to m; its edges are straight in degrees, as in autopilots.

    An edge that bends by more than _LARGEST_BEND in m is divided by further corners.

    :param corners: (latitude, longitude) in degrees, (K, 2).
    :return: (x, y) in m of each corner.
    :raises OptionError: for corners more than 100 km from the origin.
    """
    degrees = unwrap(corners, origin)
    metres = _convert_places(degrees, origin)
    _check_distance(*metres.T)
    divided = _divide(degrees, _count_pieces(degrees, metres, origin))
    return tuple((x, y) for x, y in _convert_places(divided, origin).tolist())


def invert_ring(vertices: ArrayLike, origin: Origin) -> Array:
    """
    Convert a polygon from m to degrees, such that convert_ring returns its straight edges.

    An edge that bends by more than _LARGEST_BEND is divided by further corners.

    :param vertices: (x, y) in m, (K, 2).
    :return: (latitude, longitude) in degrees, with longitudes within 180 of the origin's, (L, 2).
    :raises OptionError: for vertices more than 100 km from the origin.
    """
    metres = np.array(vertices, float)
    degrees = invert_points(metres, origin)
    return invert_points(_divide(metres, _count_pieces(degrees, metres, origin)), origin)


def invert_points(points: Array, origin: Origin) -> Array:
    """Convert points (K, 2) in m to degrees, with longitudes within 180 of the origin's."""
    return unwrap(np.column_stack(origin.to_geographic(*points.T)), origin)


def _convert_places(places: Array, origin: Origin) -> Array:
    return np.column_stack(origin._convert(*places.T))


def _count_pieces(degrees: Array, metres: Array, origin: Origin) -> NDArray[np.int_]:
    """Return the number of pieces of each edge (K,), by the bends at its quarters."""
    edges = [np.roll(places, -1, axis=0) - places for places in (degrees, metres)]
    bends = np.max([np.linalg.norm(
        _convert_places(degrees + share * edges[0], origin) - (metres + share * edges[1]), axis=1)
        for share in (0.25, 0.5, 0.75)], axis=0)
    return np.maximum(np.ceil(np.sqrt(bends / _LARGEST_BEND)), 1).astype(int)


def _divide(corners: Array, counts: NDArray[np.int_]) -> Array:
    """Return a polygon (K, 2) with each edge divided into `counts` (K,) equal pieces, (L, 2)."""
    edges = np.roll(corners, -1, axis=0) - corners
    return np.concatenate([begin + edge * np.arange(count)[:, None] / count
                           for begin, edge, count in zip(corners, edges, counts)])


def _describe_swapped(place: tuple[float, float], origin: Origin) -> str:
    """Return a hint if (longitude, latitude) would lie within 100 km of the origin, or ''."""
    with suppress(OptionError):
        origin.to_local(*place[::-1])
        return '; latitude and longitude are swapped'
    return ''


def convert_points(value: Any, origin: Origin, levels: int = _MOST_LEVELS) -> Any:
    """
    Convert each {latitude, longitude} in the plain values of a mission to [x, y] in m.

    Coordinates are rounded to 1e-6 m. A place in a knot of a track becomes two numbers of the
    knot. A place beyond 100 km from the origin, or that has wrong numbers, becomes a
    RefusedPlace, which the checks of fields refuse. The value of `origin` stays in degrees.

    :param levels: nested levels in which places are still sought.
    """
    if isinstance(value, Mapping) and set(value) == {'latitude', 'longitude'}:
        place = to_number(value['latitude']), to_number(value['longitude'])
        try:
            return [round(float(part), _DECIMALS) for part in origin.to_local(*place)]
        except OptionError as error:
            return RefusedPlace(value, f'{error}{_describe_swapped(place, origin)}')
    elif isinstance(value, Mapping) and levels:
        return {name: item if name == 'origin' else convert_points(item, origin, levels - 1)
                for name, item in value.items()}
    elif isinstance(value, (list, tuple)) and levels:
        items = [convert_points(item, origin, levels - 1) for item in value]
        if not value or isinstance(value[0], (list, tuple, Mapping)):
            return items
        return [part for given, item in zip(value, items) for part in (  # A knot is flat.
            item if isinstance(given, Mapping) and isinstance(item, list) else [item])]
    return value
