"""
The smoothed dual function on columns, with its gradient and Hessian, and its Newton step.

It is the certificate's bound with every maximum taken over columns and over branches, and smoothed
to tau log sum exp(. / tau). The branches are a single breakpoint of w0 in each cell, and silence.
Every cell has its own v, see lemma 10. The dual function is jointly convex in the potentials, v
and lam. v has a barrier at 0 if there are several eavesdroppers. The slack w0 - s and lam have
weak barriers: at a high SNR the slack is of the order of 1e-3 and below.

Newton's linear system is an arrow: a band, in which the potentials at an edge are followed by the
v of the group after it, and the prices of power as its border.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
import scipy

from .columns import Columns, pack_columns
from .variables import DualPoint, GroupLayout, PotentialLayout
from ..proof.certificate import entropy, maximise_power
from ..proof.reachable_set import Team
from ...mission.validation import Array
from ...model.kernel import core

V_BARRIER = 0.3
"""Weight of the barrier -log v: in units of tau, or of 1e-5 nats with one eavesdropper."""

SLACK_BARRIER = 1e-6
"""Weight [nats] of the barrier -log(w0 - s)."""

PRICE_BARRIER = 1e-7
"""Weight [nats] of the barrier -log lam."""

SMOOTHING = 0.3
"""Smoothing width of the largest eigenvalue of S [nats per unit^2]."""


@dataclass(frozen=True, eq=False)
class ArrowSystem:
    """
    Gradient and Hessian of the dual function in blocks, F unknowns for each slot group.

    :param potential: layout of the potentials.
    :param layout: layout of a group's unknowns; neighbouring groups have an edge in common.
    :param group: gradient of the groups' terms, (G, F).
    :param groups: Hessians of the groups' terms, (G, F, F).
    :param edge: gradient of the edges' own terms, (G + 1, U P).
    :param edges: Hessians of the edges' own terms, (G + 1, U P, U P).
    :param price: gradient of the prices' own terms, (U,).
    :param prices: diagonal of the Hessian of the prices' own terms, (U,).
    :param sharpness: number of slots of a group, divided by the temperature, (G,).
    :param cells: number of cells of a group.
    """

    potential: PotentialLayout
    layout: GroupLayout
    group: Array
    groups: Array
    edge: Array
    edges: Array
    price: Array
    prices: Array
    sharpness: Array
    cells: int

    def slope(self, step: DualPoint) -> float:
        """Return the derivative of the dual function along a step."""
        x = step.potentials.reshape(self.edge.shape)
        local = np.concatenate([x[:-1], step.v.reshape(len(step.v), -1), x[1:], np.broadcast_to(
            step.prices, (len(step.v), len(step.prices)))], 1)
        return float((self.group * local).sum() + (self.edge * x).sum()
                     + self.price @ step.prices)

    def solve(self, damping: float) -> DualPoint:
        """
        Return the damped Newton step.

        If a single column is far better than any other, the function is linear near the point,
        and a full step would leave the neighbourhood in which it is linear. Damping acts as an
        additional variance of the columns of a group: it limits how much the potentials change
        from edge to edge and at both ends. It also raises the diagonals of v and of the prices by
        a fraction.

        :param damping: the variance [units^2] and the fraction.
        :raises numpy.linalg.LinAlgError: if the Hessian is not positive definite.
        """
        groups, edges = self._damp(damping)
        factor = scipy.linalg.cholesky_banded(
            self._assemble_band(groups, edges), lower=True, check_finite=False)
        border = self._assemble_border(groups)
        answer = scipy.linalg.cho_solve_banded((factor, True), border, check_finite=False)
        prices = self._eliminate_border(groups, border, answer, damping)
        (count, width), shift = self.edge.shape, self.layout.after.start
        x = -(answer[:, -1] + answer[:, :-1] @ prices).reshape(count, shift)
        return DualPoint(self.potential, x[:, :width].reshape(count, len(prices), -1),
                         x[:-1, width:].reshape(count - 1, self.cells, -1), prices)

    def _damp(self, damping: float) -> tuple[Array, Array]:
        """Return the Hessians of groups (G, F, F) and edges (G + 1, U P, U P) with damping."""
        before, v, after, _ = self.layout
        identity = np.eye(self.edge.shape[1])
        change = (damping * self.sharpness)[:, None, None] * identity
        groups, edges = self.groups.copy(), self.edges + 1e-9 * identity
        for side, opposite in ((before, after), (after, before)):
            groups[:, side, side] += change
            groups[:, side, opposite] -= change
        edges[[0, -1]] += change[[0, -1]]
        raised = np.arange(v.start, v.stop)
        groups[:, raised, raised] = (1 + damping) * groups[:, raised, raised] + 1e-12
        return groups, edges

    def _assemble_band(self, groups: Array, edges: Array) -> Array:
        """
        Return the lower diagonals of the Hessian's band, as scipy's cholesky_banded takes them.

        The band's unknowns are the potentials at each edge, followed by the v of the group after
        the edge.
        """
        (count, width), size, shift = self.edge.shape, self.layout.after.stop, (
            self.layout.after.start)
        band = np.zeros((count, shift, size))
        for column in range(size):
            edge, row = divmod(column, shift)
            band[edge:count - 1 + edge, row, :size - column] += groups[:, column:size, column]
        for column in range(width):
            band[:, column, :width - column] += edges[:, column:, column]
        # No group follows the last edge.
        band[-1, width:, 0] = 1.0
        return np.asarray(band.reshape(-1, size).T)

    def _assemble_border(self, groups: Array) -> Array:
        """
        Return the right sides of the band's linear systems, a row for each unknown of the band.

        The first columns are the mixed derivatives by the unknown and by each UAV's price; the
        last column is the gradient.
        """
        (count, width), size, shift = self.edge.shape, self.layout.after.stop, (
            self.layout.after.start)
        border = np.zeros((count, shift, len(self.price) + 1))
        own = np.concatenate(
            [groups[:, :size, self.layout.prices], self.group[:, :size, None]], -1)
        border[:-1] += own[:, :shift]
        border[1:, :width] += own[:, shift:]
        border[:, :width, -1] += self.edge
        return border.reshape(count * shift, -1)

    def _eliminate_border(self, groups: Array, border: Array, answer: Array, damping: float
                          ) -> Array:
        """
        Return the step of the prices, (U,), by the Schur complement of the band.

        :param groups: damped Hessians of the groups' terms, (G, F, F).
        :param border: right sides by _assemble_border; the last column is the gradient.
        :param answer: inverse of the band times the border.
        :param damping: fraction by which the diagonal is raised.
        """
        price = self.layout.prices
        corner = np.diag(self.prices) + groups[:, price, price].sum(0) - (
            border[:, :-1].T @ answer[:, :-1])
        corner += damping * np.diag(np.abs(np.diag(corner)))
        return np.asarray(-np.linalg.solve(
            corner, self.price + self.group[:, price].sum(0) - border[:, :-1].T @ answer[:, -1]))


class EdgeTerms:
    """
    The terms of the dual function at the edges and at both ends, with derivatives.

    :param x: potentials, (G + 1, U, P).
    :param tau: temperature [nats].
    :ivar value: sum of the terms that were added.
    :ivar gradient: derivatives of the sum by the potentials, (G + 1, U, P).
    :ivar hessian: second derivatives at each edge, (G + 1, U, P, U, P).
    """

    def __init__(self, x: Array, tau: float) -> None:
        self._x, self._tau, self.value = x, tau, 0.0
        count, u, p = x.shape
        self.gradient, self.hessian = np.zeros((count, u, p)), np.zeros((count, u, p, u, p))

    def add_linear(self, edge: int, uav: int, part: slice, slope: Array) -> None:
        """Add slope . x of a part of a UAV's potential at one edge."""
        self.value += float(slope @ self._x[edge, uav, part])
        self.gradient[edge, uav, part] += slope

    def add_lengths(self, uav: int, parts: list[slice], factor: Array, step: float) -> None:
        """Add factor times the smoothed length of the sum of two-vector parts, at every edge."""
        vector = np.sum([self._x[:, uav, part] for part in parts], 0)
        delta = self._tau / step
        norm = np.sqrt((vector * vector).sum(-1) + delta * delta)
        share = factor / norm
        second = share[:, None, None] * (
            np.eye(2) - vector[:, :, None] * vector[:, None] / (norm * norm)[:, None, None])
        for part in parts:
            self.gradient[:, uav, part] += share[:, None] * vector
            for column in parts:
                self.hessian[:, uav, part, uav, column] += second
        self.value += float(factor @ norm)

    def add_eigenvalues(self, uav: int, part: slice, factor: Array) -> None:
        """Add factor times the smoothed max(0, largest eigenvalue of S), at every edge."""
        largest, slope, second = _smooth_largest_eigenvalue(self._x[:, uav, part])
        self.value += float(factor @ largest)
        self.gradient[:, uav, part] += factor[:, None] * slope
        self.hessian[:, uav, part, uav, part] += factor[:, None, None] * second

    def flatten(self) -> tuple[Array, Array]:
        """Return the gradient (G + 1, U P) and the Hessian (G + 1, U P, U P)."""
        count, u, p = self._x.shape
        return self.gradient.reshape(count, -1), self.hessian.reshape(count, u * p, u * p)


class Dual:
    """
    The dual function of a team on given columns.

    :param team: the UAVs.
    :param weight: w0 of the branch in which the transmitter sends, (G,).
    :param columns: columns of each UAV for each cell in the branch where the transmitter sends.
    :param silent: columns of each UAV in the branch of silence.
    :param tau: temperature of every smoothed maximum [nats].
    """

    def __init__(self, team: Team, weight: Array, columns: list[list[Columns]],
                 silent: list[Columns], tau: float) -> None:
        self.team, self.weight, self.tau = team, weight, tau
        self.columns, self.silent = columns, silent
        self.count = team.groups.count.astype(float)
        self.average = np.array([region.average for region in team.regions])
        # The weight of each edge: a number of slots, and one more at the start.
        before, after = team.groups.means
        self.edge = np.zeros(len(self.count) + 1)
        self.edge[:-1] += self.count * before
        self.edge[1:] += self.count * after
        self.edge[0] += 1

    def slack(self, v: Array) -> Array:
        """Return the slack w0 - sum of v, (G, B)."""
        return np.asarray(self.weight[:, None] - v.sum(-1))

    def value(self, point: DualPoint) -> float:
        """Return the dual function: N times an estimate of the bound, in nats."""
        return self._evaluate(point, False)[0]

    def derivatives(self, point: DualPoint) -> tuple[float, ArrowSystem]:
        """Return the dual function with its gradient and its Hessian."""
        return self._evaluate(point, True)

    def find_worst_cell(self, point: DualPoint) -> NDArray[np.intp]:
        """Return the index of the cell with the largest value in every group, (G,)."""
        return np.asarray(self._branches(point, False)[0][:-1].argmax(0))

    def _evaluate(self, point: DualPoint, second: bool) -> tuple[float, Any]:
        """Return the dual function, and its ArrowSystem if `second`, else None."""
        value, gradients, hessians = self._groups(point, second)
        v, prices, layout = point.v, point.prices, point.group_layout
        bar = V_BARRIER * (self.tau if v.shape[-1] > 1 else 1e-5)
        slack = self.slack(v)
        slots = float(self.count.sum())
        value += slots * float(prices @ self.average - PRICE_BARRIER * np.log(prices).sum())
        value -= float(((bar * np.log(v).sum((1, 2)) + SLACK_BARRIER * np.log(slack).sum(1))
                        * self.count).sum())
        edges = self._edges(point)
        value += edges.value
        if not second:
            return value, None
        for cell in range(v.shape[1]):
            own, part, rest = self._select_v(layout, cell), v[:, cell], slack[:, cell]
            gradients[:, own] += self.count[:, None] * (
                -bar / part + (SLACK_BARRIER / rest)[:, None])
            hessians[:, own, own] += self.count[:, None, None] * (
                (bar / part**2)[:, :, None] * np.eye(part.shape[1])
                + (SLACK_BARRIER / rest**2)[:, None, None])
        return value, ArrowSystem(
            point.layout, layout, gradients, hessians, *edges.flatten(),
            slots * (self.average - PRICE_BARRIER / prices), slots * PRICE_BARRIER / prices**2,
            self.count / self.tau, v.shape[1])

    def _select_v(self, layout: GroupLayout, cell: int) -> slice:
        """Return the slice of one cell's v in a group's unknowns."""
        size = (layout.v.stop - layout.v.start) // len(self.columns)
        return slice(layout.v.start + cell * size, layout.v.start + (cell + 1) * size)

    def _edges(self, point: DualPoint) -> EdgeTerms:
        """Return the terms of speed, acceleration and curvature at the edges and both ends."""
        layout, terms = point.layout, EdgeTerms(point.potentials, self.tau)
        at_start, at_goal = np.eye(len(self.edge))[0], np.eye(len(self.edge))[-1]
        for i, region in enumerate(self.team.regions):
            # The slope of the first move: u_0, and w_1 where accelerations are limited.
            limits, moves, step = region.end_move_changes, region.end_moves, region.step
            shorter = layout.accelerates and limits[0] < step
            first = [layout.slope, layout.acceleration] if layout.accelerates else [layout.slope]
            terms.add_lengths(i, first, (limits[0] if shorter else step) * at_start, step)
            if layout.accelerates:
                for part in first if shorter else ():
                    terms.add_linear(0, i, part, moves[0])
                terms.add_linear(-1, i, layout.acceleration, -moves[1])
                last = max(limits[1] - region.max_move_change, 0.0) * at_goal
                terms.add_lengths(i, [layout.acceleration],
                                  region.max_move_change * self.edge + last, step)
            d, place = region.distance, slice(0, layout.acceleration.start)
            terms.add_linear(-1, i, place, -np.array([d, 0.0, d * d / 2, 0.0, 0.0])[place])
            if layout.quadratic:
                terms.add_eigenvalues(
                    i, layout.curvature, np.append(step, region.steps)**2 / 2 * self.edge)
        return terms

    def _groups(self, point: DualPoint, second: bool) -> tuple[float, Array, Array]:
        """
        Return the smoothed maximum over all branches, summed over all slots, with derivatives.

        In the last branch the transmitter is silent, in all others it sends. The derivatives are a
        gradient (G, F) and a Hessian (G, F, F) for each group, and are not valid unless `second`.
        """
        values, grads, hessians = self._branches(point, second)
        top = values.max(0)
        mix = np.exp((values - top) / self.tau)
        total = mix.sum(0)
        mix /= total
        best = float(self.count @ (top + self.tau * np.log(total)))
        if not second:
            return best, values, values
        group = (mix[..., None] * grads).sum(0)
        groups = sum(share[:, None, None] * (hessian + grad[:, :, None] * grad[:, None] / self.tau)
                     for share, grad, hessian in zip(mix, grads, hessians))
        groups = groups - group[:, :, None] * group[:, None] / self.tau
        return best, group * self.count[:, None], groups * self.count[:, None, None]

    def _branches(self, point: DualPoint, second: bool) -> tuple[Array, Array, Array]:
        """
        Return values, gradients (.., F) and Hessians (.., F, F) of all branches, (B + 1, G).

        A value is the sum over the UAVs of the smoothed maximum of their columns in a group. In
        the first B branches, one for each cell, the transmitter sends, with weight w0, and the
        maximum over its power is included. The last branch is silence. Derivatives are empty
        unless `second`.
        """
        (g, cells, e), layout = point.v.shape, point.group_layout
        size = layout.prices.stop
        values, grads, hessians = (np.zeros((cells + 1, g, *shape) if second or not shape else 0)
                                   for shape in ((), (size,), (size, size)))
        lists = [(cells, i, columns, np.zeros(g), np.zeros((g, e)))
                 for i, columns in enumerate(self.silent)]
        for cell, parts in enumerate(self.columns):
            values[cell], *derivatives = self._powers(
                point.v[:, cell], point.prices[0], layout, cell, second)
            if second:
                grads[cell], hessians[cell] = derivatives
            lists += [(cell, i, columns, self.weight, point.v[:, cell])
                      for i, columns in enumerate(parts)]
        for branch, i, columns, weight, v in lists:
            index = layout.select_uav(i, self._select_v(layout, min(branch, cells - 1)))
            own = len(index)
            value, grad, hessian = (np.empty((g, *shape) if second or not shape else 0)
                                    for shape in ((), (own,), (own, own)))
            core.smooth_maxima(pack_columns(
                self.team, i, point, columns, weight, v, self.tau), value, grad, hessian)
            values[branch] += value
            if second:
                grads[branch][:, index] += grad
                hessians[branch][:, index[:, None], index] += hessian
        return values, grads, hessians

    def _powers(self, v: Array, price: float, layout: GroupLayout, cell: int,
                second: bool) -> tuple[Array, Array, Array]:
        """Return one cell's entropies and maximum over the transmit power, with derivatives."""
        rest, peak = 1 - v.sum(-1), self.team.regions[0].peak
        # `rest` is the last weight of the entropy, `slack` the part of the weight for the ground
        # node's rate, and `paid` the unknown of the transmitter's price.
        slack, own = self.weight - v.sum(-1), self._select_v(layout, cell)
        paid = layout.prices.start
        value, power = maximise_power(slack, price, peak)
        totals = self.team.sum_listeners(v)
        value = value - entropy(*totals) + entropy(self.weight)
        if not second:
            return value, np.zeros(0), np.zeros(0)
        size = layout.prices.stop
        grad, hess = np.zeros((len(v), size)), np.zeros((len(v), size, size))
        inner = power < peak * (1 - 1e-12)
        grad[:, own] = -np.log(power * rest)[:, None]
        grad[:, paid] = -power
        hess[:, own, own] = (1 / rest + inner / slack)[:, None, None]
        for places, total in zip(self.team.listeners, totals):
            at = own.start + places
            grad[:, at] += np.log(total)[:, None]
            hess[:, at[:, None], at] += (1 / total)[:, None, None]
        hess[:, own, paid] = hess[:, paid, own] = (inner / price)[:, None]
        hess[:, paid, paid] = inner * slack / price**2
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
