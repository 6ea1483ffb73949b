"""The separation of UAVs: any two of them at any time."""

from collections.abc import Callable
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from .lines import LineLimit, Lines
from ..airspace import Airspace
from ..grid import Grid
from ..kernel import core
from ...mission.scenario import Array


class SeparationLimit(LineLimit):
    """
    No two UAVs come closer than the separation: their difference stays out of a disc.

    The disc's radius is what the difference of their altitudes leaves of the separation. A line
    touches it where it is nearest to the piece of the difference.
    """

    def __init__(self, grid: Grid) -> None:
        distances = grid.airspace.separations
        first, second = map(np.ascontiguousarray, np.nonzero(np.triu(distances)))
        super().__init__(grid, first, second)
        self._radii: Array = distances[first, second] / grid.length

    @classmethod
    def applies_to(cls, airspace: Airspace) -> bool:
        """Return True if any two UAVs can come too close."""
        return bool(airspace.separations.any())

    @cached_property
    def compiled(self) -> core.SeparationLimit:
        """Return the kernel's limit."""
        assert self.second is not None
        return core.SeparationLimit(self.points.compiled, self.first, self.second, self.ignored,
                                    self._radii)

    def rotate_normals(self, path: Array, lines: Lines, opposite: bool,
                       check: Callable[[], None]) -> Lines:
        """
        Return lines that turn evenly while two UAVs are too close, from before to after that.

        So they pass each other on one side, also where the difference runs through the origin.
        """
        least = self.slacks(path, lines).min(axis=-1)
        check()
        pairs = np.flatnonzero((least <= 0).any(axis=0))
        middles = self.control_points(path, pairs).mean(axis=-2)
        for number, pair in enumerate(pairs.tolist()):
            close, middle = least[:, pair] <= 0, middles[:, number]
            angles = _turn_evenly(np.arctan2(middle[:, 1], middle[:, 0]), close, opposite)[close]
            lines.normals[close, pair] = np.stack([np.cos(angles), np.sin(angles)], axis=-1)
        return lines


def _turn_evenly(angles: Array, close: NDArray[np.bool_], opposite: bool) -> Array:
    """Return angles that change evenly within every stretch that is close."""
    angles = angles.copy()
    edges = np.flatnonzero(np.diff(np.concatenate([[False], close, [False]])))
    for begin, end in edges.reshape(-1, 2).tolist():
        before, after = angles[max(begin - 1, 0)], angles[min(end, len(angles) - 1)]
        change = (after - before + np.pi) % (2 * np.pi) - np.pi
        if opposite and abs(change) > np.pi / 3:
            change -= np.copysign(2 * np.pi, change)
        angles[begin:end] = before + change * (np.arange(end - begin) + 1) / (end - begin + 1)
    return angles
