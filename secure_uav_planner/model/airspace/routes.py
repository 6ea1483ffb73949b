"""Shortest routes around obstacles, by visibility graphs."""

from collections.abc import Sequence
import math
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray
import scipy
import shapely

from .obstacles import Airspace
from ...mission.validation import Array

MOST_ROUTES = 3
"""Largest number of routes between two places, on different sides of obstacles."""

_MOST_CORNERS = 250  # Outlines of obstacles with more corners are simplified.
_ROUNDING = 1e-6  # Depth [m] by which a route may cut into an obstacle.

Edges: TypeAlias = NDArray[np.intp]
"""Indices of the two places of each of M edges, (2, M)."""


class VisibilityGraph:
    """
    The corners of a UAV's enlarged obstacles, and the edges between corners that see each other.

    :param uav: index of the UAV.
    :param distance: distance [m] by which obstacles are enlarged, and which routes keep.
    """

    def __init__(self, airspace: Airspace, uav: int, distance: float) -> None:
        """Enlarge and simplify the obstacles, and find the corners that see each other."""
        solid = shapely.union_all([shapely.Polygon(obstacle.vertices)
                                   for obstacle in airspace.obstacles[uav]])
        enlarged = solid.buffer(distance, join_style='mitre')
        # Simplifying moves an outline by up to `coarseness`, so it is enlarged by as much more.
        coarseness = distance / 4
        while shapely.get_num_coordinates(enlarged) > _MOST_CORNERS:
            enlarged = solid.simplify(coarseness).buffer(
                distance + coarseness, join_style='mitre')
            coarseness *= 2
        self._parts = shapely.get_parts(enlarged)
        # Both are shrunk a little, so that edges along their outlines do not intersect them.
        self._solid = solid.buffer(-_ROUNDING)
        self._enlarged = enlarged.buffer(-max(_ROUNDING, distance / 100), join_style='mitre')
        shapely.prepare([self._solid, self._enlarged])
        corners = shapely.get_coordinates(enlarged)
        # Corners outside the fence's hull are left out.
        self._normals, self._offsets = airspace.hull
        self._corners: Array = corners[(corners @ self._normals.T <= self._offsets).all(axis=1)]
        self._edges = self._select_visible(
            self._corners, np.array(np.triu_indices(len(self._corners), 1)))

    def _select_visible(self, places: Array, edges: Edges) -> Edges:
        """Return the edges (2, M) between places (K, 2) in m that no enlarged obstacle blocks."""
        lines = draw_edges(places, edges)
        free = ~shapely.intersects(self._enlarged, lines)
        # An edge with an end inside an enlarged obstacle must only clear the real obstacles.
        inside = shapely.contains_xy(self._enlarged, *places[edges].T).any(axis=1)
        again = np.flatnonzero(~free & inside)
        free[again] = ~shapely.intersects(self._solid, lines[again])
        return edges[:, free]

    def find_routes(self, begin: Array, end: Array, most: int) -> list[Array]:
        """
        Return the shortest route between two places and alternatives, each (K, 2) in m.

        An alternative is the shortest route that passes one obstacle on the opposite side. It may
        not cross the ray from inside the obstacle through the corner that the shortest route
        touches. Alternatives are not sorted by length. Without a route the list is empty.

        :param begin: the first place, (2,) in m.
        :param end: the last place, (2,) in m.
        :param most: largest number of routes.
        """
        places, edges = self._insert(np.stack([begin, end]))
        shortest = _find_shortest_route(places, edges)
        if shortest is None:
            return []
        routes, corners = [shortest], shortest[1:-1]
        for part in self._parts:
            touched = corners[shapely.distance(part, shapely.points(corners)) <= _ROUNDING]
            if not len(touched) or len(routes) == most:
                continue
            centre = np.array(part.representative_point().coords[0])
            away = touched[len(touched) // 2] - centre
            ray = shapely.linestrings(np.stack([
                centre, centre + away * (1e5 / max(math.hypot(*away), 1e-9))]))
            is_allowed = ~shapely.intersects(ray, draw_edges(places, edges))
            alternative = _find_shortest_route(places, edges[:, is_allowed])
            if alternative is not None:
                routes.append(alternative)
        return routes

    def measure_distances(self, begins: Array, end: Array) -> Array:
        """Return lengths of shortest routes from places (M, 2) to `end`, (M,) in m; may be inf."""
        places, edges = self._insert(np.concatenate([begins, end[None]]))
        [distances] = measure_paths(places, edges, [len(places) - 1])
        return np.asarray(distances[-1 - len(begins):-1])

    def find_nearest_free(self, place: Array) -> Array:
        """Return a place (2,) in m, moved to the nearest outline if in an enlarged obstacle."""
        point = shapely.Point(place)
        for part in self._parts:
            if part.contains(point):
                point = part.exterior.interpolate(part.exterior.project(point))
        return np.array(point.coords[0])

    def _insert(self, extra: Array) -> tuple[Array, Edges]:
        """
        Return the corners followed by extra places, (K, 2) in m, and their visible edges (2, M).

        Extra places are joined to all corners and to the last extra place.
        """
        corners = len(self._corners)
        places = np.concatenate([self._corners, extra])
        more = np.arange(corners, len(places))
        # Edges from the corners to each extra place, and from each extra place to the last one.
        edges = np.stack([
            np.append(np.tile(np.arange(corners), len(more)), more[:-1]),
            np.append(np.repeat(more, corners), np.full(len(more) - 1, more[-1]))])
        return places, np.append(self._edges, self._select_visible(places, edges), axis=1)


def draw_edges(places: Array, edges: Edges) -> NDArray[Any]:
    """Return the straight line of each edge (2, M) between places (K, 2), (M,)."""
    return np.asarray(shapely.linestrings(places[edges].swapaxes(0, 1)))


def measure_paths(places: Array, edges: Edges, begins: Sequence[int]) -> Array:
    """
    Return the lengths of the shortest paths along edges from B places to all K, (B, K) in m.

    A length is infinite without a path.

    :param places: (K, 2) in m.
    :param begins: indices of the B places where paths begin.
    """
    return np.asarray(scipy.sparse.csgraph.dijkstra(
        _build_matrix(places, edges), directed=False, indices=begins))


def _build_matrix(places: Array, edges: Edges) -> Any:
    """Return the lengths [m] of edges (2, M) between places (K, 2) as a sparse matrix (K, K)."""
    lengths = np.linalg.norm(places[edges[0]] - places[edges[1]], axis=1)
    # A length of 0 would be no edge. SciPy 1.11 has csgraph for indices of 32 bits only.
    return scipy.sparse.csr_array((np.maximum(lengths, 1e-12), edges.astype(np.int32)),
                                  shape=(len(places),) * 2)


def _find_shortest_route(places: Array, edges: Edges) -> Array | None:
    """Return the shortest route from the last place but one to the last, (M, 2), or None."""
    begin, end = len(places) - 2, len(places) - 1
    lengths, before = scipy.sparse.csgraph.dijkstra(
        _build_matrix(places, edges), directed=False, indices=begin, return_predecessors=True)
    if not np.isfinite(lengths[end]):
        return None
    route = [end]
    while route[-1] != begin:
        route.append(before[route[-1]])
    return places[route[::-1]]
