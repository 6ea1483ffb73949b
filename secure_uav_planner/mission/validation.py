"""Checks of the fields of a mission, and of the arguments of functions."""

from collections.abc import Callable, Iterable, Iterator, Mapping, Set
from contextlib import contextmanager
from dataclasses import fields, MISSING
from decimal import Decimal, ROUND_CEILING, ROUND_FLOOR
import difflib
import math
import sys
from types import SimpleNamespace
from typing import Any, TypeAlias, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..errors import describe_class, OptionError, prefix_place, quote, ScenarioError

Array: TypeAlias = NDArray[np.float64]
Point: TypeAlias = tuple[float, float]
_Kind = TypeVar('_Kind')

MAX_DISTANCE = 100e3
"""The largest distance of a place in degrees from the origin in m."""

RANGES = {
    'coordinate': (-1e7, 1e7),
    'error_radius': (0.0, 1e7),
    'knot_time': (-1e9, 1e9),
    'receiver_advantage_db': (-100.0, 100.0),
    'altitude': (1e-3, 1e6),
    'max_speed': (1e-6, 1e6),
    'max_acceleration': (1e-6, 1e6),
    'average_power': (1e-9, 1e6),
    'peak_power': (1e-9, 1e6),
    'duration': (1e-6, 1e8),
    'slots': (1, 20000),
    'reference_snr_db': (-200.0, 300.0),
    'separation': (0.0, 1e6),
    'tracking_margin': (0.0, 1e6),
    'floor': (0.0, 1e6),
    'ceiling': (0.0, math.inf),
    'blade_power': (0.0, 1e6),
    'induced_power': (0.0, 1e6),
    'tip_speed': (1.0, 1e4),
    'induced_velocity': (1e-3, 1e3),
    'fuselage_drag_ratio': (0.0, 1e3),
    'air_density': (0.0, 1e3),
    'solidity': (0.0, 1.0),
    'disc_area': (0.0, 1e4),
    'exponent': (2.0, 6.0),
    'los_a': (0.01, 100.0),
    'los_b': (0.001, 2.0),
    'los_loss_db': (0.0, 100.0),
    'rician_k_db': (-40.0, 40.0),
    'outage': (1e-6, 0.5),
    'beyond': (0.0, 1e6),
    'los_distance': (0.0, 1e6),
    'speed_factor': (0.0, 100.0),
    'receiver_db': (-100.0, 100.0),
    'tracking_std': (0.0, 1e4),
    'tracking_time': (0.0, 1e6),
    'carrier_hz': (1e6, 1e12),
    'bandwidth_hz': (1.0, 1e11),
    'noise_figure_db': (0.0, 60.0),
    'transmit_gain_dbi': (-60.0, 80.0),
    'receive_gain_dbi': (-60.0, 80.0),
    'latitude': (-85.0, 85.0),
    'longitude': (-180.0, 180.0),
}
"""Smallest and largest value of each field; beyond them squares lose their accuracy."""

UNITS = {
    'ground_node': 'm', 'position': 'm', 'start': 'm', 'goal': 'm', 'vertices': 'm',
    'geofence': 'm', 'error_radius': 'm', 'altitude': 'm', 'separation': 'm', 'floor': 'm',
    'ceiling': 'm', 'tracking_margin': 'm', 'max_speed': 'm/s', 'start_velocity': 'm/s',
    'goal_velocity': 'm/s', 'max_acceleration': 'm/s^2', 'average_power': 'W',
    'peak_power': 'W', 'duration': 's', 'reference_snr_db': 'dB', 'receiver_advantage_db': 'dB',
    'blade_power': 'W', 'induced_power': 'W', 'tip_speed': 'm/s', 'induced_velocity': 'm/s',
    'air_density': 'kg/m^3', 'disc_area': 'm^2', 'rician_k_db': 'dB',
    'latitude': 'degrees', 'longitude': 'degrees'}
"""The unit of each field that has one."""


def read_only(values: ArrayLike) -> Array:
    """Copy values to a read-only array of floats."""
    array = np.array(values, dtype=float)
    array.setflags(write=False)
    return array


def required_fields(kind: type[Any]) -> list[str]:
    """Return the names of the fields of a dataclass that have no default."""
    return [field.name for field in fields(kind) if field.default is MISSING]


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
    missing = [name for name in required_fields(kind) if name not in data]
    if missing:
        yield ScenarioError(f'{noun} lacks {", ".join(missing)}')


def checked_fields(kind: type[Any], data: Any) -> dict[str, Any]:
    """Return a mapping as the arguments of a dataclass, or raise its unknown and missing ones."""
    raise_all(find_field_errors(kind, data))
    return dict(data)


def raise_all(errors: Iterable[ScenarioError]) -> None:
    """Raise the first of several errors, if there are any, with the rest as `further`."""
    errors = [*errors]
    if errors:
        errors[0].further = tuple(errors[1:])
        raise errors[0]


class ErrorList(list[ScenarioError]):
    """Errors that are raised together."""

    @contextmanager
    def collecting(self, *place: str | int, owner: str = '') -> Iterator[None]:
        """Add the errors that leave the with statement, with prefixes of place and text."""
        try:
            yield
        except ScenarioError as error:
            self += [type(item)(f'{owner}{item}', (*place, *item.place))
                     for item in (error, *error.further)]


class FieldChecks(ErrorList):
    """
    The errors of the fields of an object of a dataclass, whose right values are converted.

    :ivar item: the object, or a namespace of the fields that are given.
    :ivar owner: prefix of the name of a field in messages.
    """

    def __init__(self, item: Any, owner: str = '') -> None:
        super().__init__()
        self.item, self.owner = item, owner

    def check(self, check: Callable[[str, str, Any], Any], *names: str,
              optional: bool = False) -> None:
        """
        Replace fields by the results of a check, such as checked_number.

        :param optional: whether the fields may be None.
        """
        for name in names:
            value = getattr(self.item, name, None if optional else MISSING)
            if value is not (None if optional else MISSING):
                with self.collecting():
                    object.__setattr__(self.item, name, check(self.owner, name, value))

    def are_right(self, *names: str) -> bool:
        """Return True if fields are given and have no errors, so that they can be compared."""
        return all(hasattr(self.item, name) for name in names) and not any(
            error.place[:1] == (name,) for error in self for name in names)

    def add(self, field: str, text: str) -> None:
        """Add an error of a field; its text follows the owner and the name of the field."""
        self.append(ScenarioError(f'{self.owner}{field} {text}', (field,)))


def check_object(item: Any) -> None:
    """Check the fields of an object of a dataclass by its `_check_fields`; raise all errors."""
    checks = FieldChecks(item)
    type(item)._check_fields(checks)
    raise_all(checks)


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
        errors += check_plain_fields(kind, data)
    raise_all(errors)


def check_plain_fields(kind: type[Any], data: Mapping[str, Any]) -> FieldChecks:
    """Return the errors of those fields of a dataclass that a mapping has."""
    given = {field.name: data.get(field.name, field.default) for field in fields(kind)
             if field.name in data or field.default is not MISSING}
    checks = FieldChecks(SimpleNamespace(**given))
    kind._check_fields(checks)
    return checks


def checked_block(field: str, value: object, kind: type[_Kind]) -> _Kind:
    """Return value, an object of a class or a mapping of its fields, as an object."""
    if isinstance(value, kind):
        return value
    with prefix_place(field):
        if not isinstance(value, Mapping):
            raise ScenarioError(f'{field} is {quote(value)}; it must be a '
                                f'{describe_class(kind)} or a mapping of its fields')
        return read_object(kind, value)  # type: ignore[no-any-return]


def checked_members(members: tuple[type[Any], int, int], owner: str, field: str, values: object
                    ) -> tuple[Any, ...]:
    """Return values, a tuple or list, as a tuple; it has objects of a class, least and most."""
    kind, least, most = members
    if (not isinstance(values, (tuple, list)) or not least <= len(values) <= most
            or not all(isinstance(value, kind) for value in values)):
        raise ScenarioError(f'{owner}{field} is {quote(values)}; it must be a list of '
                            f'{least} to {most} {describe_class(kind)}', (field,))
    return tuple(values)


def set_checked(item: object, owner: str, check: Callable[[str, str, Any], Any], *names: str,
                optional: bool = False) -> None:
    """
    Replace fields of a frozen dataclass by the results of a check, such as checked_number.

    :param owner: prefix of the name of a field in messages.
    :param optional: whether the fields may be None.
    """
    for name in names:
        value = getattr(item, name)
        if value is not None or not optional:
            object.__setattr__(item, name, check(owner, name, value))


def checked_name(owner: str, field: str, name: object) -> str:
    """Return a string that is not empty, or raise ScenarioError."""
    if not isinstance(name, str) or not name:
        raise ScenarioError(
            f'{owner}{field} is {quote(name)}; it must be text that is not empty', (field,))
    return name


def to_number(value: Any) -> float:
    """Return a number as a float, NaN for anything else, such as its text or a truth value."""
    kind = getattr(getattr(value, 'dtype', None), 'kind', 'f')  # Of NumPy's numbers and arrays.
    if (isinstance(value, bool) or kind not in 'fiu' or getattr(value, 'ndim', 0) != 0
            or not (hasattr(value, '__float__') or hasattr(value, '__index__'))):
        return math.nan
    try:
        return float(value)
    except (TypeError, ValueError, OverflowError):
        return math.nan


def is_sequence(value: object) -> bool:
    """Return True for lists, tuples, arrays and the like, but not for text, mappings and sets."""
    return (hasattr(value, '__getitem__') and hasattr(value, '__len__')
            and not isinstance(value, (str, bytes, bytearray, Mapping))
            and getattr(value, 'ndim', 1) > 0)


def name_type(value: object) -> str:
    """Return the class of a value that looks like a list of numbers and is none, for messages."""
    return f', a {type(value).__name__}' if isinstance(value, (Set, bytes, bytearray)) else ''


def checked_truth(owner: str, field: str, value: Any) -> bool:
    """Return value, also one of NumPy's, as a bool, or raise ScenarioError."""
    if not isinstance(value, (bool, np.bool_)):
        raise ScenarioError(f'{owner}{field} is {quote(value)}; it must be true or false',
                            (field,))
    return bool(value)


def checked_number(owner: str, field: str, value: Any) -> float:
    """Return value as a float, or raise ScenarioError with field, value and range."""
    low, high = RANGES[field]
    number = to_number(value)
    if not low <= number <= high:
        unit = UNITS.get(field)
        suffix = f' {unit}' if unit else ''
        if isinstance(value, str):
            suffix = f', in {unit}, without its unit' if unit else ', without a unit'
        raise ScenarioError(
            f'{owner}{field} is {quote(value)}; it must be a number from {low:g} to {high:g}'
            f'{suffix}', (field,))
    return number


def checked_point(owner: str, field: str, value: Any, index: int | None = None,
                  allowed: str = 'two coordinates', unit: str = 'm') -> Point:
    """
    Return value as a tuple of two floats, or raise ScenarioError with field and value.

    :param index: of the value, if the field is a list of points.
    :param allowed: the description of a right value in messages, before the range and its unit.
    """
    low, high = RANGES['coordinate']
    x, y = map(to_number, value) if is_sequence(value) and len(value) == 2 else (math.nan,) * 2
    if not (low <= x <= high and low <= y <= high):
        name, place = (field, ()) if index is None else (f'{field}[{index}]', (index,))
        raise ScenarioError(f'{owner}{name} is {quote(value)}{name_type(value)}; it must be '
                            f'{allowed} (x, y) from {low:g} to {high:g} {unit}'
                            f'{describe_degrees(value)}', (field, *place))
    return (x, y)


def describe_degrees(value: object) -> str:
    """Return what a place in degrees needs, as the end of a message; '' for any other value."""
    if not isinstance(value, Mapping) or not {'latitude', 'longitude'} & set(value):
        return ''
    return (', or {latitude: , longitude: } in degrees, in the file of a mission with an origin, '
            f'at most {MAX_DISTANCE / 1e3:g} km from it')


def make_unique(names: list[str]) -> tuple[str, ...]:
    """Return names, each followed by a number where several are the same."""
    results: list[str] = []
    for number, name in enumerate(names, start=1):
        unique = name
        while names.count(unique) > 1 or unique in results or (
                unique != name and unique in names):
            unique, number = f'{name}{number}', number + 1
        results.append(unique)
    return tuple(results)


def round_up(value: float, digits: int = 6) -> float:
    """Round a number up to significant digits, so that a lower bound in a message is kept."""
    return _round(value, digits, ROUND_CEILING)


def round_down(value: float, digits: int = 6) -> float:
    """Round a number down to significant digits, so that an upper bound in a message is kept."""
    return _round(value, digits, ROUND_FLOOR)


def _round(value: float, digits: int, rounding: str) -> float:
    if not value or not math.isfinite(value):
        return value
    exact = Decimal(value)
    return float(exact.quantize(Decimal(1).scaleb(exact.adjusted() + 1 - digits), rounding))


def checked_choice(name: str, value: object, allowed: tuple[str, ...]) -> None:
    """Raise OptionError unless an argument is one of the allowed strings."""
    if not isinstance(value, str) or value not in allowed:
        raise OptionError(f'{name} is {quote(value)}; it must be one of {quote(allowed)}', (name,))


def checked_kind(name: str, value: object, kind: type[_Kind]) -> _Kind:
    """Return an argument that is an object of a class, or raise OptionError naming it."""
    if not isinstance(value, kind):
        raise OptionError(f'{name} is {quote(value)}; it must be a {kind.__name__}', (name,))
    return value


def checked_real(name: str, value: Any, low: float = -sys.float_info.max,
                 high: float = sys.float_info.max) -> float:
    """Return an argument that is a finite number, or raise OptionError naming it."""
    number = to_number(value)
    if not low <= number <= high:
        allowed = f'number from {low:g} to {high:g}' if high < sys.float_info.max else (
            'finite number')
        raise OptionError(f'{name} is {quote(value)}; it must be a {allowed}', (name,))
    return number


def checked_array(name: str, values: Any, *shapes: tuple[int | None, ...]) -> Array:
    """
    Return an argument as an array of floats, or raise OptionError naming it.

    :param shapes: allowed shapes, where None is any number; without any, all are allowed.
    """
    try:
        array = np.asarray(values, float)
        fits = not shapes or any(
            len(shape) == array.ndim and all(wanted in (None, size) for wanted, size in zip(
                shape, array.shape)) for shape in shapes)
    except (TypeError, ValueError, OverflowError):
        fits = False
    if not fits or values is None:
        allowed = ' or '.join(str(shape).replace('None', 'N') for shape in shapes)
        raise OptionError(f'{name} is {quote(values)}; it must be an array of numbers'
                          f'{" of the shape " if shapes else ""}{allowed}', (name,))
    return array


def checked_callback(name: str, value: object) -> None:
    """Raise OptionError unless an argument can be called, or is None."""
    if value is not None and not callable(value):
        raise OptionError(f'{name} is {quote(value)}; it must be callable, or None', (name,))


def checked_time_limit(time_limit: Any) -> float | None:
    """Return a time limit in s, or None without one; raise OptionError unless it is above 0."""
    number = math.inf if time_limit is None else to_number(time_limit)
    if not number > 0:
        raise OptionError(f'time_limit is {quote(time_limit)}; it must be a number above 0 s, or '
                          'None', ('time_limit',))
    return number if number < math.inf else None
