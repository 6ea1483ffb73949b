"""Where the UAVs of a scenario may fly, as convex sets."""

from functools import cached_property
import math
from typing import NamedTuple

import numpy as np
import shapely

from ...mission.polygons import convex_parts, half_planes, pockets
from ...mission.scenario import Scenario
from ...mission.validation import Array, read_only

GEOFENCE = 'the geofence'
"""Name of the obstacles outside the fence."""


class Obstacle(NamedTuple):
    """A convex polygon that no UAV may enter, (K, 2) in m, with its zone's name or GEOFENCE."""

    vertices: Array
    name: str


class Airspace:
    """
    The obstacles of UAVs, each at its altitude, tracking_margin included; read-only.

    :param scenario: Scenario of the UAVs.
    """

    def __init__(self, scenario: Scenario) -> None:
        self.scenario = scenario

    @cached_property
    def is_open(self) -> bool:
        """Whether there is no fence, no UAV has an obstacle, and `separations` are all 0."""
        return not (self.scenario.geofence or any(self.obstacles) or self.separations.any())

    @cached_property
    def obstacles(self) -> tuple[tuple[Obstacle, ...], ...]:
        """
        Obstacles of each UAV: convex parts of zones, and of the fence's hull without the fence.

        Zones at other altitudes and zones in `far` are left out.
        """
        boundaries = self.scenario.boundaries
        outside = [] if boundaries.keep_in is None else [
            Obstacle(part, GEOFENCE) for pocket in pockets(boundaries.keep_in)
            for part in convex_parts(pocket)]
        near = {altitude: [
            Obstacle(part, name) for vertices, name in boundaries.keep_out(altitude)
            if name not in self.far for part in convex_parts(vertices)]
            for altitude in {uav.altitude for uav in self.scenario.uavs}}
        return tuple((*near[uav.altitude], *outside) for uav in self.scenario.uavs)

    @cached_property
    def far(self) -> frozenset[str]:
        """
        Names of the zones that are farther from the mission than its size.

        The mission is the convex hull of starts, goals and receivers. Its size is the root of the
        sum of squares of width, length, largest altitude, and max_speed^2 / max_acceleration of
        each UAV that does not begin and end at rest.
        """
        scenario = self.scenario
        size = math.hypot(*np.ptp(scenario.landmarks, axis=0), scenario.altitudes.max(), *(
            uav.max_speed**2 / uav.max_acceleration for uav in scenario.uavs
            if uav.max_acceleration is not None
            and not uav.start_velocity == uav.goal_velocity == (0.0, 0.0)))
        mission = shapely.MultiPoint(scenario.landmarks).convex_hull
        return frozenset(name for uav in scenario.uavs
                         for vertices, name in scenario.boundaries.keep_out(uav.altitude)
                         if shapely.Polygon(vertices).distance(mission) > size)

    @cached_property
    def hull(self) -> tuple[Array, Array]:
        """Convex hull n.x <= b of a fence: outward unit normals n (K, 2), b (K,) [m]; or K = 0."""
        if self.scenario.boundaries.keep_in is None:
            return read_only(np.zeros((0, 2))), read_only(np.zeros(0))
        return half_planes(self.scenario.boundaries.keep_in)

    @cached_property
    def separations(self) -> Array:
        """Least allowed horizontal distance of two UAVs, (U, U) in m; 0 if altitudes suffice."""
        heights = self.scenario.altitudes
        squares = self.scenario.boundaries.keep_apart**2 - (heights[:, None] - heights)**2
        return read_only(np.sqrt(np.maximum(squares, 0.0)) * (1 - np.eye(len(heights))))
