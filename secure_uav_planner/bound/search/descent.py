"""Steps of Newton's method that lower the dual function."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from .dual import Dual
from .newton import DualDerivatives, DualPoint
from ..proof.conjugate import Array

LONGEST = 1e4
"""Damping at which a Newton step is given up."""


class Descent:
    """Newton's method whose damping is carried on from step to step."""

    def __init__(self) -> None:
        self._damping = 1e-6

    def damped(self, dual: Dual, point: DualPoint, value: float,
               derivatives: DualDerivatives) -> tuple[DualPoint, float]:
        """
        Return where Newton's step leads once it pays, and its slope, 0 where none does.

        The dual function is flat in many directions and sharp in others, see Derivatives.step.
        """
        while self._damping < LONGEST:
            try:
                step = derivatives.step(self._damping)
            except np.linalg.LinAlgError:
                self._damping *= 100
                continue
            step = _within(step, point, dual.room(point.shares))
            slope = min(derivatives.slope(step), 0.0)
            for length, factor in ((1.0, 0.1), (0.3, 1.0), (0.1, 1.0)):
                trial = point.moved(step, length)
                if dual.value(trial) < value + 0.1 * length * slope:
                    self._damping = max(factor * self._damping, 1e-9)
                    return trial, slope
            self._damping *= 10
        self._damping = 1.0
        return point, 0.0


def _within(step: DualPoint, point: DualPoint, room: Array) -> DualPoint:
    """Return a step cut back so that every slot's v, every room and every price stay positive."""
    with np.errstate(divide='ignore', invalid='ignore'):
        total = -step.shares.sum(-1)
        most = np.minimum(
            np.where(step.shares < 0, -point.shares / step.shares, np.inf).min(-1),
            np.where(total < 0, -room / total, np.inf))
        prices = np.where(step.prices < 0, -point.prices / step.prices, np.inf)
    return replace(step, shares=step.shares * np.minimum(1.0, 0.9 * most)[..., None],
                   prices=step.prices * np.minimum(1.0, 0.9 * prices))


def golden(value: Callable[[Array], Array], low: Array, high: Array, steps: int = 20) -> Array:
    """Return the minimisers of convex functions, one of each stage, by golden section."""
    gold = (5**0.5 - 1) / 2
    x1, x2 = high - gold * (high - low), low + gold * (high - low)
    f1, f2 = value(x1), value(x2)
    for _ in range(steps):
        left = f1 < f2
        low, high = np.where(left, low, x1), np.where(left, x2, high)
        new = np.where(left, high - gold * (high - low), low + gold * (high - low))
        f = value(new)
        x1, x2, f1, f2 = (np.where(left, new, x2), np.where(left, x1, new),
                          np.where(left, f, f2), np.where(left, f1, f))
    return (low + high) / 2
