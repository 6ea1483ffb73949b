"""Distances of the flown curves to zones, to the geofence and to each other, at any time."""

from collections.abc import Sequence
from functools import cached_property
from itertools import combinations
import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
import shapely

from ..curve import Curve
from ...errors import PlanError
from ...mission.participants import Uav
from ...mission.scenario import POSITION_TOLERANCE, Scenario
from ...mission.validation import Array

_HALVINGS = 45
_POINT = 1e-300  # The square of an edge's length at least, where its corners are equal.
_ROUNDING = 1e-9  # Share by which edges and pieces are made longer, so that no crossing is missed.

CLOSE_DISTANCE = 5.0
"""Distance between UAVs in m below which a plan without a separation deserves a warning."""

_EVERYWHERE = shapely.box(-1e9, -1e9, 1e9, 1e9)
"""What holds the outside of a fence."""


class Pieces(NamedTuple):
    """
    Pieces of equal length in which every UAV moves with constant acceleration.

    :ivar times: times of the middles of the pieces, (K,) in s from point 0.
    :ivar half: half the duration of a piece [s].
    :ivar positions: positions in the middles, (..., K, 2) in m.
    :ivar velocities: velocities in the middles, (..., K, 2) in m/s.
    :ivar accelerations: accelerations of the pieces, (..., K, 2) in m/s^2.
    """

    times: Array
    half: float
    positions: Array
    velocities: Array
    accelerations: Array

    def take(self, *index: Any) -> 'Pieces':
        """Return pieces by indices of the leading axes of the arrays; the last is for axis K."""
        return Pieces(self.times[index[-1]], self.half, self.positions[index],
                      self.velocities[index], self.accelerations[index])

    def at(self, by: Array) -> Array:
        """Return positions (..., K, 2) in m, of piece k at by[..., k] seconds from its middle."""
        return (self.positions + self.velocities * by[..., None]
                + self.accelerations * (by[..., None]**2 / 2))

    @property
    def reach(self) -> Array:
        """How far a piece goes from its middle along x and y at most, (..., K, 2) in m."""
        return (np.abs(self.velocities) * self.half
                + np.abs(self.accelerations) * (self.half**2 / 2))


def least_distance(pieces: Pieces) -> tuple[Array, Array]:
    """
    Return the least distances [m] of pieces from (0, 0), and their times [s] from the middles.

    Both are (K,). A piece is at p + v t + a t^2 / 2 for |t| <= half, with arrays p, v and a
    (K, 2). Half the derivative of the squared distance is f = cubic t^3 + square t^2 + linear t +
    constant. The distance is least at a zero of f where f rises, or at an end of the piece. f
    rises from -half to `first` and from `second` to half: the roots of f', or both half without
    roots. Bisection of either interval ends at a zero of f, or at an end of the interval.
    """
    position, velocity, acceleration = pieces.positions, pieces.velocities, pieces.accelerations
    cubic = 0.5 * (acceleration**2).sum(axis=-1)
    square = 1.5 * (velocity * acceleration).sum(axis=-1)
    linear = ((velocity**2) + position * acceleration).sum(axis=-1)
    constant = (position * velocity).sum(axis=-1)
    first, second = _find_roots(3 * cubic, square, linear, pieces.half)
    least, time = np.full(len(position), np.inf), np.zeros(len(position))
    half = np.full_like(time, pieces.half)
    for low, high in ((-half, first), (second, half)):
        for _ in range(_HALVINGS):
            middle = (low + high) / 2
            recedes = constant + middle * (linear + middle * (square + middle * cubic)) > 0
            low, high = np.where(recedes, low, middle), np.where(recedes, middle, high)
        zero = (low + high) / 2
        distance = np.linalg.norm(pieces.at(zero), axis=-1)
        time = np.where(distance < least, zero, time)
        least = np.minimum(distance, least)
    return least, time


def find_crossings(pieces: Pieces, edges: Array) -> tuple[Array, NDArray[np.bool_]]:
    """
    Return two times [s] from piece k's middle, and whether it crosses edge k then, (K, 2) each.

    A piece crosses the edge's line at most twice, at the roots of a quadratic polynomial. It
    crosses the edge at a root if |root| <= half and its place then is between the edge's corners.
    Pieces have arrays (K, 2), and edges are pairs of corners, (K, 2, 2) in m.
    """
    begin, along = edges[:, 0], edges[:, 1] - edges[:, 0]
    normal = np.stack([along[:, 1], -along[:, 0]], axis=1)
    roots = _find_roots((pieces.accelerations * normal).sum(axis=1) / 2,
                        (pieces.velocities * normal).sum(axis=1) / 2,
                        ((pieces.positions - begin) * normal).sum(axis=1), np.inf)
    times = np.stack(roots, axis=1)
    inside = np.abs(times) <= pieces.half * (1 + _ROUNDING)
    times = np.clip(times, -pieces.half, pieces.half)
    share = np.stack([((pieces.at(by) - begin) * along).sum(axis=1) for by in times.T], axis=1)
    share /= np.maximum((along**2).sum(axis=1, keepdims=True), _POINT)
    return times, inside & (np.abs(share - 0.5) <= 0.5 + _ROUNDING)


def least_distance_to_edge(pieces: Pieces, edges: Array) -> tuple[Array, Array]:
    """
    Return the least distance [m] of piece k to edge k, and its time [s] from the middle, (K,).

    Candidates of the time are the time at which the signed distance to the edge's line has a zero
    derivative, the times nearest to both corners, up to two crossings of the edge, and both ends
    of the piece. Pieces have arrays (K, 2), and edges are pairs of corners, (K, 2, 2) in m.
    """
    begin, along = edges[:, 0], edges[:, 1] - edges[:, 0]
    normal = np.stack([along[:, 1], -along[:, 0]], axis=1)
    half = np.full(len(edges), pieces.half)
    bend, slope = ((part * normal).sum(axis=1)
                   for part in (pieces.accelerations, pieces.velocities))
    # Candidates that do not exist within the piece are replaced by its end, half.
    level = np.divide(-slope, bend, out=half.copy(), where=np.abs(slope) < np.abs(bend) * half)
    corners = [least_distance(pieces._replace(positions=pieces.positions - edges[:, end]))[1]
               for end in range(2)]
    crossings, crosses = find_crossings(pieces, edges)
    times = np.stack([
        level, *corners, -half, half, *np.where(crosses, crossings, half[:, None]).T])
    offsets = pieces.at(times) - begin
    square = np.maximum((along**2).sum(axis=1), _POINT)
    share = np.clip((offsets * along).sum(axis=-1) / square, 0, 1)
    distances = np.linalg.norm(offsets - share[..., None] * along, axis=-1)
    best = distances.argmin(axis=0)[None]
    return (np.take_along_axis(distances, best, axis=0)[0],
            np.take_along_axis(times, best, axis=0)[0])


def _find_roots(square: Array, half_linear: Array, constant: Array,
                most: float) -> tuple[Array, Array]:
    """
    Return the smaller and the larger root of square t^2 + 2 half_linear t + constant, (K,) each.

    Both are clipped to [-most, most]. Without a real root both are most. A linear polynomial has a
    second root at plus or minus infinity.
    """
    discriminant = half_linear**2 - square * constant
    with np.errstate(divide='ignore', invalid='ignore', over='ignore'):
        # The sum of equal signs has no cancellation; constant / scaled is the other root.
        scaled = -(half_linear + np.copysign(np.sqrt(discriminant), half_linear))
        first, second = scaled / square, constant / scaled
    first, second = (np.where(np.isnan(first), second, first),
                     np.where(np.isnan(second), first, second))
    exists = (discriminant >= 0) & ((square != 0) | (half_linear != 0))
    low, high = (np.where(exists, np.clip(root, -most, most), most)
                 for root in (np.minimum(first, second), np.maximum(first, second)))
    return low, high


def find_unseparated_pair(scenario: Scenario) -> tuple[str, str] | None:
    """Return names of two UAVs that neither a separation nor altitudes keep apart, or None."""
    least = CLOSE_DISTANCE + 2 * scenario.tracking_margin
    for first, second in combinations(scenario.uavs, 2):
        if scenario.separation == 0 and abs(first.altitude - second.altitude) < least:
            return first.name, second.name
    return None


class Approach(NamedTuple):
    """
    The closest approach of a UAV to another UAV or a zone.

    :ivar distance: distance [m], in space to a UAV, and on the map to a zone without its margin.
    :ivar time: time of the approach [s] from point 0.
    :ivar names: names of the UAV, and of the other UAV or the zone.
    """

    distance: float
    time: float
    names: tuple[str, str]


class Clearance:
    """
    Distances of a flight in continuous time, by closed forms and not by samples.

    They include a UAV that waits at its start or goal while another flies.

    :param scenario: a Scenario.
    :param curve: the Curve that its UAVs fly.
    """

    def __init__(self, scenario: Scenario, curve: Curve) -> None:
        self._scenario = scenario
        self._curve = curve

    def __repr__(self) -> str:
        approaches = (('UAVs', self.between_uavs), ('UAV and zone', self.to_zones))
        return '<Clearance: ' + '; '.join(
            f'{kind} at least {least.distance:.4g} m apart ({" and ".join(least.names)} after '
            f'{least.time:.4g} s)' for kind, least in approaches if least is not None) + '>'

    def validate(self) -> None:
        """
        Check zones, geofence and separation with tracking_margin, each to POSITION_TOLERANCE.

        :raises PlanError: naming the UAV, the zone, fence or other UAV, the time and the distance.
        """
        scenario = self._scenario
        if scenario.no_fly_zones or scenario.geofence is not None:
            for number, uav in enumerate(scenario.uavs):
                self._check_area(number, uav)
        nearest = self.between_uavs if scenario.separation > 0 else None
        least, margin = scenario.boundaries.keep_apart, scenario.boundaries.margin_text
        if nearest is not None and nearest.distance < least - POSITION_TOLERANCE:
            raise PlanError(
                f'{nearest.names[0]} and {nearest.names[1]} are {nearest.distance:.9g} m apart '
                f'{nearest.time:.6g} s after point 0; separation{margin} is {least:.9g} m')

    @cached_property
    def between_uavs(self) -> Approach | None:
        """Closest approach of any two UAVs in space, or None with a single UAV."""
        uavs, pieces = self._scenario.uavs, self._pieces
        pairs = np.array(list(combinations(range(len(uavs)), 2)), int).reshape(-1, 2)
        if not len(pairs):
            return None
        first, second = pairs.T
        relative = Pieces(pieces.times, pieces.half, *(
            values[first] - values[second]
            for values in (pieces.positions, pieces.velocities, pieces.accelerations)))
        heights = self._scenario.altitudes[first] - self._scenario.altitudes[second]
        middle = np.hypot(np.linalg.norm(relative.positions, axis=-1), heights[:, None])
        # Only pieces are examined that may come nearer than the nearest middle within their reach.
        least = middle - np.linalg.norm(relative.reach, axis=-1)
        pair, piece = np.nonzero(least <= middle.min())
        horizontal, delays = least_distance(relative.take(pair, piece))
        distances = np.hypot(horizontal, heights[pair])
        best = int(distances.argmin())
        names = [uavs[number].name for number in pairs[pair[best]].tolist()]
        return Approach(float(distances[best]), float(pieces.times[piece[best]] + delays[best]),
                        (names[0], names[1]))

    @property
    def uavs_beyond_margin(self) -> float:
        """Least distance [m] of two UAVs minus 2 tracking_margin; infinite for a single UAV."""
        least = self.between_uavs
        return math.inf if least is None else least.distance - 2 * self._scenario.tracking_margin

    @property
    def zones_beyond_margin(self) -> float:
        """Least distance [m] of a UAV to a zone minus tracking_margin; infinite without zones."""
        least = self.to_zones
        return math.inf if least is None else least.distance - self._scenario.tracking_margin

    @property
    def is_close(self) -> bool:
        """Whether no separation is asked for and UAVs come within CLOSE_DISTANCE and margins."""
        return self._scenario.separation == 0 and self.uavs_beyond_margin < CLOSE_DISTANCE

    @property
    def between_uavs_text(self) -> str:
        """Closest approach of UAVs in words, with advice if it is_close; '' for a single UAV."""
        least, margin = self.between_uavs, self._scenario.boundaries.margin_text
        if least is None:
            return ''
        rest = margin and f' ({self.uavs_beyond_margin:.1f} m{margin})'
        text = (f'{least.names[0]} and {least.names[1]} come within {least.distance:.1f} m of '
                f'each other{rest}')
        return text if not self.is_close else (
            f'{text} at {least.time:.1f} s, less than {CLOSE_DISTANCE:g} m{margin}; set '
            'separation to keep them apart')

    @cached_property
    def to_zones(self) -> Approach | None:
        """Closest approach of a UAV to a zone at its altitude, without margin, or None."""
        nearest = (self._find_nearest_zone(number, uav)
                   for number, uav in enumerate(self._scenario.uavs))
        return min((approach for approach in nearest if approach is not None), default=None)

    @cached_property
    def _pieces(self) -> Pieces:
        """Pieces of the whole flight, with arrays (U, K, 2)."""
        curve = self._curve
        count = round((curve.end - curve.begin) / curve.piece)
        times = curve.begin + (np.arange(count) + 0.5) * curve.piece
        return Pieces(times, curve.piece / 2, *curve.at(times)[:3])

    def _check_area(self, number: int, uav: Uav) -> None:
        """Raise PlanError, with a depth and its time, if a UAV enters a zone or leaves a fence."""
        boundaries, pieces = self._scenario.boundaries, self._pieces.take(number, slice(None))
        zones = boundaries.keep_out(uav.altitude)
        shapes = [shapely.Polygon(vertices) for vertices, _ in zones]
        texts = [f'inside {name}' for _, name in zones]
        # Zones shrunk by the tolerance, and all that is outside the fence enlarged by it.
        forbidden = [shape.buffer(-POSITION_TOLERANCE, join_style='mitre') for shape in shapes]
        if boundaries.keep_in is not None:
            shapes.append(shapely.Polygon(boundaries.keep_in))
            texts.append('outside the geofence')
            forbidden.append(_EVERYWHERE.difference(
                shapes[-1].buffer(POSITION_TOLERANCE, join_style='mitre')))
        index, times = _find_entry(pieces, forbidden)
        if not len(times):
            return
        # Depths are compared at these times, both ends and the middles in between. One middle is
        # enough, because the UAV neither enters nor leaves between two successive times.
        ends = np.array([self._curve.begin, *times, self._curve.end])
        times = np.concatenate([ends, (ends[1:] + ends[:-1]) / 2])
        points = shapely.points(self._curve.at(times).positions[number])
        depths = np.where(shapely.intersects(forbidden[index], points), shapely.distance(
            shapes[index].exterior, points), POSITION_TOLERANCE)
        raise PlanError(f'{uav.name} is {depths.max():.9g} m {texts[index]}'
                        f'{boundaries.margin_text} {times[depths.argmax()]:.6g} s after point 0; '
                        'it must not be')

    def _find_nearest_zone(self, number: int, uav: Uav) -> Approach | None:
        """Return the closest approach of UAV `number` to outlines of zones at its altitude."""
        zones = self._scenario.boundaries.zones_at(uav.altitude)
        if not zones:
            return None
        pieces = self._pieces.take(number, slice(None))
        edges, owners, tree = _list_edges([shapely.Polygon(zone.vertices) for zone, _ in zones])
        middles = shapely.points(pieces.positions)
        _, gaps = tree.query_nearest(middles, all_matches=False, return_distance=True)
        # A piece stays within its reach of its middle. So only pieces are examined that may come
        # nearer to a zone than the nearest middle, which is `least` away.
        least, reach = gaps.min(), np.linalg.norm(pieces.reach, axis=-1)
        near = np.flatnonzero(gaps - reach <= least)
        index, edge = tree.query(middles[near], predicate='dwithin',
                                 distance=(least + reach[near]) * (1 + 1e-9))
        distances, delays = least_distance_to_edge(pieces.take(near[index]), edges[edge])
        best = int(distances.argmin())
        return Approach(float(distances[best]),
                        float(pieces.times[near[index[best]]] + delays[best]),
                        (uav.name, zones[owners[edge[best]]][1]))


def _find_entry(pieces: Pieces, polygons: Sequence[Any]) -> tuple[int, Array]:
    """
    Return the least index of the polygons that a motion enters, and times at or in that polygon.

    The times [s], sorted, are from point 0: middles of pieces in the polygon, and crossings of its
    outline. Without an entry, the index is the number of polygons and there are no times.

    :param pieces: pieces of the motion, with arrays (K, 2).
    """
    middles = shapely.points(pieces.positions)
    piece, entered = shapely.STRtree(polygons).query(middles, predicate='intersects')
    edges, owners, tree = _list_edges(polygons)
    low, high = pieces.positions - pieces.reach, pieces.positions + pieces.reach
    near, edge = tree.query(shapely.box(*low.T, *high.T))
    delays, crossed = find_crossings(pieces.take(near), edges[edge])
    crossing, side = np.nonzero(crossed)
    indices = np.concatenate([entered, owners[edge[crossing]]])
    times = np.concatenate([
        pieces.times[piece], pieces.times[near[crossing]] + delays[crossing, side]])
    first = int(indices.min(initial=len(polygons)))
    return first, np.sort(times[indices == first])


def _list_edges(polygons: Sequence[Any]) -> tuple[Array, NDArray[np.intp], Any]:
    """Return edges (E, 2, 2) in m, the index of each edge's polygon (E,), and their STRtree."""
    parts, owner = shapely.get_parts(np.array(polygons, object), return_index=True)
    rings, part = shapely.get_rings(parts, return_index=True)
    corners, ring = shapely.get_coordinates(rings, return_index=True)
    inside = np.flatnonzero(ring[1:] == ring[:-1])
    edges = np.stack([corners[inside], corners[inside + 1]], axis=1)
    return edges, owner[part[ring[inside]]], shapely.STRtree(shapely.linestrings(edges))
