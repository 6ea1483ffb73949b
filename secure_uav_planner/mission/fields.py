"""
Fields of the dataclasses of a mission, whose metadata say what is allowed.

The metadata of a field have its check and its unit. A check is called with a prefix and the name
of the field, for messages, and with a value; it returns the value converted, or raises
ScenarioError.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, Field, fields, MISSING
import difflib
import math
from types import NoneType, SimpleNamespace
from typing import Any, ClassVar, get_args, TypeAlias

import numpy as np

from .validation import is_sequence, name_type, to_number
from ..errors import describe_class, quote, ScenarioError

Point: TypeAlias = tuple[float, float]
Metadata: TypeAlias = dict[str, Any]

MAX_DISTANCE = 100e3
"""The largest distance of a place in degrees from the origin in m."""


@dataclass(frozen=True)
class Number:
    """
    The check of a number.

    :param low: the smallest.
    :param high: the largest; beyond it, squares would lose their accuracy.
    :param unit: such as 'm/s', or '' for none.
    """

    low: float
    high: float
    unit: str = ''

    def __call__(self, owner: str, field: str, value: Any) -> float:
        number = to_number(value)
        if not self.low <= number <= self.high:
            suffix = f' {self.unit}' if self.unit else ''
            if isinstance(value, str):
                suffix = f', in {self.unit}, without its unit' if self.unit else ', without a unit'
            raise ScenarioError(
                f'{owner}{field} is {quote(value)}; it must be a number from {self.low:g} to '
                f'{self.high:g}{suffix}', (field,))
        return number


@dataclass(frozen=True)
class WholeNumber(Number):
    """The check of a whole number."""

    def __call__(self, owner: str, field: str, value: Any) -> int:
        number = super().__call__(owner, field, value)
        if not number.is_integer():
            raise ScenarioError(f'{owner}{field} is {quote(value)}; it must be a whole number',
                                (field,))
        return int(number)


COORDINATE = Number(-1e7, 1e7, 'm')
RADIUS = Number(0.0, 1e7, 'm')


@dataclass(frozen=True)
class Pair:
    """
    The check of two numbers with the range of a coordinate.

    :param unit: of each.
    :param noun: of a right value, for messages.
    :param is_optional: whether None is allowed instead, for messages.
    """

    unit: str = 'm'
    noun: str = 'two coordinates'
    is_optional: bool = False

    def __call__(self, owner: str, field: str, value: Any, index: int | None = None) -> Point:
        """Return a value as floats; it has an index if the field is a list of pairs."""
        low, high = COORDINATE.low, COORDINATE.high
        x, y = map(to_number, value) if is_sequence(value) and len(value) == 2 else (math.nan,) * 2
        if not (low <= x <= high and low <= y <= high):
            name, path = (field, ()) if index is None else (f'{field}[{index}]', (index,))
            allowed = f'{quote(None)} or {self.noun}' if self.is_optional else self.noun
            raise ScenarioError(f'{owner}{name} is {quote(value)}{name_type(value)}; it must be '
                                f'{allowed} (x, y) from {low:g} to {high:g} {self.unit}'
                                f'{describe_degrees(value)}', (field, *path))
        return (x, y)


checked_point = Pair()


def describe_degrees(value: object) -> str:
    """Describe the needs of a place in degrees for a message; '' for any other value."""
    if not isinstance(value, Mapping) or not {'latitude', 'longitude'} & set(value):
        return ''
    return (', or {latitude: , longitude: } in degrees, in the file of a mission with an origin, '
            f'at most {MAX_DISTANCE / 1e3:g} km from it')


@dataclass(frozen=True)
class Choice:
    """The check of one of several strings."""

    names: tuple[str, ...]

    def __call__(self, owner: str, field: str, value: Any) -> str:
        if not isinstance(value, str) or value not in self.names:
            raise ScenarioError(f'{owner}{field} is {quote(value)}; it must be one of '
                                f'{", ".join(self.names)}', (field,))
        return value


@dataclass(frozen=True)
class Block:
    """The check of an object of a class, also as a mapping of its fields."""

    kind: type[Any]

    def __call__(self, owner: str, field: str, value: Any) -> Any:
        if isinstance(value, self.kind):
            return value
        errors = ErrorList()
        with errors.collecting(field, owner=owner):
            if not isinstance(value, Mapping):
                raise ScenarioError(f'{field} is {quote(value)}; it must be a '
                                    f'{describe_class(self.kind)} or a mapping of its fields')
            value = read_object(self.kind, value)
        raise_all(errors)
        return value


@dataclass(frozen=True)
class Members:
    """The check of a list of objects of a class, also as mappings of their fields."""

    kind: type[Any]
    least: int
    most: int

    def __call__(self, owner: str, field: str, values: Any) -> tuple[Any, ...]:
        if not isinstance(values, (tuple, list)) or not self.least <= len(values) <= self.most:
            raise ScenarioError(f'{owner}{field} is {quote(values)}; it must be a list of '
                                f'{self.least} to {self.most} {describe_class(self.kind)}',
                                (field,))
        errors, members = ErrorList(), []
        for number, value in enumerate(values):
            with errors.collecting(field, number):
                members.append(value if isinstance(value, self.kind) else
                               read_object(self.kind, value, f'{owner}{field}[{number}]: '))
        raise_all(errors)
        return tuple(members)


def checked_name(owner: str, field: str, name: object) -> str:
    """Return a string that is not empty, or raise ScenarioError."""
    if not isinstance(name, str) or not name:
        raise ScenarioError(
            f'{owner}{field} is {quote(name)}; it must be text that is not empty', (field,))
    return name


def checked_text(owner: str, field: str, text: object) -> str:
    """Return a string, or raise ScenarioError."""
    if not isinstance(text, str):
        raise ScenarioError(f'{owner}{field} is {quote(text)}; it must be text', (field,))
    return text


def checked_truth(owner: str, field: str, value: Any) -> bool:
    """Return value, also one of NumPy's, as a bool, or raise ScenarioError."""
    if not isinstance(value, (bool, np.bool_)):
        raise ScenarioError(f'{owner}{field} is {quote(value)}; it must be true or false',
                            (field,))
    return bool(value)


def checked_by(check: Callable[[str, str, Any], Any], unit: str = '') -> Metadata:
    """Return the metadata of a field with a check."""
    return {'check': check, 'unit': getattr(check, 'unit', unit)}


def number(low: float, high: float, unit: str = '') -> Metadata:
    """Return the metadata of a field that is a number in a range."""
    return checked_by(Number(low, high, unit))


def get_check(kind: type[Any], name: str) -> Any:
    """Return the check of a field of a dataclass."""
    return {field.name: field for field in fields(kind)}[name].metadata['check']


def find_range(kind: type[Any], name: str) -> Number:
    """Return the range of a field of a dataclass that is a number."""
    check = get_check(kind, name)
    assert isinstance(check, Number)
    return check


class ErrorList(list[ScenarioError]):
    """Errors that are raised together."""

    @contextmanager
    def collecting(self, *path: str | int, owner: str = '') -> Iterator[None]:
        """Add the errors that leave the with statement, with prefixes of path and text."""
        try:
            yield
        except ScenarioError as error:
            self += [type(item)(f'{owner}{item}', (*path, *item.place))
                     for item in (error, *error.further)]


def raise_all(errors: Iterable[ScenarioError]) -> None:
    """Raise the first of several errors, if there are any, with the rest as `further`."""
    errors = [*errors]
    if errors:
        errors[0].further = tuple(errors[1:])
        raise errors[0]


class FieldChecks(ErrorList):
    """
    The errors of the fields of an object of a dataclass, whose right values are converted.

    :ivar item: the object, or a namespace of the fields that are given.
    :ivar owner: prefix of the name of a field in messages.
    """

    def __init__(self, kind: 'type[Checked]', item: Any) -> None:
        super().__init__()
        name = getattr(item, 'name', None)
        self.item = item
        self.owner = f'{quote(name)[1:-1]}.' if name and isinstance(name, str) else kind._OWNER
        for field in fields(kind):  # type: ignore[arg-type]
            self._check(field)
        kind._check_together(self)

    def _check(self, field: 'Field[Any]') -> None:
        value = getattr(self.item, field.name, MISSING)
        if value is MISSING or value is None and (
                field.default is None or NoneType in get_args(field.type)):
            return
        try:  # Much faster than a context manager.
            object.__setattr__(self.item, field.name, field.metadata['check'](
                self.owner, field.name, value))
        except ScenarioError as error:
            self += [error, *error.further]

    def are_right(self, *names: str) -> bool:
        """Return True if fields are given and have no errors, so that they can be compared."""
        return all(hasattr(self.item, name) for name in names) and not any(
            error.place[:1] == (name,) for error in self for name in names)

    def add(self, field: str, text: str) -> None:
        """Add an error of a field; its text follows the owner and the name of the field."""
        self.append(ScenarioError(f'{self.owner}{field} {text}', (field,)))


class Checked:
    """
    A frozen dataclass whose fields are checked and converted as their metadata say.

    :cvar _OWNER: prefix of the names of its fields in messages, unless it has a name.
    """

    _OWNER: ClassVar[str] = ''

    def __post_init__(self) -> None:
        raise_all(FieldChecks(type(self), self))

    @staticmethod
    def _check_together(checks: FieldChecks) -> None:
        """Add the errors of values that do not fit each other."""


REQUIRED: Any = object()
"""The default of a field without one that follows a field with one."""


def find_field_errors(kind: type[Any], data: object) -> Iterator[ScenarioError]:
    """Yield an error for each unknown field of data and for missing fields of a dataclass."""
    noun = describe_class(kind)
    if not isinstance(data, Mapping):
        yield ScenarioError(f'{noun} is {quote(data)}; it must be a mapping of fields')
        return
    names = [field.name for field in fields(kind)]
    for name in data:
        if name not in names:
            near = difflib.get_close_matches(str(name), names, 1)
            hint = f'; did you mean {near[0]}?' if near else f'; it has {", ".join(names)}'
            yield ScenarioError(f'{noun} has no field {quote(name)}{hint}', (name,))
    missing = [field.name for field in fields(kind)
               if field.default in (MISSING, REQUIRED) and field.name not in data]
    if missing:
        yield ScenarioError(f'{noun} lacks {", ".join(missing)}')


def checked_fields(kind: type[Any], data: Any) -> dict[str, Any]:
    """Return a mapping as the arguments of a dataclass, or raise its unknown and missing ones."""
    raise_all(find_field_errors(kind, data))
    return dict(data)


def read_object(kind: type[Any], data: object, owner: str = '') -> Any:
    """
    Return an object of a dataclass from a mapping of its fields, or raise all their errors.

    :param owner: prefix of the messages of unknown and missing fields.
    """
    errors = ErrorList()
    with errors.collecting(owner=owner):
        raise_all(find_field_errors(kind, data))
    if not errors:
        return kind(**dict(data))  # type: ignore[call-overload]
    if isinstance(data, Mapping):
        given = {field.name: data.get(field.name, field.default) for field in fields(kind)}
        errors += FieldChecks(kind, SimpleNamespace(**{
            name: value for name, value in given.items()
            if value is not MISSING and value is not REQUIRED}))
    raise_all(errors)
