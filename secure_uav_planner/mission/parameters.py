"""A parameter file of the planner node as the mission that it describes, read without ROS."""

from collections.abc import Iterator, Mapping
import difflib
from typing import Any

from .documents import Document, Place, Problem
from .schema import Schema
from ..errors import shown

CONTENT = 'ros__parameters'

OTHER_NODES = ('replay', 'relay')
"""Nodes whose parameters in the same file say nothing of the mission."""

OF_THE_NODE = frozenset({
    'bound', 'confidence', 'frame_id', 'height_tolerance', 'method', 'objective', 'plan_file',
    'pose_timeout', 'replan_deviation', 'replan_distance', 'replan_lead', 'replan_period',
    'start_delay', 'time_limit', 'track_tolerance'})
"""Parameters of the planner that are no part of a mission."""

OF_A_UAV = frozenset({
    'altitude', 'average_power', 'goal', 'goal_velocity', 'max_acceleration', 'max_speed',
    'peak_power', 'start', 'start_velocity', 'use_pose'})
OF_AN_EAVESDROPPER = frozenset({'error_radius', 'position', 'receiver_advantage_db'})
OF_A_ZONE = frozenset({'ceiling', 'floor', 'vertices'})
OF_THE_MISSION = frozenset({
    'duration', 'geofence', 'ground_node', 'reference_snr_db', 'separation', 'slots'})

OF_ROS = ('qos_overrides.', 'use_sim_time', 'start_type_description_service')
"""What parameters that every node of ROS has begin with."""


def is_parameter_file(data: Any) -> bool:
    """Return whether plain values are those of a ROS parameter file."""
    return isinstance(data, dict) and any(
        isinstance(value, dict) and (CONTENT in value or is_parameter_file(value))
        for value in data.values())


def mission(document: Document, schema: Schema) -> Document:
    """
    Return the mission of a parameter file, whose lines remain those of the file.

    As in the node, what is left out is as in the paper's mission. `ground_node` and for each
    eavesdropper `position` come from topics there, so that a file must have them in addition:
    among the node's parameters, which then warns that it does not know them, or under a name of
    their own such as `/**/mission`.
    """
    values: dict[str, Any] = {}
    places: dict[str, Place] = {}
    for place, content in _sections(document.data, ()):
        for name, value, where in _flat(content, place):
            values[name], places[name] = value, where
    work = _Mapping(document, values, places, schema.paper)
    data = work.data()
    return Document(data, work.lines, (*document.problems, *work.problems))


def _sections(data: Mapping[str, Any], place: Place) -> Iterator[tuple[Place, Any]]:
    """Yield the parameters of the nodes, with their places."""
    for name, value in data.items():
        if not isinstance(value, dict) or name.rpartition('/')[2] in OTHER_NODES:
            continue
        if CONTENT in value:
            yield (*place, name, CONTENT), value[CONTENT]
        else:
            yield from _sections(value, (*place, name))


def _flat(data: Any, place: Place, prefix: str = '') -> Iterator[tuple[str, Any, Place]]:
    """Yield every parameter with its dotted name."""
    if not isinstance(data, dict):
        yield prefix.rstrip('.'), data, place
        return
    for name, value in data.items():
        yield from _flat(value, (*place, name), f'{prefix}{name}.')


class _Mapping:
    """Takes parameters by their names, and knows which are left."""

    def __init__(self, document: Document, values: dict[str, Any], places: dict[str, Place],
                 paper: Mapping[str, Any]) -> None:
        self.lines: dict[Place, int] = {}
        self.problems: list[Problem] = []
        self._document, self._values, self._places = document, values, places
        self._paper = paper
        self._known: set[str] = set()

    def data(self) -> dict[str, Any]:
        """Return the mission as plain values."""
        data: dict[str, Any] = {}
        self.lines[()] = 1
        for name in sorted(OF_THE_MISSION):
            self._take(data, name, name, (name,), self._paper[name])
        self._need('ground_node', ())
        data['geofence'] = self._points(data['geofence'], ('geofence',)) or None
        for field, make in (('uavs', self._uav), ('eavesdroppers', self._eavesdropper),
                            ('no_fly_zones', self._zone)):
            data[field] = [make(name, number) for number, name in enumerate(self._names(field))]
        self._note_unknown()
        return data

    def _take(self, data: dict[str, Any], field: str, name: str, place: Place,
              default: Any) -> None:
        """Put a parameter into a mapping of the mission."""
        self._known.add(name)
        data[field] = self._values.get(name, default)
        if name in self._places and (line := self._document.line(self._places[name])) is not None:
            self.lines[place] = line

    def _names(self, field: str) -> list[str]:
        self._known.add(field)
        default = [member['name'] for member in self._paper[field]]
        names = self._values.get(field, default)
        if not isinstance(names, list) or not all(isinstance(name, str) for name in names):
            self.problems.append(Problem(
                self._document.line(self._places[field]),
                f'{field} is {shown(names)}; it must be a list of names'))
            return default
        if field in self._places:
            line = self._document.line(self._places[field]) or 1
            self.lines[(field,)] = line
            for number in range(len(names)):
                self.lines[(field, number)] = line
        return names

    def _uav(self, name: str, number: int) -> dict[str, Any]:
        paper = self._paper['uavs'][min(number, len(self._paper['uavs']) - 1)]
        data: dict[str, Any] = {'name': name}
        for field in sorted(OF_A_UAV):
            self._take(data, field, f'{name}.{field}', ('uavs', number, field), paper.get(field))
        del data['use_pose']
        # What the parameters, which have one type each, say for None.
        data['max_acceleration'] = data['max_acceleration'] or None
        for field in ('start_velocity', 'goal_velocity'):
            data[field] = None if data[field] == [] else data[field]
        return data

    def _eavesdropper(self, name: str, number: int) -> dict[str, Any]:
        data: dict[str, Any] = {'name': name}
        for field in sorted(OF_AN_EAVESDROPPER):
            self._take(data, field, f'{name}.{field}', ('eavesdroppers', number, field),
                       self._paper['eavesdroppers'][0][field])
        self._need(f'{name}.position', ('eavesdroppers', number))
        return data

    def _zone(self, name: str, number: int) -> dict[str, Any]:
        data: dict[str, Any] = {'name': name}
        for field in sorted(OF_A_ZONE):
            self._take(data, field, f'{name}.{field}', ('no_fly_zones', number, field), 0.0)
        data['vertices'] = self._points(data['vertices'], ('no_fly_zones', number, 'vertices'))
        data['ceiling'] = data['ceiling'] or None
        return data

    def _points(self, numbers: Any, place: Place) -> Any:
        """Return x1, y1, x2, y2, ... as a list of points; what is no list as it is."""
        if not isinstance(numbers, list):
            return numbers
        if len(numbers) % 2:
            self.problems.append(Problem(
                self.lines.get(place), f'{place[-1]} is {shown(numbers)}; it must have an even '
                'number of coordinates x1, y1, x2, y2, ...'))
        return [list(point) for point in zip(numbers[::2], numbers[1::2])]

    def _need(self, name: str, place: Place) -> None:
        """Note that a parameter is missing which a mission must have, unless it is there."""
        if name not in self._values:
            self.problems.append(Problem(
                self.lines.get(place), f'{shown(name)[1:-1]} is missing; the node takes it from a '
                'topic, a mission needs it as [x, y] in m'))

    def _note_unknown(self) -> None:
        for name, place in self._places.items():
            if name in self._known or name in OF_THE_NODE or name.startswith(OF_ROS):
                continue
            near = difflib.get_close_matches(name[:200], self._known | OF_THE_NODE, 1)
            hint = f'; did you mean {near[0]}?' if near else ''
            self.problems.append(Problem(
                self._document.line(place), f'there is no parameter {shown(name)[1:-1]}{hint}'))
