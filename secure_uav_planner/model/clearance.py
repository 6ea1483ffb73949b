"""Distances of the flown curves to zones, to the geofence and to each other, at any time."""

from collections.abc import Sequence
from functools import cached_property
from itertools import combinations
import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
import shapely

from .curve import Curve
from .quadratics import find_crossings, least_distance, least_distance_to_edge, Pieces
from ..errors import PlanError
from ..mission.participants import Uav
from ..mission.scenario import POSITION_TOLERANCE, Scenario
from ..mission.validation import Array

CLOSE_DISTANCE = 5.0
"""Distance between UAVs in m below which a plan without a separation deserves a warning."""

_Indices = NDArray[np.intp]


def find_unseparated_pair(scenario: Scenario) -> tuple[str, str] | None:
    """Return two UAVs that may come within CLOSE_DISTANCE and margins, or None if none may."""
    least = CLOSE_DISTANCE + 2 * scenario.tracking_margin
    for first, second in combinations(scenario.uavs, 2):
        if scenario.separation == 0 and abs(first.altitude - second.altitude) < least:
            return first.name, second.name
    return None


class Approach(NamedTuple):
    """
    The closest approach of a UAV to another UAV or a zone.

    :ivar distance: in m, in space between UAVs and on the map to a zone as given, without margin.
    :ivar time: in s from point 0.
    :ivar names: of the UAV, and of the other UAV or the zone.
    """

    distance: float
    time: float
    names: tuple[str, str]


class Clearance:
    """
    Distances of a flight in continuous time, by closed forms and not by samples.

    A UAV that waits at its start or goal while another flies counts as well.

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
        if nearest is not None and nearest.distance < scenario.keep_apart - POSITION_TOLERANCE:
            raise PlanError(
                f'{nearest.names[0]} and {nearest.names[1]} are {nearest.distance:.9g} m apart '
                f'{nearest.time:.6g} s after point 0; separation{scenario.margin_text} is '
                f'{scenario.keep_apart:.9g} m')

    @cached_property
    def between_uavs(self) -> Approach | None:
        """Smallest distance between any two UAVs, or None with only one."""
        uavs, pieces = self._scenario.uavs, self._pieces
        pairs = np.array(list(combinations(range(len(uavs)), 2)), int).reshape(-1, 2)
        if not len(pairs):
            return None
        first, second = pairs.T
        position, velocity, acceleration = (
            values[first] - values[second]
            for values in (pieces.positions, pieces.velocities, pieces.accelerations))
        heights = self._scenario.altitudes[first] - self._scenario.altitudes[second]
        middle = np.hypot(np.linalg.norm(position, axis=-1), heights[:, None])
        relative = Pieces(pieces.times, pieces.half, position, velocity, acceleration)
        least = middle - np.linalg.norm(relative.reach, axis=-1)
        pair, at = np.nonzero(least <= middle.min())
        level, by = least_distance(position[pair, at], velocity[pair, at], acceleration[pair, at],
                                   pieces.half)
        distance = np.hypot(level, heights[pair])
        best = int(distance.argmin())
        names = [uavs[number].name for number in pairs[pair[best]].tolist()]
        return Approach(float(distance[best]), float(pieces.times[at[best]] + by[best]),
                        (names[0], names[1]))

    @property
    def uavs_beyond_margin(self) -> float:
        """Distance that two errors of tracking_margin leave between UAVs, m; infinite for one."""
        least = self.between_uavs
        return math.inf if least is None else least.distance - 2 * self._scenario.tracking_margin

    @property
    def zones_beyond_margin(self) -> float:
        """Distance that an error of tracking_margin leaves to zones, m; infinite without any."""
        least = self.to_zones
        return math.inf if least is None else least.distance - self._scenario.tracking_margin

    @property
    def is_close(self) -> bool:
        """Whether no separation is asked for and UAVs come within CLOSE_DISTANCE and margins."""
        return self._scenario.separation == 0 and self.uavs_beyond_margin < CLOSE_DISTANCE

    @property
    def between_uavs_text(self) -> str:
        """Closest approach of UAVs in words, with the remedy if it is too close."""
        least, margin = self.between_uavs, self._scenario.margin_text
        if least is None:
            return ''
        left = margin and f' ({self.uavs_beyond_margin:.1f} m{margin})'
        text = (f'{least.names[0]} and {least.names[1]} come within {least.distance:.1f} m of '
                f'each other{left}')
        return text if not self.is_close else (
            f'{text} at {least.time:.1f} s, less than {CLOSE_DISTANCE:g} m{margin}; set '
            'separation to keep them apart')

    @cached_property
    def to_zones(self) -> Approach | None:
        """Smallest distance of a UAV to a zone, as given, at its altitude, or None without any."""
        nearest = (self._find_nearest_zone(number, uav)
                   for number, uav in enumerate(self._scenario.uavs))
        return min((approach for approach in nearest if approach is not None), default=None)

    @cached_property
    def _pieces(self) -> Pieces:
        return Pieces.of(self._curve)

    def _check_area(self, number: int, uav: Uav) -> None:
        """Check the zones and the fence of one UAV."""
        scenario, pieces = self._scenario, self._pieces.select_uav(number)
        zones = scenario.keep_out(uav.altitude)
        shapes = [shapely.Polygon(vertices) for vertices, _ in zones]
        texts = [f'inside {name}' for _, name in zones]
        # Deeper in a zone than the tolerance, and farther from the fence.
        forbidden = [shape.buffer(-POSITION_TOLERANCE, join_style='mitre') for shape in shapes]
        if scenario.keep_in is not None:
            fence = shapely.Polygon(scenario.keep_in)
            shapes.append(fence)
            texts.append('outside the geofence')
            forbidden.append(_bounding_box(pieces, fence).difference(
                fence.buffer(POSITION_TOLERANCE, join_style='mitre')))
        entered = _find_entries(pieces, forbidden)
        if not entered:
            return
        index, times = next(iter(entered.items()))
        # Between two entries or ends of the flight it is inside, or outside.
        ends = np.array([self._curve.begin, *times, self._curve.end])
        times = np.concatenate([ends, (ends[1:] + ends[:-1]) / 2])
        points = shapely.points(self._curve.at(times).positions[number])
        depths = np.where(shapely.intersects(forbidden[index], points), shapely.distance(
            shapes[index].exterior, points), POSITION_TOLERANCE)
        raise PlanError(f'{uav.name} is {depths.max():.9g} m {texts[index]}'
                        f'{scenario.margin_text} {times[depths.argmax()]:.6g} s after point 0; '
                        'it must not be')

    def _find_nearest_zone(self, number: int, uav: Uav) -> Approach | None:
        """Return the smallest distance of one UAV to a zone at its altitude."""
        zones, pieces = self._scenario.zones_at(uav.altitude), self._pieces.select_uav(number)
        if not zones:
            return None
        edges, owners = _list_edges([shapely.Polygon(zone.vertices) for zone, _ in zones])
        tree, middles = _build_tree(edges), shapely.points(pieces.positions)
        (at, _), distances = tree.query_nearest(
            middles, all_matches=False, return_distance=True)
        middle = np.empty(len(middles))
        middle[at] = distances
        reach = np.linalg.norm(pieces.reach, axis=-1)
        near = np.flatnonzero(middle - reach <= middle.min())
        at, edge = tree.query(middles[near], predicate='dwithin',
                              distance=(middle.min() + reach[near]) * (1 + 1e-9))
        distance, by = least_distance_to_edge(pieces.take(near[at]), edges[edge])
        best = int(distance.argmin())
        return Approach(float(distance[best]), float(pieces.times[near[at[best]]] + by[best]),
                        (uav.name, zones[owners[edge[best]]][1]))


def _find_entries(pieces: Pieces, polygons: Sequence[Any]) -> dict[int, Array]:
    """Return times around the entries of a motion into polygons, by the polygons' indices."""
    entries: dict[int, list[Array]] = {}
    middles = shapely.points(pieces.positions)
    at, inside = shapely.STRtree(polygons).query(middles, predicate='intersects')
    for index in np.unique(inside).tolist():
        entries.setdefault(index, []).append(pieces.times[at[inside == index]])
    edges, owners = _list_edges(polygons)
    low, high = pieces.positions - pieces.reach, pieces.positions + pieces.reach
    at, edge = _build_tree(edges).query(shapely.box(*low.T, *high.T))
    by, crossed = find_crossings(pieces.take(at), edges[edge])
    times = np.where(crossed, pieces.times[at][:, None] + by, np.nan)
    for index in np.unique(owners[edge][crossed.any(axis=1)]).tolist():
        own = times[owners[edge] == index]
        entries.setdefault(index, []).append(own[~np.isnan(own)])
    return {index: np.sort(np.concatenate(entries[index])) for index in sorted(entries)}


def _bounding_box(pieces: Pieces, polygon: Any) -> Any:
    """Return a box that holds a motion and a polygon."""
    places = np.concatenate([pieces.positions - pieces.reach, pieces.positions + pieces.reach,
                             shapely.get_coordinates(polygon)])
    return shapely.box(*places.min(axis=0) - 1.0, *places.max(axis=0) + 1.0)


def _list_edges(polygons: Sequence[Any]) -> tuple[Array, _Indices]:
    """Return the edges of polygons, (E, 2, 2) in m, and the index of the polygon of each."""
    parts, owner = shapely.get_parts(np.array(polygons, object), return_index=True)
    rings, part = shapely.get_rings(parts, return_index=True)
    corners, ring = shapely.get_coordinates(rings, return_index=True)
    inside = np.flatnonzero(ring[1:] == ring[:-1])
    return np.stack([corners[inside], corners[inside + 1]], axis=1), owner[part[ring[inside]]]


def _build_tree(edges: Array) -> Any:
    return shapely.STRtree(shapely.linestrings(edges))
