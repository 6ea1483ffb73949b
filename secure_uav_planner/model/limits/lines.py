"""Limits that keep pieces of the flown curve on one side of lines: what clearances share."""

from abc import abstractmethod
from collections.abc import Callable
from functools import cached_property
from typing import Any, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from .base import Limit
from .tracks import Tracks
from ..grid import Grid
from ..kernel import core
from ...mission.scenario import Array, Scenario

_INSIDE = 1e-6  # How far in units what is given may be beyond a line.


class Lines(NamedTuple):
    """
    Lines on whose far side pieces of curves stay: normal . place >= offset.

    :ivar normals: unit vectors, (N+2, G, 2).
    :ivar offsets: in units, (N+2, G).
    """

    normals: Array
    offsets: Array


Subjects: TypeAlias = tuple[
    Tracks, NDArray[np.intp], NDArray[np.intp] | None, dict[str, Array]]


class LineLimit(Limit):
    """
    A limit c = normal . p - offset >= 0 on the control points p of pieces of curves.

    A convex obstacle is cleared by a convex piece when a line separates them. So each of G
    subjects has a line for every piece: a UAV with an obstacle, or two UAVs, whose difference is
    the piece. The kernel's class of the same name chooses the lines.

    :ivar first: the track of each subject, (G,).
    :ivar second: the track that is subtracted, (G,), or None.
    :ivar ignored: which control points do not vary, (N+2, G, K).
    """

    of_flights = True

    def __init__(self, scenario: Scenario, grid: Grid | None = None) -> None:
        super().__init__(scenario, grid)
        self.tracks, self.first, self.second, self._obstacles = self._subjects()
        still: NDArray[np.bool_] = np.all(self.tracks.weights == 0, axis=-1)
        self.ignored = still[:, self.first]
        if self.second is not None:
            self.ignored &= still[:, self.second]

    @abstractmethod
    def _subjects(self) -> Subjects:
        """Return the tracks, first and second, and what the kernel asks of the obstacles."""

    @cached_property
    def compiled(self) -> Any:
        """Return an object of the kernel's class."""
        tracks = self.tracks
        arrays = {'uav': tracks.uav, 'weights': tracks.weights, 'all': tracks.all_weights,
                  'constant': tracks.constant, 'first': self.first, 'ignored': self.ignored,
                  'second': self.second, **self._obstacles}
        plain = {name: values if values is None else np.ascontiguousarray(values, float)
                 for name, values in arrays.items()}
        return getattr(core, type(self).__name__)({
            'slots': self.grid.slots, 'uavs': len(self.scenario.uavs),
            'corners': tracks.weights.shape[2], **plain})

    def lines(self, path: Array) -> Lines:
        """
        Return lines that separate the pieces of a path from what they must clear.

        Where that is impossible, c is negative for some control point of the piece.
        """
        shape = len(path), len(self.first)
        found = Lines(np.empty((*shape, 2)), np.empty(shape))
        self.compiled.choose(np.ascontiguousarray(path), *found)
        return found

    def turned_lines(self, path: Array, lines: Lines, other_way: bool,
                     check: Callable[[], None]) -> Lines:
        """
        Return lines for a path that need not be clear, as whole flights ask for.

        :param lines: those of the path, which may be changed.
        :param other_way: whether to take another side than the nearest, where there is one.
        :param check: called now and then; what it raises is passed on.
        """
        return lines

    def check(self, positions: Array, powers: Array) -> None:
        """Leave it to Plan, which checks the flown curve by itself."""

    def places(self, path: Array, subjects: Any = slice(None)) -> Array:
        """Return what lines are about on a path, for some of the subjects, (N+2, G, K, 2)."""
        found = self.tracks.at(path)
        places = found[:, self.first[subjects]]
        return places if self.second is None else places - found[:, self.second[subjects]]

    def slacks(self, path: Array, lines: Lines) -> Array:
        """Return c of a path, (N+2, G, K)."""
        places = self.places(path)
        along = np.einsum('ngkx,ngx->ngk', places, lines.normals)
        return along - lines.offsets[..., None]

    def is_clear(self, positions: Array) -> bool:
        """Return whether all control points of flights, also fixed ones, are beyond lines."""
        path = self.grid.path_of(positions)
        slacks = self.slacks(path, self.lines(path))
        # What is given may be at the very limit.
        slacks[self.ignored] += _INSIDE
        return bool((slacks > 0).all())
