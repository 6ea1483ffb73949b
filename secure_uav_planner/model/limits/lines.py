"""
Limits that keep pieces of the flown curve on one side of lines.

With a limit of acceleration, the curve in the slot around point n is a Bezier curve with the
control points (q[n-1] + q[n]) / 2, q[n] and (q[n] + q[n+1]) / 2, and stays within their convex
hull. Without one, it is the line from q[n] to q[n+1].
"""

from abc import abstractmethod
from collections.abc import Callable
from functools import cached_property
from typing import Any, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from .base import compile_vectors, Limit
from ..grid import Grid
from ..kernel import core
from ...mission.scenario import Array

_TOLERANCE = 1e-6  # Distance [units] by which constant control points may be beyond a line.

_Piece: TypeAlias = tuple[tuple[float, float, float], ...]

# The weights of q[n-1], q[n], q[n+1] in each control point.
_SMOOTH: _Piece = ((0.5, 0.5, 0.0), (0.0, 1.0, 0.0), (0.0, 0.5, 0.5))
_STRAIGHT = ((0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
_POINT = ((0.0, 1.0, 0.0),)


class ControlPoints:
    """
    The K control points of each piece of the curves, linear in the points of a flight.

    Around each of the points 0..N+1 every UAV has one piece.

    :param grid: grid of the flight.
    :param on_curve: True for the control points of the flown curve; False for the points of the
        flight, with the curve's ends in place of start and goal.
    :ivar weights: weights of q[n-1], q[n], q[n+1] in each control point, (N+2, U, K, 3); zero for
        points that do not vary.
    :ivar all_weights: the same weights, also of points that do not vary, (N+2, U, K, 3).
    :ivar constant: the constant part of each control point, (N+2, U, K, 2) in units.
    """

    def __init__(self, grid: Grid, on_curve: bool) -> None:
        self.grid = grid
        is_smooth = grid.scenario.limits_acceleration
        piece = _POINT if not on_curve else _SMOOTH if is_smooth else _STRAIGHT
        self.weights: Array = np.tile(piece, (grid.slots + 2, len(grid.scenario.uavs), 1, 1))
        if not on_curve:  # The ends of the curve.
            self.weights[0], self.weights[-1] = _SMOOTH[:1], _SMOOTH[2:]
        self.constant = np.zeros((*self.weights.shape[:-1], 2))
        self._close_ends()
        self.all_weights = self.weights.copy()
        # Start q[0], goal q[N+1] and all points of fixed UAVs do not vary.
        self.weights[0, ..., 1] = self.weights[-1, ..., 1] = 0.0
        self.weights[1, ..., 0] = self.weights[-2, ..., 2] = 0.0
        self.weights[:, grid.fixed] = 0.0

    def _close_ends(self) -> None:
        """
        Express q[-1] and q[N+2], which are no points of the flight, by points of the flight.

        They are q[0] - v_start ts and q[N+1] + v_goal ts, with both v = 0 if acceleration is not
        limited. With a free velocity they continue the nearest move: q[-1] = 2 q[0] - q[1]. The
        weights of q[-1] and q[N+2] in control points go to q[0], q[1], q[N], q[N+1], `constant`.
        """
        velocities = self.grid.scenario.end_velocities
        if not self.grid.scenario.limits_acceleration:
            velocities = np.zeros_like(velocities)  # UAVs rest at both ends.
        free = np.isnan(velocities[..., 0])
        moves = np.nan_to_num(velocities) * self.grid.slot_duration / self.grid.length
        for end, sign, outer, inner in ((0, -1.0, 0, 2), (-1, 1.0, 2, 0)):
            weights = self.weights[end]
            beyond = weights[..., outer].copy()
            weights[..., outer] = 0.0
            weights[..., 1] += beyond
            weights[free[end], :, 1] += beyond[free[end]]
            weights[free[end], :, inner] -= beyond[free[end]]
            self.constant[end] += beyond[..., None] * sign * moves[end][:, None]

    def evaluate(self, path: Array) -> Array:
        """
        Return the control points of a path, (N+2, U, K, 2) in units.

        :param path: the points q[n] of each UAV, (N+2, U, 2) in units.
        """
        path, weights = path[:, :, None], self.all_weights[..., None]
        # Entries 0, 1 and 2 are the weights of q[n-1], q[n] and q[n+1].
        points: Array = weights[..., 1, :] * path
        points[1:] += weights[1:, ..., 0, :] * path[:-1]
        points[:-1] += weights[:-1, ..., 2, :] * path[1:]
        return points + self.constant


class Lines(NamedTuple):
    """
    Separating half-planes normal . p >= offset, one for each piece and pair.

    :ivar normals: unit vectors, (N+2, G, 2).
    :ivar offsets: (N+2, G) in units.
    """

    normals: Array
    offsets: Array


class LineLimit(Limit):
    """
    A limit c = normal . p - offset >= 0 on the control points p of pieces of curves.

    A convex piece clears a convex obstacle if a line separates them. A pair is a UAV and an
    obstacle, or two UAVs, whose difference must stay out of a disc. Each of G pairs has a line for
    every piece of its curve. The kernel's class of the same name chooses the lines.

    :param first: the UAV of each pair, (G,).
    :param second: the UAV whose piece is subtracted, (G,), or None.
    :param on_curve: whether the limit holds for control points of the curve; see ControlPoints.
    :ivar points: the ControlPoints of all curves.
    :ivar ignored: True for control points that do not vary, (N+2, G, K).
    """

    def __init__(self, grid: Grid, first: NDArray[np.intp],
                 second: NDArray[np.intp] | None = None, on_curve: bool = True) -> None:
        super().__init__(grid)
        self.points = ControlPoints(grid, on_curve)
        self.first, self.second = first, second
        constant: NDArray[np.bool_] = np.all(self.points.weights == 0, axis=-1)
        self.ignored = np.ascontiguousarray(constant[:, first])
        if second is not None:
            self.ignored &= constant[:, second]

    @cached_property
    @abstractmethod
    def compiled(self) -> core.LineLimit:
        """Return the kernel's form."""

    @property
    def compiled_points(self) -> core.Vectors:
        """Return the kernel's form of control_points of all pairs, (N+2, G, K) vectors."""
        number, uavs = np.arange(self.grid.slots + 2)[:, None], len(self.grid.fixed)
        # A control point is a sum of q[n], q[n-1] and q[n+1] with weights, in this order.
        near: NDArray[np.intp] = np.clip(number + [0, -1, 1], 0, number[-1])
        neighbours = near[:, None, None] * uavs
        weights, constant = self.points.all_weights[..., [1, 0, 2]], self.points.constant
        points, factors = neighbours + self.first[:, None, None], weights[:, self.first]
        constants = constant[:, self.first]
        if self.second is not None:
            points = np.concatenate([points, neighbours + self.second[:, None, None]], axis=-1)
            factors = np.concatenate([factors, -weights[:, self.second]], axis=-1)
            constants = constants - constant[:, self.second]
        return compile_vectors(self.grid, points, factors, constants)

    def choose_lines(self, path: Array) -> Lines:
        """
        Return lines that separate the pieces of a path (N+2, U, 2) from their obstacles.

        If a piece cannot be separated, normal . p < offset for at least one control point p.
        """
        shape = len(path), len(self.first)
        lines = Lines(np.empty((*shape, 2)), np.empty(shape))
        self.compiled.choose_lines(np.ascontiguousarray(path), *lines)
        return lines

    def rotate_normals(self, path: Array, lines: Lines, opposite: bool,
                       raise_if_over: Callable[[], None]) -> Lines:
        """
        Return lines by which a path that is not clear can be moved to one side of each obstacle.

        :param lines: lines of the path by choose_lines, which are returned by default. An override
            may change them in place.
        :param opposite: whether UAVs that meet pass each other on the side that is not nearest.
        """
        return lines

    def validate(self, positions: Array, powers: Array) -> None:
        """Check nothing: Plan checks the flown curve."""

    def control_points(self, path: Array, pairs: Any = slice(None)) -> Array:
        """
        Return the control points p of pairs, by default of all, (N+2, G, K, 2) in units.

        For a pair of two UAVs p is a control point of the first minus the same of the second.
        """
        points = self.points.evaluate(path)
        first = points[:, self.first[pairs]]
        return first if self.second is None else first - points[:, self.second[pairs]]

    def slacks(self, path: Array, lines: Lines) -> Array:
        """Return c = normal . p - offset of a path (N+2, U, 2), (N+2, G, K), all in units."""
        along = np.einsum('ngkx,ngx->ngk', self.control_points(path), lines.normals)
        return along - lines.offsets[..., None]

    def is_clear(self, positions: Array) -> bool:
        """Return True if lines separate all pieces of flights (U, N+2, 2) in m from obstacles."""
        path = self.grid.to_path(positions)
        slacks = self.slacks(path, self.choose_lines(path))
        # Control points that do not vary may be beyond a line by _TOLERANCE.
        slacks[self.ignored] += _TOLERANCE
        return bool((slacks > 0).all())
