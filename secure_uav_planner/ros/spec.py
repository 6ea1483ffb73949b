"""One parameter of a node: its type, its meaning and what it may be."""

from dataclasses import dataclass
from typing import Any

from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor
from rclpy.exceptions import NameValidationException
from rclpy.validate_topic_name import validate_topic_name

from ..errors import brief, ParameterError, quote

_MOST_IN_NAME = 100  # ROS allows about 240 in a topic, of which a name is one part.


@dataclass(frozen=True)
class Spec:
    """
    One parameter.

    :param default: the default value; its type is the parameter's type.
    :param limits: the smallest and the largest allowed number, for numbers and lists of numbers.
    :param length: the smallest and the largest allowed length, for lists and strings.
    :param choices: the allowed strings. YAML's `off`, which is false, counts as the string.
    """

    default: Any
    description: str
    limits: tuple[float, float] | None = None
    length: tuple[int, int] | None = None
    choices: tuple[str, ...] | None = None
    read_only: bool = False

    @property
    def allowed(self) -> str:
        """Return what is allowed, in words."""
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
                     if self._of_names else ' numbers')
        if self.limits:
            noun += f' from {self.limits[0]:g} to {self.limits[1]:g}'
        return noun

    @property
    def _of_names(self) -> bool:
        return isinstance(self.default, list) and self.limits is None

    def checked(self, name: str, value: Any, what: str = '') -> Any:
        """Return the value in the parameter's type; the text of an error begins with `what`."""
        try:
            return self._converted(value)
        except (TypeError, ValueError, OverflowError, NameValidationException):
            raise ParameterError(f'{what}{brief(name, 100)} is {quote(value)}; it must be '
                                 f'{self.allowed}', (name,)) from None

    def _converted(self, value: Any) -> Any:
        kind = type(self.default)
        if kind is list:
            values = list(value)
            if isinstance(value, (str, bytes)) or not (
                    self.length[0] <= len(values) <= self.length[1]):
                raise ValueError
            return [_name(one) for one in values] if self._of_names else [
                self._number(one, float) for one in values]
        if kind in (int, float):
            return self._number(value, kind)
        if value is False and 'off' in (self.choices or ()):
            return 'off'
        if not isinstance(value, kind) or self.choices and value not in self.choices or (
                kind is str and self.length and len(value) > self.length[1]):
            raise ValueError
        return value

    def _number(self, value: Any, kind: type) -> float:
        # An integer is accepted as a float, as in `duration: 150` in YAML, and 1e2 as an integer.
        low, high = self.limits
        if isinstance(value, bool) or not isinstance(value, (int, float)) or not (
                low <= value <= high and value == kind(value)):
            raise ValueError
        return kind(value)

    def descriptor(self) -> ParameterDescriptor:
        """Return what `ros2 param describe` shows."""
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


def _name(value: Any) -> str:
    """Return a name that can be part of a topic and of a parameter."""
    if not isinstance(value, str) or '/' in value or '~' in value or (
            len(value) > _MOST_IN_NAME):
        raise ValueError
    validate_topic_name(value)
    return value
