"""
The Newton step of the dual function, by a linear system that is an arrow.

The arrow is a band, in which the potentials at an edge are followed by the v of the group after
it, and the prices of power as its border.
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
    :param layout: layout of a group's unknowns; neighbouring groups have an edge in common.
    :param group_gradient: gradient of the groups' terms, (G, F).
    :param group_hessian: Hessians of the groups' terms, (G, F, F).
    :param edge_gradient: gradient of the edges' own terms, (G + 1, U P).
    :param edge_hessian: Hessians of the edges' own terms, (G + 1, U P, U P).
    :param price_gradient: gradient of the prices' own terms, (U,).
    :param price_curvature: diagonal of the Hessian of the prices' own terms, (U,).
    :param sharpness: number of slots of a group, divided by the temperature, (G,).
    :param cells: number of cells of a group.
    """

    potential: PotentialLayout
    layout: GroupLayout
    group_gradient: Array
    group_hessian: Array
    edge_gradient: Array
    edge_hessian: Array
    price_gradient: Array
    price_curvature: Array
    sharpness: Array
    cells: int

    def slope(self, step: DualPoint) -> float:
        """Return the derivative of the dual function along a step: gradient times step."""
        groups, potentials = len(step.v), step.potentials.reshape(self.edge_gradient.shape)
        # The step of each group's F unknowns, (G, F).
        group_steps = np.concatenate([
            potentials[:-1], step.v.reshape(groups, -1), potentials[1:],
            np.broadcast_to(step.prices, (groups, len(step.prices)))], 1)
        return float((self.group_gradient * group_steps).sum()
                     + (self.edge_gradient * potentials).sum()
                     + self.price_gradient @ step.prices)

    def solve(self, damping: float) -> DualPoint:
        """
        Return the damped Newton step.

        If a single column is far better than any other, the function is linear near the point,
        and a full step would leave the neighbourhood in which it is linear. Damping limits how
        much the potentials change from edge to edge and at both ends, see _damp. It also raises
        the diagonals of v and of the prices by a fraction.

        :param damping: an additional variance [units^2] of a group's columns, and the fraction.
        :raises numpy.linalg.LinAlgError: if the Hessian is not positive definite.
        """
        groups, edges = self._damp(damping)
        factor = scipy.linalg.cholesky_banded(
            self._assemble_band(groups, edges), lower=True, check_finite=False)
        border = self._assemble_border(groups)
        answer = scipy.linalg.cho_solve_banded((factor, True), border, check_finite=False)
        prices = self._eliminate_border(groups, border, answer, damping)
        (count, width), block = self.edge_gradient.shape, self.layout.after.start
        # A row for each edge: its potentials, then the v of the group after it.
        rows = -(answer[:, -1] + answer[:, :-1] @ prices).reshape(count, block)
        return DualPoint(self.potential, rows[:, :width].reshape(count, len(prices), -1),
                         rows[:-1, width:].reshape(count - 1, self.cells, -1), prices)

    def _damp(self, damping: float) -> tuple[Array, Array]:
        """
        Return the Hessians of groups (G, F, F) and edges (G + 1, U P, U P) with damping.

        With c = damping * sharpness of a group, c |x_after - x_before|^2 / 2 is added for the
        potentials x at its edges, and c |x|^2 / 2 at the first and the last edge. The diagonal of
        v is multiplied by 1 + damping. 1e-12 is added to this diagonal, 1e-9 to the edges' ones.
        """
        before, v, after, _ = self.layout
        identity = np.eye(self.edge_gradient.shape[1])
        variance = (damping * self.sharpness)[:, None, None] * identity
        groups, edges = self.group_hessian.copy(), self.edge_hessian + 1e-9 * identity
        for side, opposite in ((before, after), (after, before)):
            groups[:, side, side] += variance
            groups[:, side, opposite] -= variance
        edges[[0, -1]] += variance[[0, -1]]
        diagonal = np.arange(v.start, v.stop)
        groups[:, diagonal, diagonal] = (1 + damping) * groups[:, diagonal, diagonal] + 1e-12
        return groups, edges

    def _assemble_band(self, groups: Array, edges: Array) -> Array:
        """
        Return the band H of the Hessian as cholesky_banded takes it: row i holds H[j + i, j].

        The band has K = U P + (number of v) unknowns for each edge: the potentials at the edge,
        then the v of the group after it. Column j of a group's Hessian belongs to the edge before
        the group if j < K, and otherwise to the edge after it.
        """
        (count, width), block = self.edge_gradient.shape, self.layout.after.start
        size = self.layout.after.stop
        band = np.zeros((count, block, size))
        for j in range(size):
            edge, column = divmod(j, block)
            band[edge:count - 1 + edge, column, :size - j] += groups[:, j:size, j]
        for j in range(width):
            band[:, j, :width - j] += edges[:, j:, j]
        # No group follows the last edge, so its v are unknowns with an equation of their own.
        band[-1, width:, 0] = 1.0
        return np.asarray(band.reshape(-1, size).T)

    def _assemble_border(self, groups: Array) -> Array:
        """
        Return the right sides of the band's linear systems, ((G + 1) K, U + 1).

        The rows are the band's unknowns, K for each edge as in _assemble_band. The first U columns
        are the mixed derivatives by the unknown and by each UAV's price; the last column is the
        gradient.
        """
        (count, width), block = self.edge_gradient.shape, self.layout.after.start
        size = self.layout.after.stop
        border = np.zeros((count, block, len(self.price_gradient) + 1))
        group_rows = np.concatenate(
            [groups[:, :size, self.layout.prices], self.group_gradient[:, :size, None]], -1)
        border[:-1] += group_rows[:, :block]
        border[1:, :width] += group_rows[:, block:]
        border[:, :width, -1] += self.edge_gradient
        return border.reshape(count * block, -1)

    def _eliminate_border(self, groups: Array, border: Array, answer: Array, damping: float
                          ) -> Array:
        """
        Return the step of the prices, (U,), by the Schur complement of the band.

        With the Hessian [[H, C], [C', D]] and the gradient [h, d] it is minus the inverse of
        D - C' H^-1 C, with its diagonal raised, times d - C' H^-1 h.

        :param groups: damped Hessians of the groups' terms, (G, F, F).
        :param border: right sides by _assemble_border; the last column is the gradient.
        :param answer: inverse of the band times the border.
        :param damping: fraction by which this diagonal is raised.
        """
        own, mixed = self.layout.prices, border[:, :-1]
        complement = np.diag(self.price_curvature) + groups[:, own, own].sum(0) - (
            mixed.T @ answer[:, :-1])
        complement += damping * np.diag(np.abs(np.diag(complement)))
        gradient = self.price_gradient + self.group_gradient[:, own].sum(0)
        return np.asarray(-np.linalg.solve(complement, gradient - mixed.T @ answer[:, -1]))
