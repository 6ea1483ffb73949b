"""
Lemma 5: the maximum of one UAV's term over its lens and its powers, by branch and bound.

On a box with centre m a function F is bounded by F(q) <= F(m) + grad F(m) . (q - m) + rest, where
F - rest is concave about m ("semiconcave"). With rho the half diagonal of the box in the plane and
"near" the least d^2 + H^2 over the box, the largest eigenvalues of the second derivatives are

    of -log(d^2 + H^2):                at most min(1 / (4 H^2), 2 / near),
    of log([d - eps]+^2 + H^2):        at most 2 / near (it is C^1 at d = eps),
    of -log((d + eps)^2 + H^2):        at most min(1 / (4 H^2), 2 / near); its kink at d = 0 points
                                       upwards, so any supergradient serves there,

the first two being f'(d) / d across and f''(d) along the radius. A jammer's term is taken in
pi = log p, z = pi + log b(q): -w0 phi(z0) adds at most w0 phi'(z0) 2 / near |dq|^2 / 2, because
-phi'' is not positive; v phi(z_e) adds at most v / 2 (max phi'' (|dpi| + G |dq|)^2 + max phi'
min(1 / (4 H^2), 2 / near) |dq|^2), G = min(1 / H, 2 / (d + eps)) bounding the gradient of log b;
-lam e^pi is concave. The potential's q . S q / 2 is bounded as it is, and for its |g + S dq| with
g = u + S m both |g| + g . S dq / |g| + |S dq|^2 / (2 |g|) and |g| + g . S dq / |g| + 2 |S dq|
are bounds. The linear part is at most the box's maximum, and the lens's (Lens.support).

Second order matters: near a maximum inside the lens the number of boxes does not grow as they
shrink.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .conjugate import Array, sigmoid, softplus
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

    def maxima(self, known: Array, tolerance: Array, budget: int = 20000,
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

    def search(self, known: Array, tolerance: Array, budget: int = 20000,
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
        rho2 = ha * ha + hb * hb
        rho = np.sqrt(rho2)
        # The potential.
        slope, bend = self.slope[function], self.bend[function]
        ga, gb = slope[:, 0], slope[:, 1]
        value = ga * a + gb * b
        rest = self.margin[function]
        if bend.any():
            sa = bend[:, 0] * a + bend[:, 1] * b
            sb = bend[:, 1] * a + bend[:, 2] * b
            value += (sa * a + sb * b) / 2
            ga, gb = ga + sa, gb + sb
            rest = (rest + np.maximum(bend[:, 0], 0) * ha * ha / 2
                    + np.maximum(bend[:, 2], 0) * hb * hb / 2 + np.abs(bend[:, 1]) * ha * hb)
        for factor, tilt, matrix in self.tilts:
            f, t, s = factor[function], tilt[function], matrix[function]
            ta = t[:, 0] + s[:, 0] * a + s[:, 1] * b
            tb = t[:, 1] + s[:, 1] * a + s[:, 2] * b
            norm = np.hypot(ta, tb)
            safe = np.maximum(norm, 1e-200)
            value += f * norm
            ga = ga + f * (s[:, 0] * ta + s[:, 1] * tb) / safe
            gb = gb + f * (s[:, 1] * ta + s[:, 2] * tb) / safe
            move = np.sqrt(s[:, 0]**2 + 2 * s[:, 1]**2 + s[:, 2]**2) * rho
            rest = rest + f * move * np.minimum(2.0, move / (2 * safe))
        curve = self._channel(function, centre, half, rho, rho2)
        value = value + curve.value
        ga, gb = ga + curve.ga, gb + curve.gb
        flat_a, flat_b = np.abs(ga) * ha, np.abs(gb) * hb
        flat = flat_a + flat_b
        stage = self.stage[function]
        # Only where the box is not well inside does the lens say more than the box.
        touching = ~self._covers(stage, centre, half)
        if touching.any():
            g = np.stack([ga[touching], gb[touching]], -1)
            lens = (self.lens.support(g, stage[touching])
                    - g[:, 0] * a[touching] - g[:, 1] * b[touching])
            flat[touching] = np.minimum(flat[touching], lens)
        rest = rest + curve.rest
        share = rest / np.maximum(rho2, 1e-300)
        scores = [flat_a + share * ha * ha, flat_b + share * hb * hb]
        bound = value + flat + rest
        if self.powers is not None:
            bound += np.abs(curve.gp) * half[2] + curve.rest_power
            scores.append(np.abs(curve.gp) * half[2] + curve.rest_power)
        return value, bound, np.stack(scores)

    def _covers(self, stage: Index, centre: Array, half: Array) -> NDArray[np.bool_]:
        """Return whether the boxes lie inside both discs."""
        lens = self.lens
        across = (np.abs(centre[1]) + half[1])**2
        return np.asarray(
            ((np.abs(centre[0]) + half[0])**2 + across <= lens.from_start[stage]**2)
            & ((np.abs(centre[0] - lens.distance) + half[0])**2 + across
               <= lens.to_goal[stage]**2))

    def _channel(self, function: Index, centre: Array, half: Array, rho: Array,
                 rho2: Array) -> _Curve:
        """Return the rates' part of `bounds`; nothing where neither w0 nor v is above zero."""
        lens, weight = self.lens, self.weight[function]
        a, b = centre[0], centre[1]
        square = lens.altitude**2
        da, db = a - lens.ground[0], b - lens.ground[1]
        d2 = da * da + db * db
        q = d2 + square
        near = np.maximum(np.sqrt(d2) - rho, 0.0)**2 + square
        if self.powers is None:
            value = weight * (self.log_gain - np.log(q))
            factor = -2 * weight / q
            rest = weight * np.minimum(0.25 / square, 2 / near)
            gp = rest_power = power = np.zeros(0)
        else:
            power = centre[2]
            width = half[2]
            z = power + self.log_gain - np.log(q)
            value = -weight * softplus(z)
            use = weight * sigmoid(z)
            factor = 2 * use / q
            most = sigmoid(z + width + np.minimum(1 / lens.altitude, 2 / np.sqrt(near)) * rho)
            rest = weight * most * 2 / near
            watts = np.exp(power)
            value -= self.price * watts
            gp = -use - self.price * watts
            rest_power = np.zeros_like(value)
        ga, gb = factor * da, factor * db
        for e, (place, radius) in enumerate(zip(lens.eavesdroppers, lens.radii)):
            share = self.shares[function, e]
            log_gain = self.log_gain + lens.log_advantages[e]
            ea, eb = a - place[0], b - place[1]
            d = np.sqrt(ea * ea + eb * eb)
            safe = np.maximum(d, 1e-300)
            if self.powers is None:
                x = np.maximum(d - radius, 0.0)
                near = np.maximum(d - radius - rho, 0.0)**2 + square
                q = x * x + square
                value += share * (np.log(q) - log_gain)
                factor = share * 2 * x / (q * safe)
                rest += share * 2 / near
            else:
                x = d + radius
                least = np.maximum(d - rho, 0.0) + radius
                q = x * x + square
                z = power + log_gain - np.log(q)
                value += share * softplus(z)
                use = share * sigmoid(z)
                factor = -use * 2 * x / (q * safe)
                gp += use
                steep = np.minimum(1 / lens.altitude, 2 / np.maximum(least, 1e-300))
                reach = width + steep * rho
                inner = sigmoid(np.maximum(np.abs(z) - reach, 0.0))
                twice = share * inner * (1 - inner)
                # (|dpi| + G |dq|)^2: the two squares and the product are shared out.
                rest += twice * steep * (steep + width / np.maximum(rho, 1e-300))
                rest_power += twice * width * (width + steep * rho) / 2
                rest += share * sigmoid(z + reach) * np.minimum(
                    0.25 / square, 2 / (least * least + square))
            ga = ga + factor * ea
            gb = gb + factor * eb
        return _Curve(value, ga, gb, gp, rest * rho2 / 2, rest_power)


@dataclass(frozen=True, eq=False)
class _Curve:
    """Value and gradient at the centres of boxes, and what second derivatives can add."""

    value: Array
    ga: Array
    gb: Array
    gp: Array
    rest: Array
    rest_power: Array


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
