"""
Links: the gain of a link as a function of the squared horizontal distance.

A channel model is one class here with the methods of FreeSpace, and one of the class Channel in
`kernel/channel.hpp`, which has the gain's derivatives as well. Each kind of link, from the
transmitter or a jammer to the ground node or an eavesdropper, has a gain of its own; `link_of`
says which.
"""

from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from ..kernel import core
from ...mission.propagation import Channel
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

    def for_receivers(self, advantages: Array | float) -> 'FreeSpace':
        """Return the link to receivers whose SNR is larger by factors, as reference_snr."""
        return replace(self, reference_snr=self.reference_snr * advantages)

    def gain(self, squared: Array) -> Array:
        """Return the gain over the noise power at squared horizontal distances."""
        return self.reference_snr / (squared + self.squared_altitudes)

    def slope(self, squared: Array) -> Array:
        """Return the derivative of the gain by the squared distance."""
        return -self.gain(squared) / (squared + self.squared_altitudes)

    def drawn_gain(self, squared: Array, numbers: Array) -> Array:
        """Return the gain, with a line of sight where a number in [0, 1) is below its chance."""
        return self.gain(squared)

    def taken(self, receivers: NDArray[np.intp]) -> 'FreeSpace':
        """Return the link of arrays (K, U) to some of its receivers."""
        return replace(self, reference_snr=np.asarray(self.reference_snr)[receivers])

    def compiled(self, receivers: int, uavs: int) -> core.Channel:
        """Return the kernel's form of the links from every UAV to every receiver."""
        return core.FreeSpace(*self._arrays(receivers, uavs))

    def _arrays(self, *shape: int) -> tuple[Array, Array]:
        snr, squared_altitudes = (
            np.ascontiguousarray(np.broadcast_to(values, shape), float)
            for values in (self.reference_snr, self.squared_altitudes))
        return snr, squared_altitudes


@dataclass(frozen=True, eq=False)
class PathLoss(FreeSpace):
    """
    Path loss with an exponent and a probability of line of sight.

    The gain is beta_0 / sigma^2 (d^2 + H^2)^(-exponent / 2) (kappa + (1 - kappa) P), where P =
    1 / (1 + a exp(-b (theta - a))) at the elevation theta in degrees (Al-Hourani, Kandeepan and
    Lardner 2014; the mean of both cases as in Zeng, Wu and Zhang 2019).

    :param losses: kappa, what is left of the gain without a line of sight; 1 for a link that has
        one. As reference_snr.
    :param exponent: alpha.
    :param los: a, and b per degree.
    """

    losses: Array | float = 1.0
    exponent: float = 2.0
    los: tuple[float, float] = (1.0, 1.0)

    def gain(self, squared: Array) -> Array:
        return self._in_sight(squared) * self._mean(self._probability(squared))

    def drawn_gain(self, squared: Array, numbers: Array) -> Array:
        return self._in_sight(squared) * np.where(
            numbers < self._probability(squared), 1.0, self.losses)

    def slope(self, squared: Array) -> Array:
        """Return the derivative of the gain by the squared distance; without end at 0."""
        heights, (_, b) = self.squared_altitudes, self.los
        likely = self._probability(squared)
        with np.errstate(divide='ignore'):
            turn = -0.5 * np.degrees(np.sqrt(heights / squared)) / (squared + heights) * b
        steeper = np.where(np.less(self.losses, 1.0), turn * likely * (1 - likely), 0.0)
        return self._in_sight(squared) * (
            -0.5 * self.exponent / (squared + heights) * self._mean(likely)
            + (1 - self.losses) * steeper)

    def taken(self, receivers: NDArray[np.intp]) -> 'PathLoss':
        snr = np.asarray(self.reference_snr)
        losses = np.broadcast_to(self.losses, snr.shape)
        return replace(self, reference_snr=snr[receivers], losses=losses[receivers])

    def compiled(self, receivers: int, uavs: int) -> core.Channel:
        losses = np.ascontiguousarray(np.broadcast_to(self.losses, (receivers, uavs)), float)
        return core.PathLoss(*self._arrays(receivers, uavs), losses, self.exponent, *self.los)

    def _in_sight(self, squared: Array) -> Array:
        return self.reference_snr * (
            squared + self.squared_altitudes)**(-0.5 * self.exponent)

    def _mean(self, likely: Array) -> Array:
        return self.losses + (1 - self.losses) * likely

    def _probability(self, squared: Array) -> Array:
        a, b = self.los
        elevation = np.degrees(np.arctan2(np.sqrt(self.squared_altitudes), np.sqrt(squared)))
        return 1 / (1 + a * np.exp(-b * (elevation - a)))


def link_of(scenario: Scenario, receiver: Literal['ground_node', 'eavesdropper'],
            axes: int = 1) -> FreeSpace:
    """
    Return the link of a scenario's UAVs to the ground node, or to an eavesdropper, in m and W.

    Its gains are those that the guarantee counts with: means or, where the channel is cautious, of
    a line of sight on the bad side; with fading, quantiles.

    :param axes: how many axes the squared distances have behind that of the UAVs.
    """
    shape = -1, *[1] * axes
    return _link(scenario, int(receiver == 'eavesdropper'), shape, scenario.reference_snr,
                 scenario.altitudes.reshape(shape))


def links_of(scenario: Scenario, length: float, power: Array) -> FreeSpace:
    """
    Return the links to the ground node and to every eavesdropper, for arrays (..., K, U).

    :param length: the unit of length in m, as power (U,) has those of powers in W.
    """
    eves = len(scenario.eavesdroppers)
    link = _link(scenario, [0] + [1] * eves, (1 + eves, -1),
                 scenario.reference_snr * power / length**scenario.channel.exponent,
                 scenario.altitudes / length)
    return link.for_receivers(np.append(1.0, scenario.receiver_advantages)[:, None])


def _link(scenario: Scenario, kinds: int | list[int], shape: tuple[int, ...],
          snr: Array | float, altitudes: Array) -> FreeSpace:
    """Return a link to kinds of receivers, ground node (0) or eavesdroppers (1), in a shape."""
    channel, uavs = scenario.channel, len(scenario.uavs)
    transmits = np.arange(uavs) == 0
    # To the ground node a jammer interferes, to an eavesdropper the transmitter leaks.
    harms = np.stack([~transmits, transmits])[kinds].reshape(shape)
    if channel.outage is not None:
        low, high = fading_quantiles(channel, uavs * (1 + len(scenario.eavesdroppers)))
        snr = snr * np.where(harms, high, low)
    if channel.is_inverse_square:
        return FreeSpace(snr, altitudes**2)
    a, b, loss = channel.los_numbers or (1.0, 1.0, 0.0)
    losses = np.where(harms & channel.cautious, 1.0, 10.0**(-loss / 10.0))
    return PathLoss(snr, altitudes**2, losses, channel.exponent, (a, b))


@lru_cache(maxsize=256)
def fading_quantiles(channel: Channel, links: int) -> tuple[float, float]:
    """
    Return between what the power gain of Rician fading is, each side but for outage / links.

    With the factor K, 2 (K + 1) |h|^2 is noncentral chi-square with 2 degrees of freedom and the
    noncentrality 2 K. All links are on the right side at once but for the outage (union bound).
    """
    from scipy.stats import ncx2  # Here, because it takes half a second to import.
    assert channel.rician_k_db is not None and channel.outage is not None
    factor = 10.0**(channel.rician_k_db / 10.0)
    share = channel.outage / links
    low, high = (quantile(share, 2, 2 * factor) / (2 * (factor + 1))
                 for quantile in (ncx2.ppf, ncx2.isf))
    return float(low), float(high)


def guaranteed_squared_distance(squared: Array, edge: Array) -> Array:
    """
    Return ([d + edge]^+)^2 of equation (9) for squared distances d^2.

    The edge is -epsilon for the transmitter, whose best case counts, and epsilon for jammers.
    """
    return np.maximum(np.sqrt(squared) + edge, 0.0)**2
