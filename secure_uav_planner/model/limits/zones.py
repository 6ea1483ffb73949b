"""Obstacles that no UAV enters, and the convex hull of the geofence that none leaves."""

from functools import cached_property

import numpy as np

from .lines import ControlPoints, LineLimit
from ..airspace import Airspace
from ..grid import Grid
from ..kernel import core
from ...mission.scenario import Array

MOST_LINES = 4
"""The most obstacles, the nearest, from which lines separate a piece of a UAV's curve."""
_ROUNDING = 1e-3


class FenceLimit(LineLimit):
    """
    No UAV leaves the convex hull of the geofence: all control points are within its sides.

    The rest outside the fence are obstacles. A point that its UAV could not take to a side of the
    hull, with its speed, has no c there.
    """

    def __init__(self, grid: Grid) -> None:
        outward, offsets = grid.airspace.hull
        uavs = len(grid.scenario.uavs)
        super().__init__(grid, np.repeat(np.arange(uavs), len(offsets)))
        self._normals: Array = np.tile(-outward, (uavs, 1))
        self._offsets: Array = np.tile(outward @ grid.origin - offsets, uavs) / grid.length
        number = np.arange(self.grid.slots + 2.0)[:, None]
        # The curve may begin and end up to half a slot beyond the points.
        number[0], number[-1] = 0.5, number[-1] + 0.5
        steps = (self.scenario.max_speeds * self.grid.slot_duration / self.grid.length)[self.first]
        for ends, moves in ((self.grid.starts, number), (self.grid.goals, number[::-1])):
            slack = (self._normals * ends[self.first]).sum(axis=-1) - self._offsets
            self.ignored |= (slack > (1 + _ROUNDING) * moves * steps)[..., None]

    @classmethod
    def applies_to(cls, airspace: Airspace) -> bool:
        """Return True if there is a fence."""
        return airspace.scenario.geofence is not None

    def _make_points(self) -> ControlPoints:
        return ControlPoints.from_points(self.grid)

    @cached_property
    def compiled(self) -> core.FenceLimit:
        """Return the kernel's limit."""
        return core.FenceLimit(self.points.compiled, self.first, self.ignored, self._normals,
                               self._offsets)


class ZoneLimit(LineLimit):
    """
    No UAV enters an obstacle at its altitude.

    Only the nearest of many obstacles have lines; a step goes no farther than to the next.
    """

    def __init__(self, grid: Grid) -> None:
        obstacles = grid.airspace.obstacles
        uavs = [uav for uav, polygons in enumerate(obstacles) if polygons]
        most = max(len(obstacles[uav]) for uav in uavs)
        corners = max(len(obstacle.vertices) for uav in uavs for obstacle in obstacles[uav])
        super().__init__(grid, np.repeat(uavs, min(most, MOST_LINES)))
        # Of every UAV in uavs, repeated where it has fewer: (A, Z, V, 2), in units.
        self._polygons: Array = (np.array([
            [_pad(obstacles[uav][index % len(obstacles[uav])].vertices, corners)
             for index in range(most)] for uav in uavs]) - grid.origin) / grid.length

    @classmethod
    def applies_to(cls, airspace: Airspace) -> bool:
        """Return True if there is an obstacle at the altitude of any UAV."""
        return any(airspace.obstacles)

    @cached_property
    def compiled(self) -> core.ZoneLimit:
        """Return the kernel's limit."""
        return core.ZoneLimit(self.points.compiled, self.first, self.ignored, self._polygons)


def _pad(vertices: Array, count: int) -> Array:
    """Repeat the last vertex up to a count."""
    return np.concatenate([vertices, np.repeat(vertices[-1:], count - len(vertices), axis=0)])
