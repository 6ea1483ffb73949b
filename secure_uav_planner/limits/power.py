"""The limits of power, equation (power): a peak in every slot, and an average over all."""

from importlib import import_module
from typing import Any

import numpy as np

from .base import ALL_SLOTS, ConvexVariables, Iterate, Limit, Step, step_to_zero
from ..errors import PlanError
from ..grid import Grid
from ..scenario import Array, Scenario

TOLERANCE = 1e-9
"""How far in W a power of a plan may exceed its limit, or lie below zero."""


class PeakPower(Limit):
    """Powers are not negative, c = p, and not above their peak, c = 1 - p / peak."""

    reach = 0

    def __init__(self, scenario: Scenario, grid: Grid | None = None) -> None:
        super().__init__(scenario, grid)
        self._peaks = scenario.peak_powers / self.grid.power

    @property
    def peaks(self) -> Array:
        """Peak powers in the grid's units, (U,)."""
        return self._peaks

    def check(self, positions: Array, powers: Array) -> None:
        """Check the power of every slot of a plan; see Limit."""
        for uav, power in zip(self.scenario.uavs, powers, strict=True):
            if power.min() < -TOLERANCE:
                raise PlanError(f'the power of {uav.name} is {power.min():.9g} W in slot '
                                f'{power.argmin() + 1}; it must not be negative')
            if power.max() > uav.peak_power + TOLERANCE:
                raise PlanError(f'the power of {uav.name} is {power.max():.9g} W in slot '
                                f'{power.argmax() + 1}; at most {uav.peak_power:g} W are allowed')

    def repair(self, positions: Array, powers: Array,
               margin: float = 0.0) -> tuple[Array, Array]:
        """Return the powers clipped."""
        return positions, np.clip(powers, 0, self.scenario.peak_powers[:, None])

    def margin(self, iterate: Iterate) -> Array:
        """Return both c, (S, N, U, 2)."""
        margin = np.empty((*iterate.power.shape, 2))
        margin[..., 0] = iterate.power
        margin[..., 1] = 1.0 - iterate.power / self._peaks
        return margin

    def add_gradient(self, iterate: Iterate, force: Array, gradient: Array) -> None:
        """Subtract force * dc/dx."""
        gradient[..., 0] -= force[..., 0] - force[..., 1] / self._peaks

    def change(self, iterate: Iterate, step: Step) -> Array:
        """Return the derivatives of both c along a step, (S, N, U, 2)."""
        return np.stack([step.power, -step.power / self._peaks], axis=-1)

    def longest_step(self, iterate: Iterate, step: Step, margin: Array, change: Array,
                     share: float) -> Array:
        """Return the least over the slots, (S, U)."""
        least: Array = step_to_zero(margin, change, share).min(axis=(1, 3))
        return least

    def clip(self, x: Array, trial: Array, share: float, factor: float) -> None:
        """Stop every power by itself."""
        power = x[..., 0]
        np.clip(trial[..., 0], power * max(1 - share, 1 / factor),
                np.minimum(power * factor, power + share * (self._peaks - power)),
                out=trial[..., 0])

    def add_curvature(self, iterate: Iterate, dual: Array, margin: Array, matrix: Any) -> None:
        """Add to the diagonal; c is linear."""
        ratio = dual / margin
        matrix.add_powers(ratio[..., 0] + ratio[..., 1] / self._peaks**2)

    def convex_form(self, variables: ConvexVariables) -> list[Any]:
        """Return bounds of the powers."""
        if variables.powers is None:
            return []
        peaks = self.scenario.peak_powers / self.scenario.average_powers
        return [variables.powers >= 0,
                variables.powers <= peaks[:, None] @ np.ones((1, self.scenario.slots))]


class AveragePower(Limit):
    """The mean of a UAV's powers is at most its average power: c = 1 - mean p."""

    reach = ALL_SLOTS

    @property
    def weight(self) -> float:
        """One for every slot: there is a single inequality for all of them."""
        return float(self.grid.slots)

    def check(self, positions: Array, powers: Array) -> None:
        """Check the mean power of every UAV of a plan; see Limit."""
        for uav, power in zip(self.scenario.uavs, powers, strict=True):
            if power.mean() > uav.average_power + TOLERANCE:
                raise PlanError(f'the average power of {uav.name} is {power.mean():.9g} W; '
                                f'at most {uav.average_power:g} W are allowed')

    def repair(self, positions: Array, powers: Array,
               margin: float = 0.0) -> tuple[Array, Array]:
        """Return the powers scaled down."""
        mean = powers.mean(axis=1, keepdims=True)
        return positions, powers * np.minimum(
            1.0, self.scenario.average_powers[:, None] / np.maximum(mean, 1e-300))

    def margin(self, iterate: Iterate) -> Array:
        """Return c, (S, U)."""
        margin: Array = 1.0 - iterate.power.mean(axis=1)
        return margin

    def add_gradient(self, iterate: Iterate, force: Array, gradient: Array) -> None:
        """Subtract force * dc/dx."""
        gradient[..., 0] += force[:, None] / self.grid.slots

    def change(self, iterate: Iterate, step: Step) -> Array:
        """Return the derivative of c along a step, (S, U)."""
        change: Array = -step.power.mean(axis=1)
        return change

    def longest_step(self, iterate: Iterate, step: Step, margin: Array, change: Array,
                     share: float) -> Array:
        """Return how far the mean allows to go, (S, U)."""
        return step_to_zero(margin, change, share)

    def dense_rows(self) -> Array:
        """Return the gradients of the means, (U, N * U * 3)."""
        uavs = len(self.scenario.uavs)
        rows = np.zeros((uavs, self.grid.slots, uavs, 3))
        rows[np.arange(uavs), :, np.arange(uavs), 0] = -1.0 / self.grid.slots
        return rows.reshape(uavs, -1)

    def convex_form(self, variables: ConvexVariables) -> list[Any]:
        """Return a bound of every UAV's sum."""
        if variables.powers is None:
            return []
        # Only here, where a CVXPY problem is being built anyway.
        cp: Any = import_module('cvxpy')
        return [cp.sum(variables.powers, axis=1) <= self.scenario.slots]
