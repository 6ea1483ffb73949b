"""Shortest ways around what a UAV may not enter, also those on the other sides."""

from collections.abc import Callable, Sequence
from functools import lru_cache
from itertools import pairwise
import math
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray
import scipy
import shapely

from ...mission.scenario import Array, Scenario
from ...model.airspace import airspace_of
from ...model.grid import Grid

MOST_WAYS = 3
"""Between two places, on different sides of what is between them."""

_DISTANCES = (0.2, 0.01)  # That ways keep from what is in their way, in steps, where they can.
_INSIDE = 0.1  # How far places are within the fence, in steps.
_MOST_CORNERS = 250  # Of what is in the way; outlines of more are made coarser.
_ROUNDING = 1e-6  # By which a way may touch what is in the way, in m.

Check: TypeAlias = Callable[[], None]
"""Called now and then in a search; what it raises ends the search."""


class VisibilityGraph:
    """The visibility graph of what a UAV may not enter, enlarged by a distance in m."""

    def __init__(self, scenario: Scenario, uav: int, distance: float) -> None:
        pieces = airspace_of(scenario).pieces[uav]
        solid = shapely.union_all([shapely.Polygon(piece.vertices) for piece in pieces])
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
        self._normals, self._offsets = airspace_of(scenario).hull
        self._corners: Array = corners[(corners @ self._normals.T <= self._offsets).all(axis=1)]
        count = len(self._corners)
        first, second = np.triu_indices(count, 1)
        seen = self._sees(self._corners[first], self._corners[second])
        self._edges = first[seen], second[seen]

    def _sees(self, begin: Array, end: Array) -> NDArray[np.bool_]:
        """Return whether nothing is between places, (M,)."""
        lines = shapely.linestrings(np.stack([begin, end], axis=1))
        free: NDArray[np.bool_] = ~shapely.intersects(self._enlarged, lines)
        if not free.all():
            # Near what is in the way, the distance cannot be kept.
            inside = shapely.contains_xy(self._enlarged, begin) | shapely.contains_xy(
                self._enlarged, end)
            again = np.flatnonzero(~free & inside)
            free[again] = ~shapely.intersects(self._solid, lines[again])
        return free

    def ways(self, begin: Array, end: Array, most: int) -> list[Array]:
        """
        Return at most so many ways between two places, the shortest first, each (K, 2) in m.

        The others pass what the shortest one touches on the other side.
        """
        places, edges = self._with(np.stack([begin, end]))
        shortest = _shortest(places, edges)
        if shortest is None:
            return []
        found = [shortest]
        for part in self._parts:
            touched = shortest[1:-1][shapely.distance(
                part, shapely.points(shortest[1:-1])) <= _ROUNDING]
            if not len(touched) or len(found) == most:
                continue
            # No way crosses a ray from inside it through where the shortest one touches it.
            centre = np.array(part.representative_point().coords[0])
            away = touched[len(touched) // 2] - centre
            ray = shapely.linestrings(np.stack([
                centre, centre + away * (1e5 / max(math.hypot(*away), 1e-9))]))
            lines = shapely.linestrings(np.stack([places[edges[0]], places[edges[1]]], axis=1))
            open_ = ~shapely.intersects(ray, lines)
            other = _shortest(places, (edges[0][open_], edges[1][open_]))
            if other is not None:
                found.append(other)
        return found

    def distances(self, begins: Array, end: Array) -> Array:
        """Return how long the shortest ways from places (M, 2) to one are, (M,) in m."""
        places, edges = self._with(np.concatenate([begins, end[None]]))
        found: Array = scipy.sparse.csgraph.dijkstra(
            _graph(places, edges), directed=False, indices=[len(places) - 1])[0]
        return found[-1 - len(begins):-1]

    def nearest_free(self, place: Array) -> Array:
        """Return the nearest place to one that keeps the distance, (2,)."""
        point = shapely.Point(place)
        for part in self._parts:
            if part.contains(point):
                point = part.exterior.interpolate(part.exterior.project(point))
        return np.array(point.coords[0])

    def _with(self, extra: Array) -> tuple[Array, tuple[NDArray[np.intp], NDArray[np.intp]]]:
        """Return places with some more, these last, and the edges between all."""
        known = len(self._corners)
        places = np.concatenate([self._corners, extra])
        more = np.arange(known, len(places))
        # From the corners to each of these, and from these to the last.
        first = np.append(np.tile(np.arange(known), len(more)), more[:-1])
        second = np.append(np.repeat(more, known), np.full(len(more) - 1, more[-1]))
        seen = self._sees(places[first], places[second])
        return places, (np.append(self._edges[0], first[seen]),
                        np.append(self._edges[1], second[seen]))


def free_places(scenario: Scenario, places: Array, check: Check) -> Array:
    """Return the nearest places to some (..., U, 2) in m where each UAV may be."""
    normals, offsets = airspace_of(scenario).hull
    found = places.copy()
    for uav, step in enumerate(Grid.of(scenario).steps.tolist()):
        check()
        graph = _graph_of(scenario, uav, _DISTANCES[0])
        for index in np.ndindex(places.shape[:-2]):
            at = (*index, uav)
            found[at] = _into(found[at], normals, offsets - _INSIDE * step)
            if graph is not None:
                found[at] = graph.nearest_free(found[at])
    return found


def ways_through(scenario: Scenario, uav: int, places: Sequence[Array],
                 most: int) -> tuple[VisibilityGraph | None, list[list[Array]]]:
    """
    Return the ways of a UAV from each place to the next, which keep a distance where they can.

    :return: the visibility graph, or None where nothing can be in its way, and for each pair of
        places the ways, as VisibilityGraph.ways returns them.
    """
    ways: list[list[Array]] = [[] for _ in places[1:]]
    for distance in _DISTANCES:
        graph = _graph_of(scenario, uav, distance)
        if graph is None:
            break
        ways = [graph.ways(begin, end, most) for begin, end in pairwise(places)]
        if all(ways):
            break
    return graph, ways


def _graph_of(scenario: Scenario, uav: int, distance: float) -> VisibilityGraph | None:
    """Return the graph of a UAV with a distance in steps, or None without anything in its way."""
    if not airspace_of(scenario).pieces[uav]:
        return None
    # The same for all that fly as high and as fast.
    kinds = [(one.altitude, one.max_speed) for one in scenario.uavs]
    return _known_graph(scenario, kinds.index(kinds[uav]), distance)


@lru_cache(maxsize=128)
def _known_graph(scenario: Scenario, uav: int, distance: float) -> VisibilityGraph:
    return VisibilityGraph(
        scenario, uav, distance * float(Grid.of(scenario).steps[uav]))


def _into(place: Array, normals: Array, offsets: Array) -> Array:
    """Return a place moved into half-planes, by projections in turn."""
    for _ in range(100):
        beyond = normals @ place - offsets
        if (beyond <= 0).all():
            break
        worst = int(beyond.argmax())
        place = place - beyond[worst] * normals[worst]
    return place


def _graph(places: Array, edges: tuple[Any, Any]) -> Any:
    lengths = np.linalg.norm(places[edges[0]] - places[edges[1]], axis=1)
    # SciPy 1.11 has csgraph for indices of 32 bits only.
    indices = tuple(np.asarray(places_at, np.int32) for places_at in edges)
    return scipy.sparse.csr_array((np.maximum(lengths, 1e-12), indices), shape=(len(places),) * 2)


def _shortest(places: Array, edges: tuple[Any, Any]) -> Array | None:
    """Return the shortest way from the last place but one to the last, or None."""
    begin, end = len(places) - 2, len(places) - 1
    lengths, before = scipy.sparse.csgraph.dijkstra(
        _graph(places, edges), directed=False, indices=begin, return_predecessors=True)
    if not np.isfinite(lengths[end]):
        return None
    way = [end]
    while way[-1] != begin:
        way.append(before[way[-1]])
    return places[way[::-1]]
