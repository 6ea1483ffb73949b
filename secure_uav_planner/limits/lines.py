"""Limits that keep pieces of the flown curve on one side of lines: what clearances share."""

from abc import abstractmethod
from importlib import import_module
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from .base import ConvexVariables, Iterate, Limit, Step, step_to_zero
from .nearest import dot
from .tracks import Tracks
from ..grid import Grid
from ..scenario import Array, Scenario

_INSIDE = 1e-6  # How far in units a convex form keeps from lines, as its solver is not exact.


class Lines(NamedTuple):
    """
    Lines on whose far side pieces of curves stay: normal . place >= offset.

    :ivar normals: unit vectors, (S, N+2, G, 2).
    :ivar offsets: in units, (S, N+2, G).
    :ivar room: how far a piece may move without meeting what has no line, in units,
        (S, N+2, G), or None where everything has one.
    """

    normals: Array
    offsets: Array
    room: Array | None = None


class LineLimit(Limit):
    """
    A limit c = normal . p - offset >= 0 on the control points p of pieces of curves.

    A convex obstacle is cleared by a convex piece when a line separates them. So each of G
    subjects has a line for every piece: a UAV with an obstacle, or two UAVs, whose difference is
    the piece. Lines are chosen anew for every Iterate that is not given any, and stay for what is
    derived from it. c of what does not vary is 1.

    :ivar first: the track of each subject, (G,).
    :ivar second: the track that is subtracted, (G,), or None.
    :ivar ignored: which control points do not vary, (N+2, G, K).
    """

    of_flights = True

    def __init__(self, scenario: Scenario, grid: Grid | None = None) -> None:
        super().__init__(scenario, grid)
        self.tracks, self.first, self.second = self._subjects()
        weights = np.abs(self.tracks.weights).max(axis=-1)
        varies = weights[:, self.first]
        if self.second is not None:
            varies = np.maximum(varies, weights[:, self.second])
        self.ignored: NDArray[np.bool_] = varies == 0
        self._has_ignored = bool(self.ignored.any())
        self.reach = self.tracks.reach
        self._parameters: list[Any] = []
        # Which subjects are about each track, (T, G).
        track = np.arange(len(self.tracks.uav))[:, None]
        self._plus: Array = (track == self.first).astype(float)
        self._minus: Array | None = (
            None if self.second is None else (track == self.second).astype(float))
        uav = np.arange(len(scenario.uavs))[:, None]
        # Which subjects each UAV is in, (U, G).
        self._concerned: NDArray[np.bool_] = uav == self.tracks.uav[self.first]
        if self.second is not None:
            self._concerned |= uav == self.tracks.uav[self.second]

    @abstractmethod
    def _subjects(self) -> tuple[Tracks, NDArray[np.intp], NDArray[np.intp] | None]:
        """Return the tracks, and first and second of the subjects."""

    @abstractmethod
    def lines(self, places: Array) -> Lines:
        """
        Return lines that separate pieces from what they must clear, as far as possible.

        Where that is impossible, c is negative for some control point of the piece.

        :param places: control points, or their differences, (S, N+2, G, K, 2).
        """

    def first_lines(self, places: Array, other_way: bool) -> Lines:
        """
        Return lines for pieces that need not be clear, as whole flights ask for.

        :param places: as for lines.
        :param other_way: whether to take another side than the nearest, where there is one.
        """
        return self.lines(places)

    def check(self, positions: Array, powers: Array) -> None:
        """Leave it to Plan, which checks the flown curve by itself."""

    def height(self, size: int) -> int:
        """Return how many diagonals of the band its inequalities fill; see Limit."""
        if self.second is None:
            return super().height(size)
        return (1 + self.reach) * size - 1

    def places(self, path: Array) -> Array:
        """Return what lines are about, (S, N+2, G, K, 2), of points (S, N+2, U, 2) in units."""
        return self._differences(self.tracks.at(path))

    def _differences(self, found: Array) -> Array:
        places = found[:, :, self.first]
        return places if self.second is None else places - found[:, :, self.second]

    def lines_of(self, iterate: Iterate, places: Array | None = None) -> Lines:
        """
        Return the lines of an iterate.

        :param places: of its path, where they are known.
        """
        if self not in iterate.lines:
            iterate.lines[self] = self.lines(
                self.places(iterate.path) if places is None else places)
        found: Lines = iterate.lines[self]
        return found

    def margin(self, iterate: Iterate) -> Array:
        """Return c, (S, N+2, G, K)."""
        places = self.places(iterate.path)
        lines = self.lines_of(iterate, places)
        margin: Array = _along(lines, places) - lines.offsets[..., None]
        if self._has_ignored:
            margin[:, self.ignored] = 1.0
        return margin

    def is_clear(self, positions: Array, clearance: float = 0.0,
                 everything: bool = False) -> bool:
        """
        Return whether the control points of flights are on their side of lines.

        :param positions: (U, N+2, 2) in m.
        :param clearance: which they must have, in units.
        :param everything: whether those count as well that do not vary.
        """
        path = (np.swapaxes(positions, 0, 1) - self.grid.origin) / self.grid.length
        if everything:
            places = self.places(path[None])
            lines = self.lines(places)
            margin = _along(lines, places) - lines.offsets[..., None]
            # What is given may be at the very limit.
            margin[:, self.ignored] += _INSIDE
        else:
            margin = self.margin(Iterate.of_path(self.grid, path[None]))
        return bool((margin > clearance).all())

    def add_gradient(self, iterate: Iterate, force: Array, gradient: Array) -> None:
        """Subtract force * dc/dx."""
        lines = self.lines_of(iterate)
        if self._has_ignored:
            force = np.where(self.ignored, 0.0, force)
        pull = force[..., None] * lines.normals[..., None, :]
        gradient[..., 1:] -= self.tracks.gathered(self._to_tracks(pull))

    def _to_tracks(self, values: Array) -> Array:
        """Return values of subjects, (S, N+2, G, ...), on their tracks, (S, N+2, T, ...)."""
        incidence = self._plus if self._minus is None else self._plus - self._minus
        return _spread(incidence, values)

    def change(self, iterate: Iterate, step: Step) -> Array:
        """Return the derivative of c along a step, (S, N+2, G, K)."""
        change: Array = _along(self.lines_of(iterate), self._moved(step))
        if self._has_ignored:
            change[:, self.ignored] = 0.0
        return change

    def _moved(self, step: Step) -> Array:
        return self._differences(self.tracks.change(step.path))

    def longest_step(self, iterate: Iterate, step: Step, margin: Array, change: Array,
                     share: float) -> Array:
        """Return the least over the pieces in which a UAV is, (S, U)."""
        length = step_to_zero(margin, change, share).min(axis=(1, 3))
        room = self.lines_of(iterate).room
        if room is not None:
            moved = self._moved(step)
            moved = np.sqrt(dot(moved, moved).max(axis=-1))
            room = share * room
            length = np.minimum(length, (room / np.maximum(moved, np.maximum(room, 1e-300))
                                         ).min(axis=1))
        found: Array = np.where(self._concerned, length[:, None], 1.0).min(axis=-1)
        return found

    def add_curvature(self, iterate: Iterate, dual: Array, margin: Array, matrix: Any) -> None:
        """Add dual / c for every control point; c is linear."""
        normals = self.lines_of(iterate).normals
        ratio = dual / margin
        if self._has_ignored:
            ratio[:, self.ignored] = 0.0
        square = normals[..., :, None] * normals[..., None, :]
        block = ratio[..., None, None] * square[..., None, :, :]
        sums = self._plus if self._minus is None else self._plus + self._minus
        weights = self.tracks.weights
        self._add_blocks(matrix.add_positions, weights, weights, _spread(sums, block),
                         self.tracks.by_uav)
        if self.second is None:
            return
        # Off the diagonal of UAVs, for the pairs in both orders.
        ends = self.tracks.uav[self.first], self.tracks.uav[self.second]
        halves = len(self.tracks.uav) // len(self.scenario.uavs)
        for later, earlier in ((0, 1), (1, 0)):
            row, column = ends[later][::halves], ends[earlier][::halves]
            tracks = self.first, self.second

            def add(after: int, blocks: Array, row: Any = row, column: Any = column) -> None:
                matrix.add_pairs(after, row, column, blocks)

            self._add_blocks(
                add, weights[:, tracks[earlier]], weights[:, tracks[later]], -block,
                lambda values: values.reshape(
                    *values.shape[:2], -1, halves, *values.shape[3:]).sum(axis=3))

    @staticmethod
    def _add_blocks(add: Any, earlier: Array, later: Array, values: Array,
                    collected: Any) -> None:
        """
        Add the blocks that couple points n-1, n and n+1 of pieces.

        :param add: takes how many slots later the second point is, and blocks.
        :param earlier: weights of the points in columns, (N+2, T, K, 3).
        :param later: weights of the points in rows, likewise.
        :param values: of every control point, (S, N+2, T, K, 2, 2).
        :param collected: sums what is about the same UAVs.
        """
        count = values.shape[1]
        for first in range(3):
            for second in range(first, 3):
                product = earlier[..., first] * later[..., second]
                if not product.any():
                    continue
                found = collected((product[..., None, None] * values).sum(axis=3))
                add(second - first, found[:, 2 - first:count - second])

    def convex_form(self, variables: ConvexVariables) -> list[Any]:
        """Return the half-planes of lines that set_local_point chooses."""
        if variables.paths is None:
            return []
        # Only here, where a CVXPY problem is being built anyway.
        cp: Any = import_module('cvxpy')
        count = self.grid.slots + 2
        # Of every subject, both coordinates of the normal and the offset.
        self._parameters = [tuple(cp.Parameter(count) for _ in range(3)) for _ in self.first]
        constraints = []
        for subject, (*normal, offset) in enumerate(self._parameters):
            for place in range(self.tracks.weights.shape[2]):
                counted = np.flatnonzero(~self.ignored[:, subject, place])
                if not len(counted):
                    continue
                found = self._expression(variables, self.first[subject], place)
                if self.second is not None:
                    found -= self._expression(variables, self.second[subject], place)
                along = cp.multiply(normal[0], found[:, 0]) + cp.multiply(normal[1], found[:, 1])
                constraints.append(along[counted] >= (offset * variables.scale)[counted])
        return constraints

    def _expression(self, variables: ConvexVariables, track: int, place: int) -> Any:
        """Return a control point of every piece of a track as CVXPY has it, (N+2, 2)."""
        matrix, constant = self.tracks.matrix(track, place)
        length = self.grid.length
        origin = self.grid.origin
        path = (variables.paths or [])[self.tracks.uav[track]]
        # Differences of two UAVs do not see the origin, other places do.
        shift = constant * length + (0.0 if self.second is not None else -origin)
        return matrix @ path + shift * variables.scale

    def set_local_point(self, positions: Array, powers: Array) -> None:
        """Choose the lines for a flight; see Limit."""
        if not self._parameters:
            return
        path = (np.swapaxes(positions, 0, 1) - self.grid.origin) / self.grid.length
        lines = self.lines(self.places(path[None]))
        least = self.margin(Iterate.of_path(self.grid, path[None]))[0].min(axis=-1)
        length = self.grid.length
        for subject, (*normal, offset) in enumerate(self._parameters):
            for axis, parameter in enumerate(normal):
                parameter.value = lines.normals[0, :, subject, axis]
            offset.value = (lines.offsets[0, :, subject] + np.minimum(
                _INSIDE, np.maximum(least[:, subject], 0) / 2)) * length


def _along(lines: Lines, places: Array) -> Array:
    """Return normal . place, (S, N+2, G, K)."""
    return dot(lines.normals[..., None, :], places)


def _spread(incidence: Array, values: Array) -> Array:
    """Return incidence (T, G) times values (S, N+2, G, ...), (S, N+2, T, ...)."""
    flat = values.reshape(*values.shape[:3], -1)
    return (incidence @ flat).reshape(*values.shape[:2], len(incidence), *values.shape[3:])
