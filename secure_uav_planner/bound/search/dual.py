"""
The smoothed dual function on columns, with its gradient and Hessian.

It is the certificate's bound with every maximum taken over columns and over branches, and smoothed
to tau log sum exp(. / tau). The branches are a single breakpoint of w0 in each cell, and silence.
Every cell has its own v, see lemma 10. The dual function is jointly convex in the potentials, v
and lam. v has a barrier at 0 if there are several eavesdroppers. The slack w0 - s and lam have
weak barriers: at a high SNR the slack is of the order of 1e-3 and below.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from .arrow_system import ArrowSystem
from .columns import Columns, pack_columns
from .variables import DualPoint, PotentialLayout
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
        """
        Add factor |x| at every edge, smoothed to factor sqrt(|x|^2 + (tau / step)^2).

        :param uav: index of the UAV.
        :param parts: x is the sum of these parts of the UAV's potential, each of two numbers.
        :param factor: factor of each edge, (G + 1,).
        :param step: the UAV's largest move [units]; it sets the width of the smoothing only.
        """
        vector = np.sum([self._x[:, uav, part] for part in parts], 0)
        delta = self._tau / step
        norm = np.sqrt((vector * vector).sum(-1) + delta * delta)
        # The smoothed length r has the slope x / r and the Hessian (I - x x' / r^2) / r.
        share = factor / norm
        slope = _scale(share, vector)
        second = _scale(share, np.eye(2) - _square(vector) / (norm * norm)[:, None, None])
        for part in parts:
            self.gradient[:, uav, part] += slope
            for column in parts:
                self.hessian[:, uav, part, uav, column] += second
        self.value += float(factor @ norm)

    def add_eigenvalues(self, uav: int, part: slice, factor: Array) -> None:
        """Add factor (G + 1,) times the smoothed max(0, largest eigenvalue of S), the `part`."""
        largest, slope, second = _smooth_largest_eigenvalue(self._x[:, uav, part])
        self.value += float(factor @ largest)
        self.gradient[:, uav, part] += _scale(factor, slope)
        self.hessian[:, uav, part, uav, part] += _scale(factor, second)

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
        # Weight of each edge: the sum of its weights in all slots, see SlotGroups.means, plus 1 at
        # the start for the first move.
        before, after = team.groups.means
        self.edge_weights = np.zeros(len(self.count) + 1)
        self.edge_weights[:-1] += self.count * before
        self.edge_weights[1:] += self.count * after
        self.edge_weights[0] += 1

    def slack(self, v: Array) -> Array:
        """Return the slack w0 - sum of v, (G, B)."""
        return np.asarray(self.weight[:, None] - v.sum(-1))

    def value(self, point: DualPoint) -> float:
        """Return the dual function: N times an estimate of the bound, in nats."""
        return self._add_up(point, self._compute_branches(point).value, self._compute_edges(point))

    def derivatives(self, point: DualPoint) -> tuple[float, ArrowSystem]:
        """Return the dual function [nats], and its gradient and Hessian as an ArrowSystem."""
        branches = self._compute_branches(point, differentiate=True)
        gradient, hessian = self._differentiate_groups(branches)
        self._add_v_barriers(point, gradient, hessian)
        edges, slots, prices = self._compute_edges(point), self.count.sum(), point.prices
        return self._add_up(point, branches.value, edges), ArrowSystem(
            point.layout, point.group_layout, gradient, hessian, *edges.flatten(),
            slots * (self.average - PRICE_BARRIER / prices), slots * PRICE_BARRIER / prices**2,
            self.count / self.tau, point.v.shape[1])

    def find_worst_cell(self, point: DualPoint) -> NDArray[np.intp]:
        """Return the index of the cell with the largest value in every group, (G,)."""
        return np.asarray(self._compute_branches(point).value[:-1].argmax(0))

    def _add_up(self, point: DualPoint, branches: Array, edges: EdgeTerms) -> float:
        """
        Return the dual function [nats], N times an estimate of the bound.

        It is the sum over groups of n slots of n (tau log sum exp(branch / tau) - barriers), plus
        N (lam . average powers - barrier), plus the edges' terms. A barrier is a weight times the
        sum of log v, of log slack or of log lam.

        :param branches: value of every branch, (B + 1, G) in nats.
        """
        groups = float(self.count @ _soften(branches, self.tau)[0])
        prices, slack = point.prices, self.slack(point.v)
        powers = float(self.count.sum()) * float(
            prices @ self.average - PRICE_BARRIER * np.log(prices).sum())
        barriers = self._v_barrier(point) * np.log(point.v).sum((1, 2)) + (
            SLACK_BARRIER * np.log(slack).sum(1))
        return groups + powers - float((barriers * self.count).sum()) + edges.value

    def _v_barrier(self, point: DualPoint) -> float:
        """Return the weight of the barrier -log v [nats]."""
        return V_BARRIER * (self.tau if point.v.shape[-1] > 1 else 1e-5)

    def _add_v_barriers(self, point: DualPoint, gradient: Array, hessian: Array) -> None:
        """Add derivatives of slots * (-weight log v - SLACK_BARRIER log(w0 - s)), by unknowns."""
        weight, slack = self._v_barrier(point), self.slack(point.v)
        for cell in range(point.v.shape[1]):
            own, v, rest = self._select_v(point, cell), point.v[:, cell], slack[:, [cell]]
            gradient[:, own] += _scale(self.count, -weight / v + SLACK_BARRIER / rest)
            of_v = (weight / v**2)[:, :, None] * np.eye(v.shape[1])
            of_slack = (SLACK_BARRIER / rest**2)[:, :, None]
            hessian[:, own, own] += _scale(self.count, of_v + of_slack)

    def _select_v(self, point: DualPoint, cell: int) -> slice:
        """Return the slice of one cell's v in a group's unknowns."""
        first, size = point.group_layout.v.start, point.v.shape[-1]
        return slice(first + cell * size, first + (cell + 1) * size)

    def _compute_edges(self, point: DualPoint) -> EdgeTerms:
        """Return the edges' terms: first move, acceleration, -W_N(goal), eigenvalues of S."""
        layout, terms = point.layout, EdgeTerms(point.potentials, self.tau)
        for uav, region in enumerate(self.team.regions):
            self._add_first_move(terms, uav, layout)
            if layout.accelerates:
                self._add_accelerations(terms, uav, layout)
            # - W_N(goal), where the goal is (D, 0) in the UAV's frame.
            d, place = region.distance, slice(0, layout.acceleration.start)
            terms.add_linear(-1, uav, place, -np.array([d, 0.0, d * d / 2, 0.0, 0.0])[place])
            if layout.quadratic:
                terms.add_eigenvalues(
                    uav, layout.curvature,
                    np.append(region.step, region.steps)**2 / 2 * self.edge_weights)
        return terms

    def _add_first_move(self, terms: EdgeTerms, uav: int, layout: PotentialLayout) -> None:
        """
        Add the first move's bound with g = u_0 + w_1 at the first edge; see lemma 8 in Potential.

        It is step |g|, smoothed by add_lengths. If the velocity at the start is given and the
        first move differs from the move d_{-1} before the start by at most A_0 < step, it is
        A_0 |g| + g . d_{-1}, smoothed too.
        """
        region, at_start = self.team.regions[uav], np.eye(len(self.edge_weights))[0]
        parts = [layout.slope, layout.acceleration] if layout.accelerates else [layout.slope]
        limit = region.end_move_changes[0]
        if not layout.accelerates or limit >= region.step:
            terms.add_lengths(uav, parts, region.step * at_start, region.step)
            return
        terms.add_lengths(uav, parts, limit * at_start, region.step)
        for part in parts:
            terms.add_linear(0, uav, part, region.end_moves[0])

    def _add_accelerations(self, terms: EdgeTerms, uav: int, layout: PotentialLayout) -> None:
        """
        Add the terms of a limit A of acceleration, with the potential w; see lemma 8.

        An edge has A |w| times its weight. The last edge has max(A_{N+1} - A, 0) |w| - w . d_{N+1}
        in addition, where d_{N+1} is the move after the goal.
        """
        region, at_goal = self.team.regions[uav], np.eye(len(self.edge_weights))[-1]
        terms.add_linear(-1, uav, layout.acceleration, -region.end_moves[1])
        excess = max(region.end_move_changes[1] - region.max_move_change, 0.0)
        terms.add_lengths(
            uav, [layout.acceleration],
            region.max_move_change * self.edge_weights + excess * at_goal, region.step)

    def _differentiate_groups(self, branches: BranchTerms) -> tuple[Array, Array]:
        """
        Return gradient (G, F) and Hessian (G, F, F) of n times a group's smoothed maximum.

        n is the group's number of slots. The maximum is over the branches of a slot.
        With the shares r of the branches, and gradient g and Hessian H of each branch, the
        gradient is m = sum of r g, and the Hessian is sum of r (H + g g' / tau) - m m' / tau.
        """
        shares = _soften(branches.value, self.tau)[1]
        mean = (shares[..., None] * branches.gradient).sum(0)
        hessian = sum(_scale(share, own + _square(gradient) / self.tau) for share, gradient, own
                      in zip(shares, branches.gradient, branches.hessian))
        hessian = hessian - _square(mean) / self.tau
        return mean * self.count[:, None], _scale(self.count, hessian)

    def _compute_branches(self, point: DualPoint, differentiate: bool = False) -> BranchTerms:
        """
        Return the branches of a slot of each group: B in which the transmitter sends, and silence.

        Each of the B cells has a branch. The value of a branch is the sum over the UAVs of the
        smoothed maximum of their columns, plus _compute_sending if the transmitter sends.
        """
        terms = BranchTerms(point, differentiate)
        silence = len(self.columns)
        for cell, parts in enumerate(self.columns):
            v, own = point.v[:, cell], self._select_v(point, cell)
            terms.value[cell] = self._compute_sending(v, point.prices[0])
            if differentiate:
                self._differentiate_sending(v, point.prices[0], own, terms.gradient[cell],
                                            terms.hessian[cell])
        for uav, columns in enumerate(self.silent):
            # Silent columns have no factors of w0 and v: both are 0, and any cell's v serves.
            w0, v = np.zeros_like(self.weight), np.zeros_like(point.v[:, 0])
            terms.add_columns(silence, uav, self._select_v(point, silence - 1), pack_columns(
                self.team, uav, point, columns, w0, v, self.tau))
        for cell, parts in enumerate(self.columns):
            for uav, columns in enumerate(parts):
                terms.add_columns(cell, uav, self._select_v(point, cell), pack_columns(
                    self.team, uav, point, columns, self.weight, point.v[:, cell], self.tau))
        return terms

    def _compute_sending(self, v: Array, price: float) -> Array:
        """
        Return H(w0) - H(v) + max over p of (w0 - s) log p - lam p, (G,) in nats; lemmas 1 and 3.

        :param v: v of a cell, (G, E), with the sum s.
        :param price: lam of the transmitter.
        """
        best, _ = maximise_power(self.weight - v.sum(-1), price, self.team.regions[0].peak)
        return np.asarray(
            best - entropy(*self.team.sum_adversaries(v)) + entropy(self.weight))

    def _differentiate_sending(self, v: Array, price: float, own: slice, gradient: Array,
                               hessian: Array) -> None:
        """
        Write the derivatives of _compute_sending into a gradient (G, F) and a Hessian (G, F, F).

        With the best power p, and t the sum of v of a place's adversary, they are

            by v      log t - log(1 - s) - log p;  by lam  -p,
            by v, v   1 / (1 - s), and 1 / t for places of one adversary,

        and where p = (w0 - s) / lam is below the peak also 1 / (w0 - s) by v and v, 1 / lam by v
        and lam, and (w0 - s) / lam^2 by lam and lam.

        :param own: slice of v in the unknowns.
        """
        rest, slack, peak = 1 - v.sum(-1), self.weight - v.sum(-1), self.team.regions[0].peak
        _, power = maximise_power(slack, price, peak)
        is_inner = power < peak * (1 - 1e-12)
        at_price = gradient.shape[1] - len(self.team.regions)
        gradient[:, own] = -np.log(power * rest)[:, None]
        gradient[:, at_price] = -power
        hessian[:, own, own] = (1 / rest + is_inner / slack)[:, None, None]
        for places, total in zip(self.team.adversaries, self.team.sum_adversaries(v)):
            at = own.start + places
            gradient[:, at] += np.log(total)[:, None]
            hessian[:, at[:, None], at] += (1 / total)[:, None, None]
        hessian[:, own, at_price] = hessian[:, at_price, own] = (is_inner / price)[:, None]
        hessian[:, at_price, at_price] = is_inner * slack / price**2


class BranchTerms:
    """
    The value of every branch in every group, with derivatives by a group's F unknowns.

    :param point: the unknowns, with B cells.
    :param differentiate: whether there are derivatives; otherwise their arrays are empty.
    :ivar value: (B + 1, G) in nats; the last branch is silence.
    :ivar gradient: (B + 1, G, F).
    :ivar hessian: (B + 1, G, F, F).
    """

    def __init__(self, point: DualPoint, differentiate: bool) -> None:
        groups, cells, _ = point.v.shape
        self._layout, self._differentiate = point.group_layout, differentiate
        self.value = np.zeros((cells + 1, groups))
        count, size = cells + 1 if differentiate else 0, self._layout.prices.stop
        self.gradient = np.zeros((count, groups, size))
        self.hessian = np.zeros((count, groups, size, size))

    def add_columns(self, branch: int, uav: int, own_v: slice, columns: dict[str, Any]) -> None:
        """
        Add tau log sum exp(value / tau) over a UAV's columns, in each group, to a branch.

        :param branch: index of the branch; the last is silence.
        :param uav: index of the UAV.
        :param own_v: slice of the branch's v in a group's unknowns.
        :param columns: the columns, by pack_columns.
        """
        groups = self.value.shape[1]
        index = self._layout.select_uav(uav, own_v)
        value, size = np.empty(groups), len(index) if self._differentiate else 0
        gradient, hessian = np.empty((groups, size)), np.empty((groups, size, size))
        core.smooth_maxima(columns, value, gradient, hessian)
        self.value[branch] += value
        if self._differentiate:
            self.gradient[branch][:, index] += gradient
            self.hessian[branch][:, index[:, None], index] += hessian


def _soften(values: Array, tau: float) -> tuple[Array, Array]:
    """Return tau log sum exp(values / tau) over rows, (G,), and each row's shares, (B, G)."""
    top = values.max(0)
    shares = np.exp((values - top) / tau)
    total = shares.sum(0)
    return top + tau * np.log(total), shares / total


def _scale(factors: Array, arrays: Array) -> Array:
    """Return each of K arrays, (K, ...), times its factor, (K,)."""
    return np.asarray(factors.reshape(-1, *[1] * (arrays.ndim - 1)) * arrays)


def _square(vectors: Array) -> Array:
    """Return the matrix x x' of each of K vectors x, (K, n), in an array (K, n, n)."""
    return np.asarray(vectors[:, :, None] * vectors[:, None])


def _smooth_largest_eigenvalue(curvature: Array) -> tuple[Array, Array, Array]:
    """
    Return max(0, largest eigenvalue of S), smoothed, with gradient and Hessian by S.

    With d = SMOOTHING, h = (S_11 - S_22) / 2 and r = sqrt(h^2 + S_12^2 + d^2), the
    largest eigenvalue is smoothed to l = (S_11 + S_22) / 2 + r, and max(0, l) to
    (l + sqrt(l^2 + d^2)) / 2.

    :param curvature: (S_11, S_12, S_22) of each S, (K, 3).
    :return: values (K,), gradients (K, 3) and Hessians (K, 3, 3).
    """
    s11, s12, s22 = curvature.T
    h = (s11 - s22) / 2
    r = np.sqrt(h * h + s12 * s12 + SMOOTHING**2)
    largest = (s11 + s22) / 2 + r
    root = np.sqrt(largest * largest + SMOOTHING**2)
    first = (1 + largest / root) / 2
    slope = np.stack([0.5 + h / (2 * r), s12 / r, 0.5 - h / (2 * r)], -1)
    # The second derivatives of r by (h, S_12) are (I - n n') / r with n = (h, S_12) / r.
    by_curvature = np.array([[0.5, 0.0, -0.5], [0.0, 1.0, 0.0]])
    direction = np.stack([h, s12], -1) / r[:, None]
    of_r = by_curvature.T @ (
        (np.eye(2) - _square(direction)) / r[:, None, None]) @ by_curvature
    second = _scale(first, of_r) + (
        SMOOTHING**2 / (2 * root**3))[:, None, None] * slope[:, :, None] * slope[:, None]
    return (largest + root) / 2, _scale(first, slope), second
