"""Places east and north of an origin as latitude and longitude (WGS 84)."""

import math

import numpy as np
from numpy.typing import ArrayLike

from ..errors import OptionError
from ..mission.validation import Array

_RADIUS = 6378137.0  # Semi-major axis of the ellipsoid in m.
_FLATTENING = 1 / 298.257223563
_SQUARE = _FLATTENING * (2 - _FLATTENING)  # Of its eccentricity.


class Origin:
    """
    The origin of a local frame, x to the east, y to the north, z up, as in REP-103.

    :param latitude: in degrees, north positive.
    :param longitude: in degrees, east positive.
    :param altitude: above sea level in m.
    :raises OptionError: for values that are no place on Earth.
    """

    def __init__(self, latitude: float, longitude: float, altitude: float = 0.0) -> None:
        for name, value, low, high in (('latitude', latitude, -89.9, 89.9),
                                       ('longitude', longitude, -180.0, 180.0),
                                       ('altitude', altitude, -500.0, 9000.0)):
            if not low <= value <= high:
                raise OptionError(
                    f'origin: the {name} is {value:g}; it must be from {low:g} to {high:g}')
        self.latitude, self.longitude, self.altitude = latitude, longitude, altitude

    def coordinates(self, places: ArrayLike) -> Array:
        """
        Return latitudes and longitudes in degrees, (..., 2), of places (x, y) in m, (..., 2).

        Places are on the plane that touches the ellipsoid at the origin; they become Cartesian
        coordinates centred in the Earth, and then geodetic ones.
        """
        east, north = np.moveaxis(np.asarray(places, dtype=float), -1, 0)
        latitude, longitude = math.radians(self.latitude), math.radians(self.longitude)
        sine, cosine = math.sin(latitude), math.cos(latitude)
        across = _RADIUS / math.sqrt(1 - _SQUARE * sine**2)
        # Away from the Earth's axis in the origin's meridian, across it, and along the axis.
        away = across * cosine - sine * north
        along = across * (1 - _SQUARE) * sine + cosine * north
        angle = np.arctan2(east, away)
        distance = np.hypot(away, east)
        found = np.arctan2(along, distance * (1 - _SQUARE))
        for _ in range(5):  # Each step leaves a few thousandths of the error.
            normal = _RADIUS / np.sqrt(1 - _SQUARE * np.sin(found)**2)
            found = np.arctan2(along + _SQUARE * normal * np.sin(found), distance)
        turned = np.degrees(longitude + angle)
        return np.stack([np.degrees(found), (turned + 180.0) % 360.0 - 180.0], axis=-1)
