"""The dual function on columns, smoothed, with two derivatives: what Newton's method minimises."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import cho_solve_banded, cholesky_banded

from .columns import Columns, monomials
from .conjugate import Array, entropy, transmit_power
from .team import Team

_BARRIER_SHARE, _BARRIER_ROOM, _BARRIER_PRICE = 0.3, 1e-6, 1e-7


@dataclass(frozen=True, eq=False)
class Branch:
    """
    One way a slot can be: a node of w0 and, with two jammers, of rho.

    :param weight: w0, (G,).
    :param shares: which of the point's v belongs to it.
    :param theta: shares of the UAVs at the ground node, (U, G), 1 for the transmitter.
    :param rho: shares of the UAVs at the eavesdropper, (U,), 1 for the transmitter.
    """

    weight: Array
    shares: int
    theta: Array
    rho: Array


@dataclass(frozen=True, eq=False)
class Point:
    """
    Where the dual function is evaluated.

    :param potentials: (u, S) at every edge, (G + 1, U, P), P = 2 without S, else 5.
    :param shares: v, (B, G, E).
    :param prices: lam, (U,).
    """

    potentials: Array
    shares: Array
    prices: Array

    def moved(self, step: Point, length: float) -> Point:
        """Return this point moved along a step."""
        return Point(self.potentials + length * step.potentials,
                     self.shares + length * step.shares, self.prices + length * step.prices)


class Dual:
    """
    The dual function of a team on given columns.

    :param team: the UAVs.
    :param columns: for every UAV, those with which something is sent.
    :param places: for every UAV, those without.
    :param branches: nodes of w0 that the multipliers have to be good for.
    :param tau: temperature of every smoothed maximum, in nats.
    """

    def __init__(self, team: Team, columns: list[Columns], places: list[Columns],
                 branches: list[Branch], tau: float) -> None:
        self.team, self.branches, self.tau = team, branches, tau
        self.columns, self.places = columns, places
        self.count = team.stages.count.astype(float)
        self.before = (self.count - 1) / (2 * self.count)
        self.after = (self.count + 1) / (2 * self.count)
        self.edge = np.zeros(len(self.count) + 1)
        self.edge[:-1] += self.count * self.before
        self.edge[1:] += self.count * self.after
        self.edge[0] += 1

    def _potential(self, i: int, point: Point, place: Array, second: bool):
        """Value (G, C), derivatives by both edges (G, C, 2P), and the norms' curvature."""
        x, p = point.potentials[:, i], point.potentials.shape[2]
        step, tau = self.team.lenses[i].step, self.tau
        phi = monomials(place)[..., :p]
        k = self.count[:, None, None]
        value = np.matmul(phi, (np.diff(x, axis=0) / self.count[:, None])[..., None])[..., 0]
        parts, curves = ([-phi / k, phi / k] if second else []), []
        for edge, factor in ((0, self.before), (1, self.after)):
            if not factor.any():
                curves.append(None)
                continue
            u = x[edge:len(x) - 1 + edge]
            g0, g1 = u[:, None, 0], u[:, None, 1]
            if p == 5:
                s11, s12, s22 = (u[:, None, j] for j in (2, 3, 4))
                px, py = place[..., 0], place[..., 1]
                g0 = g0 + s11 * px + s12 * py
                g1 = g1 + s12 * px + s22 * py
            delta = tau / step
            norm = np.sqrt(g0 * g0 + g1 * g1 + delta * delta)
            f = (factor * step)[:, None]
            value = value + f * (norm - delta)
            if second:
                n0, n1 = f * g0 / norm, f * g1 / norm
                small = delta / norm
                t0, t1 = -g1 / norm, g0 / norm
                # I - n n' = t t' + (delta / norm)^2 I, as rows of (u, S).
                if p == 5:
                    zero = np.zeros_like(small)
                    parts[edge] = parts[edge] + np.stack(
                        [n0, n1, n0 * px, n0 * py + n1 * px, n1 * py], -1)
                    rows = [np.stack([t0, t1, t0 * px, t0 * py + t1 * px, t1 * py], -1),
                            np.stack([small, zero, small * px, small * py, zero], -1),
                            np.stack([zero, small, zero, small * px, small * py], -1)]
                else:
                    zero = np.zeros_like(small)
                    parts[edge] = parts[edge] + np.stack([n0, n1], -1)
                    rows = [np.stack([t0, t1], -1), np.stack([small, zero], -1),
                            np.stack([zero, small], -1)]
                curves.append((f / norm, rows))
        return value, parts, curves

    def evaluate(self, point: Point, second: bool = True):
        """Return the value, and with `second` the gradient and the Hessian in blocks."""
        team, tau = self.team, self.tau
        u, e = len(team.lenses), team.eavesdroppers
        g, p = len(self.count), point.potentials.shape[2]
        up = u * p
        size = e + 2 * up + u
        sets = len(point.shares)
        x0, la = e, e + 2 * up
        terms = [[self._potential(i, point, cols[i].place, second) for i in range(u)]
                 for cols in (self.columns, self.places)]
        features = [[], []]
        if second:
            for kind, cols in enumerate((self.columns, self.places)):
                for i in range(u):
                    parts = list(terms[kind][i][1])
                    if not kind:
                        parts = [cols[i].leaks, *parts, -cols[i].power[..., None]]
                    features[kind].append(np.concatenate(
                        [np.broadcast_to(f, cols[i].power.shape + f.shape[-1:]) for f in parts],
                        -1))

        def smooth(kind, i, value, rho, grad, hess):
            top = value.max(1)
            weight = np.exp((value - top[:, None]) / tau)
            total = weight.sum(1)
            result = top + tau * np.log(total)
            if not second:
                return result
            weight /= total[:, None]
            f = features[kind][i]
            edges = np.r_[x0 + i * p:x0 + (i + 1) * p, x0 + up + i * p:x0 + up + (i + 1) * p]
            which = edges if kind else np.r_[0:e, edges, la + i]
            mean = np.matmul(weight[:, None], f)[:, 0]
            cov = np.matmul((f * weight[..., None]).transpose(0, 2, 1), f)
            cov -= mean[:, :, None] * mean[:, None]
            cov /= tau
            if not kind and rho != 1.0:
                mean[:, :e] *= rho
                cov[:, :e] *= rho
                cov[:, :, :e] *= rho
            grad[:, which] += mean
            hess[:, which[:, None], which] += cov
            for edge, curve in enumerate(terms[kind][i][2]):
                if curve is None:
                    continue
                factor, rows = curve
                at = edges[edge * p:(edge + 1) * p]
                scaled = weight * factor if rows[0].shape[1] > 1 else factor
                for t in rows:
                    hess[:, at[:, None], at] += np.matmul(
                        (t * scaled[..., None]).transpose(0, 2, 1), t)
            return result

        options = []
        for branch in self.branches:
            v = point.shares[branch.shares]
            s = v.sum(-1)
            room = branch.weight - s
            value, power = transmit_power(room, point.prices[0], team.lenses[0].peak)
            value = value - entropy(s) + entropy(branch.weight)
            jam = team.jammers
            if jam > 1:
                theta, rho = branch.theta[1:], branch.rho[1:]
                value += branch.weight * (np.log(jam) + (theta * np.log(theta)).sum(0))
                kappa = -np.log(jam) - (rho * np.log(np.maximum(rho, 1e-300))).sum()
                value += s * kappa
            else:
                kappa = 0.0
            grad = np.zeros((g, size))
            hess = np.zeros((g, size, size)) if second else None
            if second:
                inner = power < team.lenses[0].peak * (1 - 1e-12)
                grad[:, :e] = (np.log(s / (1 - s)) - np.log(power) + kappa)[:, None]
                grad[:, la] = -power
                hess[:, :e, :e] = (1 / (s * (1 - s)) + inner / room)[:, None, None]
                hess[:, :e, la] = hess[:, la, :e] = (inner / point.prices[0])[:, None]
                hess[:, la, la] = inner * room / point.prices[0]**2
            for i in range(u):
                rho = branch.rho[i]
                column = (terms[0][i][0] + self.columns[i].value(
                    branch.weight * branch.theta[i], v * rho, point.prices[i]))
                value = value + smooth(0, i, column, rho, grad, hess)
            options.append((value, grad, hess, branch.shares))
        grad = np.zeros((g, size))
        hess = np.zeros((g, size, size)) if second else None
        value = np.zeros(g)
        for i in range(u):
            value = value + smooth(1, i, np.broadcast_to(
                terms[1][i][0], self.places[i].power.shape), 1.0, grad, hess)
        options.append((value, grad, hess, None))

        values = np.array([option[0] for option in options])
        top = values.max(0)
        mix = np.exp((values - top) / tau)
        sums = mix.sum(0)
        per = top + tau * np.log(sums)
        mix /= sums
        total = float(self.count @ per)
        # Limits that v and lam keep away from, and what lies outside the slots.
        bar = _BARRIER_SHARE * (tau if e > 1 else 1e-5)
        n = float(self.count.sum())
        average = np.array([lens.average for lens in team.lenses])
        total += n * float(point.prices @ average)
        total -= _BARRIER_PRICE * n * float(np.log(point.prices).sum())
        weights = [next(b.weight for b in self.branches if b.shares == k) for k in range(sets)]
        rooms = np.array(weights) - point.shares.sum(-1)
        total -= float(((bar * np.log(point.shares).sum(-1)
                         + _BARRIER_ROOM * np.log(rooms)) * self.count).sum())
        ends = []
        for i, lens in enumerate(team.lenses):
            x = point.potentials[:, i]
            delta = tau / lens.step
            norm = np.sqrt(x[0, 0]**2 + x[0, 1]**2 + delta**2)
            goal = monomials(np.array([lens.distance, 0.0]))[:p]
            total += lens.step * norm - float(goal @ x[-1])
            frob = jump = None
            if p == 5:
                jump = lens.step**2 / 2 * self.edge
                frob = np.sqrt(x[:, 2]**2 + 2 * x[:, 3]**2 + x[:, 4]**2 + 1e-4)
                total += float(jump @ frob)
            ends.append((x, norm, goal, jump, frob))
        if not second:
            return total, per, values
        # Everything of a stage: the sets' v, then the edges' potentials, then lam.
        ve = sets * e
        big = np.zeros((g, ve + 2 * up + u))
        matrix = np.zeros((g, ve + 2 * up + u, ve + 2 * up + u))
        rest = np.r_[e:size]
        target_rest = np.r_[ve:ve + 2 * up + u]
        for (_, grad, hess, index), share in zip(options, mix):
            where = (np.r_[index * e:(index + 1) * e, target_rest] if index is not None
                     else target_rest)
            source = np.r_[0:size] if index is not None else rest
            gs = grad[:, source]
            big[:, where] += share[:, None] * gs
            block = hess[:, source[:, None], source] + gs[:, :, None] * gs[:, None] / tau
            matrix[:, where[:, None], where] += share[:, None, None] * block
        matrix -= big[:, :, None] * big[:, None] / tau
        matrix *= self.count[:, None, None]
        big *= self.count[:, None]
        for k in range(sets):
            at = np.r_[k * e:(k + 1) * e]
            v, room = point.shares[k], rooms[k]
            big[:, at] += self.count[:, None] * (-bar / v + (_BARRIER_ROOM / room)[:, None])
            matrix[:, at[:, None], at] += self.count[:, None, None] * (
                (bar / v**2)[:, :, None] * np.eye(e)
                + (_BARRIER_ROOM / room**2)[:, None, None])
        return total, per, values, self._assemble(point, big, matrix, ends, ve)

    def _assemble(self, point, big, matrix, ends, ve):
        team = self.team
        u = len(team.lenses)
        g, p = len(self.count), point.potentials.shape[2]
        up = u * p
        n = float(self.count.sum())
        average = np.array([lens.average for lens in team.lenses])
        edges = np.zeros((g + 1, up))
        diagonal = np.zeros((g + 1, up, up))
        for i, (x, norm, goal, jump, frob) in enumerate(ends):
            at = slice(i * p, (i + 1) * p)
            step = team.lenses[i].step
            edges[0, i * p:i * p + 2] += step * x[0, :2] / norm
            diagonal[0, i * p:i * p + 2, i * p:i * p + 2] += step * (
                np.eye(2) / norm - np.outer(x[0, :2], x[0, :2]) / norm**3)
            edges[-1, at] -= goal
            if p == 5:
                weight = np.array([1.0, 2.0, 1.0])
                s = x[:, 2:] * weight
                three = slice(i * p + 2, i * p + 5)
                edges[:, three] += jump[:, None] * s / frob[:, None]
                diagonal[:, three, three] += jump[:, None, None] * (
                    np.diag(weight) / frob[:, None, None]
                    - s[:, :, None] * s[:, None] / frob[:, None, None]**3)
        prices = n * average - _BARRIER_PRICE * n / point.prices
        curve = np.diag(_BARRIER_PRICE * n / point.prices**2)
        return Newton(big, matrix, edges, diagonal, prices, curve, ve, u, p, len(point.shares))


class Newton:
    """The gradient and the Hessian in blocks, and Newton's step."""

    def __init__(self, big, matrix, edges, diagonal, prices, curve, ve, u, p, sets):
        self.sets = sets
        self.big, self.matrix, self.ve, self.u, self.p = big, matrix, ve, u, p
        up = u * p
        self.edges = edges
        edges[:-1] += big[:, ve:ve + up]
        edges[1:] += big[:, ve + up:ve + 2 * up]
        self.prices = prices + big[:, ve + 2 * up:].sum(0)
        self.diagonal, self.curve = diagonal, curve

    def slope(self, step: Point) -> float:
        """Directional derivative along a step."""
        shares = step.shares.transpose(1, 0, 2).reshape(len(self.big), -1)
        return float((self.edges * step.potentials.reshape(len(self.edges), -1)).sum()
                     + (self.big[:, :self.ve] * shares).sum() + self.prices @ step.prices)

    def step(self, damping: float = 1e-9) -> Point:
        """Return Newton's step."""
        ve, up, u = self.ve, self.u * self.p, self.u
        g = len(self.big)
        vv = self.matrix[:, :ve, :ve]
        vv = vv + (damping * np.einsum('gii->gi', vv) + 1e-12)[:, :, None] * np.eye(ve)
        vr = self.matrix[:, :ve, ve:]
        solved = np.linalg.solve(vv, np.concatenate([vr, self.big[:, :ve, None]], -1))
        local = self.matrix[:, ve:, ve:] - np.matmul(vr.transpose(0, 2, 1), solved[..., :-1])
        pull = np.matmul(vr.transpose(0, 2, 1), solved[..., -1:])[..., 0]
        diagonal = self.diagonal.copy()
        diagonal[:-1] += local[:, :up, :up]
        diagonal[1:] += local[:, up:2 * up, up:2 * up]
        off = local[:, up:2 * up, :up]                      # rows: edge g + 1, columns: edge g
        edges = self.edges.copy()
        edges[:-1] -= pull[:, :up]
        edges[1:] -= pull[:, up:2 * up]
        border = np.zeros((g + 1, up, u))
        border[:-1] += local[:, :up, 2 * up:]
        border[1:] += local[:, up:2 * up, 2 * up:]
        corner = self.curve + local[:, 2 * up:, 2 * up:].sum(0)
        prices = self.prices - pull[:, 2 * up:].sum(0)
        scale = np.einsum('gii->gi', diagonal)
        diagonal = diagonal + (damping * scale + 1e-12)[:, :, None] * np.eye(up)
        band = np.zeros((2 * up, (g + 1) * up))
        for row in range(up):
            for column in range(up):
                if row >= column:
                    band[row - column, column::up] = diagonal[:, row, column]
                band[up + row - column, column:g * up:up] = off[:, row, column]
        factor = cholesky_banded(band, lower=True, check_finite=False)
        right = np.concatenate([border.reshape(-1, u), edges.reshape(-1, 1)], 1)
        answer = cho_solve_banded((factor, True), right, check_finite=False)
        flat = border.reshape(-1, u)
        corner = corner - flat.T @ answer[:, :u]
        corner = corner + (damping * np.diag(np.abs(np.diag(corner))))
        dp = -np.linalg.solve(corner, prices - flat.T @ answer[:, u])
        dx = (-answer[:, u] - answer[:, :u] @ dp).reshape(g + 1, up)
        other = np.concatenate([dx[:-1], dx[1:], np.broadcast_to(dp, (g, u))], 1)
        dv = -solved[..., -1] - np.matmul(solved[..., :-1], other[..., None])[..., 0]
        sets = dv.reshape(g, self.sets, -1).transpose(1, 0, 2)
        return Point(dx.reshape(g + 1, u, self.p), sets, dp)

