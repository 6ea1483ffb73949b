"""Obstacles that no UAV enters, and the convex hull of the geofence that none leaves."""

from functools import cached_property

import numpy as np

from .lines import ControlPoints, LineLimit
from ..airspace import get_airspace
from ..grid import Grid
from ..kernel import core
from ...mission.scenario import Array, Scenario

MOST_LINES = 4
"""The most obstacles, the nearest, from which lines separate a piece of a UAV's curve."""
_ROUNDING = 1e-3


class FenceLimit(LineLimit):
    """
    No UAV leaves the convex hull of the geofence: all control points are within its sides.

    The rest outside the fence are obstacles. A point that its UAV could not take to a side of the
    hull, with its speed, has no c there.
    """

    def __init__(self, scenario: Scenario, grid: Grid | None = None) -> None:
        outward, offsets = get_airspace(scenario).hull
        uavs = len(scenario.uavs)
        super().__init__(scenario, grid, np.repeat(np.arange(uavs), len(offsets)))
        self._normals: Array = np.tile(-outward, (uavs, 1))
        self._offsets: Array = np.tile(
            outward @ self.grid.origin - offsets, uavs) / self.grid.length
        number = np.arange(self.grid.slots + 2.0)[:, None]
        # The curve may begin and end up to half a slot beyond the points.
        number[0], number[-1] = 0.5, number[-1] + 0.5
        steps = (scenario.max_speeds * self.grid.slot_duration / self.grid.length)[self.first]
        for ends, moves in ((self.grid.starts, number), (self.grid.goals, number[::-1])):
            slack = (self._normals * ends[self.first]).sum(axis=-1) - self._offsets
            self.ignored |= (slack > (1 + _ROUNDING) * moves * steps)[..., None]

    @classmethod
    def applies_to(cls, scenario: Scenario) -> bool:
        """Return True if there is a fence."""
        return scenario.geofence is not None

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

    def __init__(self, scenario: Scenario, grid: Grid | None = None) -> None:
        obstacles = get_airspace(scenario).obstacles
        uavs = [uav for uav, polygons in enumerate(obstacles) if polygons]
        most = max(len(obstacles[uav]) for uav in uavs)
        corners = max(len(obstacle.vertices) for uav in uavs for obstacle in obstacles[uav])
        super().__init__(scenario, grid, np.repeat(uavs, min(most, MOST_LINES)))
        # Of every UAV in uavs, repeated where it has fewer: (A, Z, V, 2), in units.
        self._polygons: Array = (np.array([
            [_pad(obstacles[uav][index % len(obstacles[uav])].vertices, corners)
             for index in range(most)] for uav in uavs]) - self.grid.origin) / self.grid.length

    @classmethod
    def applies_to(cls, scenario: Scenario) -> bool:
        """Return True if there is an obstacle at the altitude of any UAV."""
        return any(get_airspace(scenario).obstacles)

    @cached_property
    def compiled(self) -> core.ZoneLimit:
        """Return the kernel's limit."""
        return core.ZoneLimit(self.points.compiled, self.first, self.ignored, self._polygons)


def _pad(vertices: Array, count: int) -> Array:
    """Repeat the last vertex up to a count."""
    return np.concatenate([vertices, np.repeat(vertices[-1:], count - len(vertices), axis=0)])
