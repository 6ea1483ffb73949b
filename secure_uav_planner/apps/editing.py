"""Edits of a mission: shapes of Plotly that are dragged, new values, and added members."""

from collections.abc import Callable, Iterator, Mapping
import copy
from dataclasses import asdict
from functools import partial, reduce
import itertools
import json
import math
import operator
import re
from typing import Any, NamedTuple

import numpy as np
import shapely

from ..errors import FieldPath
from ..mission.scenario import Array, Scenario
from ..output.drawing import EAVESDROPPER, GEOFENCE, GROUND_NODE, NO_FLY_ZONE, uav_color

Mission = dict[str, Any]
"""A mission as plain values of JSON, as Scenario.to_dict returns them."""

_OPTIONAL = ('max_acceleration', 'outage')  # Fields whose 0 on a slider is null in a mission.
# Least number of corners of a polygon that is dragged as a circle; ground stations write such.
_LEAST_CORNERS = 16
_ROUNDNESS = 0.02  # Largest spread of a circle's radii, and of its edges, in radii.
_DISC = ((9, 0), (6, 6), (0, 9), (-6, 6), (-9, 0), (-6, -6), (0, -9), (6, -6))
_MOST_RINGS = 20  # Rings around the map's middle that are searched for room for a new member.
_SQUARE = ((-8, -8), (8, -8), (8, 8), (-8, 8))
_DIAMOND = ((5, 0), (0, 5), (-5, 0), (0, -5))
_TRIANGLE = ((-9, -7), (9, -7), (0, 10))


def to_mission(scenario: Scenario) -> Mission:
    """Return a Scenario as plain values, with all fields that can be edited."""
    return json.loads(json.dumps({**scenario.to_dict(), 'channel': asdict(scenario.channel),
                                  'colluding': scenario.colluding}))


class Handle(NamedTuple):
    """
    A shape of the map, and what changes when it is dragged or removed.

    :ivar shape: the shape, as Plotly has it.
    :ivar place: path of the value that changes when the shape is dragged.
    :ivar removes: path of the member that a double click removes; () for none.
    """

    shape: dict[str, Any]
    place: FieldPath
    removes: FieldPath


def list_handles(mission: Mission) -> list[Handle]:
    """
    Return Handles of areas, receivers, and UAVs' goals and starts; a later one lies above.

    A single UAV cannot be removed, because a new one is made like the last.
    """
    return [*_list_areas(mission), *_list_receivers(mission), *(
        Handle(_draw_point(uav[end], outline, uav_color(number)), ('uavs', number, end),
               ('uavs', number) if len(mission['uavs']) > 1 else ())
        for number, uav in enumerate(mission['uavs'])
        for end, outline in (('goal', _SQUARE), ('start', _DISC)))]


def list_places(mission: Mission) -> list[FieldPath]:
    """Return the paths of the values that the shapes of list_handles move, by their numbers."""
    return [handle.place for handle in list_handles(mission)]


def _list_areas(mission: Mission) -> Iterator[Handle]:
    """
    Yield Handles of fence and zones, each before the Handles of its corners.

    An area like a circle has no corners to drag. Removing a triangle's corner removes the area.
    """
    areas: list[tuple[FieldPath, FieldPath, Any, str, str]] = [
        (('no_fly_zones', number), ('no_fly_zones', number, 'vertices'), zone['vertices'],
         NO_FLY_ZONE, zone['name']) for number, zone in enumerate(mission['no_fly_zones'])]
    if mission['geofence'] is not None:
        areas.insert(0, (('geofence',), ('geofence',), mission['geofence'], GEOFENCE, ''))
    # Path of the area, path of its corners, corners, colour and text.
    for owner, path, vertices, color, text in areas:
        if circle := find_circle(vertices):
            yield Handle({**_draw_circle(*circle, color), 'opacity': 0.6, 'label': {'text': text}},
                         path, owner)
            continue
        # Plotly drags an open path by its line only, so that the map inside a fence stays free.
        is_fence = color == GEOFENCE
        points = [*vertices, vertices[0]] if is_fence else vertices
        outline = 'L'.join(f'{x},{y}' for x, y in points)
        yield Handle({'type': 'path', 'path': f'M{outline}{"" if is_fence else "Z"}',
                      'line': {'color': color, 'width': 2}, 'opacity': 0.6,
                      'fillcolor': 'rgba(0,0,0,0)' if is_fence else color,
                      'label': {'text': text}}, path, owner)
        for number, vertex in enumerate(vertices):
            corner = (*path, number)
            yield Handle(_draw_point(vertex, _DIAMOND, color), corner,
                         corner if len(vertices) > 3 else owner)  # Three corners are needed.


def _list_receivers(mission: Mission) -> Iterator[Handle]:
    """
    Yield Handles of each eavesdropper's disc and centre, then of ground nodes.

    A receiver with a track has them for each knot. If a track has two knots, removing one removes
    the receiver. A single ground node cannot be removed.
    """
    for number, eve in enumerate(mission['eavesdroppers']):
        owner: FieldPath = 'eavesdroppers', number
        name = eve['name']
        discs: list[tuple[FieldPath, Any, str]] = [
            ((*owner, 'track', knot), disc, f'{name} {time:g} s')
            for knot, (time, *disc) in enumerate(eve.get('track', ()))] or [
                (owner, (*eve['position'], eve['error_radius']), name)]
        for path, (x, y, radius), text in discs:
            removes = path if len(discs) > 2 else owner  # A track has at least two knots.
            yield Handle({**_draw_circle(x, y, radius, EAVESDROPPER), 'opacity': 0.5},
                         path, removes)
            yield Handle(_draw_point((x, y), _DIAMOND, EAVESDROPPER, text), path, removes)
    nodes: list[tuple[FieldPath, Any]] = [
        (('ground_nodes', number), node)
        for number, node in enumerate(mission.get('ground_nodes', ()))] or [
            (('ground_node',), mission['ground_node'])]
    for node_path, node in nodes:
        removes_node = node_path if len(nodes) > 1 else ()
        knots = node.get('track', ()) if isinstance(node, Mapping) else ()
        for knot, (time, *point) in enumerate(knots):
            path = (*node_path, 'track', knot)
            yield Handle(_draw_point(point, _TRIANGLE, GROUND_NODE, f'{time:g} s'), path,
                         path if len(knots) > 2 else removes_node)
        if not knots:
            path, point = ((*node_path, 'position'), node['position']) if isinstance(
                node, Mapping) else (node_path, node)
            yield Handle(_draw_point(point, _TRIANGLE, GROUND_NODE), path, removes_node)


def _draw_circle(x: float, y: float, radius: float, color: str) -> dict[str, Any]:
    return {'type': 'circle', 'x0': x - radius, 'x1': x + radius, 'y0': y - radius,
            'y1': y + radius, 'fillcolor': color, 'line': {'color': color}}


def find_circle(vertices: Any) -> tuple[float, float, float] | None:
    """Return (x, y, radius) of a nearly regular polygon of 16 corners or more, otherwise None."""
    if len(vertices) < _LEAST_CORNERS:
        return None
    corners = np.asarray(vertices)
    center = corners.mean(axis=0)
    radii = np.hypot(*(corners - center).T)
    edges = np.hypot(*(np.roll(corners, -1, axis=0) - corners).T)
    is_round = all(np.ptp(lengths) <= _ROUNDNESS * radii.mean() for lengths in (radii, edges))
    return (*center.tolist(), radii.mean().item()) if is_round else None


def _draw_point(point: Any, outline: Any, color: str, text: str = '') -> dict[str, Any]:
    """Return Plotly's shape of an outline (x, y) [pixels] around a point, with a text below."""
    path = 'L'.join(f'{x},{y}' for x, y in outline)
    return {'type': 'path', 'path': f'M{path}Z', 'xsizemode': 'pixel', 'ysizemode': 'pixel',
            'xanchor': point[0], 'yanchor': point[1], 'fillcolor': color,
            'line': {'color': 'white', 'width': 1},
            'label': {'text': text, 'textposition': 'bottom center', 'yanchor': 'top'}}


def replace_value(mission: Mission, path: FieldPath, change: Callable[[Any], Any]) -> Mission:
    """Return the mission with change(value) at a path; if that is None, a list loses the item."""
    changed: Any = copy.deepcopy(mission)
    owner, last = reduce(operator.getitem, path[:-1], changed), path[-1]
    owner[last] = change(owner[last])
    if owner[last] is None and not isinstance(last, str):
        del owner[last]
    return changed


def remove_member(mission: Mission, number: int) -> Mission:
    """Return the mission without the member that the Handle of this number removes."""
    removes = list_handles(mission)[number].removes
    if removes[:1] == ('ground_nodes',) and len(removes) == 2 and mission.get('head_starts'):
        mission = replace_value(mission, ('head_starts', removes[1]), lambda _: None)
        if len(mission['head_starts']) == 1:  # A single ground node has none.
            mission['head_starts'] = []
    return replace_value(mission, removes, lambda _: None) if removes else mission


def drag(mission: Mission, changes: Mapping[str, Any]) -> Mission:
    """Return the mission after relayoutData such as {'shapes[2].xanchor': 10.0, ...}."""
    for number, (shape, path, _) in enumerate(list_handles(mission)):
        moved = {name.rpartition('.')[2]: value for name, value in changes.items()
                 if name.startswith(f'shapes[{number}].')}
        if moved:
            mission = replace_value(mission, path, partial(_move, {**shape, **moved}))
    return mission


def _move(shape: Mapping[str, Any], value: Any) -> Any:
    """
    Return the value of a Handle after its shape was dragged, rounded to 0.1 m.

    :param shape: the shape after the drag.
    :param value: the value before the drag: corners [[x, y], ...] of an area, one place [x, y], a
        knot [time, x, y] or [time, x, y, radius], or an eavesdropper's fields by name.
    """
    # An area that is drawn as a circle is moved and scaled; its corners are rounded to 0.01 m.
    if shape['type'] == 'circle' and isinstance(value, list) and isinstance(value[0], list):
        x, y, radius = find_circle(value) or (0.0, 0.0, 1.0)
        east, north, reach = _read_disc(shape, x, y, radius)
        return np.round(
            np.subtract(value, (x, y)) * (reach / radius) + (east, north), 2).tolist()
    if shape['type'] == 'circle':
        x, y, radius = value[1:] if isinstance(value, list) else (
            *value['position'], value['error_radius'])
        moved: tuple[float, ...] = _read_disc(shape, x, y, radius)
    elif 'xanchor' in shape:
        moved = (shape['xanchor'], shape['yanchor'])
    else:
        numbers = [round(float(text), 1) for text in re.findall(r'[-+.\deE]+', shape['path'])]
        return [list(point) for point in zip(numbers[::2], numbers[1::2])][:len(value)]
    rounded = [round(number, 1) for number in moved]
    if isinstance(value, dict):
        return value | dict(zip(('position', 'error_radius'), (rounded[:2], *rounded[2:])))
    time = value[:1] if len(value) > 2 else []
    # The time of a knot stays; its radius stays if only the centre was dragged.
    return [*time, *rounded, *value[len(time) + len(rounded):]]


def _read_disc(shape: Mapping[str, Any], x: float, y: float,
               radius: float) -> tuple[float, float, float]:
    """
    Return (x, y, radius) of a disc after a drag, from x, y and radius before the drag.

    A disc of the old size was moved. Otherwise the centre stays, and the new radius is the
    distance from the centre to the side of the bounding box that moved most.
    """
    x0, x1, y0, y1 = (float(shape[name]) for name in ('x0', 'x1', 'y0', 'y1'))
    if all(math.isclose(span, 2 * radius, abs_tol=1e-6) for span in (x1 - x0, y1 - y0)):
        return (x0 + x1) / 2, (y0 + y1) / 2, radius
    reach: float = max((x1 - x, x - x0, y1 - y, y - y0), key=lambda reach: abs(reach - radius))
    return x, y, abs(reach)


def read_field(mission: Mission, owner: str, field: str) -> Any:
    """Return a field of the first of _list_owners; 0 for the null of an _OPTIONAL field."""
    value = next((item[field] for item in _list_owners(mission, owner)), None)
    return 0.0 if value is None and field in _OPTIONAL else value


def set_field(mission: Mission, owner: str, field: str, value: Any) -> Mission:
    """
    Return the mission with another value of a field of each of _list_owners.

    The value 0 of an _OPTIONAL field becomes null. A new duration also scales the number of slots,
    so that the slot length stays nearly the same.
    """
    mission = copy.deepcopy(mission)
    if field == 'duration' and value:
        mission['slots'] = max(1, round(mission['slots'] * value / mission['duration']))
    for item in _list_owners(mission, owner):
        item[field] = (value or None) if field in _OPTIONAL else value
    return mission


def _list_owners(mission: Mission, owner: str) -> list[Any]:
    return {'mission': [mission], 'channel': [mission['channel']], 'uavs': mission['uavs'],
            'transmitter': mission['uavs'][:1], 'jammers': mission['uavs'][1:]}[owner]


def add_member(mission: Mission, kind: str, extent: Array) -> Mission:
    """Return the mission with one more eavesdropper, jammer or zone near the map's middle."""
    size = max(0.1, round(float(np.ptp(extent, axis=0).max()) / 40, 1))
    x, y = _find_room(mission, extent.mean(axis=0).round(1), size)
    members: dict[str, tuple[str, Mission]] = {
        'eavesdropper': ('eavesdroppers', {'position': [x, y], 'error_radius': size}),
        'zone': ('no_fly_zones', {'vertices': [
            [x - size, y - size], [x + size, y - size], [x + size, y + size],
            [x - size, y + size]]}),
        'jammer': ('uavs', {
            **mission['uavs'][-1], 'start': [x - size, y], 'goal': [x + size, y],
            # The new UAV is above all UAVs by at least the separation, so that none is close.
            'altitude': max(uav['altitude'] for uav in mission['uavs'])
            + max(10.0, mission['separation'] + 2 * mission['tracking_margin'])})}
    field, member = members[kind]
    names = {present['name'] for present in mission[field]}
    name = next(name for number in itertools.count(1) if (name := f'{kind}{number}') not in names)
    return {**mission, field: [*mission[field], copy.deepcopy({**member, 'name': name})]}


def _find_room(mission: Mission, middle: Array, size: float) -> list[float]:
    """
    Return the place nearest to the middle, on rings `size` apart, with room for a new member.

    Room is a square of side 2 size that is inside the fence and away from zones, starts and goals,
    with the tracking margin. Without room on _MOST_RINGS rings, the middle is returned.
    """
    margin = mission['tracking_margin']
    taken = [shapely.Polygon(zone['vertices']).buffer(margin + 0.2 * size)
             for zone in mission['no_fly_zones']]
    taken += [shapely.Point(uav[end]).buffer(margin + 0.2 * size)
              for uav in mission['uavs'] for end in ('start', 'goal')]
    fence = mission['geofence'] and shapely.Polygon(mission['geofence']).buffer(-margin)
    for radius in range(_MOST_RINGS):
        for angle in np.arange(max(1, 6 * radius)) * 2 * np.pi / max(1, 6 * radius):
            x, y = place = (middle + radius * size * np.array([np.cos(angle), np.sin(angle)])
                            ).round(1).tolist()
            square = shapely.box(x - size, y - size, x + size, y + size)
            if not any(map(square.intersects, taken)) and (
                    not fence or fence.contains(square)):
                return place
    return middle.tolist()
