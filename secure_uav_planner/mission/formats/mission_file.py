"""Mission files, YAML and JSON: from a file to a Scenario and back, with all errors at once."""

from collections.abc import Iterator
import os
from pathlib import Path
from typing import Any

from .documents import Document, format_document, make_file_error, Problem, read_document
from ..files import atomic_file
from ...errors import MissionFileError, ScenarioError, yaml_notation

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


def read_mission(path: str | os.PathLike[str], kind: type[Any]) -> Any:
    """
    Read the mission of a file; see Scenario.load.

    :param kind: the class Scenario, which imports this module.
    """
    document = read_document(path)
    for field, description in _FOREIGN_FILES.items():
        if _has_field(document.data, field):
            raise make_file_error(path, [Problem(None, f'it is {description}')])
    problems = [*document.problems]
    if document.data is None:
        raise make_file_error(path, [Problem(
            None, 'the file is empty; it must have the fields of a mission'), *problems])
    try:
        with yaml_notation():
            scenario = kind.from_dict(document.data)
    except ScenarioError as error:
        problems += _locate(document, error)
    if problems:
        raise make_file_error(path, problems)
    return scenario


def write_mission(path: str | os.PathLike[str], data: dict[str, Any]) -> None:
    """Write the plain values of a mission to a file; see Scenario.save."""
    text = format_document(path, data)
    with atomic_file(path) as file:
        file.write(text if text.startswith('{') else _HEAD + text)


def locate_error(path: str | os.PathLike[str], error: ScenarioError) -> MissionFileError:
    """Return the error of a file with the lines of a scenario's errors."""
    return make_file_error(path, _locate(read_document(path), error))


def _locate(document: Document, error: ScenarioError) -> Iterator[Problem]:
    """Yield the problems of a document that an error and its further ones are."""
    for item in (error, *error.further):
        field, *inner = item.place or ('',)
        place = ('ground_node', 'track', *inner) if field == 'ground_node_track' else item.place
        yield Problem(document.line(place), str(item))


def _has_field(data: Any, field: str) -> bool:
    """Return True if nested mappings have a field."""
    return isinstance(data, dict) and (
        field in data or any(_has_field(value, field) for value in data.values()))
