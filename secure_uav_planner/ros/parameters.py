"""The nodes' parameters: the table of parameters.yaml, and what their values may be."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor
from rclpy.exceptions import NameValidationException
from rclpy.validate_topic_name import validate_topic_name
import yaml

from ..errors import brief, ParameterError, quote
from ..mission.fields import COORDINATE, get_check, Number, Pair
from ..mission.geography import Origin
from ..mission.participants import Propulsion
from ..mission.scenario import Scenario

_TABLE: dict[str, dict[str, dict[str, Any]]] = yaml.safe_load(
    Path(__file__).with_suffix('.yaml').read_text(encoding='utf-8'))
_PAPER = Scenario.paper()
_MOST_IN_NAME = 100  # Largest length of a member's name; ROS allows about 240 in a whole topic.

METHOD_DEFAULT = 'default'
"""The objective that the method maximises by itself."""

NO_LOS = NO_ORIGIN = NO_PROPULSION = NO_REFERENCE = 'none'


@dataclass(frozen=True)
class Spec:
    """
    One parameter.

    :param default: the default value; its type is the parameter's type.
    :param limits: the smallest and the largest allowed number, for numbers and lists of numbers.
    :param length: the smallest and the largest allowed length, for lists and strings.
    :param choices: the allowed strings. If 'off' is one, YAML's `off`, which is false, means it.
    """

    default: Any
    description: str
    limits: tuple[float, float] | None = None
    length: tuple[int, int] | None = None
    choices: tuple[str, ...] | None = None
    read_only: bool = False

    @property
    def allowed(self) -> str:
        """Return the allowed values in words."""
        noun = {bool: 'true or false', int: 'a whole number', float: 'a number', str: 'a string',
                list: 'a list'}[type(self.default)]
        if self.choices:
            return 'one of ' + ', '.join(self.choices)
        if self.length and isinstance(self.default, str):
            noun += f' of at most {self.length[1]} characters'
        elif self.length:
            low, high = self.length
            noun += f' of {low}' if low == high else f' of {low} to {high}'
            noun += (f' names of letters, digits and _, at most {_MOST_IN_NAME} each'
                     if self._is_name_list else ' numbers')
        if self.limits:
            noun += f' from {self.limits[0]:g} to {self.limits[1]:g}'
        return noun

    @property
    def _is_name_list(self) -> bool:
        return isinstance(self.default, list) and self.limits is None

    def convert(self, name: str, value: Any, prefix: str = '') -> Any:
        """Return the value in the parameter's type; the text of an error begins with `prefix`."""
        try:
            return self._convert(value)
        except (TypeError, ValueError, OverflowError, NameValidationException):
            raise ParameterError(f'{prefix}{brief(name, 100)} is {quote(value)}; it must be '
                                 f'{self.allowed}', (name,)) from None

    def _convert(self, value: Any) -> Any:
        """Return a value in the parameter's type, or raise an error that `convert` replaces."""
        kind = type(self.default)
        if kind is list:
            values = list(value)
            assert self.length is not None
            if isinstance(value, (str, bytes)) or not (
                    self.length[0] <= len(values) <= self.length[1]):
                raise ValueError
            return [_check_name(item) for item in values] if self._is_name_list else [
                self._convert_number(item, float) for item in values]
        if kind in (int, float):
            return self._convert_number(value, kind)
        if value is False and 'off' in (self.choices or ()):
            return 'off'
        if not isinstance(value, kind) or self.choices and value not in self.choices or (
                kind is str and self.length and len(value) > self.length[1]):
            raise ValueError
        return value

    def _convert_number(self, value: Any, kind: type) -> float:
        """Return a number within the limits as int or float, or raise a ValueError."""
        # A float may be written as 150 in YAML, and an integer as 1e2.
        assert self.limits is not None
        low, high = self.limits
        if isinstance(value, bool) or not isinstance(value, (int, float)) or not (
                low <= value <= high and value == kind(value)):
            raise ValueError
        return kind(value)

    def descriptor(self) -> ParameterDescriptor:
        """Return the description that `ros2 param describe` shows."""
        descriptor = ParameterDescriptor(
            description=self.description, additional_constraints=f'Must be {self.allowed}.',
            read_only=self.read_only,
            # Types are checked by this class, which accepts an integer as a float.
            dynamic_typing=True)
        if self.limits and isinstance(self.default, float):
            descriptor.floating_point_range = [FloatingPointRange(
                from_value=float(self.limits[0]), to_value=float(self.limits[1]))]
        elif self.limits and isinstance(self.default, int):
            descriptor.integer_range = [IntegerRange(
                from_value=int(self.limits[0]), to_value=int(self.limits[1]), step=1)]
        return descriptor


def _check_name(value: Any) -> str:
    """Return a name that can be part of a topic and of a parameter, or raise a ValueError."""
    if not isinstance(value, str) or '/' in value or '~' in value or (
            len(value) > _MOST_IN_NAME):
        raise ValueError
    validate_topic_name(value)
    return value


def read_specs(section: str, member: str = '', index: int = 0) -> dict[str, Spec]:
    """
    Return the Spec of each parameter of a section of the table by the parameter's name.

    :param member: name of the UAV, receiver or zone that has the parameters; empty for the node's
        own parameters.
    :param index: index of a UAV, whose defaults are the values of the paper's UAV of this index,
        or of the paper's last one.
    """
    prefix = f'{member}.' if member else ''
    owners = {'Scenario': _PAPER, 'Channel': _PAPER.channel, 'Propulsion': Propulsion(),
              'Eavesdropper': _PAPER.eavesdroppers[0], 'GroundNode': _PAPER.ground_nodes[0],
              'Origin': Origin(0.0, 0.0),
              'Uav': _PAPER.uavs[min(index, len(_PAPER.uavs) - 1)]}
    return {f'{prefix}{name}': _read_spec(row, owners) for name, row in _TABLE[section].items()}


def _read_spec(row: Mapping[str, Any], owners: Mapping[str, Any]) -> Spec:
    """
    Return the Spec of a row of the table; a `field` gives the default and the limits.

    :param row: keys of Spec, or `field` such as 'Uav.altitude' and `none`, the parameter's value
        for the field's None, which the limits then include.
    :param owners: an object of each class, such as 'Uav', whose field values are the defaults.
    """
    values: dict[str, Any] = {
        key: tuple(value) if key in ('limits', 'length', 'choices') else value
        for key, value in row.items() if key not in ('field', 'none')}
    if 'field' not in row:
        return Spec(**values)
    kind, _, name = row['field'].partition('.')
    owner, none = owners[kind], row.get('none')
    default, check = getattr(owner, name), get_check(type(owner), name)
    if isinstance(check, Number):
        ends = [check.low, check.high] if none is None else [check.low, check.high, none]
        values['limits'] = min(ends), max(ends)
    elif isinstance(check, Pair):
        values |= {'limits': (COORDINATE.low, COORDINATE.high),
                   'length': (2 if none is None else 0, 2)}
    return Spec(_to_value(default, none), **values)


def _to_value(field: Any, none: Any) -> Any:
    """Return a field's value as a parameter: `none` for None, and a list for a tuple."""
    return none if field is None else list(field) if isinstance(field, tuple) else field


def _list_fields(section: str, kind: type) -> Iterator[tuple[str, str, Any]]:
    """Yield (parameter, field of `kind`, parameter's value for None) of a section of the table."""
    for name, row in _TABLE[section].items():
        owner, _, field = row.get('field', '').partition('.')
        if owner == kind.__name__:
            yield name, field, row.get('none')


def read_fields(section: str, kind: type, values: Mapping[str, Any], prefix: str = ''
                ) -> dict[str, Any]:
    """Return the fields of a class that are parameters in a section, from their values."""
    return {field: None if values[prefix + name] == none else values[prefix + name]
            for name, field, none in _list_fields(section, kind)}


def list_values(section: str, item: Any, prefix: str = '') -> dict[str, Any]:
    """Return an object's fields that are parameters of a section, as values by parameter."""
    return {prefix + name: _to_value(getattr(item, field), none)
            for name, field, none in _list_fields(section, type(item))}


PLANNER, REPLAY, RELAY = (read_specs(node) for node in ('planner', 'replay', 'relay'))
"""Parameters of the nodes that do not belong to one UAV, receiver or zone."""

PLANNER_MEMBERS = {'uavs': 'uav', 'ground_nodes': 'ground_node', 'eavesdroppers': 'eavesdropper',
                   'no_fly_zones': 'no_fly_zone'}
RELAY_MEMBERS = {'uavs': 'relay_uav'}
"""Sections of the table for the members of the nodes, by the parameters that list their names."""


def read_member_specs(values: Mapping[str, Any], sections: Mapping[str, str]) -> dict[str, Spec]:
    """
    Return the Spec of each parameter of all members by the parameter's name.

    :param values: values of the parameters that list the names of members.
    :param sections: sections of the table by these parameters, such as PLANNER_MEMBERS.
    :raises ParameterError: for a name that two members of any kind share.
    """
    names = [name for kind in sections for name in values[kind]]
    if len(set(names)) < len(names):
        raise ParameterError(f'parameters {", ".join(sections)} give the names {names}; they must '
                             'be unique')
    return {key: spec for kind, section in sections.items()
            for index, name in enumerate(values[kind])
            for key, spec in read_specs(section, name, index).items()}
