"""
The dual function on columns, smoothed, with two derivatives: what Newton's method minimises.

It is the certificate's bound with every maximum taken over columns and over a few branches, that
is nodes of w0 and "nothing is sent", and smoothed to tau log sum exp(. / tau). It is jointly
convex in the potentials, v and lam. v has a barrier at 0 where there are several witnesses, w0 - s
and lam have weak ones of their own: at a high SNR w0 - s is of the order of 1e-3 and below.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from .columns import Columns
from .conjugate import Array, entropy, transmit_power
from .newton import Derivatives, Point
from .team import Team

SHARE_BARRIER, ROOM_BARRIER, PRICE_BARRIER = 0.3, 1e-6, 1e-7
"""Barriers of v, times tau, of w0 - s, and of lam, in nats."""


BLUNT = 0.3
"""By how much the largest eigenvalue of S is smoothed, in nats per unit^2."""


@dataclass(frozen=True, eq=False)
class Branch:
    """
    One way a slot can be: a node of w0 and, with two jammers, of rho.

    :param weight: w0, (G,).
    :param group: which of the point's v belongs to it.
    :param theta: the first jammer's share at the ground node, (G,); 1 for one jammer.
    :param rho: the first jammer's share at the eavesdropper, (G,); 1 for one jammer.
    """

    weight: Array
    group: int
    theta: Array
    rho: Array

    def parts(self, uav: int) -> tuple[Array, Array]:
        """Return what multiplies w0 and v for a UAV, (G,) each."""
        if uav == 0:
            return np.ones_like(self.theta), np.ones_like(self.theta)
        return (self.theta, self.rho) if uav == 1 else (1.0 - self.theta, 1.0 - self.rho)


def monomials(place: Array, count: int) -> Array:
    """Return the first 2 or all 5 of (x, y, x^2/2, x y, y^2/2) at places (..., 2)."""
    x, y = place[..., 0], place[..., 1]
    return place if count == 2 else np.stack([x, y, x * x / 2, x * y, y * y / 2], -1)


class Dual:
    """
    The dual function of a team on given columns.

    :param team: the UAVs.
    :param columns: for every UAV, those with which something is sent.
    :param silent: for every UAV, those without.
    :param branches: nodes of w0 that the multipliers have to be good for.
    :param tau: temperature of every smoothed maximum, in nats.
    """

    def __init__(self, team: Team, columns: list[Columns], silent: list[Columns],
                 branches: list[Branch], tau: float) -> None:
        self.team, self.branches, self.tau = team, branches, tau
        self.columns = (columns, silent)
        self.count = team.stages.count.astype(float)
        self.average = np.array([lens.average for lens in team.lenses])
        self.mean = shares = team.stages.means
        # How often an edge's T counts; the start's, at the first edge, comes on top.
        self.edge = np.zeros(len(self.count) + 1)
        self.edge[:-1] += self.count * shares[0]
        self.edge[1:] += self.count * shares[1]
        self.edge[0] += 1
        self.weights = {branch.group: branch.weight for branch in branches}
        self._monomials: dict[tuple[int, int], Array] = {}

    def room(self, shares: Array) -> Array:
        """Return w0 - s of every set, (B, G)."""
        return np.array([self.weights[k] - v.sum(-1) for k, v in enumerate(shares)])

    def value(self, point: Point) -> float:
        """Return the dual function, N times a rate in nats."""
        return self._evaluate(point, False)[0]

    def derivatives(self, point: Point) -> tuple[float, Derivatives]:
        """Return the dual function with its gradient and its Hessian."""
        value, derivatives = self._evaluate(point, True)
        assert derivatives is not None
        return value, derivatives

    def _evaluate(self, point: Point, second: bool) -> tuple[float, Derivatives | None]:
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
        return value, Derivatives(
            stage, stages, *edges, slots * (self.average - PRICE_BARRIER / prices),
            slots * PRICE_BARRIER / prices**2, (point.potentials.shape, shares.shape),
            self.count / self.tau)

    def _edges(self, point: Point) -> tuple[float, tuple[Array, Array]]:
        """Return value, gradient and Hessian of what is outside the stages: lengths and ends."""
        x = point.potentials
        count, u, p = x.shape
        value = 0.0
        grad, hess = np.zeros((count, u, p)), np.zeros((count, u * p, u * p))
        for i, lens in enumerate(self.team.lenses):
            delta = self.tau / lens.step
            # Without S the T of every edge is a length; with S only the start's is one.
            times = self.edge if p == 2 else np.eye(1, count)[0]
            slope = x[:, i, :2]
            norm = np.sqrt((slope * slope).sum(-1) + delta * delta)
            value += float(lens.step * (times @ norm))
            factor = lens.step * times / norm
            grad[:, i, :2] += factor[:, None] * slope
            two = slice(i * p, i * p + 2)
            hess[:, two, two] += factor[:, None, None] * (
                np.eye(2) - slope[:, :, None] * slope[:, None] / (norm * norm)[:, None, None])
            goal = monomials(np.array([lens.distance, 0.0]), p)
            value -= float(goal @ x[-1, i])
            grad[-1, i] -= goal
            if p == 5:
                jump, slope, second = _jump(x[:, i, 2:])
                factor = lens.step**2 / 2 * self.edge
                value += float(factor @ jump)
                grad[:, i, 2:] += factor[:, None] * slope
                three = slice(i * p + 2, i * p + 5)
                hess[:, three, three] += factor[:, None, None] * second
        return value, (grad.reshape(count, -1), hess)

    def potential(self, uav: int, point: Point, place: Array, second: bool = False,
                  phi: Array | None = None) -> tuple[Array, list[Array], list[Any]]:
        """
        Return a potential's terms at places (G, C, 2).

        :param phi: the monomials of the places where they are known.
        :return: values (G, C); with `second` their derivatives by the potentials at the edge
            before and at the edge after, (G, C, P) each, and the second derivatives of the
            norms as pairs of a factor and of vectors whose squares they are.
        """
        x = point.potentials[:, uav]
        p = x.shape[1]
        step = self.team.lenses[uav].step
        phi = monomials(place, p) if phi is None else phi
        value = np.matmul(phi, (np.diff(x, axis=0) / self.count[:, None])[..., None])[..., 0]
        count = self.count[:, None, None]
        parts = [-phi / count, phi / count] if second else []
        curves: list[Any] = []
        for edge, factor in enumerate(self.mean):
            if p == 2 or not factor.any():
                curves.append(None)
                continue
            px, py = place[..., 0], place[..., 1]
            u = x[edge:len(x) - 1 + edge, :, None]
            g0 = u[:, 0] + u[:, 2] * px + u[:, 3] * py
            g1 = u[:, 1] + u[:, 3] * px + u[:, 4] * py
            delta = self.tau / step
            norm = np.sqrt(g0 * g0 + g1 * g1 + delta * delta)
            f = (factor * step)[:, None]
            value = value + f * (norm - delta)
            if not second:
                continue
            n0, n1, small = g0 / norm, g1 / norm, delta / norm
            none = np.zeros_like(small)
            parts[edge] = parts[edge] + f[..., None] * _chain(n0, n1, px, py)
            # I - n n' = t t' + (delta / norm)^2 I with t across n.
            curves.append((f / norm, [_chain(-n1, n0, px, py), _chain(small, none, px, py),
                                      _chain(none, small, px, py)]))
        return value, parts, curves

    def _stages(self, point: Point, second: bool) -> tuple[float, Array, Array]:
        """Return value, gradient and Hessian of the stages' smoothed maxima."""
        u, p = point.potentials.shape[1:]
        e, sets = point.shares.shape[-1], len(point.shares)
        size = e + 2 * u * p + u
        table = [[self._features(i, point, kind, second) for i in range(u)] for kind in (0, 1)]
        options: list[tuple[Array, Array, Array, int]] = []
        for branch in self.branches:
            value, grad, hess = self._powers(branch, point, size, second)
            for i in range(u):
                ground, leak = branch.parts(i)
                v = point.shares[branch.group] * leak[:, None]
                column = table[0][i][0] + self.columns[0][i].value(
                    branch.weight * ground, v, point.prices[i])
                value = value + self._smooth(column, table[0][i], i, p, e, leak, grad, hess)
            options.append((value, grad, hess, branch.group))
        shape = (len(self.count), size) if second else (0, 0)
        grad, hess = np.zeros(shape), np.zeros(shape + shape[1:])
        value = np.zeros(len(self.count))
        for i in range(u):
            value = value + self._smooth(table[1][i][0], table[1][i], i, p, e, None, grad, hess)
        options.append((value, grad, hess, -1))
        values = np.array([option[0] for option in options])
        top = values.max(0)
        mix = np.exp((values - top) / self.tau)
        total = mix.sum(0)
        mix /= total
        best = float(self.count @ (top + self.tau * np.log(total)))
        if not second:
            return best, grad, hess
        ve = sets * e
        stage = np.zeros((len(self.count), ve + size - e))
        stages = np.zeros(stage.shape + stage.shape[1:])
        for (_, grad, hess, k), share in zip(options, mix):
            where = np.r_[k * e:(k + 1) * e, ve:ve + size - e] if k >= 0 else np.r_[
                ve:ve + size - e]
            source = slice(0, size) if k >= 0 else slice(e, size)
            g = grad[:, source]
            stage[:, where] += share[:, None] * g
            stages[:, where[:, None], where] += share[:, None, None] * (
                hess[:, source, source] + g[:, :, None] * g[:, None] / self.tau)
        stages -= stage[:, :, None] * stage[:, None] / self.tau
        return best, stage * self.count[:, None], stages * self.count[:, None, None]

    def _features(self, i: int, point: Point, kind: int, second: bool) -> tuple[
            Array, Array | None, list[Any]]:
        """Return a potential's values at the columns, and all columns' derivatives."""
        columns = self.columns[kind][i]
        p = point.potentials.shape[2]
        if (kind, i) not in self._monomials:
            self._monomials[kind, i] = monomials(columns.place, p)
        value, parts, curves = self.potential(i, point, columns.place, second,
                                              self._monomials[kind, i])
        if not second:
            return value, None, curves
        if kind == 0:
            parts = [columns.leaks, *parts, -columns.power[..., None]]
        return value, np.concatenate(parts, -1), curves

    def _powers(self, branch: Branch, point: Point, size: int,
                second: bool) -> tuple[Array, Array, Array]:
        """Return entropies and the transmit power's maximum in a branch, with derivatives."""
        team = self.team
        s = point.shares[branch.group].sum(-1)
        room = branch.weight - s
        e, price, peak = point.shares.shape[-1], point.prices[0], team.lenses[0].peak
        value, power = transmit_power(room, price, peak)
        value = value - entropy(s) + entropy(branch.weight)
        kappa: Array | float = 0.0
        if team.jammers == 2:
            kappa = entropy(branch.rho) - np.log(2)
            value += branch.weight * (np.log(2) - entropy(branch.theta)) + s * kappa
        if not second:
            return value, np.zeros((0, 0)), np.zeros((0, 0, 0))
        grad, hess = np.zeros((len(s), size)), np.zeros((len(s), size, size))
        la = size - len(team.lenses)
        inner = power < peak * (1 - 1e-12)
        grad[:, :e] = (np.log(s / (1 - s)) - np.log(power) + kappa)[:, None]
        grad[:, la] = -power
        hess[:, :e, :e] = (1 / (s * (1 - s)) + inner / room)[:, None, None]
        hess[:, :e, la] = hess[:, la, :e] = (inner / price)[:, None]
        hess[:, la, la] = inner * room / price**2
        return value, grad, hess

    def _smooth(self, value: Array, table: tuple[Array, Array | None, list[Any]], i: int, p: int,
                e: int, leak: Array | None, grad: Array, hess: Array) -> Array:
        """Return tau log sum exp(value / tau) and add its derivatives; leak None is silence."""
        top = value.max(1)
        weight = np.exp((value - top[:, None]) / self.tau)
        total = weight.sum(1)
        result = top + self.tau * np.log(total)
        _, features, curves = table
        if features is None:
            return np.asarray(result)
        weight /= total[:, None]
        up = len(self.team.lenses) * p
        edges = np.r_[e + i * p:e + (i + 1) * p, e + up + i * p:e + up + (i + 1) * p]
        which = edges if leak is None else np.r_[0:e, edges, e + 2 * up + i]
        mean = np.matmul(weight[:, None], features)[:, 0]
        cov = np.matmul((features * weight[..., None]).transpose(0, 2, 1), features)
        cov -= mean[:, :, None] * mean[:, None]
        cov /= self.tau
        if leak is not None:
            mean[:, :e] *= leak[:, None]
            cov[:, :e] *= leak[:, None, None]
            cov[:, :, :e] *= leak[:, None, None]
        grad[:, which] += mean
        hess[:, which[:, None], which] += cov
        for edge, curve in enumerate(curves):
            if curve is not None:
                at = edges[edge * p:(edge + 1) * p]
                for t in curve[1]:
                    hess[:, at[:, None], at] += np.matmul(
                        (t * (weight * curve[0])[..., None]).transpose(0, 2, 1), t)
        return np.asarray(result)


def _chain(g0: Array, g1: Array, x: Array, y: Array) -> Array:
    """Return the derivative by (u, S) of g . (u + S q), (..., 5)."""
    return np.stack([g0, g1, g0 * x, g0 * y + g1 * x, g1 * y], -1)


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
