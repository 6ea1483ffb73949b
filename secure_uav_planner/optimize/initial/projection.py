"""
Moves flights strictly inside all limits, as little as it can, by sequential convex programming.

Lines separate each piece of a curve from what it must clear, which makes the limits convex. The
nearest flight on its side of the lines is found, and lines are chosen anew from there. Many UAVs
are moved a few at a time while the rest stay, as Chen, Cutler and How (2015) do. Flights of many
slots are found on a coarse grid first.
"""

from collections.abc import Iterator
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray
import scipy

from ..deadline import DeadlineCheck
from ...mission.scenario import Array
from ...model.cone_program import solve_cone_program
from ...model.grid import Grid, resample_flights
from ...model.limits import build_limits, LineLimit, NormLimit
from ...model.limits.lines import Lines
from ...model.problem import Problem

_SHARE = 1e-3  # Share of the slack that flights keep free, if they can.
_ROUNDS = 8  # Largest number of rounds in which lines are chosen.
_PENALTY = 1e4  # Weight of the relative excess of a limit; 1 is one squared step of deviation.
_LINE_PENALTY = 1e7  # Weight of a step beyond a line: sides are kept even if time is too short.
_CLEARANCE = 0.05  # Distance from lines [steps] that flights keep, if there is room.
_NEAR = 4.0  # Distance [steps] beyond which lines are left out.
_MOST_MOVED = 1000  # Points that are moved together: Clarabel cannot be stopped until it begins.
_COARSE_SLOTS = 500  # Largest number of slots of the grid on which flights are found first.
_MOST_POINTS = 4000  # Largest number of points of all UAVs on the first grid.
_COARSE_SHARE = 0.05  # Least share of the slack that flights on a coarse grid keep free.
_REFINEMENT = 4  # Ratio of slots of the next grid, if a coarse grid has no flights.
_SMOOTH_ENDS = 20  # Points at each end over which smoothing is faded in.

_Rows: TypeAlias = tuple[list[tuple[NDArray[np.intp], NDArray[np.intp], Array]], Array]
"""Rows of a map A x + b into a cone: (row, column, value) of A as arrays, and b."""


def find_flights_near(problem: Problem, positions: Array,
                      raise_if_over: DeadlineCheck) -> Array | None:
    """Return flights that keep all limits, near given ones (U, N+2, 2) in m, or None."""
    for opposite in (False, True) if problem.airspace.separations.any() else (False,):
        flights = project(problem.grid, positions, _SHARE, raise_if_over, opposite)
        if flights is not None and problem.is_clear(flights, raise_if_over):
            return flights
    return None


def project(grid: Grid, positions: Array, share: float, raise_if_over: DeadlineCheck,
            opposite: bool = False) -> Array | None:
    """
    Return flights (U, N+2, 2) in m strictly inside all limits, near given ones, or None.

    :param positions: given flights, (U, M+2, 2) in m, for any number M of slots.
    :param share: utilisations stay below 1 - share * (1 - u), where u is the least utilisation of
        a flight of the UAV from start to goal.
    :param opposite: whether UAVs that meet pass each other on the side opposite to the nearest.
    """
    slots = min(_COARSE_SLOTS, _MOST_POINTS // len(positions))
    while slots < grid.slots:
        coarse = grid.with_slots(slots)
        flights = _Projection(coarse, max(share, _COARSE_SHARE), raise_if_over).solve(
            resample_flights(positions, slots), opposite)
        if flights is not None:
            flights = move_inside(
                grid, _refine_flights(coarse, flights, grid), share, raise_if_over)
            if flights is not None:
                return flights
        slots *= _REFINEMENT
    return _Projection(grid, share, raise_if_over).solve(
        resample_flights(positions, grid.slots), opposite)


def move_inside(grid: Grid, positions: Array, share: float,
                raise_if_over: DeadlineCheck) -> Array | None:
    """Return flights (U, N+2, 2) in m, projected unless well inside all limits, or None."""
    projection = _Projection(grid, share, raise_if_over)
    inside = projection.test_inside(positions, _CLEARANCE / 2)
    return positions if inside.all() else projection.solve(positions, inside=inside)


def _refine_flights(coarse: Grid, positions: Array, grid: Grid) -> Array:
    """
    Return flights of a coarse grid interpolated to the N slots of a finer grid, (U, N+2, 2) in m.

    With a limit of acceleration the interpolated flights are smoothed, because they exceed this
    limit where the acceleration changes. Smoothing fades out towards both ends.

    :param positions: flights on the coarse grid, (U, M+2, 2) in m.
    """
    path = coarse.refine_path(coarse.to_path(positions), grid.slots)
    if grid.scenario.limits_acceleration:
        number = np.arange(1.0, grid.slots + 1)
        weight = np.minimum(np.minimum(number, number[::-1]) / _SMOOTH_ENDS, 1.0)
        # A weight of 1 moves each control point to the place of the curve at the same time.
        path[1:-1] += weight[:, None, None] / 8 * np.diff(path, n=2, axis=0)
    return grid.to_positions(path)


class _Projection:
    """
    The second-order cone problem of flights near given ones and inside their limits.

    Speeds and accelerations stay below a share of their limits, and each piece of a curve stays in
    the half-plane that separates it from an obstacle.
    """

    def __init__(self, grid: Grid, share: float, raise_if_over: DeadlineCheck) -> None:
        self._grid, self._raise_if_over = grid, raise_if_over
        limits = build_limits(grid)
        self._lines = [limit for limit in limits if isinstance(limit, LineLimit)]
        self._norms = [limit for limit in limits if isinstance(limit, NormLimit)]
        # Largest utilisation of speed and acceleration for each UAV, (U,).
        self._utilisations = 1 - share * np.maximum(
            1 - grid.least_flights.find_utilisations(grid.scenario, raise_if_over), 0.0)
        self._step = float(np.median(grid.step_lengths)) / grid.length  # A step, in grid units.

    def solve(self, positions: Array, opposite: bool = False,
              inside: NDArray[np.bool_] | None = None) -> Array | None:
        """
        Return flights (U, N+2, 2) in m inside the limits, near given ones, or None.

        A round moves every UAV that is not inside to its side of the lines, which are then chosen
        anew for the moved path. After _ROUNDS rounds, or if the solver fails, the answer is None.

        :param opposite: whether UAVs that meet pass on the side opposite to the nearest.
        :param inside: True for UAVs that are not moved in the first round, (U,). None moves all
            UAVs, and first turns the lines so that a flight passes an obstacle on one side.
        """
        base = target = self._to_path(positions)
        lines = self._choose_lines(base)
        if inside is None:
            inside = np.full(len(positions), False)
            lines = [limit.rotate_normals(base, chosen, opposite, self._raise_if_over)
                     for limit, chosen in zip(self._lines, lines, strict=True)]
        for _ in range(_ROUNDS):
            for group in self._split_groups(~inside):
                self._raise_if_over()
                moved = self._move_group(group, base, target, lines)
                if moved is None:
                    return None
                base = moved
            flights = self._grid.to_positions(base)
            inside = self.test_inside(flights)
            if inside.all():
                return flights
            lines = self._choose_lines(base)
        return None

    def _choose_lines(self, base: Array) -> list[Lines]:
        """Return the separating lines of every limit for a path (N+2, U, 2) in units."""
        chosen = []
        for limit in self._lines:
            self._raise_if_over()
            chosen.append(limit.choose_lines(base))
        return chosen

    def _split_groups(self, moving: NDArray[np.bool_]) -> Iterator[NDArray[np.intp]]:
        """Yield indices of UAVs to be moved: one, or several with <= _MOST_MOVED points in all."""
        uavs = np.flatnonzero(moving & ~self._grid.fixed)
        most = max(1, _MOST_MOVED // self._grid.slots)
        for first in range(0, len(uavs), most):
            yield uavs[first:first + most]

    def test_inside(self, positions: Array, clearance: float = 0.0) -> NDArray[np.bool_]:
        """Return True for UAVs inside all limits, farther than a clearance [steps] from lines."""
        inside = np.full(len(positions), True)
        for norm in self._norms:
            inside &= self._grid.fixed | (norm.utilisations(positions) < 1)
        for limit in self._lines:
            self._raise_if_over()
            path = self._grid.to_path(positions)
            lines = limit.choose_lines(path)
            self._raise_if_over()
            slacks = limit.slacks(path, lines)
            close = ((slacks <= clearance * self._step) & ~limit.ignored).any(axis=(0, 2))
            for pieces in (limit.first, limit.second):
                if pieces is not None:
                    inside[pieces[close]] = False
        return inside

    def _to_path(self, positions: Array) -> Array:
        """Return positions as a path (N+2, U, 2) in units; fixed UAVs fly reference_flight."""
        grid = self._grid
        path = grid.to_path(positions)
        path[[0, -1]] = grid.starts, grid.goals
        if grid.fixed.any():
            path[:, grid.fixed] = grid.to_path(grid.reference_flight)[:, grid.fixed]
        return path

    def _move_group(self, group: NDArray[np.intp], base: Array, target: Array,
                    lines: list[Lines]) -> Array | None:
        """
        Return the path near a target in which a group is on its side of lines, or None.

        The displacements d [steps] of the group minimise mean(((base - target) / step + d)^2) / 2
        + _PENALTY * excess + _LINE_PENALTY * shortfall. Speeds and accelerations may exceed their
        limits by the relative excess >= 0, and lines by the shortfall >= 0 [steps].

        :param group: indices of the UAVs that are moved together.
        :param base: path at which the limits are linearised, (N+2, U, 2) in units.
        :param target: path that the answer stays near, (N+2, U, 2) in units.
        """
        step, size = self._step, 2 * self._grid.slots * len(group)
        # The column of d_x of each point, (N+2, U), before d_y; -1 for points that do not vary.
        columns: NDArray[np.intp] = np.full(base.shape[:2], -1)
        columns[1:-1, group] = 2 * np.arange(size // 2).reshape(-1, len(group))
        excess, shortfall = size, size + 1
        signs = [(np.arange(2), np.array([excess, shortfall]), np.ones(2))], np.zeros(2)
        plain = [signs, *self._line_rows(columns, group, base, lines, shortfall)]
        norms = self._cone_rows(columns, group, base, excess)
        matrix, right = _assemble([*plain, *norms], size + 2)
        weight = 1.0 / max(size, 1)
        cost = scipy.sparse.csc_array(scipy.sparse.diags(
            np.append(np.full(size, weight), [0.0, 0.0])))
        linear = np.append(weight * ((base - target)[1:-1, group] / step).ravel(),
                           [_PENALTY, _LINE_PENALTY])
        answer = solve_cone_program(
            cost, linear, matrix, right, raise_if_over=self._raise_if_over,
            inequalities=sum(len(constants) for _, constants in plain))
        if answer is None:
            return None
        moved = base.copy()
        moved[1:-1, group] += step * answer[:size].reshape(-1, len(group), 2)
        return moved

    def _line_rows(self, columns: NDArray[np.intp], group: NDArray[np.intp], base: Array,
                   chosen: list[Lines], shortfall: int) -> Iterator[_Rows]:
        """
        Yield each limit's rows, slack + normal . (change of p) + shortfall >= _CLEARANCE [steps].

        A row is for a control point p that the group moves and whose slack is below _NEAR.

        :param columns: column of the x coordinate of each point, -1 for a point that is not moved.
        :param chosen: the lines of each limit.
        :param shortfall: column of the shortfall to lines.
        """
        step = self._step
        for limit, lines in zip(self._lines, chosen, strict=True):
            weights = limit.points.weights
            ends = [pieces for pieces in (limit.first, limit.second) if pieces is not None]
            pairs = np.flatnonzero(np.any([np.isin(end, group) for end in ends], axis=0))
            normals, offsets = lines.normals[:, pairs], lines.offsets[:, pairs]
            along = (limit.control_points(base, pairs) @ normals[..., None])[..., 0]
            slacks = (along - offsets[..., None]) / step
            varies = np.any([
                weights[:, end[pairs]].any(axis=-1)
                & np.isin(end[pairs], group)[:, None] for end in ends], axis=0)
            near = np.nonzero(varies & ~limit.ignored[:, pairs] & (slacks < _NEAR))
            point, pair, corner = near  # Indices (n, g, k) of each row's control point.
            normal = normals[near[:2]]
            row = np.arange(len(point))
            entries = [(row, np.full(len(point), shortfall), np.ones(len(point)))]
            for end, sign in zip(ends, (1.0, -1.0)):
                piece = end[pairs[pair]]
                for shift in (-1, 0, 1):
                    weight = sign * weights[point, piece, corner, 1 + shift]
                    used = np.flatnonzero(weight)
                    column = columns[point[used] + shift, piece[used]]
                    used, column = used[column >= 0], column[column >= 0]
                    for axis in (0, 1):
                        entries.append((used, column + axis, weight[used] * normal[used, axis]))
            yield entries, slacks[near] - _CLEARANCE

    def _cone_rows(self, columns: NDArray[np.intp], group: NDArray[np.intp], base: Array,
                   excess: int) -> Iterator[_Rows]:
        """
        Yield each limit's cones |difference + change| <= longest * (utilisation + excess).

        A cone has three rows, the right-hand side and both coordinates of a difference of the
        group's points, all in steps.

        :param columns: column of the x coordinate of each point, -1 for a point that is not moved.
        :param excess: column of the excess of speed and acceleration.
        """
        unit = self._grid.length * self._step
        positions = self._grid.to_positions(base)
        for limit in self._norms:
            differences, longest = limit.differences(positions) / unit, limit.longest / unit
            # The UAV and the index of the difference of each cone, and the cone's first row.
            member, difference = np.nonzero(~limit.absent.T[group])
            uav = group[member]
            row = 3 * np.arange(len(uav))
            entries = [(row, np.full(len(uav), excess), longest[uav])]
            for index, weight in enumerate(limit.stencil):
                point = difference + 1 - limit.order + index
                inside = np.flatnonzero((point > 0) & (point < len(base) - 1))
                column = columns[point[inside], uav[inside]]
                for axis in (0, 1):
                    entries.append((row[inside] + 1 + axis, column + axis,
                                    np.full(len(inside), weight)))
            constants = np.zeros((len(uav), 3))
            constants[:, 0] = longest[uav] * self._utilisations[uav]
            constants[:, 1:] = differences[uav, difference]
            yield entries, constants.ravel()


def _assemble(rows: list[_Rows], columns: int) -> tuple[Any, Array]:
    """Return -A, sparse, and b of all rows A x + b, as Clarabel's s = b - (-A) x needs them."""
    parts, count = [], 0
    for entries, constants in rows:
        parts += [(row + count, column, value) for row, column, value in entries]
        count += len(constants)
    row, column, value = (np.concatenate(part) for part in zip(*parts, strict=True))
    matrix = scipy.sparse.csc_matrix((-value, (row, column)), shape=(count, columns))
    return matrix, np.concatenate([constants for _, constants in rows])
