"""
The dual function on columns, smoothed, with two derivatives: what Newton's method minimises.

It is the certificate's bound with every maximum taken over columns and over two branches, that is
one breakpoint of w0 and "nothing is sent", and smoothed to tau log sum exp(. / tau). It is jointly
convex in the potentials, v and lam. v has a barrier at 0 where there are several eavesdroppers,
w0 - s and lam have weak ones of their own: at a high SNR w0 - s is of the order of 1e-3 and below.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from .columns import Columns
from .newton import DualDerivatives, DualPoint
from ..proof.conjugate import Array, entropy, transmit_power
from ..proof.team import Team
from ...model.kernel import core

SHARE_BARRIER, ROOM_BARRIER, PRICE_BARRIER = 0.3, 1e-6, 1e-7
"""Barriers of v, times tau, of w0 - s, and of lam, in nats."""


BLUNT = 0.3
"""By how much the largest eigenvalue of S is smoothed, in nats per unit^2."""


def monomials(place: Array, quadratic: bool) -> Array:
    """Return (x, y), or (x, y, x^2/2, x y, y^2/2), at places (..., 2)."""
    x, y = place[..., 0], place[..., 1]
    return np.stack([x, y, x * x / 2, x * y, y * y / 2], -1) if quadratic else place


class Dual:
    """
    The dual function of a team on given columns.

    :param team: the UAVs.
    :param weight: w0 of the breakpoint that the multipliers have to be good for, (G,).
    :param columns: of every UAV.
    :param silent: for every UAV, those with which nothing is sent.
    :param tau: temperature of every smoothed maximum, in nats.
    """

    def __init__(self, team: Team, weight: Array, columns: list[Columns],
                 silent: list[Columns], tau: float) -> None:
        self.team, self.weight, self.tau = team, weight, tau
        self.columns, self.silent = columns, silent
        self.count = team.stages.count.astype(float)
        self.average = np.array([region.average for region in team.regions])
        # How often an edge counts; the start's, at the first edge, comes on top.
        before, after = team.stages.means
        self.edge = np.zeros(len(self.count) + 1)
        self.edge[:-1] += self.count * before
        self.edge[1:] += self.count * after
        self.edge[0] += 1

    def room(self, shares: Array) -> Array:
        """Return w0 - s, (G,)."""
        return np.asarray(self.weight - shares.sum(-1))

    def value(self, point: DualPoint) -> float:
        """Return the dual function, N times a rate in nats."""
        return self._evaluate(point, False)[0]

    def derivatives(self, point: DualPoint) -> tuple[float, DualDerivatives]:
        """Return the dual function with its gradient and its Hessian."""
        value, derivatives = self._evaluate(point, True)
        assert derivatives is not None
        return value, derivatives

    def _evaluate(self, point: DualPoint, second: bool) -> tuple[float, DualDerivatives | None]:
        value, stage, stages = self._stages(point, second)
        shares, prices = point.shares, point.prices
        bar = SHARE_BARRIER * (self.tau if shares.shape[-1] > 1 else 1e-5)
        room = self.room(shares)
        slots = float(self.count.sum())
        value += slots * float(prices @ self.average - PRICE_BARRIER * np.log(prices).sum())
        value -= float(((bar * np.log(shares).sum(-1) + ROOM_BARRIER * np.log(room))
                        * self.count).sum())
        edge, edges = self._edges(point)
        value += edge
        if not second:
            return value, None
        e = shares.shape[-1]
        stage[:, :e] += self.count[:, None] * (-bar / shares + (ROOM_BARRIER / room)[:, None])
        stages[:, :e, :e] += self.count[:, None, None] * (
            (bar / shares**2)[:, :, None] * np.eye(e) + (ROOM_BARRIER / room**2)[:, None, None])
        return value, DualDerivatives(
            stage, stages, *edges, slots * (self.average - PRICE_BARRIER / prices),
            slots * PRICE_BARRIER / prices**2, self.count / self.tau)

    def _edges(self, point: DualPoint) -> tuple[float, tuple[Array, Array]]:
        """Return value, gradient and Hessian of what is outside the stages: what ends cost."""
        x = point.potentials
        count, u, p = x.shape
        value = 0.0
        grad, hess = np.zeros((count, u, p)), np.zeros((count, u * p, u * p))

        def length(i: int, firsts: tuple[int, ...], vector: Array, factor: Array) -> float:
            """Add lengths of sums (count, 2) of the unknowns from all of `firsts` on."""
            delta = self.tau / self.team.regions[i].step
            norm = np.sqrt((vector * vector).sum(-1) + delta * delta)
            share = factor / norm
            second = share[:, None, None] * (
                np.eye(2) - vector[:, :, None] * vector[:, None] / (norm * norm)[:, None, None])
            for first in firsts:
                grad[:, i, first:first + 2] += share[:, None] * vector
                for other in firsts:
                    hess[:, i * p + first:i * p + first + 2,
                         i * p + other:i * p + other + 2] += second
            return float(factor @ norm)

        for i, region in enumerate(self.team.regions):
            # The slope of the first move: u_0, and w_1 where accelerations are limited.
            turns, (limited, at_rest) = p in (4, 7), (region.end_turns, region.end_moves)
            shorter = turns and limited[0] < region.step
            start = (limited[0] if shorter else region.step) * np.eye(1, count)[0]
            firsts = (0, p - 2) if turns else (0,)
            value += length(i, firsts, np.sum([x[:, i, at:at + 2] for at in firsts], 0), start)
            if turns:
                for at in firsts if shorter else ():
                    value += float(x[0, i, at:at + 2] @ at_rest[0])
                    grad[0, i, at:at + 2] += at_rest[0]
                value -= float(x[-1, i, -2:] @ at_rest[1])
                grad[-1, i, -2:] -= at_rest[1]
                last = max(limited[1] - region.turn, 0.0) * np.eye(1, count)[0][::-1]
                value += length(i, (p - 2,), x[:, i, -2:], region.turn * self.edge + last)
            goal = monomials(np.array([region.distance, 0.0]), curved(p))
            value -= float(goal @ x[-1, i, :len(goal)])
            grad[-1, i, :len(goal)] -= goal
            if curved(p):
                jump, slope, second = _jump(x[:, i, 2:5])
                factor = np.append(region.step, region.steps)**2 / 2 * self.edge
                value += float(factor @ jump)
                grad[:, i, 2:5] += factor[:, None] * slope
                three = slice(i * p + 2, i * p + 5)
                hess[:, three, three] += factor[:, None, None] * second
        return value, (grad.reshape(count, -1), hess)

    def _stages(self, point: DualPoint, second: bool) -> tuple[float, Array, Array]:
        """Return value, gradient and Hessian of the stages' smoothed maxima."""
        u, p = point.potentials.shape[1:]
        g, e = point.shares.shape
        size = e + 2 * u * p + u
        # Of the two branches: w0, and nothing sent.
        values, grads, bends = (np.zeros((2, g, *more) if second or not more else 0)
                                for more in ((), (size,), (size, size)))
        values[0], *more = self._powers(point.shares, point.prices[0], size, second)
        if second:
            grads[0], bends[0] = more
        sent, none = (self.weight, point.shares), (np.zeros(g), np.zeros((g, e)))
        lists = [(1, i, some, none) for i, some in enumerate(self.silent)]
        lists += [(0, i, some, sent) for i, some in enumerate(self.columns)]
        for k, i, columns, (weight, v) in lists:
            which = self._unknowns(i, point)
            own = len(which)
            value, slope, bend = (np.empty((g, *more) if second or not more else 0)
                                  for more in ((), (own,), (own, own)))
            core.bound_smooth_maxima(column_fields(
                self.team, i, point, columns, weight, v, self.tau),
                value, slope, bend)
            values[k] += value
            if second:
                grads[k][:, which] += slope
                bends[k][:, which[:, None], which] += bend
        top = values.max(0)
        mix = np.exp((values - top) / self.tau)
        total = mix.sum(0)
        mix /= total
        best = float(self.count @ (top + self.tau * np.log(total)))
        if not second:
            return best, values, values
        stage = (mix[..., None] * grads).sum(0)
        stages = sum(share[:, None, None] * (bend + grad[:, :, None] * grad[:, None] / self.tau)
                     for share, grad, bend in zip(mix, grads, bends))
        stages = stages - stage[:, :, None] * stage[:, None] / self.tau
        return best, stage * self.count[:, None], stages * self.count[:, None, None]

    @staticmethod
    def _unknowns(i: int, point: DualPoint) -> NDArray[np.intp]:
        """Return where v and UAV i's potentials and price are among a stage's unknowns."""
        (u, p), e = point.potentials.shape[1:], point.shares.shape[-1]
        own = e + p * i + np.arange(p)
        return np.r_[0:e, own, own + u * p, e + 2 * u * p + i]

    def _powers(self, v: Array, price: float, size: int, second: bool) -> tuple[
            Array, Array, Array]:
        """Return entropies and the transmit power's maximum, with derivatives."""
        s, peak = v.sum(-1), self.team.regions[0].peak
        room, e = self.room(v), v.shape[-1]
        value, power = transmit_power(room, price, peak)
        value = value - entropy(s) + entropy(self.weight)
        if not second:
            return value, np.zeros(0), np.zeros(0)
        grad, hess = np.zeros((len(s), size)), np.zeros((len(s), size, size))
        la = size - len(self.team.regions)
        inner = power < peak * (1 - 1e-12)
        grad[:, :e] = (np.log(s / (1 - s)) - np.log(power))[:, None]
        grad[:, la] = -power
        hess[:, :e, :e] = (1 / (s * (1 - s)) + inner / room)[:, None, None]
        hess[:, :e, la] = hess[:, la, :e] = (inner / price)[:, None]
        hess[:, la, la] = inner * room / price**2
        return value, grad, hess


def column_fields(team: Team, uav: int, point: DualPoint, columns: Columns, weight: Array,
                  shares: Array, tau: float = 1e-9) -> dict[str, Any]:
    """
    Return what the kernel reads: columns of a UAV, its potential, and w0 and v.

    :param weight: w0 of this UAV, (G,).
    :param shares: its v, (G, E).
    """
    potentials = point.potentials[:, uav]
    fields = {
        'place': columns.place, 'power': columns.power, 'ground': columns.ground,
        'leaks': columns.leaks, 'potentials': potentials, 'count': team.stages.count,
        'step': team.regions[uav].steps, 'mean': team.stages.means, 'weights': weight,
        'shares': shares}
    width = potentials.shape[1]
    return {**{name: np.ascontiguousarray(array, float) for name, array in fields.items()},
            'curved': curved(width), 'turns': width in (4, 7), 'tau': tau,
            'price': float(point.prices[uav])}


def curved(width: int) -> bool:
    """Return whether potentials of so many entries have a quadratic part."""
    return width >= 5


def unpacked(x: Array) -> tuple[Array, Array, Array]:
    """Return u, S and w, zero where there are none, of potentials (..., P)."""
    none = np.zeros(x.shape[:-1] + (3,))
    return (x[..., :2], x[..., 2:5] if curved(x.shape[-1]) else none,
            x[..., -2:] if x.shape[-1] in (4, 7) else none[..., :2])


def _jump(bend: Array) -> tuple[Array, Array, Array]:
    """Return max(0, the largest eigenvalue of S), smoothed, for S (G, 3), with derivatives."""
    h, b = (bend[:, 0] - bend[:, 2]) / 2, bend[:, 1]
    r = np.sqrt(h * h + b * b + BLUNT**2)
    largest = (bend[:, 0] + bend[:, 2]) / 2 + r
    root = np.sqrt(largest * largest + BLUNT**2)
    first = (1 + largest / root) / 2
    slope = np.stack([0.5 + h / (2 * r), b / r, 0.5 - h / (2 * r)], -1)
    # The second derivatives of r by h and b, and by S through them.
    move = np.array([[0.5, 0.0, -0.5], [0.0, 1.0, 0.0]])
    way = np.stack([h, b], -1) / r[:, None]
    inner = (np.eye(2) - way[:, :, None] * way[:, None]) / r[:, None, None]
    second = (first[:, None, None] * (move.T @ inner @ move)
              + (BLUNT**2 / (2 * root**3))[:, None, None] * slope[:, :, None] * slope[:, None])
    return (largest + root) / 2, first[:, None] * slope, second
