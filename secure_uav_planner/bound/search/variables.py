"""
The variables of the search: candidate places and powers of each UAV, and the multipliers.

A place and a power in one stage are a column. Its value is convex in the multipliers, and so is
the largest value of any columns.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..proof.certificate import sigmoid
from ..proof.reachable_set import ReachableSet, Team
from ..proof.relaxation import unit_circle
from ...mission.validation import Array

RINGS = (0.01, 0.03, 0.1, 0.3)
"""Radii of rings of twelve places around a plan's place, in units."""

GRID, COARSE_GRID, SILENT_GRID = (11, 13), (4, 5), (5, 5)
"""Places along and across a set: of candidates, of columns always kept, and of silent ones."""

RIM = 32
"""Silent places on the rim of a reachable set, the farthest in as many directions."""

AUDIBLE = 1e-3
"""Share of the average power above which a slot counts as one with a transmission."""


@dataclass(frozen=True, eq=False)
class Columns:
    """
    Places and powers of one UAV in every stage.

    :param place: (G, C, 2) in units.
    :param power: (G, C) in W; 0 for the transmitter, whose power has a closed form.
    :param ground: factor of w0, (G, C) in nats.
    :param leaks: factors of v, (G, C, E) in nats.
    """

    place: Array
    power: Array
    ground: Array
    leaks: Array

    @classmethod
    def of(cls, region: ReachableSet, place: Array, power: Array) -> Columns:
        """Return the columns of given places and powers."""
        ground, leaks = region.log_squares(place)
        if region.transmits:
            return cls(place, power, region.log_gain - ground, leaks - region.log_gain)
        return cls(place, power, -np.log1p(power * np.exp(region.log_gain - ground)),
                   np.log1p(power[..., None] * np.exp(region.log_gain - leaks)))

    @classmethod
    def product(cls, region: ReachableSet, place: Array, levels: Array) -> Columns:
        """Return the columns of every place (G, K, 2) with every power (G, P), (G, K P)."""
        shape = place.shape[:2] + levels.shape[1:]
        return cls.of(region, np.broadcast_to(place[:, :, None], shape + (2,)).reshape(
            len(place), -1, 2), np.broadcast_to(levels[:, None], shape).reshape(len(place), -1))

    def take(self, index: NDArray[np.intp]) -> Columns:
        """Return the columns with the given indices of every stage, (G, C')."""
        row = np.arange(len(index))[:, None]
        return Columns(self.place[row, index], self.power[row, index],
                       self.ground[row, index], self.leaks[row, index])

    @staticmethod
    def concatenate(parts: list[Columns]) -> Columns:
        """Return all columns of several lists."""
        return Columns(*(np.concatenate([getattr(part, name) for part in parts], 1)
                         for name in ('place', 'power', 'ground', 'leaks')))


def sample_grid(region: ReachableSet, along: int, across: int) -> Array:
    """Return a grid over every reachable set, its boundary included, (G, along * across, 2)."""
    low, high = region.bounding_box
    even = np.linspace(0, 1, along)
    step = 0.25 * (1 - np.cos(np.pi * even)) + 0.5 * even
    a = low[:, :1] + (high - low)[:, :1] * step
    half = np.sqrt(np.maximum(np.minimum(
        (region.from_start[:, None] - a) * (region.from_start[:, None] + a),
        region.to_goal[:, None]**2 - (a - region.distance)**2), 0.0))
    left, right = np.maximum(-half, low[:, 1:]), np.minimum(half, high[:, 1:])
    b = left[..., None] + (right - left)[..., None] * np.linspace(0, 1, across)
    place = np.stack(np.broadcast_arrays(a[:, :, None], b), -1).reshape(len(a), -1, 2)
    return region.clip(place, np.arange(len(a))[:, None])


def sample_rings(region: ReachableSet, centre: Array) -> Array:
    """Return centres (G, 2) and rings around them, as far as they are in the set, (G, K, 2)."""
    offset = np.concatenate([[[0.0, 0.0]], *(radius * unit_circle(12) for radius in RINGS)])
    place = centre[:, None] + offset
    stage = np.arange(len(place))[:, None]
    return np.asarray(np.where(region.contains(place, stage)[..., None], place, centre[:, None]))


def sample_powers(region: ReachableSet, power: Array) -> Array:
    """Return powers of a jammer around a plan's, (G,), and up to the peak, (G, 13)."""
    about = np.clip(power, 1e-6 * region.peak, region.peak)[:, None]
    return np.asarray(np.minimum(np.concatenate([
        np.zeros_like(about), about * np.exp(np.linspace(-1.2, 1.2, 7)),
        np.broadcast_to(region.peak * np.geomspace(1e-4, 1.0, 5), (len(power), 5))], 1),
        region.peak))


@dataclass(frozen=True)
class PotentialLayout:
    """
    The entries of a potential at an edge: u (2), then S (3) and w (2) where it has them.

    :param quadratic: True with S.
    :param acceleration: True with w, for UAVs with a limit of acceleration.
    """

    quadratic: bool
    acceleration: bool

    @classmethod
    def of(cls, potentials: Array) -> PotentialLayout:
        """Return the layout of potentials (..., P)."""
        width = potentials.shape[-1]
        return cls(width >= 5, width in (4, 7))


def split_potentials(x: Array) -> tuple[Array, Array, Array]:
    """Return u, S and w of potentials (..., P), zeros for those that they do not have."""
    layout, zeros = PotentialLayout.of(x), np.zeros(x.shape[:-1] + (3,))
    return (x[..., :2], x[..., 2:5] if layout.quadratic else zeros,
            x[..., -2:] if layout.acceleration else zeros[..., :2])


@dataclass(frozen=True, eq=False)
class DualPoint:
    """
    The unknowns of the dual function.

    :param potentials: at every edge, see PotentialLayout, (G + 1, U, P).
    :param shares: v, (G, E).
    :param prices: lam, (U,).
    """

    potentials: Array
    shares: Array
    prices: Array

    def move(self, step: DualPoint, length: float) -> DualPoint:
        """Return this point moved along a step."""
        return DualPoint(self.potentials + length * step.potentials,
                         self.shares + length * step.shares, self.prices + length * step.prices)

    def shorten(self, point: DualPoint, slack: Array) -> DualPoint:
        """Return this step, shortened so that every slot's v, slack and prices stay positive."""
        with np.errstate(divide='ignore', invalid='ignore'):
            total = -self.shares.sum(-1)
            most = np.minimum(
                np.where(self.shares < 0, -point.shares / self.shares, np.inf).min(-1),
                np.where(total < 0, -slack / total, np.inf))
            prices = np.where(self.prices < 0, -point.prices / self.prices, np.inf)
        return replace(self, shares=self.shares * np.minimum(1.0, 0.9 * most)[..., None],
                       prices=self.prices * np.minimum(1.0, 0.9 * prices))


def pack_columns(team: Team, uav: int, point: DualPoint, columns: Columns, weight: Array,
                 shares: Array, tau: float = 1e-9) -> dict[str, Any]:
    """
    Return the kernel's arguments: columns of a UAV, its potential, and w0 and v.

    :param weight: w0, (G,).
    :param shares: v, (G, E).
    """
    potentials = point.potentials[:, uav]
    layout = PotentialLayout.of(potentials)
    arrays = {
        'place': columns.place, 'power': columns.power, 'ground': columns.ground,
        'leaks': columns.leaks, 'potentials': potentials, 'count': team.stages.count,
        'step': team.regions[uav].steps, 'mean': team.stages.means, 'weights': weight,
        'shares': shares}
    return {**{name: np.ascontiguousarray(array, float) for name, array in arrays.items()},
            'quadratic': layout.quadratic, 'acceleration': layout.acceleration, 'tau': tau,
            'price': float(point.prices[uav])}


@dataclass(frozen=True, eq=False)
class InitialMultipliers:
    """
    The multipliers with which a search begins.

    :param places: of every UAV in every stage, (U, G, 2) in units of its reachable set.
    :param powers: (U, G) in W; in silent stages those of the nearest stage with a transmission.
    :param weight: w0, the derivative of the rate by log SINR at the ground node, (G,).
    :param shares: v, (G, E).
    :param prices: lam, (U,) in nats per W.
    """

    places: Array
    powers: Array
    weight: Array
    shares: Array
    prices: Array

    @classmethod
    def of(cls, team: Team, positions: Array, powers: Array) -> InitialMultipliers:
        """
        Return the multipliers that a plan suggests.

        :param positions: (U, N + 2, 2) in m.
        :param powers: (U, N) in W.
        """
        middle = (team.stages.first + team.stages.last) // 2
        places = np.array([region.local(path[middle])
                           for region, path in zip(team.regions, positions)])
        power = np.maximum(powers[:, middle - 1], 0.0)
        on = power[0] > AUDIBLE * team.regions[0].average
        watts = np.repeat([[region.average] for region in team.regions], len(on), axis=1)
        if on.any():
            sending = np.flatnonzero(on)
            watts = power[:, sending[np.abs(sending - np.arange(len(on))[:, None]).argmin(1)]]
        ground, leaks = [], []
        for region, place, p in zip(team.regions, places, watts):
            log_ground, log_leaks = region.log_squares(place)
            ground.append(p * np.exp(region.log_gain - log_ground))
            leaks.append(p[:, None] * np.exp(region.log_gain - log_leaks))
        noise0 = 1.0 + sum(ground[1:], np.zeros_like(ground[0]))
        noise = 1.0 + sum(leaks[1:], np.zeros_like(leaks[0]))
        z0 = np.log(np.maximum(ground[0] / noise0, 1e-9))
        ze = np.log(np.maximum(leaks[0] / noise, 1e-9))
        weight = np.clip(sigmoid(z0), 0.3, 1 - 1e-6)
        group = np.array([ze[:, index].max(-1) for index in team.groups]).T
        loudest = sigmoid(np.logaddexp.reduce(group, -1))
        prices = np.full(len(team.regions), 1e-5)
        prices[0] = 1e-2
        if on.any():
            slope = (sigmoid(z0) - loudest) / np.maximum(power[0], 1e-9)
            prices[0] = max(float(np.median(slope[on])), 1e-6)
        slack = prices[0] * np.maximum(watts[0], 0.1 * team.regions[0].average)
        total = np.clip(np.minimum(loudest, weight - slack), 0.05, weight * (1 - 1e-7))
        share = np.empty_like(ze)
        for index, largest in zip(team.groups, group.T):
            near = np.exp(8 * (ze[:, index] - largest[:, None]))
            share[:, index] = near / near.sum(-1, keepdims=True) * np.exp(
                largest - group.max(-1))[:, None]
        share = share / share.sum(-1, keepdims=True) + 0.02
        share /= share.sum(-1, keepdims=True)
        return cls(places, watts, weight, total[:, None] * share, prices)
