"""Newton's step for the dual function: block tridiagonal in the potentials, bordered by prices."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import scipy

from ..proof.conjugate import Array


@dataclass(frozen=True, eq=False)
class DualPoint:
    """
    Where the dual function is evaluated.

    :param potentials: at every edge u, then S where potentials are quadratic, then w where
        accelerations are limited, (G + 1, U, P).
    :param shares: v, (G, E).
    :param prices: lam, (U,).
    """

    potentials: Array
    shares: Array
    prices: Array

    def moved(self, step: DualPoint, length: float) -> DualPoint:
        """Return this point moved along a step."""
        return DualPoint(self.potentials + length * step.potentials,
                         self.shares + length * step.shares, self.prices + length * step.prices)

    def within(self, point: DualPoint, room: Array) -> DualPoint:
        """Return this step cut back so that every slot's v, room and prices stay positive."""
        with np.errstate(divide='ignore', invalid='ignore'):
            total = -self.shares.sum(-1)
            most = np.minimum(
                np.where(self.shares < 0, -point.shares / self.shares, np.inf).min(-1),
                np.where(total < 0, -room / total, np.inf))
            prices = np.where(self.prices < 0, -point.prices / self.prices, np.inf)
        return replace(self, shares=self.shares * np.minimum(1.0, 0.9 * most)[..., None],
                       prices=self.prices * np.minimum(1.0, 0.9 * prices))


@dataclass(frozen=True, eq=False)
class DualDerivatives:
    """
    Gradient and Hessian in blocks; a stage's unknowns are v, both edges' potentials, and lam.

    :param stage: gradient of what belongs to a stage, (G, V + 2 U P + U).
    :param stages: its Hessian, (G, V + 2 U P + U, alike).
    :param edge: gradient of what belongs to an edge alone, (G + 1, U P).
    :param edges: its Hessian, (G + 1, U P, U P).
    :param price: gradient of what belongs to the prices alone, (U,).
    :param prices: its Hessian's diagonal, (U,).
    :param sharpness: how many slots a stage has, divided by the temperature, (G,).
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

    def step(self, damping: float) -> DualPoint:
        """
        Return Newton's step, damped.

        Where one column is far better than all others the function is linear, and a full step
        would go far beyond where that holds. `damping` is what a stage's columns vary by in every
        direction at least, in units^2: changes of the potentials from one edge to the next, and
        of those at both ends, are then limited. For v and the prices it is the share by which
        their diagonal is raised.

        v is eliminated in every stage, then the potentials by a banded Cholesky factorisation.

        :raises numpy.linalg.LinAlgError: where the Hessian is not positive definite.
        """
        count, up, u = len(self.stage), self.edge.shape[1], len(self.price)
        first = self.stage.shape[1] - 2 * up - u
        vv = self.stages[:, :first, :first]
        more = damping * self.sharpness
        vv = vv + (damping * np.einsum('gii->gi', vv) + 1e-12)[:, :, None] * np.eye(first)
        vr = self.stages[:, :first, first:]
        solved = np.linalg.solve(vv, np.concatenate([vr, self.stage[:, :first, None]], -1))
        local = self.stages[:, first:, first:] - np.matmul(vr.transpose(0, 2, 1), solved[..., :-1])
        rest = self.stage[:, first:] - np.matmul(
            vr.transpose(0, 2, 1), solved[..., -1:])[..., 0]
        move = more[:, None, None] * np.eye(up)
        local[:, :up, :up] += move
        local[:, up:2 * up, up:2 * up] += move
        local[:, up:2 * up, :up] -= move
        local[:, :up, up:2 * up] -= move
        here, after, price = slice(0, up), slice(up, 2 * up), slice(2 * up, None)
        diagonal, edge = self.edges.copy(), self.edge.copy()
        border = np.zeros((count + 1, up, u))
        for at, part in ((slice(0, -1), here), (slice(1, None), after)):
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
        other = np.concatenate([x[:-1], x[1:], np.broadcast_to(prices, (count, u))], 1)
        shares = -solved[..., -1] - np.matmul(solved[..., :-1], other[..., None])[..., 0]
        return DualPoint(x.reshape(count + 1, u, -1), shares, prices)
