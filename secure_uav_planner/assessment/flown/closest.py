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
    """Return the smallest distance in 3D between two UAVs at one time, or None for one UAV."""
    places = _fill_heights(flight)
    return _find_least(flight.times, {
        f'{first} and {second}': np.linalg.norm(places[first] - places[second], axis=1)
        for first, second in combinations(places, 2)})


def find_zone(flight: FlownFlight) -> Closest | None:
    """
    Return the least horizontal distance of a UAV to a no-fly zone, < 0 inside, or None.

    Only times count at which the UAV's height is between floor - margin and ceiling + margin of
    the zone, with the tracking margin of the mission.
    """
    scenario, margin = flight.plan.scenario, flight.plan.scenario.tracking_margin
    return _find_least(flight.times, {
        f'{name} and {zone_name}': np.where(
            (path[:, 2] >= zone.floor - margin) & (path[:, 2] <= zone.ceiling + margin),
            -_measure_depths(zone.vertices, path), np.nan)
        for name, path in _fill_heights(flight).items()
        for zone, zone_name in zip(scenario.no_fly_zones, scenario.zone_names, strict=True)})


def find_fence(flight: FlownFlight) -> Closest | None:
    """Return the least distance of a UAV to the geofence, < 0 outside, or None without one."""
    fence = flight.plan.scenario.geofence
    return _find_least(flight.times, {} if fence is None else {
        name: _measure_depths(fence, path) for name, path in _fill_heights(flight).items()})


def _fill_heights(flight: FlownFlight) -> dict[str, Array]:
    """Return positions (K, 3) by UAV, at the planned altitude if heights are not in the log."""
    places = {}
    for uav, path in zip(flight.plan.scenario.uavs, flight.positions, strict=True):
        heights = np.where(np.isnan(path[:, 2]), uav.altitude, path[:, 2])
        places[uav.name] = np.column_stack([path[:, :2], heights])
    return places


def _measure_depths(vertices: Vertices, path: Array) -> Array:
    """Return horizontal distances (K,) [m] of a path (K, 3) to an outline, negative outside."""
    polygon, points = shapely.Polygon(vertices), shapely.points(np.nan_to_num(path[:, :2]))
    depths = np.where(shapely.contains(polygon, points), 1.0, -1.0) * shapely.distance(
        polygon.exterior, points)
    return np.where(np.isfinite(path[:, 0]), depths, np.nan)


def _find_least(times: Array, distances: dict[str, Array]) -> Closest | None:
    """Return the least of all distances (K,) [m], with time and names; None if all are NaN."""
    closest = [Closest(float(values[index]), float(times[index]), names)
               for names, values in distances.items() if np.isfinite(values).any()
               for index in [int(np.nanargmin(values))]]
    return min(closest, default=None)
