"""The interface of limits, and the limits of power, equation (7)."""

from abc import ABC, abstractmethod

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..airspace import Airspace
from ..grid import Grid
from ..kernel import core
from ...errors import PlanError
from ...mission.validation import Array, round_down

POWER_TOLERANCE = 1e-9
"""How far in W a power of a plan may exceed its limit, or lie below zero."""


class Limit(ABC):
    """
    One limit of a scenario.

    A new limit is one subclass, named in `limits.LIMITS`. `Plan` calls validate, `Incumbent` calls
    retract, and `joint` uses the kernel's form.

    :param grid: grid of the flights.
    :ivar scenario: scenario of the grid.
    """

    def __init__(self, grid: Grid) -> None:
        self.grid = grid
        self.scenario = grid.scenario

    @classmethod
    def applies_to(cls, airspace: Airspace) -> bool:
        """Return True if the scenario of an airspace has this limit."""
        return True

    @property
    def compiled(self) -> core.Limit | None:
        """
        Return the kernel's form, with slacks c(x) > 0 strictly inside the limit; here None.

        Limits of powers keep this None, as the kernel has them as bounds of its variables.
        """
        return None

    @abstractmethod
    def validate(self, positions: Array, powers: Array) -> None:
        """
        Check a plan in plain NumPy.

        :param positions: (U, N+2, 2) in m.
        :param powers: (U, N) in W.
        :raises PlanError: naming UAV, place in the plan, value and limit.
        """

    def shape_start(self, positions: Array) -> Array:
        """
        Return a first flight changed so that it keeps this limit; unchanged by default.

        Override it if fly-hover-fly can violate the limit: solvers refine this flight, they cannot
        repair it. The result must keep the limit on a grid of 25 slots, too, and when it is
        blended by 5% with the flight of least utilisation.

        :param positions: (U, N+2, 2) in m.
        """
        return positions

    def retract(self, positions: Array) -> Array:
        """Return nearly feasible positions (U, N+2, 2) in m made feasible."""
        return positions

    def retract_powers(self, powers: Array) -> Array:
        """Return nearly feasible powers (U, N) in W made feasible."""
        return powers


def compile_vectors(grid: Grid, points: NDArray[np.intp], weights: ArrayLike,
                    constants: Array, differences: bool = False) -> core.Vectors:
    """
    Return the kernel's form of vectors, each constant + sum over T points of weight * point.

    :param points: index U n + u of point n of UAV u, (..., T).
    :param weights: weights of the points; they broadcast to (..., T).
    :param constants: constant part of each vector, (..., 2) in units.
    :param differences: whether the weights of each vector add up to 0.
    """
    varies = np.zeros((grid.slots + 2, len(grid.fixed)), bool)
    varies[1:-1] = ~grid.fixed
    shape = (*constants.shape[:-1], points.shape[-1])
    return core.Vectors(
        varies, np.ascontiguousarray(np.broadcast_to(points, shape), np.int64),
        np.ascontiguousarray(np.broadcast_to(weights, shape), float),
        np.ascontiguousarray(constants), differences)


class PeakPower(Limit):
    """Powers are not negative and not above their peak."""

    def validate(self, positions: Array, powers: Array) -> None:
        for uav, power in zip(self.scenario.uavs, powers, strict=True):
            if power.min() < -POWER_TOLERANCE:
                raise PlanError(f'the power of {uav.name} is {power.min():.9g} W in slot '
                                f'{power.argmin() + 1}; it must not be negative')
            if power.max() > uav.peak_power + POWER_TOLERANCE:
                raise PlanError(f'the power of {uav.name} is {power.max():.9g} W in slot '
                                f'{power.argmax() + 1}; at most '
                                f'{round_down(uav.peak_power, 9):.9g} W are allowed')

    def retract_powers(self, powers: Array) -> Array:
        return np.clip(powers, 0, self.scenario.peak_powers[:, None])


class AveragePower(Limit):
    """The mean of a UAV's powers is at most its average power."""

    def validate(self, positions: Array, powers: Array) -> None:
        for uav, power in zip(self.scenario.uavs, powers, strict=True):
            if power.mean() > uav.average_power + POWER_TOLERANCE:
                raise PlanError(f'the average power of {uav.name} is {power.mean():.9g} W; '
                                f'at most {round_down(uav.average_power, 9):.9g} W are allowed')

    def retract_powers(self, powers: Array) -> Array:
        mean = powers.mean(axis=1, keepdims=True)
        return powers * np.minimum(
            1.0, self.scenario.average_powers[:, None] / np.maximum(mean, 1e-300))
