"""How far a Newton step is taken."""

from collections.abc import Sequence
from typing import Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from .schedule import Schedule
from ...limits.base import Limit, Step
from ...scenario import Array

_ROUNDING = 1e-12  # Relative change of the barrier function that is only rounding.


class Evaluated(Protocol):
    """What is known of a function at one x of several starts."""

    @property
    def value(self) -> Array:
        """Return the values, (S,), infinite outside the limits."""


_Evaluation = TypeVar('_Evaluation', bound=Evaluated)


class Searched(Protocol[_Evaluation]):
    """What a line search moves along a step: several starts, x (S, N, U, 3), at once."""

    x: Array
    schedule: Schedule

    @property
    def limits(self) -> Sequence[Limit]:
        """Return what stops a step."""

    def try_from(self, x: Array, starts: NDArray[np.intp]) -> _Evaluation:
        """Return the function of some of the starts at another x."""

    def move(self, x: Array, known: _Evaluation | None) -> None:
        """Go to another x, with what is known there if that is so for all starts."""


def line_search(barrier: Searched[_Evaluation], here: _Evaluation, step: Step, gradient: Array,
                reaches: list[Array]) -> Array:
    """
    Move a Barrier along a step, and return how far each start went, (S,).

    It is 0 where no trial was better. First every power is stopped at its own limit and every
    flight at its own, which goes much farther than stopping all at the first limit; then all go
    plainly along the step.

    :param here: what is known where the step begins.
    :param gradient: of the barrier function, (S, N, U, 3).
    :param reaches: how far each limit lets each UAV go along the step, (S, U).
    """
    x, schedule = barrier.x, barrier.schedule
    slope = (step.x * gradient).sum(axis=(1, 2, 3))
    uniform = np.min(reaches, axis=(0, 2))
    flights = np.min([reach for limit, reach in zip(barrier.limits, reaches, strict=True)
                      if limit.of_flights], axis=0)
    length = np.zeros(len(x))
    remaining = np.arange(len(x))
    moved, known = x.copy(), None
    for trial in range(schedule.clipped_trials + schedule.uniform_trials):
        begin = x[remaining]
        if trial < schedule.clipped_trials:
            by = np.full(len(remaining), 0.5**trial)
            change = by[:, None, None, None] * step.x[remaining]
            change[..., 1:] *= flights[remaining][:, None, :, None]
            there = begin + change
            for limit in barrier.limits:
                limit.clip(begin, there, schedule.boundary, schedule.power_factor)
            expected = (gradient[remaining] * (there - begin)).sum(axis=(1, 2, 3))
        else:
            by = uniform[remaining] * 0.5**(trial - schedule.clipped_trials)
            there = begin + by[:, None, None, None] * step.x[remaining]
            expected = by * slope[remaining]
        evaluation = barrier.try_from(there, remaining)
        value = here.value[remaining]
        good = (evaluation.value <= value + schedule.sufficient_decrease * expected
                + _ROUNDING * np.abs(value)) & (expected < 0)
        moved[remaining[good]] = there[good]
        length[remaining[good]] = by[good]
        if len(remaining) == len(x) and good.all():
            known = evaluation
        remaining = remaining[~good]
        if not len(remaining):
            break
    barrier.move(moved, known)
    return length
