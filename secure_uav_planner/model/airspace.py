"""Where the UAVs of a scenario may fly, as convex sets, and routes around the obstacles."""

from functools import cached_property
import math
from typing import Any, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray
import scipy
import shapely

from ..mission.polygons import convex_parts, half_planes, pockets
from ..mission.scenario import Scenario
from ..mission.validation import Array, read_only

GEOFENCE = 'the geofence'
"""Name of the obstacles outside the fence."""

MOST_ROUTES = 3  # Largest number of routes between two places, on different sides of obstacles.
_MOST_CORNERS = 250  # Outlines of obstacles with more corners are simplified.
_ROUNDING = 1e-6  # Depth [m] by which a route may cut into an obstacle.

_Edges: TypeAlias = NDArray[np.intp]
"""Pairs of places, by their indices, (2, M)."""


class Obstacle(NamedTuple):
    """A convex polygon that no UAV may enter, (K, 2) in m, with its zone's name or GEOFENCE."""

    vertices: Array
    name: str


class Airspace:
    """
    The obstacles of UAVs, each at its altitude, tracking_margin included; read-only.

    :param scenario: whose UAVs they are.
    """

    def __init__(self, scenario: Scenario) -> None:
        self.scenario = scenario

    @cached_property
    def is_open(self) -> bool:
        """Whether there are no zones, no fence and no separation."""
        return not (self.scenario.geofence or any(self.obstacles) or self.separations.any())

    @cached_property
    def obstacles(self) -> tuple[tuple[Obstacle, ...], ...]:
        """
        Obstacles of each UAV: convex parts of zones, and of the fence's hull without the fence.

        Only zones at the UAV's altitude are obstacles, except far ones.
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
        Names of the zones that are farther away than the mission's diameter.

        The diameter is the diagonal of the box around starts, goals and receivers, together with
        the largest altitude and the braking distances of UAVs that do not begin and end at rest.
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
        """Convex hull of the geofence as n.x <= b: unit normals n (K, 2) outwards, b (K,) in m."""
        if self.scenario.boundaries.keep_in is None:
            return read_only(np.zeros((0, 2))), read_only(np.zeros(0))
        return half_planes(self.scenario.boundaries.keep_in)

    @cached_property
    def separations(self) -> Array:
        """Smallest horizontal distance between UAVs at their altitudes, (U, U) in m."""
        heights = self.scenario.altitudes
        squares = self.scenario.boundaries.keep_apart**2 - (heights[:, None] - heights)**2
        return read_only(np.sqrt(np.maximum(squares, 0.0)) * (1 - np.eye(len(heights))))


class VisibilityGraph:
    """The visibility graph of a UAV's obstacles, enlarged by a distance in m."""

    def __init__(self, airspace: Airspace, uav: int, distance: float) -> None:
        solid = shapely.union_all([shapely.Polygon(obstacle.vertices)
                                   for obstacle in airspace.obstacles[uav]])
        enlarged = solid.buffer(distance, join_style='mitre')
        coarseness = distance / 4
        while shapely.get_num_coordinates(enlarged) > _MOST_CORNERS:
            enlarged = solid.simplify(coarseness).buffer(
                distance + coarseness, join_style='mitre')
            coarseness *= 2
        self._parts = shapely.get_parts(enlarged)
        self._solid = solid.buffer(-_ROUNDING)
        self._enlarged = enlarged.buffer(-max(_ROUNDING, distance / 100), join_style='mitre')
        shapely.prepare([self._solid, self._enlarged])
        corners = shapely.get_coordinates(enlarged)
        self._normals, self._offsets = airspace.hull
        self._corners: Array = corners[(corners @ self._normals.T <= self._offsets).all(axis=1)]
        self._edges = self._select_visible(
            self._corners, np.array(np.triu_indices(len(self._corners), 1)))

    def _select_visible(self, places: Array, edges: _Edges) -> _Edges:
        """Return the edges (2, M), pairs of places (K, 2), without an obstacle in between."""
        ends = places[edges]
        lines = shapely.linestrings(ends.swapaxes(0, 1))
        free = ~shapely.intersects(self._enlarged, lines)
        # An edge that ends within the distance of an obstacle must clear the obstacle itself.
        inside = shapely.contains_xy(self._enlarged, ends[..., 0], ends[..., 1]).any(axis=0)
        again = np.flatnonzero(~free & inside)
        free[again] = ~shapely.intersects(self._solid, lines[again])
        return edges[:, free]

    def find_routes(self, begin: Array, end: Array, most: int) -> list[Array]:
        """
        Return routes between two places, the shortest first, each (K, 2) in m.

        Each alternative passes one obstacle of the shortest route on the opposite side.

        :param most: largest number of routes.
        """
        places, edges = self._insert(np.stack([begin, end]))
        shortest = _find_shortest_route(places, edges)
        if shortest is None:
            return []
        routes = [shortest]
        for part in self._parts:
            touched = shortest[1:-1][shapely.distance(
                part, shapely.points(shortest[1:-1])) <= _ROUNDING]
            if not len(touched) or len(routes) == most:
                continue
            # An alternative may not cross the ray from inside the obstacle through the corner that
            # the shortest route touches.
            centre = np.array(part.representative_point().coords[0])
            away = touched[len(touched) // 2] - centre
            ray = shapely.linestrings(np.stack([
                centre, centre + away * (1e5 / max(math.hypot(*away), 1e-9))]))
            lines = shapely.linestrings(places[edges].swapaxes(0, 1))
            alternative = _find_shortest_route(places, edges[:, ~shapely.intersects(ray, lines)])
            if alternative is not None:
                routes.append(alternative)
        return routes

    def measure_distances(self, begins: Array, end: Array) -> Array:
        """Return the lengths of the shortest routes from places (M, 2) to an end, (M,) in m."""
        places, edges = self._insert(np.concatenate([begins, end[None]]))
        distances: Array = scipy.sparse.csgraph.dijkstra(
            _build_matrix(places, edges), directed=False, indices=[len(places) - 1])[0]
        return distances[-1 - len(begins):-1]

    def find_nearest_free(self, place: Array) -> Array:
        """Return the place nearest to a given one that keeps the distance, (2,)."""
        point = shapely.Point(place)
        for part in self._parts:
            if part.contains(point):
                point = part.exterior.interpolate(part.exterior.project(point))
        return np.array(point.coords[0])

    def _insert(self, extra: Array) -> tuple[Array, _Edges]:
        """Return the corners with extra places behind them, and the edges between all."""
        corners = len(self._corners)
        places = np.concatenate([self._corners, extra])
        more = np.arange(corners, len(places))
        # Edges from the corners to each extra place, and from each extra place to the last one.
        edges = np.stack([
            np.append(np.tile(np.arange(corners), len(more)), more[:-1]),
            np.append(np.repeat(more, corners), np.full(len(more) - 1, more[-1]))])
        return places, np.append(self._edges, self._select_visible(places, edges), axis=1)


def _build_matrix(places: Array, edges: _Edges) -> Any:
    lengths = np.linalg.norm(places[edges[0]] - places[edges[1]], axis=1)
    # SciPy 1.11 has csgraph for indices of 32 bits only.
    return scipy.sparse.csr_array((np.maximum(lengths, 1e-12), edges.astype(np.int32)),
                                  shape=(len(places),) * 2)


def _find_shortest_route(places: Array, edges: _Edges) -> Array | None:
    """Return the shortest route from the last place but one to the last, or None."""
    begin, end = len(places) - 2, len(places) - 1
    lengths, before = scipy.sparse.csgraph.dijkstra(
        _build_matrix(places, edges), directed=False, indices=begin, return_predecessors=True)
    if not np.isfinite(lengths[end]):
        return None
    route = [end]
    while route[-1] != begin:
        route.append(before[route[-1]])
    return places[route[::-1]]
