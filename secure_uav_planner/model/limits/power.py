"""The limits of power, equation (7): a peak in every slot, and an average over all."""

import numpy as np

from .base import Limit
from ...errors import PlanError
from ...mission.scenario import Array

TOLERANCE = 1e-9
"""How far in W a power of a plan may exceed its limit, or lie below zero."""


class PeakPower(Limit):
    """Powers are not negative and not above their peak."""

    def validate(self, positions: Array, powers: Array) -> None:
        """Check the power of every slot of a plan; see Limit."""
        for uav, power in zip(self.scenario.uavs, powers, strict=True):
            if power.min() < -TOLERANCE:
                raise PlanError(f'the power of {uav.name} is {power.min():.9g} W in slot '
                                f'{power.argmin() + 1}; it must not be negative')
            if power.max() > uav.peak_power + TOLERANCE:
                raise PlanError(f'the power of {uav.name} is {power.max():.9g} W in slot '
                                f'{power.argmax() + 1}; at most {uav.peak_power:g} W are allowed')

    def retract(self, positions: Array, powers: Array,
                margin: float = 0.0) -> tuple[Array, Array]:
        """Clip the powers."""
        return positions, np.clip(powers, 0, self.scenario.peak_powers[:, None])


class AveragePower(Limit):
    """The mean of a UAV's powers is at most its average power."""

    def validate(self, positions: Array, powers: Array) -> None:
        """Check the mean power of every UAV of a plan; see Limit."""
        for uav, power in zip(self.scenario.uavs, powers, strict=True):
            if power.mean() > uav.average_power + TOLERANCE:
                raise PlanError(f'the average power of {uav.name} is {power.mean():.9g} W; '
                                f'at most {uav.average_power:g} W are allowed')

    def retract(self, positions: Array, powers: Array,
                margin: float = 0.0) -> tuple[Array, Array]:
        """Scale the powers down."""
        mean = powers.mean(axis=1, keepdims=True)
        return positions, powers * np.minimum(
            1.0, self.scenario.average_powers[:, None] / np.maximum(mean, 1e-300))
