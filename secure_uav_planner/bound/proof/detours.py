"""
Lemma 9: a path around obstacles takes time.

The obstacles of a UAV are a polygon O: its zones, and the parts of the geofence's convex hull that
are outside the fence, all a little smaller than they are. In slot n the UAV has flown a path
around O of at most n moves, and flies another of at most N + 1 - n moves. So the shortest path
around O from the start to its place is no longer than n moves, and the shortest path from its
place to the goal no longer than N + 1 - n moves. Places inside O, or outside the hull, have no
such path.

Shortest paths are straight between corners of O, hence

    length(q) = min over all c that are seen from q, corners and the end, of length(c) + |q - c|.

A place is not seen from c if it is in the shadow of a convex part K of O: the convex set of all
c + t (k - c) with k in K and t >= 1. For a whole cell of a grid the minimum is over all c from
which some place of the cell may be seen, with the distance from c to the cell. It is never more
than length(q) of a place q in the cell. Rounding only lets more be seen.

The points of a UAV with a limit of acceleration are beside the curve that it flies: c(n), half a
slot after the middle of the move before, is (q[n-1] + 6 q[n] + q[n+1]) / 8, no farther than A / 8
from q[n]. The curve begins at the middle of the move d_{-1} before the start, or at the start if
the velocity there is free. The speed between two middles is a mean of both moves', so the path to
c(n) is at most |d_{-1}| / 2 and an eighth of a step longer than the moves from q[0] to q[n].
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import shapely

from ...mission.polygons import convex_parts, pockets
from ...mission.scenario import Array, Scenario, Uav
from ...model.airspace import Airspace
from ...model.airspace.routes import draw_edges, measure_paths
from ...model.kernel import core
from ...plan.plan import POSITION_TOLERANCE

SIDE = 128
"""
Cells along each side of the rectangle about all places that a UAV can reach.

Measured: with twice as many, bounds of random cities are up to 0.4% closer, in twice the time.
"""

MOST_CORNERS = 200
"""Largest number of corners of O; with more, which take seconds, obstacles are ignored."""

SMALLER = 1e-3
"""
Length [m] by which O is smaller than the obstacles.

The convex parts of O overlap by a tenth of SMALLER, so that nothing is seen between them.
"""

GRID = 1e-6
"""Spacing [m] of the grid on which shadows have their corners."""


@dataclass(frozen=True, eq=False)
class Detours:
    """
    Lower bounds of the lengths of a UAV's paths to the cells of a rectangle, in its frame.

    They hold for every place of a cell and every path of a feasible plan.

    :param low: the rectangle's lower corner, (2,).
    :param size: size of a cell, (2,).
    :param lengths: bounds for paths from the start and from the goal to each cell, minus what the
        curve may save, (2, SIDE, SIDE). Infinite if no path leads to the cell.
    """

    low: Array
    size: Array
    lengths: Array

    @property
    def compiled(self) -> core.Detours:
        """Return the kernel's form of these detours."""
        return core.Detours(*map(np.ascontiguousarray, (self.low, self.size, self.lengths)))

    def scale(self, unit: float) -> Detours:
        """Return the detours with all lengths divided by a unit [m]."""
        return Detours(self.low / unit, self.size / unit, self.lengths / unit)

    def locate(self, place: Array) -> tuple[Array, Array]:
        """Return indices of the cells of places (..., 2); outside, of the closest cells."""
        cell = np.floor((place - self.low) / self.size)
        i, j = np.moveaxis(np.clip(cell, 0, SIDE - 1).astype(int), -1, 0)
        return i, j

    def find_centre(self, cell: Array) -> Array:
        """Return the centres (..., 2) of cells with indices (..., 2)."""
        return np.asarray(self.low + (cell + 0.5) * self.size)


def frame_axes(uav: Uav) -> Array:
    """Return the unit axes of a UAV's frame as rows (2, 2), the first from start to goal."""
    offset = np.subtract(uav.goal, uav.start)
    length = float(np.hypot(*offset))
    # A goal within 1e-9 m of the start, far below a Plan's tolerances, may be in any direction.
    along = offset / length if length > 1e-9 else np.array([1.0, 0.0])
    return np.array([along, [-along[1], along[0]]])


class DetourSearch:
    """
    The search for the detours of all UAVs.

    :param airspace: the airspace that has the obstacles.
    :ivar scenario: the scenario of the airspace.
    """

    def __init__(self, airspace: Airspace) -> None:
        self.scenario, self._airspace = airspace.scenario, airspace

    @property
    def is_complete(self) -> bool:
        """Whether obstacles are used at all UAVs' altitudes, with at most MOST_CORNERS each."""
        return not any(map(_has_too_many_corners, self._parts.values()))

    @cached_property
    def detours(self) -> tuple[Detours | None, ...]:
        """Detours of each UAV in m; None without obstacles or with more than MOST_CORNERS."""
        return tuple(_find_detours(self.scenario, index, self._parts[uav.altitude])
                     for index, uav in enumerate(self.scenario.uavs))

    @cached_property
    def _parts(self) -> dict[float, tuple[Any, ...]]:
        """Convex polygons that overlap a little and make up O, by UAVs' altitude [m]."""
        return {altitude: _split_obstacles(self._airspace, altitude)
                for altitude in {uav.altitude for uav in self.scenario.uavs}}


def _find_detours(scenario: Scenario, index: int, parts: tuple[Any, ...]) -> Detours | None:
    """Return the detours of UAV `index` in m around convex parts of its obstacles, or None."""
    uav, fence = scenario.uavs[index], scenario.boundaries.keep_in
    if _has_too_many_corners(parts) or not parts and fence is None:
        return None
    step = float(scenario.max_step[index]) + POSITION_TOLERANCE
    # Ends of the curve, length that it may save against the moves, distance of points beside it.
    ends, saved, beside = np.array([uav.start, uav.goal]), np.full(2, SMALLER), 0.0
    if uav.max_acceleration is not None:
        before, after = (scenario.slot_duration * np.array(velocity or (0.0, 0.0))
                         for velocity in (uav.start_velocity, uav.goal_velocity))
        ends += np.array([-before, after]) / 2
        saved += np.hypot(*np.transpose([before, after])) / 2 + step / 8
        beside = min(uav.max_acceleration * scenario.slot_duration**2, 2 * step) / 8 + SMALLER
    low, size = _lay_grid(uav, step * (scenario.slots + 1) + 1.0)
    # Cells are a little larger, so that rounding puts no place outside its cell.
    cells = _outline_cells(uav, low, size, beside + 1e-6 * size)
    hull = None if fence is None else shapely.Polygon(fence).convex_hull.buffer(
        SMALLER, join_style='mitre')
    lengths = bound_path_lengths(parts, hull, ends, cells) - saved[:, None]
    return Detours(low, size, lengths.reshape(2, SIDE, SIDE))


def _lay_grid(uav: Uav, longest: float) -> tuple[Array, Array]:
    """
    Return lower corner and cell size of a grid over reachable places, (2,) in m, in UAV's frame.

    The paths from start and goal to a place are together no longer than all moves, `longest`, so
    all places are inside an ellipse whose foci are start and goal. The grid covers the ellipse.
    """
    distance = float(np.hypot(*np.subtract(uav.goal, uav.start)))
    half = np.array([longest, np.sqrt(max(longest**2 - distance**2, 0.0)) + 1.0]) / 2
    return [distance / 2, 0.0] - half, 2 * half / SIDE


def _outline_cells(uav: Uav, low: Array, size: Array, wider: Array) -> Any:
    """Return a grid's cells, wider by `wider` [m], as polygons in the mission's frame, [m]."""
    number = np.stack(np.meshgrid(np.arange(SIDE), np.arange(SIDE), indexing='ij'), -1)
    corners = np.array([[0, 0], [1, 0], [1, 1], [0, 1]])
    outlines = low + (number.reshape(-1, 1, 2) + corners) * size + (2 * corners - 1) * wider
    return shapely.polygons(outlines @ frame_axes(uav) + uav.start)


def _has_too_many_corners(parts: tuple[Any, ...]) -> bool:
    return int(shapely.get_num_coordinates(parts).sum()) > MOST_CORNERS


def _split_obstacles(airspace: Airspace, altitude: float) -> tuple[Any, ...]:
    """Return convex parts of the obstacles at an altitude [m]: zones and the fence's pockets."""
    boundaries = airspace.scenario.boundaries
    # Distant zones are ignored. Zones are not united, as a plan may fly between two that touch.
    solids = [shapely.Polygon(vertices) for vertices, name in boundaries.keep_out(altitude)
              if name not in airspace.far]
    if boundaries.keep_in is not None:
        # A pocket is extended beyond the convex hull, so that no path runs between the two.
        fence = shapely.Polygon(boundaries.keep_in)
        solids += [shapely.Polygon(pocket).buffer(1.0, join_style='mitre').difference(fence)
                   for pocket in pockets(boundaries.keep_in)]
    # Solids are smaller by SMALLER; their parts are wider by SMALLER / 10, so that parts overlap.
    return tuple(
        shapely.Polygon(part).buffer(SMALLER / 10, join_style='mitre', mitre_limit=2)
        for solid in solids
        for polygon in _split_at_holes(solid.buffer(-SMALLER, join_style='mitre'))
        for part in convex_parts(tuple(map(
            tuple, shapely.get_coordinates(polygon.exterior)[:-1].tolist()))))


def _split_at_holes(solid: Any) -> Iterator[Any]:
    """Yield polygons without holes that together make up the polygons of `solid`."""
    for polygon in shapely.get_parts(solid):
        if not len(polygon.interiors):
            yield from () if polygon.is_empty else (polygon,)
            continue
        # Cut through a hole.
        left, low, right, high = polygon.bounds
        middle = polygon.interiors[0].centroid.x
        for begin, end in ((left, middle), (middle, right)):
            half = polygon.intersection(shapely.box(begin, low, end, high))
            yield from _split_at_holes([part for part in shapely.get_parts(half)
                                       if part.geom_type == 'Polygon'])


def bound_path_lengths(parts: Sequence[Any], hull: Any, ends: Array, cells: Any) -> Array:
    """
    Return lower bounds of the lengths of paths from two ends to cells, (2, C) in m.

    They hold for every place of a cell and every path around the parts within the hull. A bound
    is infinite if no such path reaches the cell.

    :param parts: convex polygons to go around, perhaps none.
    :param hull: a convex polygon that contains all paths, or None.
    :param ends: places at which the paths begin, (2, 2) in m.
    :param cells: convex polygons, (C,).
    """
    solid = shapely.union_all(parts)
    places = np.concatenate([ends, np.unique(shapely.get_coordinates(solid), axis=0)])
    inner = solid.buffer(-10 * GRID)
    shapely.prepare(inner)
    edges = np.array(np.triu_indices(len(places), 1))
    is_free = ~shapely.intersects(inner, draw_edges(places, edges))
    paths = measure_paths(places, edges[:, is_free], [0, 1])  # (2, K) in m.
    frame = shapely.box(*shapely.total_bounds([*cells, shapely.MultiPoint(places)])).buffer(1.0)
    reach = 10 * np.hypot(*np.ptp(shapely.get_coordinates(frame), axis=0))
    frame = frame if hull is None else frame.intersection(hull)
    outlines = [shapely.get_coordinates(part) for part in parts]
    lengths = np.full((2, len(cells)), np.inf)
    # A path to a cell goes to an end or corner from which the cell is seen, and then straight.
    for place, path in zip(places, paths.T):
        lit = frame.difference(shapely.union_all(
            [_cast_shadow(place, outline, reach) for outline in outlines], grid_size=GRID).buffer(
                -10 * GRID))
        shapely.prepare(lit)
        seen = np.flatnonzero(shapely.intersects(lit, cells))
        straight = shapely.distance(shapely.Point(place), cells[seen])
        lengths[:, seen] = np.minimum(lengths[:, seen], path[:, None] + straight)
    return lengths


def _cast_shadow(place: Array, outline: Array, reach: float) -> Any:
    """Return a convex polygon (K, 2) with its shadow, `reach` [m] long, as seen from a place."""
    offset = outline - place
    length = np.hypot(*offset.T)
    distinct = length > 1e-9
    far = place + offset[distinct] * (reach / length[distinct])[:, None]
    return shapely.MultiPoint(np.concatenate([outline, far])).convex_hull
