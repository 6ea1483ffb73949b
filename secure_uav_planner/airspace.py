"""Where the UAVs of a scenario may fly, as convex sets for the optimiser and for checks."""

from functools import cached_property, lru_cache
from typing import NamedTuple

import numpy as np

from .fields import Array, read_only
from .polygons import convex_parts, half_planes, pockets
from .scenario import Scenario

GEOFENCE = 'the geofence'
"""What a piece outside the fence belongs to."""


class Piece(NamedTuple):
    """
    A convex polygon that a UAV may not enter.

    :ivar vertices: (K, 2) in m, counter-clockwise.
    :ivar name: of the zone it belongs to, as in Scenario.zone_names, or GEOFENCE.
    """

    vertices: Array
    name: str


class Airspace:
    """
    What is forbidden to the UAVs of a scenario, each at its altitude. All arrays are read-only.

    :param scenario: a Scenario. `airspace_of` keeps the Airspace of the last ones.
    """

    def __init__(self, scenario: Scenario) -> None:
        self._scenario = scenario

    @cached_property
    def pieces(self) -> tuple[tuple[Piece, ...], ...]:
        """
        Convex pieces of all that each UAV may not enter, for each UAV a tuple.

        These are the parts of the zones at its altitude, and the pockets of a geofence that is
        not convex: what its convex hull has and the fence has not.
        """
        scenario = self._scenario
        outside = [] if scenario.geofence is None else [
            Piece(part, GEOFENCE) for pocket in pockets(scenario.geofence)
            for part in convex_parts(pocket)]
        return tuple(
            (*(Piece(part, name)
               for zone, name in zip(scenario.no_fly_zones, scenario.zone_names, strict=True)
               if zone.is_at(uav.altitude) for part in convex_parts(zone.vertices)), *outside)
            for uav in scenario.uavs)

    @cached_property
    def hull(self) -> tuple[Array, Array]:
        """
        Convex hull of the geofence as n.x <= b, without a fence no half-planes.

        :return: unit normals n that point outwards, (K, 2), and b, (K,) in m.
        """
        if self._scenario.geofence is None:
            return read_only(np.zeros((0, 2))), read_only(np.zeros(0))
        return half_planes(self._scenario.geofence)

    @cached_property
    def separations(self) -> Array:
        """Smallest horizontal distance between UAVs at their altitudes, (U, U) in m."""
        heights = self._scenario.altitudes
        squares = self._scenario.separation**2 - (heights[:, None] - heights)**2
        return read_only(np.sqrt(np.maximum(squares, 0.0)) * (1 - np.eye(len(heights))))


@lru_cache(maxsize=64)
def airspace_of(scenario: Scenario) -> Airspace:
    """Return the Airspace of a scenario, the same for equal scenarios."""
    return Airspace(scenario)
