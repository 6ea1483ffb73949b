"""Mission files, YAML and JSON: from a file to a Scenario and back, with all errors at once."""

from collections.abc import Iterable, Mapping
from dataclasses import fields
import os
from pathlib import Path
from typing import Any

from .documents import Document, format_document, make_file_error, Problem, read_document
from ..files import atomic_file
from ..participants import Eavesdropper, NoFlyZone, Uav
from ..propagation import Channel
from ..tracks import split_ground_node
from ..validation import find_field_errors, RANGES, required_fields, UNITS
from ...errors import (
    format_place, MissionFileError, Place, quote, ScenarioError, yaml_notation)

EXAMPLE = Path(__file__).with_name('example.yaml')
"""A mission file in which every field is explained: `secure_uav_planner new` copies it."""

_HEAD = """\
# A mission of secure_uav_planner. Positions are (x, y) in m, x east and y north of the origin;
# heights in m above the ground node, speeds in m/s, powers in W, times in s.
"""

# Files that users may confuse with a mission: a field by which each is recognised.
_FOREIGN_FILES = {
    'powers': 'a plan, whose field scenario is its mission',
    'vary': 'a campaign, for the command sweep; its field mission names its mission',
    'ros__parameters': 'a parameter file of nodes, which has a mission in the file that its '
                       'parameter mission_file names'}

_NEUTRAL = {
    'eavesdroppers': Eavesdropper((0.0, 0.0)),
    'uavs': Uav('uav', (0.0, 0.0), (0.0, 0.0), RANGES['altitude'][0], RANGES['max_speed'][1],
                RANGES['average_power'][0], RANGES['peak_power'][1], None, None, None),
    'no_fly_zones': NoFlyZone(((0.0, 0.0), (1.0, 0.0), (0.0, 1.0)))}
"""For each list of a scenario a member with limits so wide that any right value fits."""


def read_mission(path: str | os.PathLike[str], kind: type[Any]) -> Any:
    """
    Read the mission of a file; see Scenario.load.

    :param kind: the class Scenario, which imports this module.
    """
    document = read_document(path)
    for field, description in _FOREIGN_FILES.items():
        if _has_field(document.data, field):
            raise make_file_error(path, [Problem(None, f'it is {description}')])
    with yaml_notation():
        diagnosis = _Diagnosis(document)
        scenario = diagnosis.build_scenario(kind)
    problems = [*document.problems, *diagnosis.problems]
    if problems:
        error = make_file_error(path, problems)
        error.relaxed = scenario
        raise error
    return scenario


def write_mission(path: str | os.PathLike[str], data: dict[str, Any]) -> None:
    """Write the plain values of a mission to a file; see Scenario.save."""
    text = format_document(path, data)
    with atomic_file(path) as file:
        file.write(text if text.startswith('{') else _HEAD + text)


def locate_error(path: str | os.PathLike[str], error: ScenarioError,
                 problems: Iterable[tuple[int | None, str]] = ()) -> MissionFileError:
    """Return the error of a file with the lines of a scenario's errors, and other problems."""
    document = read_document(path)
    located = (Problem(document.line(item.place), str(item)) for item in (error, *error.further))
    return make_file_error(path, [*map(Problem._make, problems), *located])


def _has_field(data: Any, field: str) -> bool:
    """Return True if nested mappings have a field."""
    return isinstance(data, dict) and (
        field in data or any(_has_field(value, field) for value in data.values()))


class _Diagnosis:
    """Builds the Scenario of a document, and collects its problems."""

    def __init__(self, document: Document) -> None:
        self.problems: list[Problem] = []
        self._document = document

    def build_scenario(self, kind: type[Any]) -> Any:
        """Return the Scenario, with wide limits in place of wrong values, or None."""
        neutral = kind((0.0, 0.0), (_NEUTRAL['eavesdroppers'],), (_NEUTRAL['uavs'],),
                       RANGES['duration'][1], slots=1)
        data = self._document.data
        if data is None:
            self._add((), 'the file is empty; it must have the fields of a mission')
            return None
        if isinstance(data, dict):
            try:
                data = split_ground_node(data)
            except ScenarioError as error:
                self._add(error.place, str(error))
                data = {**data, 'ground_node': neutral.ground_node}
        given = self._pick_fields(kind, data, (), '')
        plain = {name: value for name, value in given.items()
                 if name not in _NEUTRAL and name != 'channel'}
        _, wrong = self._build(neutral, plain, ())
        values = {name: value for name, value in plain.items() if name not in wrong}
        numbers: dict[str | int, list[int]] = {}
        for name in [name for name in given if name in _NEUTRAL]:
            members = self._build_members(name, given[name])
            if members or given[name] == []:
                numbers[name] = [*members]
                values[name] = tuple(members.values())
        if 'channel' in given:
            channel = self._build_object(Channel(), given['channel'], ('channel',))
            if channel is not None:
                values['channel'] = channel
        try:
            missing = {*given, *required_fields(kind)} - values.keys()
            scenario = kind(**values, **{name: getattr(neutral, name) for name in missing})
        except ScenarioError as error:
            for item in (error, *error.further):
                field, *inner = item.place
                if inner and field in numbers:
                    inner[0] = numbers[field][int(inner[0])]
                if field in values:  # Otherwise a neutral value is to blame.
                    self._add((field, *inner), str(item))
            return None
        # Without the flights' time, or a UAV, others may be refused that could be flown.
        is_complete = {'duration', 'slots', 'uavs'} <= values.keys() and (
            len(values['uavs']) == len(given['uavs']))
        return scenario if is_complete else None

    def _add(self, place: Place, text: str) -> None:
        if place[:1] == ('ground_node_track',):
            place = ('ground_node', 'track', *place[1:])
        self.problems.append(Problem(self._document.line(place), text))

    def _pick_fields(self, kind: type[Any], data: Any, place: Place,
                     owner: str) -> dict[str, Any]:
        """Return the fields of a class that data has; note unknown and missing ones."""
        for error in find_field_errors(kind, data):
            self._add((*place, *error.place), f'{owner}{error}')
        names = {field.name for field in fields(kind)}
        given = data if isinstance(data, dict) else {}
        return {name: value for name, value in given.items() if name in names}

    def _build_members(self, field: str, values: Any) -> dict[int, Any]:
        """Return the members of a list that can be used to check the mission, by index."""
        if not isinstance(values, list):
            self._add((field,), f'{field} is {quote(values)}; it must be a list')
            return {}
        members = {number: self._build_object(_NEUTRAL[field], data, (field, number))
                   for number, data in enumerate(values)}
        return {number: member for number, member in members.items() if member is not None}

    def _build_object(self, neutral: Any, data: Any, place: Place) -> Any:
        """Return an object, or None if its errors could cause spurious errors elsewhere."""
        before = len(self.problems)
        given = self._pick_fields(type(neutral), data, place, f'{format_place(place)}: ')
        built, wrong = self._build(neutral, given, place)
        # Of a UAV that has its places, altitude and speed, the rest can be neutral.
        is_usable = place[0] == 'uavs' and {*required_fields(Uav)} <= given.keys() - wrong
        return built if is_usable or len(self.problems) == before else None

    def _build(self, neutral: Any, given: Mapping[str, Any], place: Place
               ) -> tuple[Any, set[str]]:
        """
        Build an object; a neutral one of its class replaces wrong and missing values.

        :return: the object, None if the neutral values do not fit the others, and the names of
            the wrong fields.
        """
        wrong: set[str] = set()
        missing = {*required_fields(type(neutral))} - given.keys()
        values = {**given, **{name: getattr(neutral, name) for name in missing}}
        while True:
            try:
                return type(neutral)(**values), wrong
            except ScenarioError as error:
                field, inner = str(error.place[0]), error.place[1:]
                if field in wrong or field in missing:
                    return None, wrong
                value = values.get(field)
                unit = _unit_suffix(error.place, value, str(error))
                self._add((*place, *error.place), f'{error}{unit}')
                if isinstance(value, dict) and inner and inner[0] in value:
                    # The block may have further errors.
                    value = {name: item for name, item in value.items() if name != inner[0]}
                else:
                    wrong.add(field)
                    value = getattr(neutral, field)
                values[field] = value


def _unit_suffix(place: Place, value: Any, message: str) -> str:
    """Return the unit to append to a message about a wrong value at a place of its object."""
    for part in place[1:]:
        value = value.get(part) if isinstance(value, dict) else value
    unit = UNITS.get(str(place[-1] if isinstance(place[-1], str) else place[0]))
    if unit and message.endswith(f' {unit}'):
        return ''
    if isinstance(value, str):
        is_number = 'must be a number' in message
        return f', in {unit}, without its unit' if unit else ', without a unit' * is_number
    return f' {unit}' if unit and isinstance(value, (int, float)) else ''
