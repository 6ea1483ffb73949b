"""Tracks of receivers that move: knots in time, linear between them and held outside."""

from functools import partial
from typing import Any, NamedTuple

import numpy as np

from .fields import (
    check_degrees, check_items, check_numbers, COORDINATE, FieldChecks, Number, RADIUS, refuse)
from .validation import Array, is_sequence
from ..errors import quote, ScenarioError

MAX_KNOTS = 10_000
"""Largest number of knots of a track."""

MAX_SPEED = 1000.0
"""Largest speed of a receiver on its track in m/s."""

LEFT_OUT: Any = None
"""Default of a field that the receiver's track decides."""

_TOLERANCE = 1e-6  # Largest difference [m] of a given position or radius from the track's.

Track = tuple[tuple[float, ...], ...]


class ReceiverPlaces(NamedTuple):
    """
    Places of the receivers at K times.

    :ivar ground_nodes: (G, K, 2) in m.
    :ivar centres: centres of the eavesdroppers' discs, (E, K, 2) in m.
    :ivar radii: radii of the eavesdroppers' discs, (E, K) in m.
    """

    ground_nodes: Array
    centres: Array
    radii: Array


def checked_track(value: Any, radius: bool = True) -> Track:
    """
    Return a track as tuples of floats.

    :param radius: True for knots (t, x, y, radius), False for knots (t, x, y).
    :raises ScenarioError: naming the field, the knot, its value and what is allowed.
    """
    parts = {'t': Number(-1e9, 1e9, 's'), 'x': COORDINATE, 'y': COORDINATE}
    if radius:
        parts['radius'] = RADIUS
    if not is_sequence(value) or not 2 <= len(value) <= MAX_KNOTS:
        raise refuse(value, f'a list of 2 to {MAX_KNOTS} knots ({", ".join(parts)})')
    knots = check_items(value, partial(_checked_knot, parts))
    for number, (before, knot) in enumerate(zip(knots, knots[1:]), start=1):
        duration = knot[0] - before[0]
        if not duration > 0:
            raise ScenarioError(
                f'[{number}] has the time {quote(knot[0])} s; it must be after that of the knot '
                f'before, {quote(before[0])} s', (number,))
        distance = float(np.hypot(knot[1] - before[1], knot[2] - before[2]))
        if distance > MAX_SPEED * duration * (1 + 1e-9):
            raise ScenarioError(
                f'[{number}] is {distance:g} m and {duration:g} s after the knot before, '
                f'{distance / duration:g} m/s; it must be at most {MAX_SPEED:g} m/s', (number,))
    return knots


def _checked_knot(parts: dict[str, Number], knot: Any) -> tuple[float, ...]:
    """Return a knot of a track, such as (t, x, y), as floats checked by `parts`, or refuse it."""
    for part in knot if is_sequence(knot) else ():
        check_degrees(part)
    if not is_sequence(knot) or len(knot) != len(parts):
        raise refuse(knot, f'the numbers ({", ".join(parts)})')
    return check_numbers(knot, parts)


def interpolate(track: Track, times: Array) -> Array:
    """Return x, y (and radius) [m] at times (K,) [s], (K, 2 or 3), held outside of the knots."""
    knots = np.array(track)
    if len(knots) == 1:
        return np.broadcast_to(knots[0, 1:], (len(times), knots.shape[1] - 1))
    return np.stack([np.interp(times, knots[:, 0], column) for column in knots.T[1:]], axis=-1)


def join_tracks(before: Track, after: Track, time: float, step: float) -> Track | None:
    """
    Return the track that follows `before` until `time` and `after` from `time + step` on.

    The change begins before `time` if it would otherwise be faster than MAX_SPEED.

    :param before: a track, or a single knot for a receiver that stands.
    :param after: a track, or a single knot for a receiver that stands.
    :param time: end of the first track [s].
    :param step: time [s] in which the receiver changes from the first track to the second.
    :return: the track; None for a receiver that stands in the same place before and after.
    """
    if before == after:
        return after if len(after) > 1 else None
    joined, = interpolate(after, np.array([time + step]))
    left, = interpolate(before, np.array([time]))
    jump = float(np.hypot(*(joined - left)[:2]))
    begin = min(time, time + step - 1.001 * jump / MAX_SPEED)  # 0.1% slower than MAX_SPEED.
    left, = interpolate(before, np.array([begin]))
    return (*(knot for knot in before if knot[0] < begin), (begin, *left.tolist()),
            (time + step, *joined.tolist()), *(knot for knot in after if knot[0] > time + step))


def set_by_track(checks: FieldChecks, field: str, track: Track) -> None:
    """Set `field` of checks.item from a track at time 0; another given value is an error."""
    x, y, *radius = interpolate(track, np.zeros(1))[0].tolist()
    decided = radius[0] if field == 'error_radius' else (x, y)
    given = getattr(checks.item, field)
    if given is not None and not np.allclose(given, decided, rtol=0.0, atol=_TOLERANCE):
        checks.add(field, f'is {quote(given)}; it must be left out, or that of the track at point '
                   f'0, {quote(decided)}')
    object.__setattr__(checks.item, field, decided)


def shift_track(track: Track | None, seconds: float) -> Track | None:
    """Return a track with its times reduced by `seconds`, for a later point 0."""
    return None if track is None else tuple((time - seconds, *rest) for time, *rest in track)
