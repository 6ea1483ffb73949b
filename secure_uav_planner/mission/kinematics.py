"""
Straight flights of a single UAV, and the shortest duration of a flight.

Points q[0..N+1] are the control points of a uniform quadratic B-spline whose slots last `step`
seconds. The velocities are the moves w[n] = (q[n+1] - q[n]) / step, n = 0..N; w[-1] and w[N+1] are
the velocities at the ends. The acceleration in a slot is (w[n] - w[n-1]) / step. Utilisation is
the largest speed or acceleration of a flight as a share of the limit.
"""

from collections.abc import Callable
from dataclasses import dataclass
import math

import numpy as np

from .fields import Number
from .validation import Array, round_up

UTILISATION_TOLERANCE = 1e-9
"""Excess of a utilisation over 1 that is accepted as rounding."""

DURATION = Number(1e-6, 1e8, 's')
"""The range of the duration of a mission."""

_MOST_STEPS = 100  # Largest number of steps of a search for a duration.
_MOST_ROUNDINGS = 20  # Number of rounded durations that are tried; the last is twice the first.


@dataclass(frozen=True)
class Vehicle:
    """
    The ends of a flight and the limits of its vehicle.

    :param displacement: goal minus start, (x, y) in m.
    :param max_speed: V in m/s.
    :param max_acceleration: largest acceleration [m/s^2], infinite for no limit.
    :param start_velocity: (x, y) in m/s, or None if any is allowed.
    :param goal_velocity: (x, y) in m/s, or None if any is allowed.
    """

    displacement: tuple[float, float]
    max_speed: float
    max_acceleration: float = math.inf
    start_velocity: tuple[float, float] | None = None
    goal_velocity: tuple[float, float] | None = None

    @property
    def is_straight_optimal(self) -> bool:
        """Whether a straight flight is best: no acceleration limit, or ends free or at rest."""
        return math.isinf(self.max_acceleration) or all(
            velocity in (None, (0.0, 0.0))
            for velocity in (self.start_velocity, self.goal_velocity))

    def straight_utilisation(self, slots: int, step: float) -> float:
        """Return the least utilisation of a straight flight of N slots of `step` seconds."""
        longest = float(self._top_speeds(slots, step).sum()) * step
        return math.hypot(*self.displacement) / longest

    def fly_straight(self, slots: int, step: float) -> Array:
        """Return the straight flight of least utilisation from (0, 0), (N+2, 2) in m."""
        top = self._top_speeds(slots, step)
        share = np.append(0.0, np.cumsum(top)) / top.sum()
        return np.asarray(share[:, None] * np.array(self.displacement))

    def _top_speeds(self, slots: int, step: float) -> Array:
        """
        Return the largest speed of each move of a straight flight, (N+1,) in m/s.

        For move n it is at most max_speed; (n + 1) * max_acceleration * step after a given start
        velocity; and (N + 1 - n) * max_acceleration * step before a given goal velocity. A given
        velocity is taken as 0.
        """
        top = np.full(slots + 1, self.max_speed)
        if not math.isinf(self.max_acceleration):
            gained = self.max_acceleration * step * np.arange(1.0, slots + 2)
            if self.start_velocity is not None:
                top = np.minimum(top, gained)
            if self.goal_velocity is not None:
                top = np.minimum(top, gained[::-1])
        return top


def find_shortest_duration(utilisation: Callable[[float], float], duration: float,
                           accuracy: float = 1e-9, longest: float = DURATION.high
                           ) -> float | None:
    """
    Return the shortest duration in s with a utilisation of at most 1, or None if none is found.

    The answer is `duration` if that suffices. Otherwise it is rounded up to six digits, and its
    utilisation was evaluated after rounding. The search is regula falsi on logarithms (Dowell and
    Jarratt, "A modified regula falsi method for computing the root of an equation", 1971).

    :param utilisation: function from a duration in s to the least utilisation of a flight.
    :param duration: smallest allowed duration in s.
    :param accuracy: relative distance between the answer, before rounding, and a duration that is
        too short.
    :param longest: largest duration in s that is tried.
    """
    # The bracket: log utilisation is `at_low` > 0 at `low` and `at_high` <= 0 at `high`.
    low, at_low = duration, _log(utilisation(duration))
    if at_low <= 0:
        return duration
    high = min(2 * duration, longest)
    while (at_high := _log(utilisation(high))) > 0:
        if high >= longest:
            return None
        low, at_low, high = high, at_high, min(2 * high, longest)
    last_sign = 0.0  # Sign of the value at the last duration tried.
    for _ in range(_MOST_STEPS):
        middle = low * (high / low)**(at_low / (at_low - at_high))
        if high <= low * (1 + accuracy) or not low < middle < high:
            break
        value = _log(utilisation(middle))
        # An end that stays twice has its logarithm halved, so that it moves soon.
        if value > 0:
            low, at_low, at_high = middle, value, at_high / (2 if last_sign > 0 else 1)
        else:
            high, at_high, at_low = middle, value, at_low / (2 if last_sign < 0 else 1)
        last_sign = 1.0 if value > 0 else -1.0
    return _round_duration(utilisation, high, longest)


def _round_duration(utilisation: Callable[[float], float], duration: float, longest: float
                    ) -> float | None:
    """Return a six-digit duration [s], `duration` or up, of utilisation at most 1, or None."""
    rounded = round_up(duration)
    for power in range(_MOST_ROUNDINGS):
        if rounded > longest:
            break
        if utilisation(rounded) <= 1:
            return rounded
        rounded = round_up(rounded * (1 + 1e-6 * 2**power))
    return None


def _log(utilisation: float) -> float:
    """Return the logarithm of a utilisation clipped to 1e-6..1e6; NaN is taken as 1e6."""
    return math.log(1e6 if math.isnan(utilisation) else min(max(utilisation, 1e-6), 1e6))


def clip_norm(x: float, y: float, most: float) -> tuple[float, float]:
    """Return the vector (x, y), scaled to the length `most` if it is longer."""
    factor = min(1.0, most / max(math.hypot(x, y), 1e-300))
    return x * factor, y * factor
