"""Maps of plans in degrees: GeoJSON, cut at the meridian of 180 degrees (RFC 7946, 3.1.9)."""

from collections.abc import Iterator, Mapping, Sequence
import json
import math
import os
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
import shapely

from .tables import point_rows
from ..errors import OptionError
from ..mission.files import atomic_file
from ..mission.geography import invert_points, invert_ring
from ..mission.validation import Array


def save_geojson(plan: Any, path: str | os.PathLike[str]) -> None:
    """
    Write paths, receivers, zones and fence of a plan to a GeoJSON file; see Plan.to_geojson.

    :raises OptionError: for a scenario without an origin.
    :raises OSError: when the file cannot be written; an existing file is kept.
    """
    if plan.scenario.origin is None:
        raise OptionError('scenario.origin is None; it must be an Origin, which says where on '
                          'Earth the plan is', ('scenario', 'origin'))
    with atomic_file(path) as file:
        json.dump({'type': 'FeatureCollection', 'features': [*_list_features(plan)]}, file,
                  allow_nan=False)


def _list_features(plan: Any) -> Iterator[dict[str, Any]]:
    """Yield GeoJSON features: UAVs' paths, nodes, eavesdroppers, tracks, zones and fence."""
    scenario, origin, rows = plan.scenario, plan.scenario.origin, point_rows(plan)

    def to_degrees(points: ArrayLike) -> Array:
        """Return longitude and latitude of points (K, 2) in m."""
        return invert_points(np.array(points, float).reshape(-1, 2), origin)[:, ::-1]

    def make_area(kind: str, vertices: ArrayLike, name: str, **properties: Any) -> dict[str, Any]:
        return _make_feature(kind, name, _cut_ring(invert_ring(vertices, origin)[:, ::-1]),
                             properties)

    def make_line(kind: str, points: ArrayLike, name: str, properties: Mapping[str, Any],
                  **values: Sequence[float] | None) -> dict[str, Any]:
        geometry, values = _cut_line(to_degrees(points), values)
        return _make_feature(kind, name, geometry, {**properties, **values})

    for uav in scenario.uavs:
        _, _, times, x, y, _, _, _, powers, *_ = zip(
            *(row for row in rows if row[0] == uav.name))
        yield make_line('path', np.column_stack([x, y]), uav.name, {'altitude': uav.altitude},
                        times=times, powers=powers)
    for name, node in zip(scenario.ground_node_names, scenario.ground_nodes, strict=True):
        yield _make_feature('ground_node', '' if scenario.is_plain_node else name,
                            _make_point(to_degrees(node.position)), {})
    for name, eve in zip(scenario.eavesdropper_names, scenario.eavesdroppers, strict=True):
        radius = eve.error_radius
        if radius:
            disc = shapely.Point(eve.position).buffer(radius).exterior.coords[:-1]
            yield make_area('eavesdropper', disc, name, error_radius=radius)
        else:
            yield _make_feature('eavesdropper', name, _make_point(to_degrees(eve.position)),
                                {'error_radius': radius})
    for name, receiver in zip(
            (*scenario.ground_node_names, *scenario.eavesdropper_names),
            (*scenario.ground_nodes, *scenario.eavesdroppers), strict=True):
        if receiver.track is not None:
            times, x, y, *radii = zip(*receiver.track)
            yield make_line('track', np.column_stack([x, y]), name, {}, times=times,
                            radii=radii[0] if radii else None)
    for name, zone in zip(scenario.zone_names, scenario.no_fly_zones, strict=True):
        yield make_area('zone', zone.vertices, name, floor=zone.floor,
                        ceiling=zone.ceiling if zone.ceiling < math.inf else None)
    if scenario.geofence is not None:
        yield make_area('geofence', scenario.geofence, '')


def _make_feature(kind: str, name: str, geometry: Mapping[str, Any],
                  properties: Mapping[str, Any]) -> dict[str, Any]:
    return {'type': 'Feature', 'properties': {'kind': kind, 'name': name, **properties},
            'geometry': geometry}


def _find_turn(longitude: float) -> int:
    """Return by how many turns of 360 degrees a longitude lies outside of -180 to 180."""
    return math.floor((longitude + 180) / 360)


def _make_point(points: Array) -> dict[str, Any]:
    longitude, latitude = points[0].tolist()
    return {'type': 'Point', 'coordinates': (longitude - 360 * _find_turn(longitude), latitude)}


def _cut_ring(ring: Array) -> dict[str, Any]:
    """Return a ring (longitude, latitude) as a Polygon, or MultiPolygon if cut at 180 degrees."""
    polygon, parts = shapely.Polygon(ring), []
    west, _, east, _ = polygon.bounds
    for turn in range(_find_turn(west), _find_turn(east) + 1):
        world = shapely.box(360 * turn - 180, -90, 360 * turn + 180, 90)
        cut = polygon if world.contains(polygon) else polygon.intersection(world)
        parts += [shapely.geometry.polygon.orient(shapely.transform(
            part, lambda corners, shift=360 * turn: corners - (shift, 0)))
            for part in shapely.get_parts(cut) if part.geom_type == 'Polygon']
    return dict(shapely.geometry.mapping(
        parts[0] if len(parts) == 1 else shapely.MultiPolygon(parts)))


def _cut_line(points: Array, values: Mapping[str, Sequence[float] | None]
              ) -> tuple[dict[str, Any], dict[str, Any]]:
    """
    Return (geometry, values) of a line: LineString, or MultiLineString if 180 degrees cuts it.

    Longitudes of the result are from -180 to 180. A line that is cut has a list of values for each
    part. At a cut, `powers` keep the value of the point before; other values are interpolated.

    :param points: longitude and latitude of K points, (K, 2) [degrees]; longitudes may exceed 180.
    :param values: lists of K values at the points, by name; None stays None.
    """
    names = [name for name, given in values.items() if given is not None]
    # A row has longitude, latitude and values. Longitudes of part k are 360 * turns[k] +- 180.
    rows = np.column_stack([points, *(np.array(values[name], float) for name in names)])
    power_columns = [2 + names.index(name) for name in names if name == 'powers']
    parts, turns = [[rows[0]]], [_find_turn(rows[0, 0])]
    for before, after in zip(rows[:-1], rows[1:]):
        if (turn := _find_turn(after[0])) != turns[-1]:
            meridian = 360 * max(turn, turns[-1]) - 180
            crossing = before + (after - before) * (meridian - before[0]) / (after[0] - before[0])
            crossing[0], crossing[power_columns] = meridian, before[power_columns]
            parts[-1].append(crossing)
            parts.append([crossing])
            turns.append(turn)
        parts[-1].append(after)
    columns = [(np.array(part) - [360 * turn, *np.zeros(rows.shape[1] - 1)]).T.tolist()
               for part, turn in zip(parts, turns, strict=True)
               # A line that begins on a meridian of 180 degrees may leave at once what it cuts.
               if len(parts) == 1 or np.ptp(np.array(part)[:, :2], axis=0).any()]
    coordinates = [[*zip(*part[:2])] for part in columns]
    values_of_parts = {name: [part[index] for part in columns]
                       for index, name in enumerate(names, start=2)}
    if len(columns) > 1:
        return {'type': 'MultiLineString', 'coordinates': coordinates}, {
            **values, **values_of_parts}
    return {'type': 'LineString', 'coordinates': coordinates[0]}, {
        **values, **{name: part for name, (part,) in values_of_parts.items()}}
