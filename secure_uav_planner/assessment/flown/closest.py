"""Smallest distances of a flown flight: between UAVs, to zones and to the geofence."""

from itertools import combinations
from typing import NamedTuple

import numpy as np
import shapely

from .flight import FlownFlight
from ...mission.polygons import Vertices
from ...mission.scenario import Array


class Closest(NamedTuple):
    """A smallest distance in m, its time in s from point 0, and between whom."""

    distance: float
    time: float
    names: str


def find_separation(flight: FlownFlight) -> Closest | None:
    """Return the smallest distance between two UAVs in space, or None for one UAV."""
    names, best = [uav.name for uav in flight.plan.scenario.uavs], None
    for first, second in combinations(range(len(names)), 2):
        distances = np.linalg.norm(flight.positions[first] - flight.positions[second], axis=1)
        best = _choose(best, distances, flight.times, f'{names[first]} and {names[second]}')
    return best


def find_zone(flight: FlownFlight) -> Closest | None:
    """Return the smallest distance to a zone, negative inside, or None without zones."""
    scenario, best = flight.plan.scenario, None
    for uav, path in zip(scenario.uavs, flight.positions, strict=True):
        for zone, name in scenario.boundaries.zones_at(uav.altitude):
            best = _choose(best, -_measure_depths(zone.vertices, path), flight.times,
                           f'{uav.name} and {name}')
    return best


def find_fence(flight: FlownFlight) -> Closest | None:
    """Return the smallest distance to the geofence, negative outside, or None without one."""
    scenario, best = flight.plan.scenario, None
    if scenario.geofence is not None:
        for uav, path in zip(scenario.uavs, flight.positions, strict=True):
            best = _choose(best, _measure_depths(scenario.geofence, path), flight.times, uav.name)
    return best


def _measure_depths(vertices: Vertices, path: Array) -> Array:
    """Return the distances of a path (K, 3) from an outline, negative outside, (K,) in m."""
    polygon, points = shapely.Polygon(vertices), shapely.points(np.nan_to_num(path[:, :2]))
    depths = np.where(shapely.contains(polygon, points), 1.0, -1.0) * shapely.distance(
        polygon.exterior, points)
    return np.where(np.isfinite(path[:, 0]), depths, np.nan)


def _choose(best: Closest | None, distances: Array, times: Array, names: str) -> Closest | None:
    """Return the smaller of `best` and the least of further distances (K,), which may be NaN."""
    if not np.isfinite(distances).any():
        return best
    index = int(np.nanargmin(distances))
    if best is not None and best.distance <= distances[index]:
        return best
    return Closest(float(distances[index]), float(times[index]), names)
