"""Scenarios as plain values of JSON and YAML and in files, and back, with all errors at once."""

from collections.abc import Mapping
from contextlib import suppress
from dataclasses import asdict
import math
import os
from typing import Any, TypeVar

from .fields import Block, Checked, read_object
from .files import checked_path
from .formats.mission_file import read_mission, write_mission
from .geography import convert_points, Origin
from ..errors import describe_class, ScenarioError

Scenario = TypeVar('Scenario', bound='Stored')  # The API's page shows the name of the TypeVar.


class Stored(Checked):
    """Conversion of the Scenario, the only subclass, to plain values and files, and back."""

    def to_dict(self) -> dict[str, Any]:
        """
        Return the scenario as plain values of JSON; an infinite ceiling is None.

        Fields that version 0.1.0 cannot read are left out if they have their defaults. Positions
        and radii that a track sets are left out. A single ground node with default name, weight
        and trust is a ground_node.
        """
        data = asdict(self)  # type: ignore[call-overload]
        for name in ('channel', 'colluding', 'head_starts', 'origin'):
            if getattr(self, name) == getattr(type(self), name):
                del data[name]
        for receiver in (*data['eavesdroppers'], *data['ground_nodes']):
            decided = ('track',) if receiver['track'] is None else ('position', 'error_radius')
            for name in decided:
                receiver.pop(name, None)
        if self.is_plain_node:  # type: ignore[attr-defined]
            node, = data.pop('ground_nodes')
            place = {'track': node['track']} if 'track' in node else node['position']
            data = {'ground_node': place, **data}
        for zone in data['no_fly_zones']:
            if math.isinf(zone['ceiling']):
                zone['ceiling'] = None
        return dict(data)

    @classmethod
    def from_dict(cls: type[Scenario], data: Any) -> Scenario:
        """
        Return the scenario of a mapping that to_dict wrote; missing fields take their defaults.

        Its places {latitude, longitude} are converted to m by its origin.

        :raises ScenarioError: for an unknown field, a missing one that has no default, or a
            wrong value. `further` has the errors of the other fields. If each field is right by
            itself, the errors are of fields that do not fit each other.
        """
        name = describe_class(cls)
        if not isinstance(data, Mapping):
            return read_object(cls, data, name)  # type: ignore[no-any-return]
        with suppress(ScenarioError):  # A wrong origin is reported with the other fields.
            data = convert_points(data, Block(Origin)(data.get('origin')))
        return read_object(cls, data, name)  # type: ignore[no-any-return]

    def save(self, path: str | os.PathLike[str]) -> None:
        """
        Write the mission to a file, as JSON if its name ends with .json, otherwise as YAML.

        :raises OSError: when the file cannot be written; an old one is left unchanged.
        """
        write_mission(checked_path(path), self.to_dict())

    @classmethod
    def load(cls: type[Scenario], path: str | os.PathLike[str]) -> Scenario:
        """
        Read a mission from a file: JSON if its name ends with .json, otherwise YAML.

        The file has the fields of Scenario in their units; a field with a default may be missing.

        :raises OSError: when the file cannot be read, is no regular file, or is too large.
        :raises MissionFileError: naming the line and the error; its `problems` are all errors.
        """
        return read_mission(checked_path(path), cls)  # type: ignore[no-any-return]
