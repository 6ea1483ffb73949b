"""
Links: the gain of a link as a function of the squared horizontal distance.

A channel model is one class here with the methods of FreeSpace, and one of the class Channel in
`kernel/channel.hpp`, which has the gain's derivatives as well. Two ask for more: the convex
restrictions of the paper's Section III, in the method `alternating`, and the proof of the worst
case, in `kernel/discs.hpp`, are valid for free space only, where 1 / gain is the squared distance
and a constant, times a factor that all UAVs share.
"""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ..kernel import core
from ...mission.scenario import Array, Scenario


@dataclass(frozen=True, eq=False)
class FreeSpace:
    """
    Line of sight with free-space path loss: the gain is beta_0 / (sigma^2 (d^2 + H^2)).

    :param reference_snr: beta_0 / sigma^2 at unit distance and unit power; any shape that
        broadcasts with the squared distances.
    :param squared_altitudes: H^2, likewise.
    """

    reference_snr: Array | float
    squared_altitudes: Array

    @classmethod
    def of(cls, scenario: Scenario, axes: int = 1) -> 'FreeSpace':
        """
        Return the link of a scenario's UAVs, in m and W.

        :param axes: how many axes the squared distances have behind that of the UAVs.
        """
        heights = scenario.altitudes.reshape(-1, *[1] * axes)
        return cls(scenario.reference_snr, heights**2)

    def for_receivers(self, advantages: Array | float) -> 'FreeSpace':
        """
        Return the link to other receivers than the ground node's.

        :param advantages: by what factor the SNR is larger there, as for reference_snr.
        """
        return replace(self, reference_snr=self.reference_snr * advantages)

    def gain(self, squared: Array) -> Array:
        """Return the gain over the noise power at squared horizontal distances."""
        return self.reference_snr / (squared + self.squared_altitudes)

    def slope(self, squared: Array) -> Array:
        """Return the derivative of the gain by the squared distance."""
        return -self.gain(squared) / (squared + self.squared_altitudes)

    def compiled(self, receivers: int, uavs: int) -> Any:
        """Return the kernel's form of the links from every UAV to every receiver."""
        return core.FreeSpace(*(
            np.ascontiguousarray(np.broadcast_to(values, (receivers, uavs)), float)
            for values in (self.reference_snr, self.squared_altitudes)))


def guaranteed_squared_distance(squared: Array, edge: Array) -> Array:
    """
    Return ([d + edge]^+)^2 of equation (9) for squared distances d^2.

    :param edge: -epsilon for the transmitter, whose best case over the disc counts, and epsilon
        for jammers, whose worst case does.
    """
    return np.maximum(np.sqrt(squared) + edge, 0.0)**2
