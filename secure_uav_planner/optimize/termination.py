"""When a call of solve must end: at its deadline, or as soon as its callback says so."""

from collections.abc import Callable
from dataclasses import replace
import time
from typing import TypeAlias

import numpy as np

from ..errors import StoppedError, TimeLimitError
from ..plan.plan import Iteration, Status

OnIteration: TypeAlias = Callable[[Iteration], object]

_PERIOD = 0.05  # After which the callback is asked again, in s.


class Termination:
    """
    The deadline and the callback of one call of solve, from its beginning.

    :param on_iteration: called with Iterations; returning True cancels.
    :param time_limit: in s from now, or None.
    :param asks_again: whether the callback is asked again between iterations, some times a second:
        where flights have to be searched, iterations can be far apart.
    """

    def __init__(self, on_iteration: OnIteration | None = None,
                 time_limit: float | None = None, asks_again: bool = False) -> None:
        self._on_iteration = on_iteration
        self._time_limit = time_limit
        self._period = _PERIOD if asks_again else np.inf
        self._started = time.monotonic()
        self._last = Iteration(0, 'start', 0.0, 0.0, 0.0)
        self._told = -np.inf  # When the callback was asked last.
        self._cancelled = False

    @property
    def elapsed(self) -> float:
        """Time since the beginning, in s."""
        return time.monotonic() - self._started

    @property
    def time_left(self) -> float:
        """Time until the deadline in s, infinite without one."""
        return np.inf if self._time_limit is None else self._time_limit - self.elapsed

    def tell(self, iteration: Iteration) -> None:
        """Call the callback, and note its wish."""
        self._last, self._told = iteration, self.elapsed
        if self._on_iteration is not None and self._on_iteration(iteration):
            self._cancelled = True

    def reason(self) -> Status | None:
        """Return the status in which the call must end now, or None."""
        if not self._cancelled and self.elapsed - self._told > self._period:
            self.tell(replace(self._last, elapsed=self.elapsed))
        if self._cancelled:
            return 'cancelled'
        return 'time_limit' if self.time_left <= 0 else None

    def check(self) -> None:
        """
        Return if the search for first flights may go on.

        :raises StoppedError: when the callback says so.
        :raises TimeLimitError: at the deadline.
        """
        reason = self.reason()
        if reason == 'cancelled':
            raise StoppedError('cancelled before flights that keep the limits were found')
        if reason is not None:
            raise TimeLimitError(
                f'time_limit is {self._time_limit:g} s; it was over before flights that keep the '
                'limits were found; with more time, or fewer slots, there may be some')
