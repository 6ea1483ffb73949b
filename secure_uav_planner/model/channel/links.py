"""
Links: the gain from a UAV to a receiver, as a function of the squared horizontal distance.

A channel model is one class here with the methods of FreeSpace, and one of the class LinkGains in
`kernel/link_gains.hpp`. Each kind of link, from the transmitter or a jammer to the ground node or
an eavesdropper, has a gain of its own; `make_link` says which.
"""

from dataclasses import dataclass, replace
import math
from typing import Any, ClassVar, Literal

import numpy as np
from numpy.typing import NDArray

from ..kernel import core
from ...mission.scenario import Array, Scenario

RISE = 1.0  # Degrees of elevation over which a smoothed quantile rises to line of sight.


@dataclass(frozen=True, eq=False)
class FreeSpace:
    """
    Line of sight with free-space path loss: the gain is beta_0 / (sigma^2 (d^2 + H^2)).

    All fields broadcast with the squared distances.

    :param reference_snr: beta_0 / sigma^2 at unit distance and unit power.
    :param squared_altitudes: H^2.
    """

    reference_snr: Array | float
    squared_altitudes: Array

    def for_receivers(self, advantages: Array | float) -> 'FreeSpace':
        """Return the link with each receiver's reference_snr multiplied by its advantage."""
        return replace(self, reference_snr=self.reference_snr * advantages)

    def gain(self, squared: Array) -> Array:
        """Return the gain over the noise power, g / sigma^2, at squared horizontal distances."""
        return self.reference_snr / (squared + self.squared_altitudes)

    def draw_gain(self, squared: Array, numbers: Array) -> Array:
        """Return a random gain; with a sure line of sight, the gain for any random numbers."""
        return self.gain(squared)

    def select_receivers(self, receivers: NDArray[np.intp]) -> 'FreeSpace':
        """Return the link to the receivers of K' indices, for arrays (..., K', U)."""
        return replace(self, reference_snr=np.asarray(self.reference_snr)[receivers])

    def compiled(self, receivers: int, uavs: int) -> core.LinkGains:
        """Return the kernel's form of the links from every UAV to every receiver."""
        return core.FreeSpace(*_spread((self.reference_snr, self.squared_altitudes),
                                       receivers, uavs))


@dataclass(frozen=True, eq=False)
class PathLoss(FreeSpace):
    """
    Path loss with an exponent and a probability of line of sight.

    The gain is beta_0 / sigma^2 (d^2 + H^2)^(-exponent / 2) (kappa + (1 - kappa) P), where P =
    1 / (1 + exp(-z)) and z = steepness theta - shift at the elevation theta in degrees
    (Al-Hourani, Kandeepan and Lardner 2014; the mean of both cases as in Zeng, Wu and Zhang 2019).

    :cvar takes_quantile: False for the mean over both cases, with and without a line of sight.
    :param losses: kappa, factor of the gain without a line of sight; 1 for a link that always has
        a line of sight. It broadcasts with the squared distances.
    :param exponent: alpha.
    :param steepness: slope of z per degree; it broadcasts with the squared distances.
    :param shift: offset of z; it broadcasts with the squared distances.
    """

    takes_quantile: ClassVar[bool] = False

    losses: Array | float = 1.0
    exponent: float = 2.0
    steepness: Array | float = 1.0
    shift: Array | float = 0.0

    def gain(self, squared: Array) -> Array:
        return self._sight_gain(squared) * self._factor(self._z(squared))

    def draw_gain(self, squared: Array, numbers: Array) -> Array:
        has_sight = numbers < _probability(self._z(squared))
        return self._sight_gain(squared) * np.where(has_sight, 1.0, self.losses)

    def select_receivers(self, receivers: NDArray[np.intp]) -> 'PathLoss':
        fields: dict[str, Any] = {
            name: np.broadcast_to(getattr(self, name), np.shape(self.reference_snr))[receivers]
            for name in ('reference_snr', 'losses', 'steepness', 'shift')}
        return replace(self, **fields)

    def compiled(self, receivers: int, uavs: int) -> core.LinkGains:
        snr, squared_altitudes, losses, steepness, shift = _spread(
            (self.reference_snr, self.squared_altitudes, self.losses, self.steepness, self.shift),
            receivers, uavs)
        return core.PathLoss(snr, squared_altitudes, losses, steepness, shift, self.exponent,
                             self.takes_quantile)

    def _sight_gain(self, squared: Array) -> Array:
        """Return the gain with a line of sight, at squared horizontal distances."""
        return self.reference_snr * (squared + self.squared_altitudes)**(-0.5 * self.exponent)

    def _factor(self, z: Array) -> Array:
        """Return the gain as a share of the gain with a line of sight."""
        return self.losses + (1 - self.losses) * _probability(z)

    def _z(self, squared: Array) -> Array:
        elevation = np.degrees(np.arctan2(np.sqrt(self.squared_altitudes), np.sqrt(squared)))
        return self.steepness * elevation - self.shift


@dataclass(frozen=True, eq=False)
class PathLossQuantile(PathLoss):
    """
    Path loss at a quantile of the line of sight.

    A helpful link has a line of sight only where the probability of none is below the outage; a
    harmful one has a line of sight unless the probability of one is below the outage.

    The factor of the gain is kappa^(1 - S), where S = z^3 (6 z^2 - 15 z + 10) rises from 0 at z =
    0 to 1 at z = 1: twice differentiable, unlike the step of the quantile itself.
    """

    takes_quantile: ClassVar[bool] = True

    def _factor(self, z: Array) -> Array:
        z = np.clip(z, 0.0, 1.0)  # The exponent below falls smoothly from 1 to 0.
        return np.asarray(self.losses**((1 - z)**3 * (1 + 3 * z + 6 * z**2)))


def make_link(scenario: Scenario, receiver: Literal['ground_node', 'eavesdropper'],
              axes: int = 1, altitudes: Array | None = None) -> FreeSpace:
    """
    Return the link of a scenario's UAVs to the ground node, or to an eavesdropper, in m and W.

    The guarantee uses these gains. Harmful links are from the transmitter to an eavesdropper, and
    from jammers to a ground node; all other links are helpful. With a stated outage, gains are
    high quantiles for harmful links and low quantiles for helpful links. Without an outage gains
    are means. Harmful links of a cautious channel then always have a line of sight.

    :param axes: number of axes of the squared distances behind the axis of the UAVs.
    :param altitudes: altitudes of the UAVs in m, shaped like the squared distances; by default
        the scenario's.
    """
    shape = -1, *[1] * axes
    return _link(scenario, int(receiver == 'eavesdropper'), shape, scenario.reference_snr,
                 scenario.altitudes.reshape(shape) if altitudes is None else altitudes)


def make_links(scenario: Scenario, length: float, power: Array,
               elevation_offset: float = 0.0) -> FreeSpace:
    """
    Return the links to K ground nodes, eavesdroppers, listeners, for arrays (..., K, U) in units.

    :param length: unit of length in m.
    :param power: units of the UAVs' powers in W, (U,).
    :param elevation_offset: homotopy parameter in degrees. It widens the smoothed step of helpful
        links, so that their gradient is not 0 outside the region with a line of sight.
    """
    nodes, listeners = len(scenario.ground_nodes), len(scenario.listeners)
    hearers = len(scenario.eavesdroppers) + listeners
    link = _link(scenario, [0] * nodes + [1] * hearers, (nodes + hearers, -1),
                 scenario.reference_snr * power / length**scenario.channel.exponent,
                 scenario.altitudes / length, elevation_offset)
    return link.for_receivers(np.concatenate([
        np.ones(nodes), scenario.receiver_advantages, np.ones(listeners)])[:, None])


def _link(scenario: Scenario, kinds: int | list[int], shape: tuple[int, ...],
          snr: Array | float, altitudes: Array, elevation_offset: float = 0.0) -> FreeSpace:
    """
    Return the links of all UAVs to receivers by the scenario's channel; see make_link.

    :param kinds: 0 for a ground node or 1 for an eavesdropper, or a list of these.
    :param shape: shape of kinds and UAVs, with which `snr` (reference SNR) and `altitudes`
        broadcast.
    """
    channel, uavs = scenario.channel, len(scenario.uavs)
    transmits = np.arange(uavs) == 0
    # A jammer interferes at the ground node; the transmitter leaks to an eavesdropper.
    is_harmful = np.stack([~transmits, transmits])[kinds].reshape(shape)
    if channel.rician_k_db is not None:
        low, high = scenario.fading_gains
        snr = snr * np.where(is_harmful, high, low)
    if channel.is_inverse_square:
        return FreeSpace(snr, altitudes**2)
    a, b, loss = channel.los_numbers or (1.0, 1.0, 0.0)
    kappa = 10.0**(-loss / 10.0)
    if channel.counts_sights:
        helping, harming = _sight_elevations(a, b, scenario.outage_share)
        # The smoothed step rises from 0 at the elevation `begin` to 1 at begin + width [degrees].
        begin = np.where(is_harmful, harming - RISE, helping - elevation_offset)
        width = np.where(is_harmful, RISE, RISE + elevation_offset)
        return PathLossQuantile(
            snr, altitudes**2, kappa, channel.exponent, 1 / width, begin / width)
    losses = np.where(is_harmful & channel.cautious, 1.0, kappa)
    return PathLoss(snr, altitudes**2, losses, channel.exponent, b, b * a + math.log(a))


def has_free_space_links(scenario: Scenario) -> bool:
    """Return whether every gain is a constant / (d^2 + H^2), also for a channel of one's own."""
    return type(make_link(scenario, 'ground_node')) is FreeSpace


def sight_radii(scenario: Scenario) -> Array:
    """
    Return the largest horizontal distances at which helpful links have a line of sight, (U,) in m.

    There the elevation is RISE above the one at which a sight has the probability 1 - outage. They
    are infinite if the channel does not count sights, or if 90 degrees of elevation are too low.
    """
    channel, elevation = scenario.channel, 90.0
    if channel.counts_sights and channel.los_numbers:
        a, b, _ = channel.los_numbers
        elevation = _sight_elevations(a, b, scenario.outage_share)[0] + RISE
    if elevation >= 90.0:
        return np.full(len(scenario.uavs), np.inf)
    return scenario.altitudes / math.tan(math.radians(elevation))


def _sight_elevations(a: float, b: float, share: float) -> tuple[float, float]:
    """Return the elevations [degrees] at which a sight has probability 1 - share and share."""
    helping, harming = (a + math.log(a * chance / (1 - chance)) / b
                        for chance in (1 - share, share))
    return helping, harming


def _probability(z: Array) -> Array:
    return 1 / (1 + np.exp(-z))


def _spread(fields: tuple[Array | float, ...], *shape: int) -> list[Array]:
    return [np.ascontiguousarray(np.broadcast_to(values, shape), float) for values in fields]


def guaranteed_squared_distance(squared: Array, edge: Array) -> Array:
    """
    Return ([d + edge]^+)^2 of equation (9) for squared distances d^2.

    The edge is -epsilon for the transmitter (nearest point of the disc) and epsilon for jammers
    (farthest point).
    """
    return np.maximum(np.sqrt(squared) + edge, 0.0)**2
