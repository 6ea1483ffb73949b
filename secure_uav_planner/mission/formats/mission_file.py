"""Mission files, YAML and JSON: from a file to a Scenario and back, with all errors at once."""

from dataclasses import asdict
import os
from pathlib import Path
from typing import Any

from .airspace_file import read_zones
from .documents import (
    Document, FileProblem, format_document, make_file_error, read_document)
from ..fields import Block, checked_text, ErrorList, refuse
from ..files import atomic_file
from ..geography import Origin
from ...errors import (
    MissionFileError, prefix_path, quote, ScenarioError, yaml_notation)

EXAMPLE = Path(__file__).with_name('example.yaml')
"""A mission file in which every field is explained: `secure_uav_planner new` copies it."""

EXAMPLES = {file.stem: file for file in sorted((EXAMPLE.parent / 'examples').glob('*.yaml'))}
"""Files of further missions by name: `secure_uav_planner new --example` copies one."""

_HEAD = """\
# A mission of secure_uav_planner. Positions are (x, y) in m, x east and y north of the origin;
# heights in m above the ground node, speeds in m/s, powers in W, times in s.
"""

# What a file is that users may take for a mission, by a field that only such a file has.
_FOREIGN_FILES = {
    'powers': 'a plan, whose field scenario is its mission',
    'vary': 'a campaign, for the command sweep; its field mission names its mission',
    'ros__parameters': 'a parameter file of nodes, for `ros2 run`; a mission is the file that its '
                       'parameter mission_file names'}


def read_mission(path: str | os.PathLike[str], kind: type[Any], text: str | None = None,
                 airspace: Any = None) -> Any:
    """
    Read the mission of a file; see Scenario.load.

    :param kind: the class Scenario, which imports this module.
    :param text: content that is read instead of the file; None to read the file.
    :param airspace: the only `airspace` that `text` may name, None for none. A file may name any.
    """
    document = read_document(path, text)
    check_foreign(path, document.data, *_FOREIGN_FILES)
    data, problems = document.data, [*document.problems]
    if data is None:
        raise make_file_error(path, [FileProblem(
            None, 'the file is empty; it must have the fields of a mission'), *problems])
    errors = ErrorList()
    with yaml_notation():
        if isinstance(data, dict) and 'airspace' in data and (
                text is None or airspace is not None and data['airspace'] == airspace):
            with errors.collecting():
                _add_airspace(data, Path(path).parent)
        with errors.collecting():
            scenario = kind.from_dict(data)
    problems += _locate(document, errors)
    if problems:
        raise make_file_error(path, dict.fromkeys(problems))
    return scenario


def check_foreign(path: str | os.PathLike[str], data: Any, *fields: str) -> None:
    """Raise a MissionFileError if one of the fields shows that a file is of another kind."""
    for field in fields:
        if _has_field(data, field):
            raise make_file_error(path, [FileProblem(None, f'it is {_FOREIGN_FILES[field]}')])


def _add_airspace(data: dict[str, Any], folder: Path) -> None:
    """
    Replace `airspace` in the plain values of a mission by the zones and the fence of this file.

    :param folder: folder of the mission file, to which the airspace's path is relative.
    :raises ScenarioError: if the airspace file is wrong or cannot be read, if the mission has no
        origin, or if the mission and its airspace both have a fence.
    """
    name = data.pop('airspace')
    if data.get('origin') is None:
        place = 'origin' if 'origin' in data else 'airspace'
        raise ScenarioError(f'origin is {quote(None)}; a mission with airspace must have one: '
                            'origin: {latitude: , longitude: }', (place,))
    with prefix_path('origin'):
        origin = Block(Origin)(data.get('origin'))
    with prefix_path('airspace'):
        if not isinstance(name, str):
            raise refuse(name, 'the path of a file, relative to the mission')
        name = checked_text(name)
        try:
            zones, fence = read_zones(folder / name, origin)
        except OSError as error:
            raise ScenarioError(f'airspace {quote(name)} cannot be read: '
                                f'{error.strerror or error}') from None
    if fence is not None and data.get('geofence') is not None:
        raise ScenarioError('geofence is in the mission and in its airspace; it must be in one',
                            ('geofence',))
    data['geofence'] = fence or data.get('geofence')
    if isinstance(data.setdefault('no_fly_zones', []), list):
        data['no_fly_zones'] += map(asdict, zones)


def write_mission(path: str | os.PathLike[str], data: dict[str, Any]) -> None:
    """Write the plain values of a mission to a file; see Scenario.save."""
    text = format_document(path, data)
    with atomic_file(path) as file:
        file.write(text if text.startswith('{') else _HEAD + text)


def locate_error(path: str | os.PathLike[str], error: ScenarioError) -> MissionFileError:
    """Return the error of a file with the lines of a scenario's errors."""
    return make_file_error(path, _locate(read_document(path), [error, *error.further]))


def _locate(document: Document, errors: list[ScenarioError]) -> list[FileProblem]:
    """Return errors with their lines in a document."""
    return [FileProblem(document.line(error.place), str(error)) for error in errors]


def _has_field(data: Any, field: str) -> bool:
    """Return True if nested mappings have a field."""
    return isinstance(data, dict) and (
        field in data or any(_has_field(value, field) for value in data.values()))
