"""
The dual function on columns, smoothed, with two derivatives: what Newton's method minimises.

It is the certificate's bound with every maximum taken over columns and over a few branches, that
is breakpoints of w0 and "nothing is sent", and smoothed to tau log sum exp(. / tau). Columns of
several jammers are combined, so that their noise is known exactly: lemma 8, with shares in boxes,
comes close to that, and multipliers that are good for a few shares are not. It is jointly convex
in the potentials, v and lam. v has a barrier at 0 where there are several eavesdroppers, w0 - s
and lam have weak ones of their own: at a high SNR w0 - s is of the order of 1e-3 and below.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .columns import Columns, Combinations
from .newton import DualDerivatives, DualPoint
from ..proof.conjugate import Array, entropy, mixing, transmit_power
from ..proof.team import Team
from ...model.kernel import core

SHARE_BARRIER, ROOM_BARRIER, PRICE_BARRIER = 0.3, 1e-6, 1e-7
"""Barriers of v, times tau, of w0 - s, and of lam, in nats."""


BLUNT = 0.3
"""By how much the largest eigenvalue of S is smoothed, in nats per unit^2."""


@dataclass(frozen=True, eq=False)
class Branch:
    """
    One way a slot can be: a breakpoint of w0, and who jams whom.

    :param weight: w0, (G,).
    :param group: which of the point's v belongs to it.
    :param theta: every jammer's share at the ground node, (J, G).
    :param rho: every jammer's share at the eavesdroppers, (J, G, E).
    """

    weight: Array
    group: int
    theta: Array
    rho: Array

    def parts(self, uav: int) -> tuple[Array, Array]:
        """Return what multiplies w0, (G,), and v, (G, E), for a UAV."""
        if uav == 0:
            return np.ones_like(self.weight), np.ones(self.rho.shape[1:])
        return self.theta[uav - 1], self.rho[uav - 1]


def monomials(place: Array, quadratic: bool) -> Array:
    """Return (x, y), or (x, y, x^2/2, x y, y^2/2), at places (..., 2)."""
    x, y = place[..., 0], place[..., 1]
    return np.stack([x, y, x * x / 2, x * y, y * y / 2], -1) if quadratic else place


class Dual:
    """
    The dual function of a team on given columns.

    :param team: the UAVs.
    :param columns: for every UAV, those with which something is sent.
    :param silent: for every UAV, those without.
    :param branches: the ways a slot can be that the multipliers have to be good for.
    :param tau: temperature of every smoothed maximum, in nats.
    :ivar jammed: in every branch several jammers' combinations, which take the place of columns.
    """

    def __init__(self, team: Team, columns: list[Columns], silent: list[Columns],
                 branches: list[Branch], tau: float) -> None:
        self.team, self.branches, self.tau = team, branches, tau
        self.jammed: list[Combinations] = []
        self.columns = (columns, silent)
        self.count = team.stages.count.astype(float)
        self.average = np.array([region.average for region in team.regions])
        # How often an edge counts; the start's, at the first edge, comes on top.
        before, after = team.stages.means
        self.edge = np.zeros(len(self.count) + 1)
        self.edge[:-1] += self.count * before
        self.edge[1:] += self.count * after
        self.edge[0] += 1
        self.weights = {branch.group: branch.weight for branch in branches}

    def room(self, shares: Array) -> Array:
        """Return w0 - s of every set, (B, G)."""
        return np.array([self.weights[k] - v.sum(-1) for k, v in enumerate(shares)])

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
        for k, (v, gap) in enumerate(zip(shares, room)):
            at = slice(k * e, (k + 1) * e)
            stage[:, at] += self.count[:, None] * (-bar / v + (ROOM_BARRIER / gap)[:, None])
            stages[:, at, at] += self.count[:, None, None] * (
                (bar / v**2)[:, :, None] * np.eye(e) + (ROOM_BARRIER / gap**2)[:, None, None])
        return value, DualDerivatives(
            stage, stages, *edges, slots * (self.average - PRICE_BARRIER / prices),
            slots * PRICE_BARRIER / prices**2, (point.potentials.shape, shares.shape),
            self.count / self.tau)

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

    def _fields(self, uav: int, point: DualPoint, columns: Columns,
                branches: list[tuple[Array, Array, Array]]) -> dict[str, Any]:
        """Return what the kernel reads of a UAV: columns, potentials, branches of (w0, v, rho)."""
        potentials = point.potentials[:, uav]
        weights, shares, parts = (np.array(part, float) for part in zip(*branches))
        width = potentials.shape[1]
        fields = {
            'place': columns.place, 'power': columns.power, 'ground': columns.ground,
            'leaks': columns.leaks, 'potentials': potentials, 'count': self.count,
            'step': self.team.regions[uav].steps, 'mean': np.array(self.team.stages.means),
            'weights': weights, 'shares': shares, 'parts': parts}
        return {**{name: np.ascontiguousarray(array, float) for name, array in fields.items()},
                'curved': curved(width), 'turns': width in (4, 7), 'tau': self.tau,
                'price': float(point.prices[uav])}

    def values(self, uav: int, point: DualPoint, columns: Columns,
               branches: list[tuple[Array, Array]] | None = None) -> Array:
        """
        Return what columns are worth, (B, G, C) in nats.

        :param branches: w0 (G,) and v (G, E) of this UAV; by default one where nothing is sent.
        """
        none = np.zeros(len(self.count))
        e = columns.leaks.shape[-1]
        branches = branches or [(none, np.zeros((len(none), e)))]
        given = [(w, v, np.ones_like(v)) for w, v in branches]
        found = np.empty((len(given), *columns.power.shape))
        fields = self._fields(uav, point, columns, given)
        fields |= {'second': False, 'value': np.empty(found.shape[:2]),
                   'slope': np.zeros(0), 'hessian': np.zeros(0)}
        core.bound_column_values(fields, found)
        return found

    def _maxima(self, uav: int, point: DualPoint, silent: bool, second: bool) -> tuple[
            Array, Array, Array]:
        """Return the smoothed maxima over columns, (B, G), and their derivatives."""
        columns = self.columns[silent][uav]
        e = point.shares.shape[-1]
        none = np.zeros(len(self.count))
        branches = [(none, np.zeros((len(none), e)), np.zeros((len(none), e)))]
        if not silent:
            branches = []
            for branch in self.branches:
                ground, parts = branch.parts(uav)
                branches.append((branch.weight * ground, point.shares[branch.group], parts))
        return self._smoothed(uav, point, columns, branches, second)

    def _smoothed(self, uav: int, point: DualPoint, columns: Columns,
                  branches: list[tuple[Array, Array, Array]], second: bool) -> tuple[
                      Array, Array, Array]:
        """Return the smoothed maxima of a UAV in branches of (w0, v, rho)."""
        size = point.shares.shape[-1] + 2 * point.potentials.shape[2] + 1
        shape = (len(branches), len(self.count))
        value = np.empty(shape)
        slope, hessian = (np.empty(shape + more if second else 0)
                          for more in ((size,), (size, size)))
        core.bound_smooth_maxima({
            **self._fields(uav, point, columns, branches), 'second': second, 'value': value,
            'slope': slope, 'hessian': hessian})
        return value, slope, hessian

    def _stages(self, point: DualPoint, second: bool) -> tuple[float, Array, Array]:
        """Return value, gradient and Hessian of the stages' smoothed maxima."""
        u, p = point.potentials.shape[1:]
        e, sets = point.shares.shape[-1], len(point.shares)
        size = e + 2 * u * p + u
        options = [(*self._powers(branch, point, size, second), branch.group)
                   for branch in self.branches]
        g = len(self.count)
        options.append((np.zeros(g), np.zeros((g, size)) if second else np.zeros(0),
                        np.zeros((g, size, size)) if second else np.zeros(0), -1))
        values = np.array([option[0] for option in options])
        for k, some in enumerate(self.jammed):
            more, slope, bend = self._of_jammers(self.branches[k], some, point, second)
            values[k] += more
            if second:
                options[k][1][:] += slope
                options[k][2][:] += bend
        for i in range(u):
            lists = [(self._maxima(i, point, True, second), options[-1:], values[-1:])]
            if not (self.jammed and i):
                lists.append((self._maxima(i, point, False, second), options[:-1], values[:-1]))
            which = self._unknowns(i, point)
            for found, into, value in lists:
                value += found[0]
                for k, (_, grad, hess, _) in enumerate(into if second else []):
                    grad[:, which] += found[1][k]
                    hess[:, which[:, None], which] += found[2][k]
        top = values.max(0)
        mix = np.exp((values - top) / self.tau)
        total = mix.sum(0)
        mix /= total
        best = float(self.count @ (top + self.tau * np.log(total)))
        if not second:
            return best, values, values
        ve = sets * e
        stage = np.zeros((g, ve + size - e))
        stages = np.zeros(stage.shape + stage.shape[1:])
        for (_, grad, hess, k), share in zip(options, mix):
            where = np.r_[k * e:(k + 1) * e, ve:ve + size - e] if k >= 0 else np.r_[
                ve:ve + size - e]
            source = slice(0, size) if k >= 0 else slice(e, size)
            slope = grad[:, source]
            stage[:, where] += share[:, None] * slope
            stages[:, where[:, None], where] += share[:, None, None] * (
                hess[:, source, source] + slope[:, :, None] * slope[:, None] / self.tau)
        stages -= stage[:, :, None] * stage[:, None] / self.tau
        return best, stage * self.count[:, None], stages * self.count[:, None, None]

    @staticmethod
    def _unknowns(i: int, point: DualPoint) -> NDArray[np.intp]:
        """Return where v and UAV i's potentials and price are among a stage's unknowns."""
        (u, p), e = point.potentials.shape[1:], point.shares.shape[-1]
        return np.r_[0:e, e + i * p:e + (i + 1) * p,
                     e + (u + i) * p:e + (u + i + 1) * p, e + 2 * u * p + i]

    def worth(self, some: Combinations, point: DualPoint, weight: Array, v: Array) -> Array:
        """Return what combinations are worth at w0 and v (G, E) but for a constant, (G, C)."""
        factor = np.concatenate([-weight[:, None], v], 1)
        pull = np.diff(point.potentials[..., :2], axis=0) / self.count[:, None, None]
        return np.asarray(np.matmul(some.rates, factor[..., None])[..., 0] + sum(
            np.matmul(place, pull[:, i, :, None])[..., 0] - point.prices[i] * power
            for i, (place, power) in enumerate(zip(some.place, some.power), 1)))

    def _of_jammers(self, branch: Branch, some: Combinations, point: DualPoint,
                    second: bool) -> tuple[Array, Array, Array]:
        """Return the smoothed maximum over combinations, (G,), with derivatives as in _powers."""
        v, (u, p), g = point.shares[branch.group], point.potentials.shape[1:], len(self.count)
        e, at = v.shape[-1], some.place / self.count[:, None, None]
        size, worth = e + 2 * u * p + u, self.worth(some, point, branch.weight, v)
        # What linear potentials cost is the same everywhere: as in a list of the origin.
        origin = Columns(*(np.zeros((g, 1, *more)) for more in ((2,), (), (), (e,))))
        costs = [self._smoothed(i, point, origin, [(np.zeros(g), 0 * v, 0 * v)], second)
                 for i in range(1, u)]
        top = worth.max(1)
        mix = np.exp((worth - top[:, None]) / self.tau)
        total = mix.sum(1)
        value = top + self.tau * np.log(total) + sum(cost[0][0] for cost in costs)
        if not second:
            return value, top, top
        mix /= total[:, None]
        rows = np.zeros((*worth.shape, size))
        rows[..., :e] = some.rates[..., 1:]
        for i in range(1, u):
            before, after = e + i * p, e + (u + i) * p
            rows[..., before:before + 2], rows[..., after:after + 2] = -at[i - 1], at[i - 1]
            rows[..., e + 2 * u * p + i] = -some.power[i - 1]
        grad = np.matmul(mix[:, None], rows)[:, 0]
        hess = (np.matmul((rows * mix[..., None]).transpose(0, 2, 1), rows)
                - grad[:, :, None] * grad[:, None]) / self.tau
        for i, (_, slope, bend) in enumerate(costs, 1):
            which = self._unknowns(i, point)
            grad[:, which] += slope[0]
            hess[:, which[:, None], which] += bend[0]
        return value, grad, hess

    def _powers(self, branch: Branch, point: DualPoint, size: int,
                second: bool) -> tuple[Array, Array, Array]:
        """Return entropies and the transmit power's maximum in a branch, with derivatives."""
        team = self.team
        v = point.shares[branch.group]
        s = v.sum(-1)
        room = branch.weight - s
        e, price, peak = v.shape[-1], point.prices[0], team.regions[0].peak
        value, power = transmit_power(room, price, peak)
        kappa = mixing(branch.rho) if team.jammers else np.zeros_like(v)
        value = value - entropy(s) + entropy(branch.weight) + (v * kappa).sum(-1)
        if team.jammers:
            value -= branch.weight * mixing(branch.theta)
        if not second:
            return value, np.zeros(0), np.zeros(0)
        grad, hess = np.zeros((len(s), size)), np.zeros((len(s), size, size))
        la = size - len(team.regions)
        inner = power < peak * (1 - 1e-12)
        grad[:, :e] = (np.log(s / (1 - s)) - np.log(power))[:, None] + kappa
        grad[:, la] = -power
        hess[:, :e, :e] = (1 / (s * (1 - s)) + inner / room)[:, None, None]
        hess[:, :e, la] = hess[:, la, :e] = (inner / price)[:, None]
        hess[:, la, la] = inner * room / price**2
        return value, grad, hess


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
