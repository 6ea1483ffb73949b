"""From a file to a mission and back."""

import os
from typing import Any

from . import parameters
from .diagnosis import diagnosed
from .documents import read, refusal, text_of
from .schema import Schema
from ..files import atomic_file

_HEAD = """\
# A mission of secure_uav_planner. Positions are (x, y) in m, x east and y north of the origin;
# heights in m above the ground node, speeds in m/s, powers in W, times in s.
"""


def load(path: str | os.PathLike[str], schema: Schema) -> Any:
    """
    Return the Scenario in a file: YAML, JSON, or a parameter file of the planner node.

    :raises OSError: when the file cannot be read, is no regular file or is too large.
    :raises MissionFileError: with all that is wrong, each with its line where it is known.
    """
    document = read(path)
    if parameters.is_parameter_file(document.data):
        document = parameters.mission(document, schema)
    scenario, problems = diagnosed(document, schema)
    if problems:
        raise refusal(path, problems)
    return scenario


def save(path: str | os.PathLike[str], data: dict[str, Any]) -> None:
    """
    Write the plain values of a mission, as JSON if the name ends with .json, otherwise as YAML.

    :raises OSError: when the file cannot be written; an old one is left as it was.
    """
    text = text_of(path, data)
    with atomic_file(path) as file:
        file.write(text if text.startswith('{') else _HEAD + text)
