"""
Links: the gain of a link as a function of the squared horizontal distance.

A channel model is one class here with the three methods of FreeSpace; rates, worst cases and
derivatives are built on it. Two ask for more: the convex restrictions of the paper's Section III,
in the method `alternating`, and the proof of the worst case, in inverse_sinr.py, are valid for
free space only, where 1 / gain is the squared distance and a constant, times a factor that all
UAVs share.
"""

from dataclasses import dataclass, replace

import numpy as np

from ..scenario import Array, Scenario

_TINY = 1e-30  # Added to a squared distance, whose root then has a gradient everywhere.


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

    def derivatives(self, squared: Array) -> tuple[Array, Array, Array]:
        """Return the gain and its first and second derivative by the squared distance."""
        denominator = squared + self.squared_altitudes
        gain = self.reference_snr / denominator
        first = -gain / denominator
        return gain, first, -2.0 * first / denominator


def guaranteed_squared_distance(squared: Array, edge: Array) -> Array:
    """
    Return ([d + edge]^+)^2 of equation (r_e_approx) for squared distances d^2.

    :param edge: -epsilon for the transmitter, whose best case over the disc counts, and epsilon
        for jammers, whose worst case does.
    """
    return np.maximum(np.sqrt(squared) + edge, 0.0)**2


class SmoothDiscDistance:
    """
    guaranteed_squared_distance with its derivatives, its kink at d = 0 rounded.

    Of jammers, d becomes sqrt(d^2 + softening^2), which only raises the distance and so only
    lowers the guaranteed rate.

    :param squared: d^2, any shape that broadcasts with edge.
    :param edge: as for guaranteed_squared_distance.
    :param softening: of the jammers' distances, likewise.
    :ivar squared: (d + edge)^2, or 0 inside the disc of a negative edge.
    """

    def __init__(self, squared: Array, edge: Array, softening: Array) -> None:
        self._edge = edge
        self._distance = np.sqrt(squared + (softening**2 * (edge > 0) + _TINY))
        self._outside = self._distance > -edge
        # (d + edge)^2 = d^2 + edge (2 d + edge), without the softening in its first term.
        self.squared = np.where(
            self._outside, squared + edge * (2 * self._distance + edge), 0.0)

    def derivatives(self) -> tuple[Array, Array]:
        """Return a, b of the gradient 2 a offset and the Hessian 2 a I - 2 b offset offset^T."""
        return (np.where(self._outside, 1.0 + self._edge / self._distance, 0.0),
                np.where(self._outside, self._edge / self._distance**3, 0.0))
