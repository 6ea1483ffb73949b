"""
Fields of the dataclasses of a mission, whose metadata say what is allowed.

The metadata of a field have a check and a unit. A check is called with a value. It returns the
converted value, or raises a ScenarioError whose subject is completed by the name of the field.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, fields, MISSING
import difflib
import math
from types import NoneType, SimpleNamespace
from typing import Any, ClassVar, get_args, TypeAlias

import numpy as np

from .validation import is_sequence, to_number
from ..errors import describe_class, FieldPath, OptionError, PlanningError, quote, ScenarioError

Point: TypeAlias = tuple[float, float]
Metadata: TypeAlias = dict[str, Any]

MAX_DISTANCE = 100e3
"""Largest distance in m from the origin of a place in degrees."""


def refuse(value: object, allowed: str) -> ScenarioError:
    """Return the error of a value, whose text says what is allowed."""
    return ScenarioError(f'is {quote(value)}; it must be {allowed}', subject=())


@dataclass(frozen=True)
class Number:
    """
    The check of a number.

    :param low: smallest allowed value.
    :param high: largest allowed value.
    :param unit: unit of the value, such as 'm/s', or '' for none.
    """

    low: float
    high: float
    unit: str = ''

    def __call__(self, value: Any) -> float:
        """Return a number from `low` to `high` as a float, or raise ScenarioError."""
        number = to_number(value)
        if not self.low <= number <= self.high:
            suffix = f' {self.unit}' if self.unit else ''
            if isinstance(value, str):
                suffix = f', in {self.unit}, without its unit' if self.unit else ', without a unit'
            raise refuse(value, f'a number from {self.low:g} to {self.high:g}{suffix}')
        return number


@dataclass(frozen=True)
class WholeNumber(Number):
    """The check of a whole number."""

    def __call__(self, value: Any) -> int:
        number = super().__call__(value)
        if not number.is_integer():
            raise refuse(value, 'a whole number')
        return int(number)


COORDINATE = Number(-1e7, 1e7, 'm')
RADIUS = Number(0.0, 1e7, 'm')
TIME = Number(-1e12, 1e12, 's')


@dataclass(frozen=True)
class Pair:
    """
    The check of two numbers with the range of a coordinate.

    :param unit: unit of both numbers.
    :param noun: noun of an allowed value in messages.
    :param is_optional: whether messages also offer None, which the check itself does not take.
    """

    unit: str = 'm'
    noun: str = 'two coordinates'
    is_optional: bool = False

    def __call__(self, value: Any) -> Point:
        """Return a pair (x, y) as floats; refuse places in degrees, wrong numbers and None."""
        check_degrees(value)
        low, high = COORDINATE.low, COORDINATE.high
        x, y = map(to_number, value) if is_sequence(value) and len(value) == 2 else (math.nan,) * 2
        if not (low <= x <= high and low <= y <= high):
            # FieldChecks accepts None for an optional field and does not call this check.
            allowed = f'{quote(None)} or {self.noun}' if self.is_optional else self.noun
            raise refuse(value, f'{allowed} (x, y) from {low:g} to {high:g} {self.unit}')
        return (x, y)


checked_point = Pair()


class RefusedPlace(dict[str, Any]):
    """
    A place in degrees that could not be converted.

    :param place: mapping with the latitude and the longitude.
    :param reason: why the place could not be converted.
    """

    def __init__(self, place: Mapping[str, Any], reason: str) -> None:
        super().__init__(place)
        self.reason = reason


def check_degrees(value: object) -> None:
    """Raise ScenarioError for a place in degrees that was not converted to m before."""
    if isinstance(value, RefusedPlace):
        raise ScenarioError(f'is {quote(dict(value))}: {value.reason}', subject=())
    if isinstance(value, Mapping) and {'latitude', 'longitude'} & set(value):
        reason = ('a place in degrees has a latitude and a longitude'
                  if set(value) != {'latitude', 'longitude'} else 'a place in degrees needs a '
                  'mission file with an origin: {latitude: , longitude: }')
        raise ScenarioError(f'is {quote(value)}; {reason}', subject=())


@dataclass(frozen=True)
class Choice:
    """The check of one of several strings."""

    names: tuple[str, ...]

    def __call__(self, value: Any) -> str:
        if not isinstance(value, str) or value not in self.names:
            raise refuse(value, f'one of {", ".join(self.names)}')
        return value


@dataclass(frozen=True)
class Instance:
    """The check of an object of a class."""

    kind: type[Any]

    def __call__(self, value: Any) -> Any:
        if not isinstance(value, self.kind):
            raise refuse(value, _with_article(self.kind))
        return value


def _with_article(kind: type[Any]) -> str:
    noun = describe_class(kind)
    return f'{"an" if noun[0] in "aeioAEIO" else "a"} {noun}'


@dataclass(frozen=True)
class Block(Instance):
    """The check of an object of a class, which may be given as a mapping of its fields."""

    def __call__(self, value: Any) -> Any:
        return value if isinstance(value, self.kind) else read_object(self.kind, value)


@dataclass(frozen=True)
class Members:
    """The check of a list of objects of a class, which may be mappings of their fields."""

    kind: type[Any]
    least: int
    most: int

    def __call__(self, values: Any) -> tuple[Any, ...]:
        """Return the members as objects of `kind`; others are read as mappings of fields."""
        if not isinstance(values, (tuple, list)) or not self.least <= len(values) <= self.most:
            raise refuse(values, f'a list of {self.least} to {self.most} '
                         f'{describe_class(self.kind)}')
        errors, members = ErrorList(), []
        for number, value in enumerate(values):
            if not isinstance(value, self.kind):
                with errors.collecting(number):
                    value = read_object(self.kind, value)
            members.append(value)
        raise_all(errors)
        return tuple(members)


def check_items(values: Iterable[Any], check: Callable[[Any], Any]) -> tuple[Any, ...]:
    """Return the items as a check converts them; its error gets the item's index as path."""
    items: list[Any] = []
    try:
        for value in values:
            items.append(check(value))
    except PlanningError as error:
        error.add_path(len(items))
        raise
    return tuple(items)


def check_numbers(values: Iterable[Any], ranges: Mapping[str, Number]) -> tuple[float, ...]:
    """Return numbers as floats, number k checked by range k; an error names the range."""
    numbers = []
    for value, (name, check) in zip(values, ranges.items(), strict=True):
        try:
            numbers.append(check(value))
        except ScenarioError as error:
            raise ScenarioError(error.args[0], subject=(name,)) from None
    return tuple(numbers)


def check_argument(name: str, value: Any, check: Callable[[Any], Any]) -> Any:
    """Return an argument of a function as a check converts it, or raise OptionError."""
    try:
        return check(value)
    except ScenarioError as error:
        error.add_path(name)
        raise OptionError(error, error.place) from None


def checked_name(name: object) -> str:
    """Return a non-empty string as checked_text does, or raise ScenarioError."""
    if not isinstance(name, str) or not name:
        raise refuse(name, 'text that is not empty')
    return checked_text(name)


def checked_text(text: object) -> str:
    """
    Return a string that can be written as UTF-8, or raise ScenarioError.

    A pair of surrogates, by which JSON escapes some characters and which YAML keeps, becomes the
    escaped character.
    """
    if not isinstance(text, str):
        raise refuse(text, 'text')
    try:
        return text.encode('utf-16-le', 'surrogatepass').decode('utf-16-le')
    except UnicodeDecodeError:
        raise refuse(text, 'text of whole characters, without half of a surrogate pair'
                     ) from None


def checked_truth(value: Any) -> bool:
    """Return a bool of Python or NumPy as a bool of Python, or raise ScenarioError."""
    if not isinstance(value, (bool, np.bool_)):
        raise refuse(value, 'true or false')
    return bool(value)


def checked_by(check: Callable[[Any], Any], unit: str = '') -> Metadata:
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
        """Catch a ScenarioError in the with statement; add it and its `further`, with path."""
        try:
            yield
        except ScenarioError as error:
            error.add_path(*path, owner=owner)
            self += [error, *error.further]


def raise_all(errors: Iterable[ScenarioError],
              kind: type[PlanningError] = ScenarioError) -> None:
    """
    Raise the first of several errors, if there are any, with the rest as `further`.

    :param kind: the class of the error, which has no `further` unless it is a ScenarioError.
    """
    errors = [*errors]
    if errors and kind is not ScenarioError:
        raise kind(str(errors[0]), errors[0].place)
    if errors:
        errors[0].further = tuple(errors[1:])
        raise errors[0]


REQUIRED: Any = object()
"""Marks a required field that stands behind fields with a default."""


class FieldChecks(ErrorList):
    """
    The errors of the fields of an object; making it replaces right values by converted ones.

    :param kind: dataclass whose fields are checked.
    :param name: name of the object in messages.
    :ivar item: the object, or a namespace of its fields.
    :ivar owner: prefix of the name of a field in messages.
    """

    def __init__(self, kind: 'type[Checked]', item: Any, name: str) -> None:
        """Convert the fields of `item` in place, and collect the errors of wrong ones."""
        super().__init__()
        own_name = getattr(item, 'name', None)
        self.item = item
        self.owner = (f'{quote(own_name)[1:-1]}.' if own_name and isinstance(own_name, str)
                      else kind._OWNER)
        self._missing = _find_missing(item)
        if self._missing:
            self.append(_make_error(name, f'lacks {", ".join(self._missing)}'))
        for field in fields(kind):  # type: ignore[arg-type]
            value = getattr(item, field.name)
            # None is not checked if the default or the type of the field allows it.
            if field.name in self._missing or 'check' not in field.metadata or value is None and (
                    field.default is None or NoneType in get_args(field.type)):
                continue
            try:  # Much faster here than the context manager ErrorList.collecting.
                object.__setattr__(item, field.name, field.metadata['check'](value))
            except ScenarioError as error:
                error.add_path(field.name, owner=self.owner)
                self += [error, *error.further]
        kind._check_together(self)

    def are_right(self, *names: str) -> bool:
        """Return True if fields are given and have no errors, so that they can be compared."""
        wrong = {*self._missing, *(error.place[0] for error in self if error.place)}
        return not wrong.intersection(names)

    def add(self, field: str, text: str) -> None:
        """Add an error of a field; its text follows the owner and the name of the field."""
        self.append(ScenarioError(f'{self.owner}{field} {text}', (field,)))


def _make_error(name: str, predicate: str, place: FieldPath = (),
                kind: type[PlanningError] = ScenarioError) -> Any:
    """Return an error of an object with a name, or of a field where the name is ''."""
    return kind(f'{name} {predicate}', place) if name else kind(predicate, place, ())


def _find_missing(item: Any) -> list[str]:
    """Return the names of the fields that an object or a namespace lacks."""
    return [name for name, value in vars(item).items() if value is MISSING or value is REQUIRED]


class Checked:
    """
    A frozen dataclass whose fields are checked and converted as their metadata say.

    :cvar _OWNER: prefix of fields in messages about an object without a name.
    :cvar _ERROR: class of the error that wrong values raise.
    """

    _OWNER: ClassVar[str] = ''
    _ERROR: ClassVar[type[PlanningError]] = ScenarioError

    def __post_init__(self) -> None:
        kind = type(self)
        raise_all(FieldChecks(kind, self, describe_class(kind)), kind._ERROR)

    @staticmethod
    def _check_together(checks: FieldChecks) -> None:
        """Add the errors of values that do not fit each other."""

    @staticmethod
    def _expand(values: Mapping[Any, Any], errors: ErrorList) -> Mapping[Any, Any]:
        """Return values by field, with short names, such as ground_node, replaced by fields."""
        return values


def read_object(kind: 'type[Checked]', data: object, name: str = '') -> Any:
    """
    Return an object of a class from a mapping of its fields, or raise kind._ERROR of all errors.

    :param name: name of the data in messages; '' for a field, whose name PlanningError.add_path
        adds.
    """
    if not isinstance(data, Mapping):
        raise _make_error(name, f'is {quote(data)}; it must be {_with_article(kind)} or a '
                          'mapping of its fields', kind=kind._ERROR)
    defaults = {field.name: field.default for field in fields(kind)}  # type: ignore[arg-type]
    errors, further = ErrorList(), ErrorList()
    data = kind._expand(data, further)
    for given in data:
        if given not in defaults:
            near = difflib.get_close_matches(str(given), defaults, 1)
            hint = f'; did you mean {near[0]}?' if near else f'; it has {", ".join(defaults)}'
            errors.append(_make_error(name, f'has no field {quote(given)}{hint}', (given,)))
    item = SimpleNamespace(**{field: data.get(field, default)
                              for field, default in defaults.items()})
    if not errors and not further and not _find_missing(item):
        return kind(**data)
    raise_all([*errors, *FieldChecks(kind, item, name), *further], kind._ERROR)
