"""Candidate places and powers of one UAV, from which the multipliers are computed."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..proof.conjugate import Array
from ..proof.reachable_set import ReachableSet
from ..proof.subset import circle

RINGS = (0.01, 0.03, 0.1, 0.3)
"""Radii of rings of places about a plan's, in the set's units; twelve places on each."""

GRID, COARSE, STILL = (11, 13), (4, 5), (5, 5)
"""Places along and across a set: to look for columns, to keep always, to be silent at."""

MOST = 40
"""Combinations of columns that are kept beside the best of every column."""

RIM = 32
"""Directions in which the reachable set's farthest place is a place to be silent at."""


@dataclass(frozen=True, eq=False)
class Columns:
    """
    Places and powers of one UAV in every stage, or, with a first axis J, of J jammers together.

    :param place: (G, C, 2) or (J, G, C, 2) in units.
    :param power: (G, C) or (J, G, C) in W; 0 for the transmitter, whose power has a closed form.
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

    @classmethod
    def together(cls, columns: list[Columns]) -> Columns:
        """Return what columns of several jammers with the same number are together."""
        snr = np.mean([some.snr for some in columns], axis=0)
        return cls(np.stack([some.place for some in columns]),
                   np.stack([some.power for some in columns]),
                   -np.log1p(snr[..., 0]), np.log1p(snr[..., 1:]))

    @property
    def snr(self) -> Array:
        """Return what is received of a jammer, as often as there are jammers, (G, C, 1 + E)."""
        return np.concatenate([np.expm1(-self.ground)[..., None], np.expm1(self.leaks)], -1)

    def take(self, index: NDArray[np.intp]) -> Columns:
        """Return the columns with the given indices of every stage, (G, C')."""
        row = np.arange(len(index))[:, None]
        return Columns(self.place[..., row, index, :], self.power[..., row, index],
                       self.ground[row, index], self.leaks[row, index])

    @staticmethod
    def joined(parts: list[Columns]) -> Columns:
        """Return all columns of several."""
        return Columns(*(np.concatenate([getattr(part, name) for part in parts], axis)
                         for name, axis in (
                             ('place', -2), ('power', -1), ('ground', 1), ('leaks', 1))))


def combined(columns: list[Columns], base: list[Array], weight: Array, v: Array) -> Columns:
    """
    Return the combinations of jammers that are worth most, and the best ones of every column.

    Jammers join one after the other.

    :param columns: of every jammer.
    :param base: what they are worth where nothing is sent, (G, C) each.
    :param weight: w0, (G,).
    :param v: (G, E).
    """
    snr = [some.snr / len(columns) for some in columns]
    factor = np.concatenate([-weight[:, None], v], 1)
    row = np.arange(len(v))[:, None]
    noise, worth = snr[0], base[0]
    index = [np.zeros(worth.shape, int) + np.arange(worth.shape[1])]
    for some, own in zip(snr[1:], base[1:]):
        first, second = worth.shape[1], own.shape[1]
        value = worth[:, :, None] + own[:, None]
        for r in range(factor.shape[1]):
            value += factor[:, r, None, None] * np.log1p(
                noise[:, :, None, r] + some[:, None, :, r])
        flat = value.reshape(len(v), -1)
        chosen = np.concatenate([
            np.argpartition(flat, -MOST, 1)[:, -MOST:],
            np.arange(first) * second + value.argmax(2),
            value.argmax(1) * second + np.arange(second)], 1)
        i, k = np.divmod(chosen, second)
        noise, worth = noise[row, i] + some[row, k], worth[row, i] + own[row, k]
        index = [*(before[row, i] for before in index), k]
    return Columns.together([some.take(i) for some, i in zip(columns, index)])


def grid(region: ReachableSet, along: int, across: int) -> Array:
    """Return a grid over every reachable set, its boundary included, (G, along * across, 2)."""
    low, high = region.sides
    even = np.linspace(0, 1, along)
    step = 0.25 * (1 - np.cos(np.pi * even)) + 0.5 * even
    a = low[:, :1] + (high - low)[:, :1] * step
    half = np.sqrt(np.maximum(np.minimum(
        (region.from_start[:, None] - a) * (region.from_start[:, None] + a),
        region.to_goal[:, None]**2 - (a - region.distance)**2), 0.0))
    left, right = np.maximum(-half, low[:, 1:]), np.minimum(half, high[:, 1:])
    b = left[..., None] + (right - left)[..., None] * np.linspace(0, 1, across)
    place = np.stack(np.broadcast_arrays(a[:, :, None], b), -1).reshape(len(a), -1, 2)
    return region.drawn_in(place, np.arange(len(a))[:, None])


def rings(region: ReachableSet, centre: Array) -> Array:
    """Return places about others (G, 2), those too, as far as they are in the reachable set."""
    offset = np.concatenate([[[0.0, 0.0]], *(radius * circle(12) for radius in RINGS)])
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
