"""
Newton's linear system in the form of a block arrow, and its solution.

A chain of edges is joined by slot groups; the prices of power border all of them.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy

from .variables import DualPoint, GroupLayout, PotentialLayout
from ...mission.validation import Array


@dataclass(frozen=True, eq=False)
class ArrowSystem:
    """
    Gradient and Hessian of the dual function in blocks, F unknowns for each slot group.

    :param potential: layout of the potentials.
    :param layout: of the unknowns of a group; neighbouring groups have an edge in common.
    :param group: gradient of the groups' terms, (G, F).
    :param groups: their Hessians, (G, F, F).
    :param edge: gradient of the edges' own terms, (G + 1, U P).
    :param edges: their Hessians, (G + 1, U P, U P).
    :param price: gradient of the prices' own terms, (U,).
    :param prices: the diagonal of their Hessian, (U,).
    :param sharpness: number of slots of a group, divided by the temperature, (G,).
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

    def slope(self, step: DualPoint) -> float:
        """Return the derivative along a step."""
        x = step.potentials.reshape(self.edge.shape)
        local = np.concatenate([step.v, _spread(x, step.prices)], 1)
        return float((self.group * local).sum() + (self.edge * x).sum()
                     + self.price @ step.prices)

    def solve(self, damping: float) -> DualPoint:
        """
        Return the damped Newton step.

        If a single column is far better than the rest, the function is linear near the point, and
        a full step would leave that neighbourhood. `damping` stands for a variance of the columns
        of a group in units^2: it limits changes of the potentials from edge to edge, and of those
        at both ends. The diagonal of v and of the prices is raised by it as a share.

        v is eliminated in every group, then the potentials by a banded Cholesky factorisation.

        :raises numpy.linalg.LinAlgError: where the Hessian is not positive definite.
        """
        layout, width, count = self.layout, self.edge.shape[1], len(self.group)
        solved, hessian, gradient = self._eliminate_v(damping)
        # What is left of a group's unknowns begins with the edge before it.
        before, after, price = (slice(part.start - layout.before.start,
                                      part.stop - layout.before.start)
                                for part in (layout.before, layout.after, layout.prices))
        change = (damping * self.sharpness)[:, None, None] * np.eye(width)
        for side, opposite in ((before, after), (after, before)):
            hessian[:, side, side] += change
            hessian[:, side, opposite] -= change
        diagonal, edge = self.edges.copy(), self.edge.copy()
        border = np.zeros((count + 1, width, len(self.price)))
        for at, part in ((slice(0, -1), before), (slice(1, None), after)):
            diagonal[at] += hessian[:, part, part]
            edge[at] += gradient[:, part]
            border[at] += hessian[:, part, price]
        diagonal = diagonal + 1e-9 * np.eye(width)
        diagonal[[0, -1]] += change[[0, -1]]
        columns = border.reshape(-1, len(self.price))
        answer = _solve_chain(diagonal, hessian[:, after, before],
                              np.concatenate([columns, edge.reshape(-1, 1)], 1))
        corner = (np.diag(self.prices) + hessian[:, price, price].sum(0)
                  - columns.T @ answer[:, :-1])
        corner = corner + damping * np.diag(np.abs(np.diag(corner)))
        prices = -np.linalg.solve(corner, self.price + gradient[:, price].sum(0)
                                  - columns.T @ answer[:, -1])
        x = (-answer[:, -1] - answer[:, :-1] @ prices).reshape(count + 1, width)
        v = -solved[..., -1] - np.matmul(
            solved[..., :-1], _spread(x, prices)[..., None])[..., 0]
        return DualPoint(self.potential, x.reshape(count + 1, len(prices), -1), v, prices)

    def _eliminate_v(self, damping: float) -> tuple[Array, Array, Array]:
        """Return v by the other unknowns and a constant, and the Hessian and gradient left."""
        v, rest = self.layout.v, slice(self.layout.before.start, None)
        own, joint = self.groups[:, v, v], self.groups[:, v, rest]
        own = own + (damping * np.einsum('gii->gi', own) + 1e-12)[:, :, None] * np.eye(v.stop)
        solved = np.linalg.solve(own, np.concatenate([joint, self.group[:, v, None]], -1))
        transposed = joint.transpose(0, 2, 1)
        return (solved, self.groups[:, rest, rest] - np.matmul(transposed, solved[..., :-1]),
                self.group[:, rest] - np.matmul(transposed, solved[..., -1:])[..., 0])


def _spread(x: Array, prices: Array) -> Array:
    """Gather the x of each group at the edges, (G + 1, U P), and the prices (U,)."""
    return np.concatenate(
        [x[:-1], x[1:], np.broadcast_to(prices, (len(x) - 1, len(prices)))], 1)


def _solve_chain(diagonal: Array, below: Array, right: Array) -> Array:
    """
    Solve a block tridiagonal system.

    :param diagonal: blocks of the symmetric matrix, (G + 1, P, P).
    :param below: blocks below those, (G, P, P).
    :param right: right-hand sides, ((G + 1) P, K).
    """
    count, width = diagonal.shape[:2]
    band = np.zeros((2 * width, count * width))
    for row in range(width):
        for column in range(width):
            if row >= column:
                band[row - column, column::width] = diagonal[:, row, column]
            band[width + row - column, column:(count - 1) * width:width] = below[:, row, column]
    factor = scipy.linalg.cholesky_banded(band, lower=True, check_finite=False, overwrite_ab=True)
    return np.asarray(scipy.linalg.cho_solve_banded((factor, True), right, check_finite=False))
