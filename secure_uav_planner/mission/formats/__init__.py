"""Mission files, YAML and JSON: from a file to a mission and back."""

from collections.abc import Iterable
import os
from typing import Any

from .diagnosis import diagnosed
from .documents import Problem, read, refusal, text_of
from ..files import atomic_file
from ...errors import MissionFileError, ScenarioError, words_of_files

__all__ = ['located', 'read_mission', 'write_mission']

_HEAD = """\
# A mission of secure_uav_planner. Positions are (x, y) in m, x east and y north of the origin;
# heights in m above the ground node, speeds in m/s, powers in W, times in s.
"""

# What else users may have at hand: a field by which it is known, and what it is.
_OTHERS = {
    'powers': 'a plan, whose field scenario is its mission',
    'vary': 'a campaign, for the command sweep; its field mission names its mission',
    'ros__parameters': 'a parameter file of nodes, which has a mission in the file that its '
                       'parameter mission_file names'}


def read_mission(path: str | os.PathLike[str], kind: type[Any]) -> Any:
    """Return what is in a file as a `kind`, which is Scenario; Scenario.load describes it."""
    document = read(path)
    for field, other in _OTHERS.items():
        if _has(document.data, field):
            raise refusal(path, [Problem(None, f'it is {other}')])
    with words_of_files():
        scenario, problems = diagnosed(document, kind)
    if problems:
        error = refusal(path, problems)
        error.rest = scenario
        raise error
    return scenario


def located(path: str | os.PathLike[str], error: ScenarioError,
            known: Iterable[tuple[int | None, str]] = ()) -> MissionFileError:
    """Return the error of a file for one of its mission, with its `others` and what is known."""
    document = read(path)
    found = (Problem(document.line(one.place), str(one)) for one in (error, *error.others))
    return refusal(path, [*map(Problem._make, known), *found])


def _has(data: Any, field: str) -> bool:
    """Return whether nested mappings have a field."""
    return isinstance(data, dict) and (
        field in data or any(_has(value, field) for value in data.values()))


def write_mission(path: str | os.PathLike[str], data: dict[str, Any]) -> None:
    """Write the plain values of a mission; Scenario.save describes it."""
    text = text_of(path, data)
    with atomic_file(path) as file:
        file.write(text if text.startswith('{') else _HEAD + text)
