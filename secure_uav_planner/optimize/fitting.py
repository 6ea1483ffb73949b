"""Bend flights as little as it takes to be strictly inside all limits of flights."""

from importlib import import_module
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from ..grid import Grid
from ..limits import limits_of
from ..limits.lines import LineLimit, Lines
from ..limits.norm import NormLimit
from ..limits.reference import reference_flight
from ..scenario import Array

_ROUNDS = 8  # How often lines are chosen at most.
_PENALTY = 1e4  # Of an exceedance by all of a limit, beside the square of a step of deviation.
_LINE_PENALTY = 1e7  # Of a step beyond a line: sides are kept even where there is no time to.
_CLEARANCE = 0.05  # That is left to lines where it can be, in steps.
_NEAR = 4.0  # Lines farther away than this do not matter, in steps.


class Fit(NamedTuple):
    """
    A flight near another one.

    :ivar positions: (U, N+2, 2) in m.
    :ivar excess: by how much limits of speed or acceleration are exceeded, as a share of them;
        0 or less where the flight is strictly inside all limits.
    """

    positions: Array
    excess: float


class Fitting:
    """
    The second-order cone problem of flights near others and inside their limits.

    Speeds and accelerations stay below a share of their limits, and pieces of curves on their
    side of lines, which separate them from what they must clear. As lines depend on the flight,
    they are chosen anew from the answer until it is inside the limits.

    :param grid: of the flights.
    :param share: of the slack of the flight of least effort that is left, at most.
    """

    def __init__(self, grid: Grid, share: float = 0.05) -> None:
        self._grid = grid
        scenario = grid.scenario
        limits = limits_of(scenario, grid)
        self._lines = [limit for limit in limits if isinstance(limit, LineLimit)]
        self._norms = [limit for limit in limits if isinstance(limit, NormLimit)]
        self._efforts = 1 - share * np.maximum(1 - scenario.efforts, 0.0)
        free = np.flatnonzero(~grid.fixed)
        # The column of the first coordinate of every point that varies, or -1: (N+2, U).
        self._columns: NDArray[np.intp] = np.full((grid.slots + 2, len(scenario.uavs)), -1)
        self._columns[1:-1, free] = 2 * np.arange(grid.slots * len(free)).reshape(
            grid.slots, len(free))
        self._size = 2 * grid.slots * len(free)
        self._step = float(np.median(
            scenario.max_speeds) * grid.slot_duration / grid.length)

    def is_inside(self, positions: Array) -> bool:
        """Return whether flights leave as much to all limits as they would if they were bent."""
        return all(limit.is_clear(positions, _CLEARANCE / 2 * self._step)
                   for limit in self._lines) and self._excess(positions) < 0

    def _excess(self, positions: Array) -> float:
        """Return the largest excess of a limit of speed or acceleration, of what varies."""
        free = ~self._grid.fixed
        return float(max((limit.efforts(positions)[free].max(initial=0.0)
                          for limit in self._norms)) - 1)

    def near(self, positions: Array, other_way: bool = False) -> Fit:
        """
        Return flights near others, which pass what is in their way on the nearest side.

        :param positions: (U, N+2, 2) in m.
        :param other_way: whether UAVs that meet pass each other on the other side.
        """
        target = base = self._path(positions)
        excess = np.inf
        for number in range(_ROUNDS):
            lines = [limit.lines(limit.places(base[None])) if number else
                     limit.first_lines(limit.places(base[None]), other_way)
                     for limit in self._lines]
            answer = self._solved(base, target, lines)
            if answer is None:
                break
            base = answer
            found = self._positions(base)
            excess = self._excess(found)
            if excess < 0 and all(limit.is_clear(found) for limit in self._lines):
                return Fit(found, excess)
        return Fit(self._positions(base), max(excess, 1e-9))

    def _path(self, positions: Array) -> Array:
        """Return positions in units, (N+2, U, 2)."""
        grid = self._grid
        path: Array = (np.swapaxes(positions, 0, 1) - grid.origin) / grid.length
        path[[0, -1]] = grid.starts, grid.goals
        if grid.fixed.any():
            reference = (np.swapaxes(reference_flight(grid), 0, 1) - grid.origin) / grid.length
            path[:, grid.fixed] = reference[:, grid.fixed]
        return path

    def _positions(self, path: Array) -> Array:
        grid = self._grid
        found = np.swapaxes(path, 0, 1) * grid.length + grid.origin
        found[:, 0], found[:, -1] = grid.scenario.starts, grid.scenario.goals
        return found

    def _solved(self, base: Array, target: Array, lines: list[Lines]) -> Array | None:
        """
        Return the path beyond lines that is nearest to a target, (N+2, U, 2).

        Variables are displacements from the base in steps, the excess of speed and acceleration,
        and what lacks to lines.
        """
        clarabel: Any = import_module('clarabel')  # Here, for few missions need it.
        size, step = self._size, self._step
        rows = _Rows(size + 2)
        excess, lack = size, size + 1
        rows.add_bounds(np.array([excess, lack]))
        cones = [clarabel.NonnegativeConeT(2 + self._add_lines(rows, base, lines, lack))]
        count = self._add_norms(rows, base, excess)
        cones += [clarabel.SecondOrderConeT(3)] * count
        matrix, right = rows.built()
        free = self._columns[1:-1] >= 0
        weight = 1.0 / max(size, 1)
        cost = sparse.csc_array(sparse.diags(np.append(np.full(size, weight), [0.0, 0.0])))
        linear = np.append(weight * ((base - target)[1:-1][free] / step).ravel(),
                           [_PENALTY, _LINE_PENALTY])
        settings = clarabel.DefaultSettings()
        settings.verbose = False
        try:
            solution = clarabel.DefaultSolver(
                cost, linear, matrix, right, cones, settings).solve()
        except BaseException as error:  # A panic of Clarabel's code is no Exception.
            if not isinstance(error, Exception) and type(error).__name__ != 'PanicException':
                raise
            return None
        moved = np.array(solution.x)[:size]
        if not np.isfinite(moved).all():
            return None
        found = base.copy()
        found[1:-1][free] += step * moved.reshape(-1, 2)
        return found

    def _add_lines(self, rows: '_Rows', base: Array, chosen: list[Lines], lack: int) -> int:
        """Add a row for every control point near a line; return how many."""
        count, step = 0, self._step
        for limit, lines in zip(self._lines, chosen, strict=True):
            places = limit.places(base[None])
            along = (places[0] @ lines.normals[0][..., None])[..., 0]
            margin = (along - lines.offsets[0][..., None]) / step
            at = np.nonzero(~limit.ignored & (margin < _NEAR))
            point, subject, place = at
            normals = lines.normals[0][at[:2]]
            number = np.arange(len(point))
            entries = [(number, np.full(len(point), lack), np.ones(len(point)))]
            for tracks, sign in ((limit.first, 1.0), (limit.second, -1.0)):
                if tracks is None:
                    continue
                track = tracks[subject]
                for shift in (-1, 0, 1):
                    weight = sign * limit.tracks.weights[point, track, place, 1 + shift]
                    used = np.flatnonzero(weight)
                    column = self._columns[
                        point[used] + shift, limit.tracks.uav[track[used]]]
                    for axis in (0, 1):
                        entries.append(
                            (used, column + axis, weight[used] * normals[used, axis]))
            rows.add(entries, margin[at] - _CLEARANCE)
            count += len(point)
        return count

    def _add_norms(self, rows: '_Rows', base: Array, excess: int) -> int:
        """Add a cone for every difference of points that has a limit; return how many."""
        count = 0
        for limit in self._norms:
            found = limit.differences(self._positions(base)) / self._grid.length / self._step
            longest = limit.longest / self._grid.length / self._step
            uav, place = np.nonzero(~limit.absent.T & ~self._grid.fixed[:, None])
            number = 3 * np.arange(len(uav))
            entries = [(number, np.full(len(uav), excess), longest[uav])]
            for index, weight in enumerate(limit.stencil):
                point = place + index - limit.lead
                inside = np.flatnonzero((point > 0) & (point < len(base) - 1))
                column = self._columns[point[inside], uav[inside]]
                for axis in (0, 1):
                    entries.append((number[inside] + 1 + axis, column + axis,
                                    np.full(len(inside), weight)))
            constant = np.zeros((len(uav), 3))
            constant[:, 0] = longest[uav] * self._efforts[uav]
            constant[:, 1:] = found[uav, place]
            rows.add(entries, constant.ravel())
            count += len(uav)
        return count


class _Rows:
    """Rows of a map A x + b into a cone, as they are added."""

    def __init__(self, columns: int) -> None:
        self._columns, self._count = columns, 0
        self._parts: list[tuple[Array, Array, Array]] = []
        self._constants: list[Array] = []

    def add(self, entries: list[Any], constants: Array) -> None:
        """
        Add rows.

        :param entries: (row, column, value) as arrays; rows count from the first of these.
        :param constants: b of each row.
        """
        self._parts += [(row + self._count, column, value) for row, column, value in entries]
        self._constants.append(constants)
        self._count += len(constants)

    def add_bounds(self, columns: Array) -> None:
        """Add rows by which variables are not negative."""
        self.add([(np.arange(len(columns)), columns, np.ones(len(columns)))],
                 np.zeros(len(columns)))

    def built(self) -> tuple[Any, Array]:
        """Return -A and b, as Clarabel wants them."""
        row, column, value = (np.concatenate(part) for part in zip(*self._parts, strict=True))
        matrix = sparse.csc_matrix((-value, (row, column)), shape=(self._count, self._columns))
        return matrix, np.concatenate(self._constants)
