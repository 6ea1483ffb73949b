"""Obstacles that no UAV enters, and the convex hull of the geofence that none leaves."""

import numpy as np

from .lines import ControlPoints, LineLimit, Subjects
from ..airspace import get_airspace
from ..grid import Grid
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
        super().__init__(scenario, grid)
        number = np.arange(self.grid.slots + 2.0)[:, None]
        # The curve may begin and end up to half a slot beyond the points.
        number[0], number[-1] = 0.5, number[-1] + 0.5
        steps = (scenario.max_speeds * self.grid.slot_duration / self.grid.length)[self.first]
        for ends, moves in ((self.grid.starts, number), (self.grid.goals, number[::-1])):
            slack = (self._obstacles['normals'] * ends[self.first]).sum(
                axis=-1) - self._obstacles['offsets']
            self.ignored |= (slack > (1 + _ROUNDING) * moves * steps)[..., None]

    @classmethod
    def applies_to(cls, scenario: Scenario) -> bool:
        """Return True if there is a fence."""
        return scenario.geofence is not None

    def _list_subjects(self) -> Subjects:
        outward, offsets = get_airspace(self.scenario).hull
        uavs = len(self.scenario.uavs)
        inwards = np.tile(outward @ self.grid.origin - offsets, uavs) / self.grid.length
        return (ControlPoints.from_points(self.grid), np.repeat(np.arange(uavs), len(offsets)),
                None, {'normals': np.tile(-outward, (uavs, 1)), 'offsets': inwards})


class ZoneLimit(LineLimit):
    """
    No UAV enters an obstacle at its altitude.

    Only the nearest of many obstacles have lines; a step goes no farther than to the next.
    """

    @classmethod
    def applies_to(cls, scenario: Scenario) -> bool:
        """Return True if there is an obstacle at the altitude of any UAV."""
        return any(get_airspace(scenario).obstacles)

    def _list_subjects(self) -> Subjects:
        obstacles = get_airspace(self.scenario).obstacles
        uavs = [uav for uav, polygons in enumerate(obstacles) if polygons]
        most = max(len(obstacles[uav]) for uav in uavs)
        corners = max(len(obstacle.vertices) for uav in uavs for obstacle in obstacles[uav])
        # Of every UAV in uavs, repeated where it has fewer: (A, Z, V, 2), in units.
        polygons = np.array([
            [_pad(obstacles[uav][index % len(obstacles[uav])].vertices, corners)
             for index in range(most)] for uav in uavs])
        return (ControlPoints.from_curve(self.grid),
                np.repeat(uavs, min(most, MOST_LINES)), None,
                {'polygons': (polygons - self.grid.origin) / self.grid.length})


def _pad(vertices: Array, count: int) -> Array:
    """Repeat the last vertex up to a count."""
    return np.concatenate([vertices, np.repeat(vertices[-1:], count - len(vertices), axis=0)])
