"""Candidate places and powers of one UAV, from which the multipliers are computed."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..proof.conjugate import Array
from ..proof.reachable_set import ReachableSet

RINGS = (0.01, 0.03, 0.1, 0.3)
"""Radii of rings of places about a plan's, in the set's units; twelve places on each."""

GRID, COARSE, STILL = (11, 13), (4, 5), (5, 5)
"""Places along and across a set: to look for columns, to keep always, to be silent at."""

PAIRS = 40
"""Pairs of columns that are kept beside the best of every column."""

RIM = 32
"""Directions in which the reachable set's farthest place is a place to be silent at."""


@dataclass(frozen=True, eq=False)
class Columns:
    """
    Places and powers of one UAV in every stage.

    :param place: (G, C, 2) in units.
    :param power: (G, C) in W; 0 for the transmitter, whose power has a closed form.
    :param ground: what w0 multiplies, (G, C) in nats.
    :param leaks: what v multiplies, (G, C, E) in nats.
    """

    place: Array
    power: Array
    ground: Array
    leaks: Array

    @classmethod
    def of(cls, region: ReachableSet, place: Array, power: Array, copies: int) -> Columns:
        """Return the columns of given places and powers; see Team.copies."""
        ground, leaks = region.log_squares(place)
        if region.transmits:
            return cls(place, power, region.log_gain - ground, leaks - region.log_gain)
        log_gain = region.log_gain + np.log(copies)
        return cls(place, power, -np.log1p(power * np.exp(log_gain - ground)),
                   np.log1p(power[..., None] * np.exp(log_gain - leaks)))

    @classmethod
    def product(cls, region: ReachableSet, place: Array, levels: Array, copies: int) -> Columns:
        """Return the columns of every place (G, K, 2) with every power (G, P), (G, K P)."""
        shape = place.shape[:2] + levels.shape[1:]
        return cls.of(region, np.broadcast_to(place[:, :, None], shape + (2,)).reshape(
            len(place), -1, 2), np.broadcast_to(levels[:, None], shape).reshape(len(place), -1),
            copies)

    def take(self, index: NDArray[np.intp]) -> Columns:
        """Return the columns with the given indices of every stage, (G, C')."""
        row = np.arange(len(self.place))[:, None]
        return Columns(self.place[row, index], self.power[row, index], self.ground[row, index],
                       self.leaks[row, index])

    @staticmethod
    def joined(parts: list[Columns]) -> Columns:
        """Return all columns of several."""
        return Columns(*(np.concatenate([getattr(part, name) for part in parts], axis=1)
                         for name in ('place', 'power', 'ground', 'leaks')))


@dataclass(frozen=True, eq=False)
class Pairs:
    """
    Places and powers of two jammers in every stage.

    :param place: (2, G, C, 2) in units.
    :param power: (2, G, C) in W.
    :param ground: what w0 multiplies, (G, C) in nats: of both jammers together, and so exact.
    :param leaks: what v multiplies, (G, C, E) in nats.
    """

    place: Array
    power: Array
    ground: Array
    leaks: Array

    @classmethod
    def best(cls, one: Columns, two: Columns, base: tuple[Array, Array], weight: Array,
             v: Array) -> Pairs:
        """
        Return the pairs that are worth most, and the best of every column.

        :param base: what the columns are worth where nothing is sent, (G, C) each.
        :param weight: w0, (G,).
        :param v: (G, E).
        """
        # Columns of two jammers count with twice their gain.
        x, y = (np.expm1(-some.ground) / 2 for some in (one, two))
        ground = -np.log1p(x[:, :, None] + y[:, None])
        x, y = (np.expm1(some.leaks) / 2 for some in (one, two))
        leaks = np.log1p(x[:, :, None] + y[:, None])
        worth = (base[0][:, :, None] + base[1][:, None] + weight[:, None, None] * ground
                 + np.matmul(leaks, v[:, None, :, None])[..., 0])
        stages, first, second = worth.shape
        flat = worth.reshape(stages, -1)
        index = np.concatenate([
            np.argpartition(flat, -PAIRS, 1)[:, -PAIRS:],
            np.arange(first) * second + worth.argmax(2),
            worth.argmax(1) * second + np.arange(second)], 1)
        row, (i, j) = np.arange(stages)[:, None], np.divmod(index, second)
        chosen = one.take(i), two.take(j)
        return cls(np.stack([some.place for some in chosen]),
                   np.stack([some.power for some in chosen]), ground[row, i, j], leaks[row, i, j])

    @staticmethod
    def joined(parts: list[Pairs]) -> Pairs:
        """Return all pairs of several."""
        return Pairs(*(np.concatenate([getattr(part, name) for part in parts], axis)
                       for name, axis in (('place', 2), ('power', 2), ('ground', 1),
                                          ('leaks', 1))))


def grid(region: ReachableSet, along: int, across: int) -> Array:
    """Return a grid over every reachable set, its boundary included, (G, along * across, 2)."""
    low, high = region.sides
    even = np.linspace(0, 1, along)
    step = 0.25 * (1 - np.cos(np.pi * even)) + 0.5 * even
    a = low[:, :1] + (high - low)[:, :1] * step
    half = np.sqrt(np.maximum(np.minimum(
        (region.from_start[:, None] - a) * (region.from_start[:, None] + a),
        region.to_goal[:, None]**2 - (a - region.distance)**2), 0.0))
    b = half[:, :, None] * np.linspace(-1, 1, across)
    return np.stack(np.broadcast_arrays(a[:, :, None], b), -1).reshape(len(a), -1, 2)


def rings(region: ReachableSet, centre: Array) -> Array:
    """Return places about others (G, 2), those too, as far as they are in the reachable set."""
    angle = np.arange(12) * np.pi / 6
    circle = np.stack([np.cos(angle), np.sin(angle)], -1)
    offset = np.concatenate([[[0.0, 0.0]], *(radius * circle for radius in RINGS)])
    place = centre[:, None] + offset
    stage = np.arange(len(place))[:, None]
    return np.asarray(np.where(region.inside(place, stage)[..., None], place, centre[:, None]))


def levels(region: ReachableSet, power: Array) -> Array:
    """Return powers of a jammer about a plan's, (G,), and others up to the peak, (G, 13)."""
    about = np.clip(power, 1e-6 * region.peak, region.peak)[:, None]
    return np.asarray(np.minimum(np.concatenate([
        np.zeros_like(about), about * np.exp(np.linspace(-1.2, 1.2, 7)),
        np.broadcast_to(region.peak * np.geomspace(1e-4, 1.0, 5), (len(power), 5))], 1),
        region.peak))
