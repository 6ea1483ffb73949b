"""
The inverse SINR of an eavesdropper: its derivatives by place, and its least value in a sector.

With the transmitter's S and the jammers' J over the noise power, v = (1 + J) / S decides the leak
log2(1 + 1 / v): the worst place of a disc is where v is least. In free space, with
D_i = |x - q_i|^2 + H_i^2 and the SNR g at unit distance and unit power,

    v = D_0 / (g p_0) + sum_j p_j / p_0 D_0 / D_j,   D_0 / D_j = 1 + L_j / D_j,

where L_j = D_0 - D_j is affine in x. UAVs at the same place so cancel before anything is bounded,
and a leak that is flat over the disc is seen to be flat.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from .links import FreeSpace
from ..scenario import Array

Indices = NDArray[np.intp]

# Rounding. A sum of up to 32 positive terms of a few operations each is right to 1e-14 of itself.
# Places and offsets are right to `doubt`, many units in the last place of the longest offset; as
# places of a sector that widens the ball, and as places of UAVs it changes v by no more than the
# slopes of its terms allow. Where terms cancel, as in L_j, in the gradient and in the Hessian, the
# error is a few units in the last place of their absolute values added up: `change`, `slopes` and
# `lowered` hold more than that. In sum, a bound is lowered by more than rounding can raise it.
_ULPS = 1e-14
_TINY = 1e-300


@dataclass(frozen=True, eq=False)
class Sectors:
    """
    Sectors of rings around the centres of discs, r in [inner, outer], |angle - middle| <= half.

    A whole disc is a sector with half = pi; all others have half <= pi / 2. All arrays are (C,).

    :param pair: to which of the Pairs each belongs.
    """

    pair: Indices
    inner: Array
    outer: Array
    middle: Array
    half: Array

    @classmethod
    def of(cls, pair: Indices, radius: Array) -> 'Sectors':
        """Return whole discs of pairs."""
        zero = np.zeros(len(pair))
        return cls(pair, zero, radius, zero, np.full(len(pair), np.pi))

    @cached_property
    def whole(self) -> NDArray[np.bool_]:
        """Whether it is a whole disc."""
        return self.half > 0.5 * np.pi

    @cached_property
    def radius(self) -> Array:
        """Where on the line in the middle the place is that stands for the sector, in m."""
        return np.where(self.whole, 0.0, 0.5 * (self.inner + self.outer))

    @cached_property
    def bow(self) -> Array:
        """(1 - cos half) / 2."""
        bow: Array = np.sin(0.5 * self.half)**2
        return bow

    @cached_property
    def ball(self) -> Array:
        """How far a place of the sector can be from that which stands for it, in m."""
        return np.sqrt((self.outer - self.radius)**2 + 4.0 * self.outer * self.radius * self.bow)

    def __len__(self) -> int:
        return len(self.pair)

    def __getitem__(self, choice: slice | Indices | NDArray[np.bool_]) -> 'Sectors':
        return Sectors(self.pair[choice], self.inner[choice], self.outer[choice],
                       self.middle[choice], self.half[choice])


@dataclass(frozen=True, eq=False)
class Pairs:
    """
    Pairs of a slot and an eavesdropper, with places relative to the centre of its disc.

    :param x: of the UAVs, (U, P) in m.
    :param y: likewise.
    :param squared_altitudes: H^2, (U, 1).
    :param noise: 1 / (g p_0), (P,); the transmitter's power is above zero.
    :param jamming: p_j / p_0, (U-1, P), none below zero.
    :param radius: of the disc, (P,) in m.
    """

    x: Array
    y: Array
    squared_altitudes: Array
    noise: Array
    jamming: Array
    radius: Array

    @classmethod
    def of(cls, link: FreeSpace, offsets: Array, powers: Array, radius: Array) -> 'Pairs':
        """
        Return pairs, for a link of arrays (U, P), with which all UAVs have one reference_snr.

        :param offsets: of the UAVs from the centres, (U, P, 2) in m.
        :param powers: in W, (U, P).
        """
        return cls(offsets[..., 0], offsets[..., 1], link.squared_altitudes,
                   1.0 / (link.reference_snr * powers[0]), powers[1:] / powers[0], radius)

    def __len__(self) -> int:
        return len(self.noise)

    def __getitem__(self, choice: Indices | NDArray[np.bool_]) -> 'Pairs':
        return Pairs(self.x[:, choice], self.y[:, choice], self.squared_altitudes,
                     self.noise[choice], self.jamming[:, choice], self.radius[choice])

    @cached_property
    def doubt(self) -> Array:
        """By how much rounding may displace a place of a disc from a UAV, (P,) in m."""
        farthest: Array = np.sqrt((self.x**2 + self.y**2).max(axis=0))
        return _ULPS * (self.radius + farthest)

    def at(self, x: Array, y: Array) -> Array:
        """Return v at one place of every pair, (P,)."""
        loss = (x - self.x)**2 + (y - self.y)**2 + self.squared_altitudes
        value: Array = loss[0] * (self.noise + (self.jamming / loss[1:]).sum(axis=0))
        return value

    def derivatives(self, x: Array, y: Array) -> 'Derivatives':
        """Return v and its derivatives at one place of every pair, (P,)."""
        dx, dy = x - self.x, y - self.y
        loss = dx**2 + dy**2 + self.squared_altitudes
        return Derivatives.of(dx, dy, loss, self.noise, self.jamming)

    def least_in(self, sectors: Sectors) -> tuple[Array, Array, Array, Array]:
        """
        Return a lower bound of v in sectors, and v at a place of each with its x and y, all (C,).

        The bound is the largest of three, all for the smallest ball around the place that holds
        the sector. The first takes every distance by itself at its smallest or largest; of it a
        link needs no more than a gain that falls with the distance. The others minimise a
        quadratic that v does not fall below, Taylor's with its Hessian lowered by what the third
        derivative can change: over the sector with its curved edges, by the Hessian's least
        eigenvalue alone, and over the square around the ball along the eigenvectors. So what is
        left to divide shrinks with the square of the sectors' size, both near a maximum of the
        leak on the edge of the disc and near one inside, even if it is flat in a direction.
        """
        pair = sectors.pair
        noise, jamming, doubt = self.noise[pair], self.jamming[:, pair], self.doubt[pair]
        altitudes = self.squared_altitudes
        cosine, sine = np.cos(sectors.middle), np.sin(sectors.middle)
        x, y = sectors.radius * cosine, sectors.radius * sine
        ball = sectors.ball * (1 + _ULPS) + doubt

        dx, dy = x - self.x[:, pair], y - self.y[:, pair]
        squared = dx**2 + dy**2
        distance = np.sqrt(squared)
        loss = squared + altitudes
        near = np.maximum(distance - ball, 0.0)**2 + altitudes
        near, far, best = near[1:], (distance[1:] + ball)**2 + altitudes[1:], near[0]
        # From q_0 to q_j, and L_j with how much it changes in the ball.
        apart_x, apart_y = self.x[1:, pair] - self.x[0, pair], self.y[1:, pair] - self.y[0, pair]
        apart = np.sqrt(apart_x**2 + apart_y**2) + doubt
        change = 2.0 * apart * (ball + _ULPS * (distance[0] + distance[1:]))
        difference = apart_x * (dx[0] + dx[1:]) + apart_y * (dy[0] + dy[1:]) + (
            altitudes[0] - altitudes[1:])
        lowest = difference - change
        ratio = np.maximum(best / far, 1.0 + lowest / np.where(lowest > 0, far, near))
        first = (noise * best + (jamming * ratio).sum(axis=0)) * (1 - _ULPS)

        # Along a line, |(1 / D)''| <= 6 / D^2 and |(1 / D)'''| <= 24 / D^(5/2), and L_j is affine.
        third = (jamming / near**2 * (
            24.0 * (np.abs(difference) + change) / np.sqrt(near) + 36.0 * apart)).sum(axis=0)
        v = Derivatives.of(dx, dy, loss, noise, jamming)
        weight = jamming / loss[1:]
        fall = v.least_fall(sectors, cosine, sine, ball, third * ball / 3.0 + _ULPS * (
            noise + (weight * (1.0 + loss[0] / loss[1:])).sum(axis=0)))
        slopes = (noise + weight.sum(axis=0)) * distance[0] + (
            weight * loss[0] / loss[1:] * distance[1:]).sum(axis=0)
        second = v.value * (1 - _ULPS) + fall - 2.0 * slopes * (doubt + _ULPS * ball)
        return np.maximum(first, second), v.value, x, y


@dataclass(frozen=True, eq=False)
class Derivatives:
    """v at places, its gradient (x, y) and its Hessian (xx, xy, yy); all (C,)."""

    value: Array
    x: Array
    y: Array
    xx: Array
    xy: Array
    yy: Array

    @classmethod
    def of(cls, dx: Array, dy: Array, loss: Array, noise: Array,
           jamming: Array) -> 'Derivatives':
        """
        Return the derivatives at places of pairs.

        :param dx: of the places from the UAVs, (U, C) in m.
        :param dy: likewise.
        :param loss: D, (U, C).
        """
        weight, ratio = jamming / loss[1:], loss[0] / loss[1:]
        # Half the gradient of D_0 / D_j is (x - q_0 - (D_0 / D_j) (x - q_j)) / D_j.
        along_x, along_y = dx[0] - ratio * dx[1:], dy[0] - ratio * dy[1:]
        slope_x, slope_y = weight * along_x, weight * along_y
        isotropic = noise + (weight * (1.0 - ratio)).sum(axis=0)
        shift_x, shift_y = 2.0 * dx[1:] / loss[1:], 2.0 * dy[1:] / loss[1:]
        return cls(loss[0] * (noise + weight.sum(axis=0)),
                   2.0 * (noise * dx[0] + slope_x.sum(axis=0)),
                   2.0 * (noise * dy[0] + slope_y.sum(axis=0)),
                   2.0 * (isotropic - 2.0 * (slope_x * shift_x).sum(axis=0)),
                   -2.0 * (slope_x * shift_y + slope_y * shift_x).sum(axis=0),
                   2.0 * (isotropic - 2.0 * (slope_y * shift_y).sum(axis=0)))

    def least_fall(self, sectors: Sectors, cosine: Array, sine: Array, ball: Array,
                   lowered: Array) -> Array:
        """
        Return a lower bound of the quadratic less its value at the places of sectors, (C,).

        :param cosine: of the sectors' middle, (C,).
        :param sine: likewise.
        :param ball: radius of the ball around the place in which the sector is, in m.
        :param lowered: by how much the Hessian is lowered.
        """
        mean, half = 0.5 * (self.xx + self.yy), 0.5 * (self.xx - self.yy)
        spread = np.hypot(half, self.xy)
        angle = 0.5 * np.arctan2(self.xy, half)
        fall = np.zeros(len(ball))
        for across_x, across_y, bend in (
                (np.cos(angle), np.sin(angle), mean + spread - lowered),
                (-np.sin(angle), np.cos(angle), mean - spread - lowered)):
            slope = np.abs(self.x * across_x + self.y * across_y)
            step = np.divide(slope, bend, out=ball.copy(), where=slope < bend * ball)
            fall += step * (0.5 * bend * step - slope)

        # On the arc at r, at (r, middle + t), the quadratic falls by a term of r, and by r times
        # along (cos t - 1) + across sin t. This is least where its steepest descent points, if
        # that is within the angle, or else at an end; over r the whole is concave, and so least
        # on one of the two arcs.
        concave = np.maximum(lowered + spread - mean, 0.0)
        outwards = self.x * cosine + self.y * sine
        along, across = outwards + concave * sectors.radius, np.abs(
            self.y * cosine - self.x * sine)
        steepest = np.hypot(along, across)
        sine_half = np.sin(sectors.half)
        within = sectors.whole | (across * np.cos(sectors.half) <= -along * sine_half)
        turn = np.where(within, np.where(
            along < 0, -across * (across / np.maximum(steepest + np.abs(along), _TINY)),
            -along - steepest), -2.0 * along * sectors.bow - across * sine_half)
        on_arcs = np.full(len(ball), np.inf)
        for edge in (sectors.inner, sectors.outer):
            step = edge - sectors.radius
            np.minimum(on_arcs, step * (outwards - 0.5 * concave * step) + edge * turn,
                       out=on_arcs)
        return np.maximum(fall, on_arcs)
