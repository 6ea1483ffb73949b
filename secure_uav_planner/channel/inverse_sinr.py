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

# Rounding. A sum of up to 32 positive terms, each of a few operations, is right to 1e-14 of itself.
# Places and offsets are right to `doubt`, a few units in the last place of the longest offset;
# that changes a distance as a larger ball does, and v by no more than its slope, 2 v / H, allows.
# Where terms cancel, in L_j, in the gradient and in the curvature, the error is some units in the
# last place of what is added up. least_in lowers its bounds by more than all of these.
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
        Return pairs, for a link of arrays (U, P).

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

    @cached_property
    def lowest_altitude(self) -> float:
        """Lowest altitude of a UAV in m; no |grad v| is above 2 v / lowest_altitude."""
        return float(np.sqrt(self.squared_altitudes.min()))

    def at(self, x: Array, y: Array) -> Array:
        """Return v at one place of every pair, (P,)."""
        loss = (x - self.x)**2 + (y - self.y)**2 + self.squared_altitudes
        value: Array = loss[0] * (self.noise + (self.jamming / loss[1:]).sum(axis=0))
        return value

    def derivatives(self, x: Array, y: Array) -> tuple[Array, Array, Array]:
        """Return v, its gradient and its Hessian (xx, xy, yy) at places: (P,), (2, P), (3, P)."""
        dx, dy = x - self.x, y - self.y
        loss = dx**2 + dy**2 + self.squared_altitudes
        value, slope_x, slope_y = self._value_and_gradient(
            dx, dy, loss, self.noise, self.jamming)
        weight, ratio = self.jamming / loss[1:], loss[0] / loss[1:]
        along_x, along_y = dx[0] - ratio * dx[1:], dy[0] - ratio * dy[1:]
        isotropic = self.noise + (weight * (1.0 - ratio)).sum(axis=0)
        weight = 2.0 * weight / loss[1:]
        return value, np.stack([slope_x, slope_y]), 2.0 * np.stack([
            isotropic - 2.0 * (weight * along_x * dx[1:]).sum(axis=0),
            -(weight * (along_x * dy[1:] + along_y * dx[1:])).sum(axis=0),
            isotropic - 2.0 * (weight * along_y * dy[1:]).sum(axis=0)])

    @staticmethod
    def _value_and_gradient(dx: Array, dy: Array, loss: Array, noise: Array,
                            jamming: Array) -> tuple[Array, Array, Array]:
        # Half the gradient of D_0 / D_j is (x - q_0 - (D_0 / D_j) (x - q_j)) / D_j.
        weight = jamming / loss[1:]
        both = noise + weight.sum(axis=0)
        weight *= loss[0] / loss[1:]
        return (loss[0] * both, 2.0 * (both * dx[0] - (weight * dx[1:]).sum(axis=0)),
                2.0 * (both * dy[0] - (weight * dy[1:]).sum(axis=0)))

    def least_in(self, sectors: Sectors) -> tuple[Array, Array, Array, Array]:
        """
        Return a lower bound of v in sectors, and v at a place of each with its x and y, all (C,).

        The bound is the larger of two. The first takes every distance by itself at its smallest
        or largest in the ball around the sector; of it a link needs no more than a gain that
        falls with the distance. The second is a quadratic that v does not fall below, with the
        gradient of v at the place and a curvature that no Hessian in the ball is below; it is
        minimised over the sector exactly, the curved edge included, so that both at a maximum
        of the leak inside the disc and at one on its edge what is left to search shrinks with
        the square of the sectors' size.
        """
        pair, outer, half = sectors.pair, sectors.outer, sectors.half
        noise, jamming, doubt = self.noise[pair], self.jamming[:, pair], self.doubt[pair]
        altitudes = self.squared_altitudes
        whole = half > 0.5 * np.pi
        radius = np.where(whole, 0.0, 0.5 * (sectors.inner + outer))
        cosine, sine = np.cos(sectors.middle), np.sin(sectors.middle)
        x, y = radius * cosine, radius * sine
        bow = np.sin(0.5 * half)**2
        ball = np.sqrt((outer - radius)**2 + 4.0 * outer * radius * bow) * (1 + _ULPS) + doubt

        dx, dy = x - self.x[:, pair], y - self.y[:, pair]
        squared = dx**2 + dy**2
        distance = np.sqrt(squared)
        loss = squared + altitudes
        near = np.maximum(distance - ball, 0.0)**2 + altitudes
        far, near_j = (distance[1:] + ball)**2 + altitudes[1:], near[1:]
        # From q_0 to q_j, and L_j with how much it changes in the ball.
        apart_x, apart_y = self.x[1:, pair] - self.x[0, pair], self.y[1:, pair] - self.y[0, pair]
        apart = np.sqrt(apart_x**2 + apart_y**2) + doubt
        difference = apart_x * (dx[0] + dx[1:]) + apart_y * (dy[0] + dy[1:]) + (
            altitudes[0] - altitudes[1:])
        change = 2.0 * apart * (ball + _ULPS * (distance[0] + distance[1:]))
        lowest, highest = difference - change, difference + change

        ratio = np.maximum(near[0] / far, 1.0 + lowest / np.where(lowest > 0, far, near_j))
        first = (noise * near[0] + (jamming * ratio).sum(axis=0)) * (1 - _ULPS)

        value, slope_x, slope_y = self._value_and_gradient(dx, dy, loss, noise, jamming)

        # The Hessian of D_0 / D_j is 2 / D_j (A + B): A = -L_j / D_j (I - 4 x x^T / D_j), with x
        # from q_j, whose least eigenvalue is -L_j / D_j where L_j > 0 and else
        # L_j / D_j (3 - 4 H_j^2 / D_j); B = -2 / D_j (b x^T + x b^T), with b from q_0 to q_j,
        # whose least eigenvalue is -2 / D_j (b.x + |b| |x|).
        shape = 4.0 * altitudes[1:] / far - 3.0
        bent = np.maximum(np.minimum(lowest, 0.0) / near_j * shape,
                          np.minimum(highest, 0.0) / far * shape)
        bent = np.where(highest > 0, np.maximum(bent, highest / near_j), bent)
        crossed = np.minimum(
            apart_x * dx[1:] + apart_y * dy[1:] + apart * distance[1:] + change,
            2.0 * apart * (distance[1:] + ball))
        bent = bent + 2.0 * crossed / near_j
        bent = jamming * bent / np.where(bent > 0, near_j, far)
        curvature = 2.0 * (
            noise * (1 - _ULPS) - bent.sum(axis=0) - _ULPS * np.abs(bent).sum(axis=0))

        # On the arc at r, at (r, middle + t), the quadratic differs from its value at (radius,
        # middle) by `level` + r (along (cos t - 1) + across sin t). Without its convex part it
        # is concave in r, and so least on one of the two arcs; there it is least where its
        # steepest descent points, if that is within the angle, or else at an end.
        convex, concave = np.maximum(curvature, 0.0), np.maximum(-curvature, 0.0)
        outwards = slope_x * cosine + slope_y * sine
        across = np.abs(slope_y * cosine - slope_x * sine)
        along = outwards + concave * radius
        steepest = np.hypot(along, across)
        within = whole | (across * np.cos(half) <= -along * np.sin(half))
        turn = np.where(within, np.where(
            along < 0, -across**2 / np.maximum(steepest - along, _TINY), -along - steepest),
            -2.0 * along * bow - across * np.sin(half))
        fall = np.full(len(pair), np.inf)
        for edge in (sectors.inner, outer):
            step = edge - radius
            np.minimum(fall, step * (outwards - 0.5 * concave * step) + edge * turn, out=fall)
        # Nor does a convex quadratic fall below its minimum, wherever that is.
        steep = slope_x**2 + slope_y**2
        np.divide(-0.5 * steep, convex, out=fall, where=-2.0 * convex * fall > steep)
        second = value * (1 - _ULPS) + fall - (
            20.0 * value / self.lowest_altitude + concave * ball) * doubt
        return np.maximum(first, second), value, x, y
