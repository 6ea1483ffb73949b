"""How a call of solve or upper_bound ends: converged, past its time limit, or cancelled."""

from collections.abc import Callable
from dataclasses import replace
import math
import time
from typing import cast, TypeAlias

import numpy as np

from ..errors import NumericalError, StoppedError, TimeLimitError
from ..plan.results import Iteration, Status

DeadlineCheck: TypeAlias = Callable[[], None]
"""Deadline.raise_if_over or a like function, which a search calls often; its errors end it."""

OnIteration: TypeAlias = Callable[[Iteration], object]
"""A callback of solve or upper_bound; returning True cancels the call."""


class Deadline:
    """
    The time limit and the callback of a call, from its beginning.

    :param callback: called with every Iteration that is reported.
    :param time_limit: limit of the time [s] from now, or None.
    :param period: time [s] without a report after which raise_if_over reports the last Iteration
        again.
    :param goal: words for error texts: what the call had not yet found when it had to end.
    :ivar is_cancelled: whether the callback has cancelled.
    """

    def __init__(self, callback: OnIteration | None = None,
                 time_limit: float | None = None, period: float = math.inf,
                 goal: str = 'flights that keep the limits') -> None:
        self._callback = callback
        self._time_limit = math.inf if time_limit is None else time_limit
        self._period = period
        self._goal = goal
        self._started = time.monotonic()
        self._last = Iteration(0, 'start', 0.0, 0.0, 0.0)
        self._last_call = -math.inf  # Time [s] of the last report, since the call began.
        self.is_cancelled = False

    @property
    def elapsed(self) -> float:
        """Time [s] since the call began."""
        return time.monotonic() - self._started

    @property
    def time_left(self) -> float:
        """Time [s] until the time limit; infinite without one."""
        return self._time_limit - self.elapsed

    @property
    def may_end(self) -> bool:
        """Whether the call may have to end early: it has a time limit or a callback."""
        return self._callback is not None or math.isfinite(self._time_limit)

    def report(self, iteration: Iteration) -> None:
        """Call the callback with an Iteration; it may cancel the call."""
        self._last, self._last_call = iteration, self.elapsed
        if self._callback is not None and self._callback(iteration):
            self.is_cancelled = True

    def raise_if_over(self, reserve: float = 0.0) -> None:
        """
        Raise an error if the call must end.

        After `period` without a report it first reports the last Iteration again, so that the
        callback can cancel.

        :param reserve: time [s] that must be left after this part of the call.
        :raises StoppedError: when the callback has cancelled.
        :raises TimeLimitError: when no more time than the reserve is left.
        """
        if not self.is_cancelled and self.elapsed - self._last_call > self._period:
            self.report(replace(self._last, elapsed=self.elapsed))
        if self.is_cancelled:
            raise StoppedError(f'cancelled before {self._goal} were found')
        if self.time_left <= reserve:
            raise TimeLimitError(
                f'time_limit is {self._time_limit:g} s; it was over before {self._goal} were '
                'found; with more time, or fewer slots, there may be some')

    def poll(self) -> bool:
        """Return True if the call must end. Like raise_if_over, this may call the callback."""
        try:
            self.raise_if_over()
        except (StoppedError, TimeLimitError):
            return True
        return False


def run_to_end(method: Callable[..., Status], *arguments: object) -> Status:
    """Return a method's status, or the status of a stop, time limit or numerical error in it."""
    try:
        return method(*arguments)
    except (StoppedError, TimeLimitError, NumericalError) as error:
        return cast(Status, error.code)
    except np.linalg.LinAlgError:
        return 'numerical_trouble'
