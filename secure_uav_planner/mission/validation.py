"""Checks of the arguments of functions, and numbers in their messages."""

from collections.abc import Mapping
from decimal import Decimal, ROUND_CEILING, ROUND_FLOOR
import math
from typing import Any, TypeAlias, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..errors import OptionError, quote

Array: TypeAlias = NDArray[np.float64]
_Kind = TypeVar('_Kind')


def read_only(values: ArrayLike) -> Array:
    """Copy values to a read-only array of floats."""
    array = np.array(values, dtype=float)
    array.setflags(write=False)
    return array


def find_runs(mask: NDArray[np.bool_]) -> NDArray[np.intp]:
    """Return the first index of each run of True in a mask, and the one after its last, (R, 2)."""
    return np.flatnonzero(np.diff(mask, prepend=False, append=False)).reshape(-1, 2)


def to_number(value: Any) -> float:
    """Return a number as a float; NaN for anything else, such as '3' or True."""
    kind = getattr(getattr(value, 'dtype', None), 'kind', 'f')  # NumPy's letter for the type.
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


def make_unique(names: list[str]) -> tuple[str, ...]:
    """Return names; a repeated one has its list number, from 1, or a later free one, appended."""
    results: list[str] = []
    for number, name in enumerate(names, start=1):
        unique = name
        while names.count(unique) > 1 or unique in results or (
                unique != name and unique in names):
            unique, number = f'{name}{number}', number + 1
        results.append(unique)
    return tuple(results)


def rate_text(rate: float, digits: int = 4) -> str:
    """Return a rate as text; 'none' for NaN, the mean rate of no slots."""
    return 'none' if math.isnan(rate) else f'{rate:.{digits}f}'


def round_up(value: float, digits: int = 6) -> float:
    """Round up to significant digits, so that a least value told in a message suffices."""
    return _round(value, digits, ROUND_CEILING)


def round_down(value: float, digits: int = 6) -> float:
    """Round down to significant digits, so that a largest value told in a message is allowed."""
    return _round(value, digits, ROUND_FLOOR)


def _round(value: float, digits: int, rounding: str) -> float:
    """Round to a number of significant digits by a rounding mode of decimal."""
    if not value or not math.isfinite(value):
        return value
    exact = Decimal(value)
    return float(exact.quantize(Decimal(1).scaleb(exact.adjusted() + 1 - digits), rounding))


def checked_kind(name: str, value: object, kind: type[_Kind]) -> _Kind:
    """Return an argument that is an object of a class, or raise OptionError naming it."""
    if not isinstance(value, kind):
        raise OptionError(f'{name} is {quote(value)}; it must be a {kind.__name__}', (name,))
    return value


def checked_array(name: str, values: Any, *shapes: tuple[int | None, ...]) -> Array:
    """
    Return an argument as an array of floats, or raise OptionError naming it.

    :param shapes: allowed shapes, with None for any length; by default any shape is allowed.
    """
    try:
        # Not text, and neither truth values nor complex numbers.
        is_number = np.asarray(values).dtype.kind not in 'SUbc'
        array = np.asarray(values, float) if is_number else np.zeros(0)
        fits = is_number and not np.ma.is_masked(values) and (not shapes or any(
            len(shape) == array.ndim and all(wanted in (None, size) for wanted, size in zip(
                shape, array.shape)) for shape in shapes))
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
