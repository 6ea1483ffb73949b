"""What no UAV may enter: zones, and the pockets of a geofence, as convex pieces."""

from collections.abc import Iterable
from functools import reduce

import numpy as np
from numpy.typing import NDArray

from .lines import LineLimit, Lines
from .nearest import dot, separating_lines
from .tracks import Tracks
from ..airspace import airspace_of
from ..scenario import Array, Scenario

MOST_LINES = 4
"""To how many pieces, the nearest, a piece of a UAV's curve has lines at most."""

_NEAR = 4.0  # In lengths of the piece; farther away a line across the shortest way will do.


class ZoneLimit(LineLimit):
    """
    No UAV enters a convex piece of what is forbidden at its altitude.

    Of many pieces, those have lines that are nearest; a step goes no farther than to the next.

    :ivar polygons: the pieces for every UAV that has some, (A, Z, V, 2) in units.
    :ivar most_lines: how many lines each of these UAVs has.
    """

    @classmethod
    def applies_to(cls, scenario: Scenario) -> bool:
        """Return whether anything is forbidden."""
        return any(airspace_of(scenario).pieces)

    def _subjects(self) -> tuple[Tracks, NDArray[np.intp], NDArray[np.intp] | None]:
        pieces = airspace_of(self.scenario).pieces
        uavs = [uav for uav, found in enumerate(pieces) if found]
        most = max(len(pieces[uav]) for uav in uavs)
        corners = max(len(piece.vertices) for uav in uavs for piece in pieces[uav])
        # Of every UAV in uavs, repeated where it has fewer: (A, Z, V, 2), in units.
        self.polygons: Array = np.array([
            [_padded(pieces[uav][index % len(pieces[uav])].vertices, corners)
             for index in range(most)] for uav in uavs])
        self.polygons = (self.polygons - self.grid.origin) / self.grid.length
        self._centres = self.polygons.mean(axis=2)
        self.most_lines = min(most, MOST_LINES)
        return Tracks(self.grid, together=False), np.repeat(uavs, self.most_lines), None

    def lines(self, places: Array) -> Lines:
        """Return lines to the nearest pieces; see LineLimit."""
        starts, points, subjects, corners = places.shape[:4]
        places = places[:, :, ::self.most_lines]  # (S, N+2, A, K, 2)
        most = self.polygons.shape[1]
        # Lines that are across the way from each polygon's centre, (S, N+2, A, Z).
        to = (sum(places[..., place, :] for place in range(corners)) / corners
              )[..., None, :] - self._centres
        normals = to / np.sqrt(np.maximum(dot(to, to), 1e-300))[..., None]
        reach = _largest(dot(normals, self.polygons[:, :, vertex])
                         for vertex in range(self.polygons.shape[2]))
        least = -_largest(-dot(normals, places[..., place, :][..., None, :])
                          for place in range(corners)) - reach
        size = places[..., -1, :] - places[..., 0, :]
        near = least < _NEAR * np.sqrt(dot(size, size))[..., None] + _LEAST
        at = np.nonzero(near)
        exact, offsets = separating_lines(places[at[:3]], self.polygons[at[2:]])
        normals[at], reach[at] = exact, offsets
        least[at] = (places[at[:3]] @ exact[..., None])[..., 0].min(axis=1) - offsets
        room = None
        if most > self.most_lines:
            order = least.argsort(axis=-1, kind='stable')
            room = np.take_along_axis(least, order[..., [self.most_lines]], axis=-1)
            room = np.repeat(room[..., 0], self.most_lines, axis=-1)
            # In the order in which the pieces are, so that duals stay with them.
            chosen = np.sort(order[..., :self.most_lines], axis=-1)
            normals = np.take_along_axis(normals, chosen[..., None], axis=3)
            reach = np.take_along_axis(reach, chosen, axis=3)
        shape = (starts, points, subjects)
        return Lines(normals.reshape(*shape, 2), reach.reshape(shape), room)


_LEAST = 1e-3  # In units, beyond the above.


def _largest(arrays: Iterable[Array]) -> Array:
    """Return the largest entries of arrays, faster than along a short axis."""
    return reduce(np.maximum, arrays)


def _padded(vertices: Array, count: int) -> Array:
    """Return vertices, the last of them repeated up to a count."""
    return np.concatenate([vertices, np.repeat(vertices[-1:], count - len(vertices), axis=0)])
