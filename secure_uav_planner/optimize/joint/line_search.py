"""How far a Newton step is taken."""

from typing import TYPE_CHECKING

import numpy as np

from ...limits.base import Step
from ...scenario import Array

if TYPE_CHECKING:
    from .barrier import Barrier, Evaluation

_ROUNDING = 1e-12  # Relative change of the barrier function that is only rounding.


def line_search(barrier: 'Barrier', here: 'Evaluation', step: Step, gradient: Array,
                reaches: list[Array]) -> Array:
    """
    Move a Barrier along a step, and return how far each start went, (S,).

    It is 0 where no trial was better. First every power is stopped at its own limit and every
    flight at its own, which goes much farther than stopping all at the first limit; then all go
    plainly along the step.

    :param here: the Evaluation where the step begins.
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
