"""
Lemma 5: the maximum of one UAV's term over its lens and its powers, by branch and bound.

On a box with centre m a function F is at most F(m) + grad F(m) . dq + K |dq|^2 / 2, K being at
least every second derivative in the box, negative where it can be; curvature.py has the rates'.
The potential's q . S q / 2 is bounded as it is, and for its |g + S dq| with g = u + S m both
|g| + g . S dq / |g| + |S dq|^2 / (2 |g|) and |g| + g . S dq / |g| + 2 |S dq| are bounds. What is
linear is at most the box's maximum, and the lens's (Lens.support); on the lens's rim
Lens.pressed takes the slope across the rim away.

Second order matters: near a maximum inside the lens, or on its rim, the number of boxes does not
grow as they shrink.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .conjugate import Array
from .curvature import channel
from .lens import Lens
from .rounding import BOX_ROUNDING

Index = NDArray[np.intp]

BATCH = 1 << 14
"""Boxes that are looked at together: their arrays fit into a processor's cache."""

PARTS = 4
"""Boxes along every side of the first grid."""


@dataclass(frozen=True, eq=False)
class Terms:
    """
    M functions of one UAV's place, and a jammer's power, each with the lens of its stage.

    :param lens: of the UAV.
    :param stage: of every function, (M,).
    :param weight: w0, for a jammer times its theta, (M,).
    :param shares: v, for a jammer times its rho, (M, E).
    :param slope: linear part of the potential, (M, 2) in nats per unit.
    :param bend: quadratic part as (S_11, S_12, S_22), (M, 3) in nats per unit^2.
    :param tilts: terms factor |u + S q| as (factor, u, S) with M rows each.
    :param margin: for rounding, added to every bound, (M,).
    :param price: lam in nats per W.
    :param log_gain: logarithm of the SNR at one unit and 1 W, for a jammer times how many jam.
    :param powers: lower and upper limit of a jammer's log p, or None where no power counts.
    """

    lens: Lens
    stage: Index
    weight: Array
    shares: Array
    slope: Array
    bend: Array
    tilts: list[tuple[Array, Array, Array]]
    margin: Array
    price: float = 0.0
    log_gain: float = 0.0
    powers: tuple[float, float] | None = None

    def __len__(self) -> int:
        return len(self.stage)

    def maxima(self, known: Array, tolerance: Array, budget: int = 5000,
               stop: Callable[[], bool] = lambda: False) -> Array:
        """
        Return an upper bound of every function's maximum, (M,) in nats.

        Boxes are halved along the side that matters most. One is dropped when it misses one of
        the lens's discs or when its bound is below the best value known plus the tolerance: if
        none is left, the maximum is not above that.

        :param known: values that the functions come close to, (M,); any are valid.
        :param tolerance: what the bound may be too large, (M,) in nats.
        :param budget: boxes for each function on average; what is left then counts with the
            bound it has.
        :param stop: asked now and then; True ends the search in the same way.
        """
        return self.search(known, tolerance, budget, stop)[0]

    def search(self, known: Array, tolerance: Array, budget: int = 5000,
               stop: Callable[[], bool] = lambda: False) -> tuple[Array, Array]:
        """
        Return the bounds of `maxima` and the best points that were met, (2 or 3, M).

        A point is NaN where none was better than what was known.
        """
        best = known + tolerance
        dimensions = 2 if self.powers is None else 3
        top, points = known.copy(), np.full((dimensions, len(self)), np.nan)
        budget = budget * len(self)
        chunk = max(1, BATCH // PARTS**dimensions)
        # All functions side by side: whoever ends the search early has all bounds equally close.
        queue = deque(self._grid(np.arange(first, min(first + chunk, len(self))))
                      for first in range(0, len(self), chunk))
        while queue:
            function, centre, half, bound = queue.popleft()
            # Written so that a NaN is never dropped.
            alive = ~(bound <= best[function]) & self._meets(function, centre, half)
            function, centre, half = function[alive], centre[:, alive], half[:, alive]
            if not len(function):
                continue
            budget -= len(function)
            ended = budget < 0 or stop()
            bound = bound[alive]
            if ended and np.isfinite(bound).all():
                np.maximum.at(best, function, bound)
                continue
            value, bound, score = self.bounds(function, centre, half)
            if ended:
                np.maximum.at(best, function, bound)
                continue
            good = self.lens.inside(centre[:2].T, self.stage[function])
            np.maximum.at(best, function[good], value[good] + tolerance[function[good]])
            good &= value > top[function]
            rising = np.flatnonzero(good)[np.argsort(value[good])]
            # The last of several values for one function stays, which is the largest.
            top[function[rising]] = value[rising]
            points[:, function[rising]] = centre[:, rising]
            alive = ~(bound <= best[function])
            if alive.any():
                queue += _halves(function[alive], centre[:, alive], half[:, alive],
                                 bound[alive], score[:, alive])
        return best, points

    def _grid(self, function: Index) -> tuple[Index, Array, Array, Array]:
        low, high = (corner[self.stage[function]].T for corner in self.lens.sides)
        if self.powers is not None:
            low, high = (np.concatenate([side, np.full((1, len(function)), limit)])
                         for side, limit in zip((low, high), self.powers))
        steps = (np.stack(np.meshgrid(*[np.arange(PARTS)] * len(low)), 0).reshape(
            len(low), 1, -1) + 0.5) / PARTS
        centre = low[:, :, None] + (high - low)[:, :, None] * steps
        half = np.broadcast_to(((high - low) / (2 * PARTS))[:, :, None], centre.shape)
        # The centre is off by a few eps of the rectangle's corners, so boxes reach farther.
        half = half * (1 + BOX_ROUNDING) + 4e-16 * (np.abs(low) + np.abs(high))[:, :, None]
        function = np.repeat(function, steps.shape[-1])
        return (function, centre.reshape(len(low), -1), half.reshape(len(low), -1),
                np.full(len(function), np.inf))

    def _meets(self, function: Index, centre: Array, half: Array) -> NDArray[np.bool_]:
        """Return whether the boxes meet both discs."""
        lens, stage = self.lens, self.stage[function]
        across = np.maximum(np.abs(centre[1]) - half[1], 0.0)**2
        return np.asarray(
            (np.maximum(np.abs(centre[0]) - half[0], 0.0)**2 + across
             <= lens.from_start[stage]**2)
            & (np.maximum(np.abs(centre[0] - lens.distance) - half[0], 0.0)**2 + across
               <= lens.to_goal[stage]**2))

    def bounds(self, function: Index, centre: Array, half: Array) -> tuple[Array, Array, Array]:
        """
        Return the value at each box's centre, a bound over the box in the lens, side scores.

        :param function: of every box, (K,).
        :param centre: (2, K), or (3, K) with log p.
        :param half: half the sides, alike.
        :return: (K,), (K,), and how much of the bound each side is to blame for, like `half`.
        """
        a, b, ha, hb = centre[0], centre[1], half[0], half[1]
        rho = np.sqrt(ha * ha + hb * hb)
        curve = channel(self, function, centre, half, rho)
        slope = self.slope[function]
        ga, gb = slope[:, 0], slope[:, 1]
        value = curve.value + ga * a + gb * b
        rest = self.margin[function]
        ka = kb = curve.bend
        sizes: Array | float = 0.0
        if self.bend.any():
            s11, s12, s22 = self.bend[function].T
            sa, sb = s11 * a + s12 * b, s12 * a + s22 * b
            value += (sa * a + sb * b) / 2
            ga, gb = ga + sa, gb + sb
            ka, kb = ka + s11, kb + s22
            rest = rest + np.abs(s12) * ha * hb
            sizes = np.abs(s11) + 2 * np.abs(s12) + np.abs(s22)
        for factor, tilt, matrix in self.tilts:
            f, (t1, t2), (s11, s12, s22) = factor[function], tilt[function].T, matrix[function].T
            ta, tb = t1 + s11 * a + s12 * b, t2 + s12 * a + s22 * b
            safe = np.maximum(np.sqrt(ta * ta + tb * tb), 1e-150)
            value += f * safe
            ga = ga + f * (s11 * ta + s12 * tb) / safe
            gb = gb + f * (s12 * ta + s22 * tb) / safe
            size = np.sqrt(s11 * s11 + 2 * s12 * s12 + s22 * s22)
            far = size * rho > 4 * safe
            more = np.where(far, 0.0, f * size * size / safe)
            ka, kb, sizes = ka + more, kb + more, sizes + more
            rest = rest + np.where(far, 2 * f * size * rho, 0.0)
        ga, gb = ga + curve.ga, gb + curve.gb
        plane = _largest(ga, ha, ka) + _largest(gb, hb, kb)
        # Only where the box is not well inside does the lens say more than the box.
        out = self._outside(function, centre, half)
        touching = np.flatnonzero(out[0] | out[1])
        if len(touching):
            stage = self.stage[function[touching]]
            g, k = (np.stack([one[touching], two[touching]]) for one, two in ((ga, gb), (ka, kb)))
            m, h = centre[:2, touching], half[:2, touching]
            whole = (self.lens.support(g.T, stage) - (g * m).sum(0)
                     + (np.maximum(k, 0) * h * h).sum(0) / 2)
            extra, g, k = self.lens.pressed(m, out[:, touching], g, k, stage)
            rim = extra + _largest(g[0], h[0], k[0]) + _largest(g[1], h[1], k[1])
            plane[touching] = np.minimum(plane[touching], np.minimum(whole, rim))
        bound = value + plane + rest
        # Where terms cancel, or a box sticks out of the lens, it is their sizes that count.
        score = [(np.abs(g) + size * h / 2) * h for g, size, h in (
            (ga, curve.sizes[0] + sizes, ha), (gb, curve.sizes[0] + sizes, hb))]
        if self.powers is not None:
            bound += _largest(curve.gp, half[2], curve.bend_power)
            score.append((np.abs(curve.gp) + curve.sizes[1] * half[2] / 2) * half[2])
        return value, bound, np.stack(score)

    def _outside(self, function: Index, centre: Array, half: Array) -> NDArray[np.bool_]:
        """Return whether the boxes stick out of the disc about the start, and the goal's."""
        lens, stage = self.lens, self.stage[function]
        across = (np.abs(centre[1]) + half[1])**2
        return np.stack(
            [(np.abs(centre[0]) + half[0])**2 + across > lens.from_start[stage]**2,
             (np.abs(centre[0] - lens.distance) + half[0])**2 + across > lens.to_goal[stage]**2])


def _largest(slope: Array, half: Array, bend: Array) -> Array:
    """Return the largest slope x + bend x^2 / 2 over |x| <= half."""
    slope = np.abs(slope)
    inner = bend * half < -slope
    end = (slope + bend * half / 2) * half
    return np.where(inner, slope * slope / np.where(inner, -2 * bend, 1.0), end)


def _halves(function: Index, centre: Array, half: Array, bound: Array,
            score: Array) -> list[tuple[Index, Array, Array, Array]]:
    """Return the boxes, each cut along its worst side, in batches."""
    side = np.argmax(score, axis=0)
    column = np.arange(len(function))
    width = half[side, column] / 2
    shift = np.zeros_like(centre)
    shift[side, column] = width
    half = half.copy()
    # A box twice as small as the spacing of floats is widened to it.
    half[side, column] = width * (1 + BOX_ROUNDING) + 2e-16 * np.abs(centre[side, column])
    function, bound = np.tile(function, 2), np.tile(bound, 2)
    centre = np.concatenate([centre - shift, centre + shift], axis=1)
    half = np.tile(half, 2)
    return [(function[i:i + BATCH], centre[:, i:i + BATCH], half[:, i:i + BATCH],
             bound[i:i + BATCH]) for i in range(0, len(function), BATCH)]
