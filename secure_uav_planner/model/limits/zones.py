"""The limits that are lines: zones, the convex hull of the geofence, and the separation."""

from collections.abc import Callable
from functools import cached_property
from itertools import cycle, islice

import numpy as np
from numpy.typing import NDArray

from .lines import LineLimit, Lines
from ..airspace import Airspace
from ..grid import Grid
from ..kernel import core
from ...mission.validation import Array, find_runs

MOST_LINES = 4
"""The most obstacles, the nearest, from which lines separate a piece of a UAV's curve."""
_ROUNDING = 1e-3


class FenceLimit(LineLimit):
    """
    No UAV leaves the convex hull of the geofence: all control points are within its sides.

    What is inside the hull but outside the fence is an obstacle. A point from which the UAV is too
    slow to reach a side of the hull has no c for this side.
    """

    def __init__(self, grid: Grid) -> None:
        outward, offsets = grid.airspace.hull
        uavs = len(grid.scenario.uavs)
        super().__init__(grid, np.repeat(np.arange(uavs), len(offsets)), on_curve=False)
        self._normals: Array = np.tile(-outward, (uavs, 1))
        self._offsets: Array = np.tile(outward @ grid.origin - offsets, uavs) / grid.length
        # Slots from the start to each point. The curve's ends are half a slot beyond the points.
        # A side is ignored at points that are too early or too late for the UAV to be there.
        elapsed = np.arange(self.grid.slots + 2.0)[:, None]
        elapsed[0], elapsed[-1] = 0.5, elapsed[-1] + 0.5
        steps = (self.scenario.max_speeds * self.grid.slot_duration / self.grid.length)[self.first]
        for ends, moves in ((self.grid.starts, elapsed), (self.grid.goals, elapsed[::-1])):
            slack = (self._normals * ends[self.first]).sum(axis=-1) - self._offsets
            self.ignored |= (slack > (1 + _ROUNDING) * moves * steps)[..., None]

    @classmethod
    def applies_to(cls, airspace: Airspace) -> bool:
        return airspace.scenario.geofence is not None

    @cached_property
    def compiled(self) -> core.FenceLimit:
        return core.FenceLimit(self.compiled_points, self.ignored, self._normals, self._offsets)


class ZoneLimit(LineLimit):
    """
    No UAV enters an obstacle at its altitude.

    Only the nearest obstacles have lines; a step ends before the nearest obstacle without one.
    """

    def __init__(self, grid: Grid) -> None:
        """Give the same number of lines, at most MOST_LINES, to every UAV with obstacles."""
        outlines = {uav: [obstacle.vertices for obstacle in obstacles]
                    for uav, obstacles in enumerate(grid.airspace.obstacles) if obstacles}
        polygons = _stack_polygons(list(outlines.values()))
        # The kernel chooses the nearest obstacles. A UAV with fewer obstacles than another one has
        # its obstacles again, so that several lines may be to one obstacle.
        lines = min(polygons.shape[1], MOST_LINES)
        super().__init__(grid, np.repeat(list(outlines), lines))
        self._polygons: Array = (polygons - grid.origin) / grid.length

    @classmethod
    def applies_to(cls, airspace: Airspace) -> bool:
        return any(airspace.obstacles)

    @cached_property
    def compiled(self) -> core.ZoneLimit:
        return core.ZoneLimit(self.compiled_points, self.ignored, self._polygons)


def _stack_polygons(polygons: list[list[Array]]) -> Array:
    """
    Return the polygons of each of A UAVs, (V, 2) each, in one array (A, Z, V, 2).

    A UAV with fewer polygons than another one has its polygons again. A polygon with fewer
    vertices than another one has its last vertex again.
    """
    most = max(map(len, polygons))
    vertices = max(len(polygon) for of_uav in polygons for polygon in of_uav)
    return np.array([[np.pad(polygon, ((0, vertices - len(polygon)), (0, 0)), 'edge')
                      for polygon in islice(cycle(of_uav), most)] for of_uav in polygons])


class SeparationLimit(LineLimit):
    """
    No two UAVs come closer than the separation: their difference stays out of a disc.

    The disc's radius is the horizontal distance that their altitudes leave of the separation. A
    line touches the disc at its point nearest to the piece of the difference.
    """

    def __init__(self, grid: Grid) -> None:
        distances = grid.airspace.separations
        first, second = map(np.ascontiguousarray, np.nonzero(np.triu(distances)))
        super().__init__(grid, first, second)
        self._radii: Array = distances[first, second] / grid.length

    @classmethod
    def applies_to(cls, airspace: Airspace) -> bool:
        return bool(airspace.separations.any())

    @cached_property
    def compiled(self) -> core.SeparationLimit:
        return core.SeparationLimit(self.compiled_points, self.ignored, self._radii)

    def rotate_normals(self, path: Array, lines: Lines, opposite: bool,
                       raise_if_over: Callable[[], None]) -> Lines:
        """
        Return the lines with normals that turn at a constant rate while two UAVs are too close.

        So the UAVs pass each other on one side, even if their difference runs through the origin.
        Normals are changed in place. Offsets stay.

        :param opposite: True to turn the other way round, where the turn is above 60 degrees.
        """
        least = self.slacks(path, lines).min(axis=-1)
        raise_if_over()
        pairs = np.flatnonzero((least <= 0).any(axis=0))
        middles = self.control_points(path, pairs).mean(axis=-2)
        for number, pair in enumerate(pairs.tolist()):
            close, middle = least[:, pair] <= 0, middles[:, number]
            angles = _turn_evenly(np.arctan2(middle[:, 1], middle[:, 0]), close, opposite)[close]
            lines.normals[close, pair] = np.stack([np.cos(angles), np.sin(angles)], axis=-1)
        return lines


def _turn_evenly(angles: Array, close: NDArray[np.bool_], opposite: bool) -> Array:
    """
    Return angles [rad] interpolated linearly over each stretch of points that are close, (N+2,).

    The turn is the smaller one. If it is above 60 degrees, `opposite` takes the larger one.
    """
    angles = angles.copy()
    for begin, end in find_runs(close).tolist():
        before, after = angles[max(begin - 1, 0)], angles[min(end, len(angles) - 1)]
        change = (after - before + np.pi) % (2 * np.pi) - np.pi
        if opposite and abs(change) > np.pi / 3:
            change -= np.copysign(2 * np.pi, change)
        angles[begin:end] = before + change * (np.arange(end - begin) + 1) / (end - begin + 1)
    return angles
