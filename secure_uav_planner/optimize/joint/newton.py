"""The Newton system: a symmetric band matrix for each start, and a few dense rows."""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray
from scipy.linalg.lapack import dpbtrf, dpbtrs

from ...errors import NumericalError
from ...scenario import Array

_FIRST_SHIFT = 1e-12  # Before the first factorisation, for matrices that are singular by rounding.
_ONE_BY_ONE = 3  # Failures after which more and more slots are made convex at once,
_ALL_AT_ONCE = 12  # and after which all are.
_SHIFTS = 10.0 ** np.arange(-8, 9, 2)  # Of all variables when no projection is left to do.


class BandMatrix:
    """
    The Hessians of a barrier function in x (N, U, 3), one for each of several starts.

    Only the lower triangle is kept: entry [start, slot, column, offset] stands `offset` rows
    below the diagonal in the column of that slot's variable.

    :param hessians: those of the objective, slot by slot, (S, N, 3 U, 3 U); those of fixed
        positions are set to zero in place.
    :param height: how many diagonals of the lower triangle there are, at least 3 U.
    :param fixed: UAVs whose positions are no variables, (U,).
    """

    def __init__(self, hessians: Array, height: int, fixed: NDArray[np.bool_]) -> None:
        starts, slots, self._size = hessians.shape[:3]
        constant = np.outer(fixed, [False, True, True]).ravel()
        hessians[..., constant, :] = 0.0
        hessians[..., constant] = 0.0
        self._hessians = hessians
        self._inside = np.arange(self._size)[:, None] + np.arange(self._size) < self._size
        columns, offsets = np.indices((self._size, self._size))
        self._pattern = np.where(self._inside, (columns + offsets) * self._size + columns, 0)
        self._band = np.zeros((starts, slots, self._size, height))
        self._band[..., :self._size] = self._lower(hessians)
        self._band[..., constant, 0] = 1.0

    def _lower(self, blocks: Array) -> Array:
        """Return the lower triangles of blocks (..., 3 U, 3 U) by column and offset."""
        flat = blocks.reshape(*blocks.shape[:-2], -1)
        lower: Array = flat[..., self._pattern] * self._inside
        return lower

    def add_powers(self, values: Array) -> None:
        """Add values (S, N, U) to the diagonal of the powers."""
        self._band[..., ::3, 0] += values

    def add_positions(self, later: int, blocks: Array) -> None:
        """
        Add blocks that couple each UAV's position in a slot with that some slots later.

        :param later: how many slots; with 0, only the lower triangles count.
        :param blocks: (S, N - later, U, 2, 2), the later slot's coordinate first.
        """
        slots = blocks.shape[1]
        for row in (0, 1):
            for column in (0, 1):
                offset = later * self._size + row - column
                if offset >= 0:
                    self._band[:, :slots, 1 + column::3, offset] += blocks[..., row, column]

    def add_pairs(self, later: int, row: NDArray[np.intp], column: NDArray[np.intp],
                  blocks: Array) -> None:
        """
        Add blocks that couple the position of one UAV in a slot with another's some slots later.

        :param later: how many slots; with 0, only what is in the lower triangle counts.
        :param row: the UAV of the later slot of each of P pairs, (P,).
        :param column: the UAV of the earlier slot, (P,); no pair occurs twice.
        :param blocks: (S, N - later, P, 2, 2), the later slot's coordinate first.
        """
        if later == 0:
            below = row > column
            row, column, blocks = row[below], column[below], blocks[:, :, below]
        slots = blocks.shape[1]
        for down in (0, 1):
            for right in (0, 1):
                offset = later * self._size + 3 * (row - column) + down - right
                self._band[:, :slots, 3 * column + 1 + right, offset] += blocks[..., down, right]

    def dense(self, start: int) -> Array:
        """Return the matrix of a start in full, (N * 3 U, N * 3 U); for small ones."""
        band = self._band[start].reshape(-1, self._band.shape[-1])
        lower = np.zeros((len(band), len(band)))
        for offset in range(min(len(band), band.shape[1])):
            lower += np.diag(band[:len(band) - offset, offset], -offset)
        return lower + np.tril(lower, -1).T

    def solve(self, right: Array, rows: Array, softness: Array,
              check: Callable[[], None] = lambda: None) -> Array:
        """
        Return the solutions of (band + sum_k row_k row_k^T / softness_k) step = right.

        Where a band is not positive definite it is made so, as little as that takes. A start
        for which even that fails gets NaN.

        :param right: (S, N * 3 U).
        :param rows: (K, N * 3 U).
        :param softness: (S, K).
        :param check: called before each start; what it raises is passed on.
        :return: (S, N * 3 U).
        """
        found = np.empty_like(right)
        together = np.empty((right.shape[1], 1 + len(rows)))
        together[:, 1:] = rows.T
        for start, one in enumerate(right):
            check()
            together[:, 0] = one
            try:
                solved = dpbtrs(self._factor(start), together, lower=1)[0]
                # Woodbury's formula.
                products = rows @ solved
                found[start] = solved[:, 0] - solved[:, 1:] @ np.linalg.solve(
                    np.diag(softness[start]) + products[:, 1:], products[:, 0])
            except (NumericalError, np.linalg.LinAlgError):
                found[start] = np.nan
        return found

    def _factor(self, start: int) -> Array:
        """
        Return the Cholesky factor of a band that has been made positive definite.

        First, the Hessians of the slots where the factorisation fails and of their neighbours
        are projected on the semidefinite cone. All limits' terms are convex, so that this ends;
        what rounding still breaks is mended by shifts of the diagonal.

        :raises NumericalError: when no shift is large enough.
        """
        band, hessians = self._band[start], self._hessians[start]
        if not np.isfinite(band).all():
            raise NumericalError('the Hessian is not finite')
        band[..., 0] += _FIRST_SHIFT
        convex = np.zeros(len(band), bool)
        failures = 0
        while not convex.all():
            factor, failed = _cholesky(band)
            if not failed:
                return factor
            chosen = ~convex
            if failures < _ALL_AT_ONCE:
                width = 2**max(0, failures - _ONE_BY_ONE)
                slot = (failed - 1) // self._size
                near = np.zeros_like(convex)
                near[max(0, slot - width):slot + width + 1] = True
                if (near & chosen).any():
                    chosen &= near
            band[chosen, :, :self._size] += self._lower(_negative_part(hessians[chosen]))
            convex |= chosen
            failures += 1
        scale = max(1.0, float(np.abs(band[..., 0]).max()))
        for shift in _SHIFTS:
            factor, failed = _cholesky(band)
            if not failed:
                return factor
            band[..., 0] += shift * scale
        raise NumericalError('the Hessian could not be made positive definite')


def _cholesky(band: Array) -> tuple[Array, int]:
    """Return the factor of a band (N, 3 U, height), and the row where it failed, from 1, or 0."""
    factor, failed = dpbtrf(band.reshape(-1, band.shape[-1]).T, lower=1)
    return factor, failed


def _negative_part(blocks: Array) -> Array:
    """Return what symmetric matrices lack to be positive semidefinite."""
    values, vectors = np.linalg.eigh(blocks)
    lacking: Array = (vectors * np.maximum(-values, 0.0)[..., None, :]) @ np.swapaxes(
        vectors, -1, -2)
    return lacking
