"""Candidate places and powers of one UAV, from which the multipliers are computed."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..proof.reachable_set import ReachableSet
from ..proof.subset import unit_circle
from ...mission.validation import Array

RINGS = (0.01, 0.03, 0.1, 0.3)
"""Radii of rings of twelve places around a plan's place, in units."""

GRID, COARSE_GRID, SILENT_GRID = (11, 13), (4, 5), (5, 5)
"""Places along and across a set: of candidates, of columns always kept, and of silent ones."""

RIM = 32
"""Silent places on the rim of a reachable set, the farthest in as many directions."""


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
