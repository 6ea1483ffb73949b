"""
The smoothed dual function on columns, with its gradient and Hessian, and Newton's step for it.

It is the certificate's bound with every maximum taken over columns and over two branches, a single
breakpoint of w0 and silence, and smoothed to tau log sum exp(. / tau). It is jointly convex in the
potentials, v and lam. v has a barrier at 0 if there are several eavesdroppers. The slack w0 - s
and lam have weak barriers: at a high SNR the slack is of the order of 1e-3 and below.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
import scipy

from .variables import Columns, DualPoint, pack_columns, PotentialLayout
from ..proof.certificate import entropy, maximise_power
from ..proof.reachable_set import Team
from ...mission.validation import Array
from ...model.kernel import core

SHARE_BARRIER, SLACK_BARRIER, PRICE_BARRIER = 0.3, 1e-6, 1e-7
"""Barriers of v, times tau, of w0 - s, and of lam, in nats."""

SMOOTHING = 0.3
"""Smoothing of the largest eigenvalue of S, in nats per unit^2."""


@dataclass(frozen=True, eq=False)
class DualDerivatives:
    """
    Gradient and Hessian in blocks; a stage's unknowns are v, both edges' potentials, and lam.

    :param stage: gradient of the stages' terms, (G, V + 2 U P + U).
    :param stages: their Hessians, (G, V + 2 U P + U, V + 2 U P + U).
    :param edge: gradient of the edges' own terms, (G + 1, U P).
    :param edges: their Hessians, (G + 1, U P, U P).
    :param price: gradient of the prices' own terms, (U,).
    :param prices: the diagonal of their Hessian, (U,).
    :param sharpness: number of slots of a stage, divided by the temperature, (G,).
    """

    stage: Array
    stages: Array
    edge: Array
    edges: Array
    price: Array
    prices: Array
    sharpness: Array

    def slope(self, step: DualPoint) -> float:
        """Return the derivative along a step."""
        count = len(self.stage)
        x = step.potentials.reshape(count + 1, -1)
        local = np.concatenate([step.shares, x[:-1], x[1:],
                                np.broadcast_to(step.prices, (count, len(step.prices)))], 1)
        return float((self.stage * local).sum() + (self.edge * x).sum()
                     + self.price @ step.prices)

    def solve(self, damping: float) -> DualPoint:
        """
        Return the damped Newton step.

        If a single column is far better than the rest, the function is linear near the point, and
        a full step would leave that neighbourhood. `damping` stands for a variance of the columns
        of a stage in units^2: it limits changes of the potentials from edge to edge, and of those
        at both ends. The diagonal of v and of the prices is raised by it as a share.

        v is eliminated in every stage, then the potentials by a banded Cholesky factorisation.

        :raises numpy.linalg.LinAlgError: where the Hessian is not positive definite.
        """
        count, up, u = len(self.stage), self.edge.shape[1], len(self.price)
        e = self.stage.shape[1] - 2 * up - u
        vv = self.stages[:, :e, :e]
        vv = vv + (damping * np.einsum('gii->gi', vv) + 1e-12)[:, :, None] * np.eye(e)
        vr = self.stages[:, :e, e:]
        solved = np.linalg.solve(vv, np.concatenate([vr, self.stage[:, :e, None]], -1))
        local = self.stages[:, e:, e:] - np.matmul(vr.transpose(0, 2, 1), solved[..., :-1])
        rest = self.stage[:, e:] - np.matmul(
            vr.transpose(0, 2, 1), solved[..., -1:])[..., 0]
        move = (damping * self.sharpness)[:, None, None] * np.eye(up)
        local[:, :up, :up] += move
        local[:, up:2 * up, up:2 * up] += move
        local[:, up:2 * up, :up] -= move
        local[:, :up, up:2 * up] -= move
        before, after, price = slice(0, up), slice(up, 2 * up), slice(2 * up, None)
        diagonal, edge = self.edges.copy(), self.edge.copy()
        border = np.zeros((count + 1, up, u))
        for at, part in ((slice(0, -1), before), (slice(1, None), after)):
            diagonal[at] += local[:, part, part]
            edge[at] += rest[:, part]
            border[at] += local[:, part, price]
        diagonal = diagonal + 1e-9 * np.eye(up)
        diagonal[[0, -1]] += move[[0, -1]]
        band = np.zeros((2 * up, (count + 1) * up))
        for row in range(up):
            for column in range(up):
                if row >= column:
                    band[row - column, column::up] = diagonal[:, row, column]
                band[up + row - column, column:count * up:up] = local[:, up + row, column]
        factor = scipy.linalg.cholesky_banded(
            band, lower=True, check_finite=False, overwrite_ab=True)
        prices_by_edge = border.reshape(-1, u)
        answer = scipy.linalg.cho_solve_banded((factor, True), np.concatenate(
            [prices_by_edge, edge.reshape(-1, 1)], 1), check_finite=False)
        corner = (np.diag(self.prices) + local[:, price, price].sum(0)
                  - prices_by_edge.T @ answer[:, :u])
        corner = corner + damping * np.diag(np.abs(np.diag(corner)))
        prices = -np.linalg.solve(corner, self.price + rest[:, price].sum(0)
                                  - prices_by_edge.T @ answer[:, u])
        x = (-answer[:, u] - answer[:, :u] @ prices).reshape(count + 1, up)
        steps = np.concatenate([x[:-1], x[1:], np.broadcast_to(prices, (count, u))], 1)
        shares = -solved[..., -1] - np.matmul(solved[..., :-1], steps[..., None])[..., 0]
        return DualPoint(x.reshape(count + 1, u, -1), shares, prices)


class Dual:
    """
    The dual function of a team on given columns.

    :param team: the UAVs.
    :param weight: w0 of the branch in which the transmitter sends, (G,).
    :param columns: of every UAV in that branch.
    :param silent: of every UAV in the branch of silence.
    :param tau: temperature of every smoothed maximum, in nats.
    """

    def __init__(self, team: Team, weight: Array, columns: list[Columns],
                 silent: list[Columns], tau: float) -> None:
        self.team, self.weight, self.tau = team, weight, tau
        self.columns, self.silent = columns, silent
        self.count = team.stages.count.astype(float)
        self.average = np.array([region.average for region in team.regions])
        # The number of slots that an edge counts for, and one more at the start.
        before, after = team.stages.means
        self.edge = np.zeros(len(self.count) + 1)
        self.edge[:-1] += self.count * before
        self.edge[1:] += self.count * after
        self.edge[0] += 1

    def slack(self, shares: Array) -> Array:
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
        slack = self.slack(shares)
        slots = float(self.count.sum())
        value += slots * float(prices @ self.average - PRICE_BARRIER * np.log(prices).sum())
        value -= float(((bar * np.log(shares).sum(-1) + SLACK_BARRIER * np.log(slack))
                        * self.count).sum())
        edge, edges = self._edges(point)
        value += edge
        if not second:
            return value, None
        e = shares.shape[-1]
        stage[:, :e] += self.count[:, None] * (-bar / shares + (SLACK_BARRIER / slack)[:, None])
        stages[:, :e, :e] += self.count[:, None, None] * (
            (bar / shares**2)[:, :, None] * np.eye(e) + (SLACK_BARRIER / slack**2)[:, None, None])
        return value, DualDerivatives(
            stage, stages, *edges, slots * (self.average - PRICE_BARRIER / prices),
            slots * PRICE_BARRIER / prices**2, self.count / self.tau)

    def _edges(self, point: DualPoint) -> tuple[float, tuple[Array, Array]]:
        """Return value, gradient and Hessian of the terms at the edges and the ends."""
        x, layout, value = point.potentials, PotentialLayout.of(point.potentials), 0.0
        count, u, p = x.shape
        grad, hess = np.zeros((count, u, p)), np.zeros((count, u * p, u * p))

        def add_lengths(i: int, firsts: tuple[int, ...], factor: Array) -> float:
            """Add factor |x|, smoothed, x (count, 2) the sum of the pairs that begin at firsts."""
            vector = np.sum([x[:, i, first:first + 2] for first in firsts], 0)
            delta = self.tau / self.team.regions[i].step
            norm = np.sqrt((vector * vector).sum(-1) + delta * delta)
            share = factor / norm
            second = share[:, None, None] * (
                np.eye(2) - vector[:, :, None] * vector[:, None] / (norm * norm)[:, None, None])
            for first in firsts:
                grad[:, i, first:first + 2] += share[:, None] * vector
                for column in firsts:
                    hess[:, i * p + first:i * p + first + 2,
                         i * p + column:i * p + column + 2] += second
            return float(factor @ norm)

        for i, region in enumerate(self.team.regions):
            # The slope of the first move: u_0, and w_1 where accelerations are limited.
            limits, moves = region.end_move_changes, region.end_moves
            shorter = layout.acceleration and limits[0] < region.step
            start = (limits[0] if shorter else region.step) * np.eye(1, count)[0]
            firsts = (0, p - 2) if layout.acceleration else (0,)
            value += add_lengths(i, firsts, start)
            if layout.acceleration:
                for at in firsts if shorter else ():
                    value += float(x[0, i, at:at + 2] @ moves[0])
                    grad[0, i, at:at + 2] += moves[0]
                value -= float(x[-1, i, -2:] @ moves[1])
                grad[-1, i, -2:] -= moves[1]
                last = max(limits[1] - region.max_move_change, 0.0) * np.eye(1, count)[0][::-1]
                value += add_lengths(i, (p - 2,), region.max_move_change * self.edge + last)
            d = region.distance
            goal = np.array([d, 0.0, d * d / 2, 0.0, 0.0])[:5 if layout.quadratic else 2]
            value -= float(goal @ x[-1, i, :len(goal)])
            grad[-1, i, :len(goal)] -= goal
            if layout.quadratic:
                largest, slope, second = _smooth_largest_eigenvalue(x[:, i, 2:5])
                factor = np.append(region.step, region.steps)**2 / 2 * self.edge
                value += float(factor @ largest)
                grad[:, i, 2:5] += factor[:, None] * slope
                three = slice(i * p + 2, i * p + 5)
                hess[:, three, three] += factor[:, None, None] * second
        return value, (grad.reshape(count, -1), hess)

    def _stages(self, point: DualPoint, second: bool) -> tuple[float, Array, Array]:
        """Return value, gradient and Hessian of the stages' smoothed maxima."""
        u, p = point.potentials.shape[1:]
        g, e = point.shares.shape
        size = e + 2 * u * p + u
        # Of the two branches: w0, and silence.
        values, grads, hessians = (np.zeros((2, g, *shape) if second or not shape else 0)
                                   for shape in ((), (size,), (size, size)))
        values[0], *derivatives = self._powers(point.shares, point.prices[0], size, second)
        if second:
            grads[0], hessians[0] = derivatives
        lists = [(1, i, columns, np.zeros(g), np.zeros((g, e)))
                 for i, columns in enumerate(self.silent)]
        lists += [(0, i, columns, self.weight, point.shares)
                  for i, columns in enumerate(self.columns)]
        for branch, i, columns, weight, v in lists:
            index = self._unknowns(i, point)
            own = len(index)
            value, grad, hessian = (np.empty((g, *shape) if second or not shape else 0)
                                    for shape in ((), (own,), (own, own)))
            core.smooth_maxima(pack_columns(
                self.team, i, point, columns, weight, v, self.tau), value, grad, hessian)
            values[branch] += value
            if second:
                grads[branch][:, index] += grad
                hessians[branch][:, index[:, None], index] += hessian
        top = values.max(0)
        mix = np.exp((values - top) / self.tau)
        total = mix.sum(0)
        mix /= total
        best = float(self.count @ (top + self.tau * np.log(total)))
        if not second:
            return best, values, values
        stage = (mix[..., None] * grads).sum(0)
        stages = sum(share[:, None, None] * (hessian + grad[:, :, None] * grad[:, None] / self.tau)
                     for share, grad, hessian in zip(mix, grads, hessians))
        stages = stages - stage[:, :, None] * stage[:, None] / self.tau
        return best, stage * self.count[:, None], stages * self.count[:, None, None]

    @staticmethod
    def _unknowns(i: int, point: DualPoint) -> NDArray[np.intp]:
        """Return the indices of v and of UAV i's potentials and price among a stage's unknowns."""
        (u, p), e = point.potentials.shape[1:], point.shares.shape[-1]
        own = e + p * i + np.arange(p)
        return np.r_[0:e, own, own + u * p, e + 2 * u * p + i]

    def _powers(self, v: Array, price: float, size: int, second: bool) -> tuple[
            Array, Array, Array]:
        """Return the entropies and the maximum over the transmit power, with derivatives."""
        rest, peak = 1 - v.sum(-1), self.team.regions[0].peak
        slack, e = self.slack(v), v.shape[-1]
        value, power = maximise_power(slack, price, peak)
        groups = self.team.sum_groups(v)
        value = value - entropy(*groups) + entropy(self.weight)
        if not second:
            return value, np.zeros(0), np.zeros(0)
        grad, hess = np.zeros((len(v), size)), np.zeros((len(v), size, size))
        la = size - len(self.team.regions)
        inner = power < peak * (1 - 1e-12)
        grad[:, :e] = -np.log(power * rest)[:, None]
        grad[:, la] = -power
        hess[:, :e, :e] = (1 / rest + inner / slack)[:, None, None]
        for group, total in zip(self.team.groups, groups):
            grad[:, group] += np.log(total)[:, None]
            hess[:, group[:, None], group] += (1 / total)[:, None, None]
        hess[:, :e, la] = hess[:, la, :e] = (inner / price)[:, None]
        hess[:, la, la] = inner * slack / price**2
        return value, grad, hess


def _smooth_largest_eigenvalue(curvature: Array) -> tuple[Array, Array, Array]:
    """Return max(0, largest eigenvalue of S), smoothed, for S (G, 3), with derivatives."""
    h, b = (curvature[:, 0] - curvature[:, 2]) / 2, curvature[:, 1]
    r = np.sqrt(h * h + b * b + SMOOTHING**2)
    largest = (curvature[:, 0] + curvature[:, 2]) / 2 + r
    root = np.sqrt(largest * largest + SMOOTHING**2)
    first = (1 + largest / root) / 2
    slope = np.stack([0.5 + h / (2 * r), b / r, 0.5 - h / (2 * r)], -1)
    # The second derivatives of r by h and b, and by S through them.
    move = np.array([[0.5, 0.0, -0.5], [0.0, 1.0, 0.0]])
    unit = np.stack([h, b], -1) / r[:, None]
    inner = (np.eye(2) - unit[:, :, None] * unit[:, None]) / r[:, None, None]
    second = (first[:, None, None] * (move.T @ inner @ move)
              + (SMOOTHING**2 / (2 * root**3))[:, None, None] * slope[:, :, None] * slope[:, None])
    return (largest + root) / 2, first[:, None] * slope, second
