"""Candidate places and powers of one UAV, from which the multipliers are computed."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .conjugate import Array
from .lens import Lens

RINGS = (0.0, 0.01, 0.03, 0.1, 0.3)
"""Radii about the reference's place, in units of the lens; twelve places on each."""


def monomials(place: Array) -> Array:
    """Return (x, y, x^2/2, x y, y^2/2): W = (u, S) . monomials, for places (..., 2)."""
    x, y = place[..., 0], place[..., 1]
    return np.stack([x, y, x * x / 2, x * y, y * y / 2], -1)


@dataclass(frozen=True, eq=False)
class Columns:
    """
    A few places and powers of one UAV in every stage.

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
    def of(cls, lens: Lens, place: Array, power: Array, jammers: int) -> Columns:
        """Return the columns of given places and powers."""
        ground, leaks = lens.log_squares(place)
        if lens.transmits:
            return cls(place, power, lens.log_gain - ground, leaks - lens.log_gain)
        log_gain = lens.log_gain + np.log(jammers)
        received = power * np.exp(log_gain - ground)
        heard = power[..., None] * np.exp(log_gain - leaks)
        return cls(place, power, -np.log1p(received), np.log1p(heard))

    def take(self, index: Array) -> Columns:
        """Return the columns with the given indices of every stage, (G, C')."""
        one = index[..., None]
        return Columns(np.take_along_axis(self.place, one, 1),
                       np.take_along_axis(self.power, index, 1),
                       np.take_along_axis(self.ground, index, 1),
                       np.take_along_axis(self.leaks, one, 1))

    def joined(self, other: Columns) -> Columns:
        """Return these columns and those of another."""
        return Columns(*(np.concatenate([getattr(self, name), getattr(other, name)], 1)
                         for name in ('place', 'power', 'ground', 'leaks')))

    def value(self, weight: Array, shares: Array, price: float) -> Array:
        """Return w0 ground + sum_e v_e leaks - lam p, (G, C), for w0 (G,) and v (G, E)."""
        value = weight[:, None] * self.ground + np.matmul(self.leaks, shares[..., None])[..., 0]
        return np.asarray(value - price * self.power)


def grid(lens: Lens, along: int, across: int) -> Array:
    """Return a grid over every lens, its boundary included, (G, along * across, 2)."""
    low, high = lens.sides
    even = np.linspace(0, 1, along)
    step = 0.25 * (1 - np.cos(np.pi * even)) + 0.5 * even
    a = low[:, :1] + (high - low)[:, :1] * step
    half = np.sqrt(np.maximum(np.minimum(
        lens.from_start[:, None]**2 - a**2,
        lens.to_goal[:, None]**2 - (a - lens.distance)**2), 0.0))
    b = half[:, :, None] * np.linspace(-1, 1, across)
    return np.stack(np.broadcast_arrays(a[:, :, None], b), -1).reshape(len(a), -1, 2)


def about(lens: Lens, reference: Array) -> Array:
    """Return places on rings about the reference's places (G, 2), (G, 49, 2)."""
    angle = np.arange(12) * np.pi / 6
    circle = np.stack([np.cos(angle), np.sin(angle)], -1)
    offset = np.concatenate([[[0.0, 0.0]], *(radius * circle for radius in RINGS[1:])])
    place = reference[:, None] + offset
    stage = np.arange(len(place))[:, None]
    return np.where(lens.inside(place, stage)[..., None], place, reference[:, None])
