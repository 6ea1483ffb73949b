"""
Convex hulls of pieces of the flown curve, by points that are linear in a flight's points.

In the slot around point n a quadratic B-spline is a Bezier curve with the control points
(q[n-1] + q[n]) / 2, q[n] and (q[n] + q[n+1]) / 2, and stays within their convex hull. A UAV
without a limit of acceleration flies along the line from q[n] to q[n+1]. Where one UAV of each
kind is compared at the same time, slots are divided in halves, in which both curves are
quadratic.
"""

from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from ..grid import Grid
from ...mission.scenario import Array

_Piece: TypeAlias = tuple[tuple[float, float, float], ...]

# The weights of q[n-1], q[n], q[n+1] for every control point.
_SMOOTH: _Piece = ((0.5, 0.5, 0.0), (0.0, 1.0, 0.0), (0.0, 0.5, 0.5))
_STRAIGHT = ((0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
_STRAIGHT_BY_THREE = ((0.0, 1.0, 0.0), (0.0, 0.5, 0.5), (0.0, 0.0, 1.0))
_SMOOTH_HALVES = (((0.5, 0.5, 0.0), (0.25, 0.75, 0.0), (0.125, 0.75, 0.125)),
                  ((0.125, 0.75, 0.125), (0.0, 0.75, 0.25), (0.0, 0.5, 0.5)))
_POINT = ((0.0, 1.0, 0.0),)
_ENDS = ((0.5, 0.5, 0.0),), ((0.0, 0.5, 0.5),)
_STRAIGHT_HALVES = (((0.5, 0.5, 0.0), (0.25, 0.75, 0.0), (0.0, 1.0, 0.0)),
                    ((0.0, 1.0, 0.0), (0.0, 0.75, 0.25), (0.0, 0.5, 0.5)))


class Tracks:
    """
    Control points of every UAV's curve around every point of its flight.

    A track is the sequence of these pieces, one around each of the points 0..N+1; with halves
    each UAV has two of them, before and after each point.

    :param grid: of the flight.
    :param kinds: the weights of the pieces of each UAV around a point, as of pieces_of.
    :param ends: those around the first point and the last, where they are others.
    :ivar uav: whose each track is, (T,).
    :ivar weights: of q[n-1], q[n], q[n+1] in each control point, (N+2, T, K, 3); zero for points
        that do not vary.
    :ivar all_weights: likewise, of all points.
    :ivar constant: what each control point has besides, (N+2, T, K, 2) in units.
    """

    def __init__(self, grid: Grid, kinds: list[list[_Piece]],
                 ends: tuple[_Piece, _Piece] | None = None) -> None:
        self.grid = grid
        self.uav: NDArray[np.intp] = np.repeat(np.arange(len(kinds)), len(kinds[0]))
        weights = np.array([one for kind in kinds for one in kind])
        self.weights: Array = np.repeat(weights[None], grid.slots + 2, axis=0)
        if ends is not None:
            self.weights[0], self.weights[-1] = ends
        self.constant = np.zeros((*self.weights.shape[:-1], 2))
        self._close_ends(np.isfinite(grid.scenario.max_accelerations))
        self.all_weights = self.weights.copy()
        # Of points that do not vary, only the places count.
        self.weights[0, ..., 1] = self.weights[-1, ..., 1] = 0.0
        self.weights[1, ..., 0] = self.weights[-2, ..., 2] = 0.0
        self.weights[:, grid.fixed[self.uav]] = 0.0

    @classmethod
    def of_points(cls, grid: Grid) -> 'Tracks':
        """Return tracks of the points alone, and of the curve's ends instead of start and goal."""
        return cls(grid, [[_POINT]] * len(grid.scenario.uavs), _ENDS)

    def _close_ends(self, smooth: NDArray[np.bool_]) -> None:
        """Express the points before the first and after the last by others."""
        moves = self.grid.scenario.end_velocities[:, self.uav] * self.grid.slot_duration / (
            self.grid.length)
        free = smooth[self.uav] & np.isnan(moves[..., 0])
        # A UAV without a limit of acceleration rests there.
        moves = np.where((smooth[self.uav] & ~free)[..., None], moves, 0.0)
        for end, sign, outer, inner in ((0, -1.0, 0, 2), (-1, 1.0, 2, 0)):
            weights = self.weights[end]
            beyond = weights[..., outer].copy()
            weights[..., outer] = 0.0
            weights[..., 1] += beyond
            weights[free[end], :, 1] += beyond[free[end]]
            weights[free[end], :, inner] -= beyond[free[end]]
            self.constant[end] += beyond[..., None] * sign * moves[end][:, None]

    def at(self, path: Array) -> Array:
        """Return the control points of a path, (N+2, T, K, 2)."""
        path, weights = path[:, self.uav, None], self.all_weights[..., None]
        found: Array = weights[..., 1, :] * path
        found[1:] += weights[1:, ..., 0, :] * path[:-1]
        found[:-1] += weights[:-1, ..., 2, :] * path[1:]
        return found + self.constant


def pieces_of(grid: Grid, together: bool) -> list[list[_Piece]]:
    """
    Return the weights of the pieces of each UAV around a point.

    :param together: whether pieces of different UAVs with the same number must be flown at the
        same time; otherwise each UAV has its own kind of piece.
    """
    smooth = np.isfinite(grid.scenario.max_accelerations)
    if smooth.all() or not smooth.any():
        return [[_SMOOTH if one else _STRAIGHT] for one in smooth]
    if together:
        return [list(_SMOOTH_HALVES if one else _STRAIGHT_HALVES) for one in smooth]
    return [[_SMOOTH if one else _STRAIGHT_BY_THREE] for one in smooth]
