"""What no UAV may enter: zones, and the pockets of a geofence, as convex pieces."""

import numpy as np

from .lines import LineLimit, Subjects
from .tracks import pieces_of, Tracks
from ..airspace import airspace_of
from ...mission.scenario import Array, Scenario

MOST_LINES = 4
"""To how many pieces, the nearest, a piece of a UAV's curve has lines at most."""


class ZoneLimit(LineLimit):
    """
    No UAV enters a convex piece of what is forbidden at its altitude.

    Of many pieces, those have lines that are nearest; a step goes no farther than to the next.
    """

    @classmethod
    def applies_to(cls, scenario: Scenario) -> bool:
        """Return whether anything is forbidden."""
        return any(airspace_of(scenario).pieces)

    def _subjects(self) -> Subjects:
        pieces = airspace_of(self.scenario).pieces
        uavs = [uav for uav, found in enumerate(pieces) if found]
        most = max(len(pieces[uav]) for uav in uavs)
        corners = max(len(piece.vertices) for uav in uavs for piece in pieces[uav])
        # Of every UAV in uavs, repeated where it has fewer: (A, Z, V, 2), in units.
        polygons = np.array([
            [_padded(pieces[uav][index % len(pieces[uav])].vertices, corners)
             for index in range(most)] for uav in uavs])
        return (Tracks(self.grid, pieces_of(self.grid, together=False)),
                np.repeat(uavs, min(most, MOST_LINES)), None,
                {'polygons': (polygons - self.grid.origin) / self.grid.length})


def _padded(vertices: Array, count: int) -> Array:
    """Return vertices, the last of them repeated up to a count."""
    return np.concatenate([vertices, np.repeat(vertices[-1:], count - len(vertices), axis=0)])
