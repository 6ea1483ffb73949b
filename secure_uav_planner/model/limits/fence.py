"""The convex hull of the geofence; what else is outside the fence are pieces as of zones."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from .lines import LineLimit
from .tracks import Tracks
from ..airspace import airspace_of
from ..grid import Grid
from ...mission.scenario import Scenario

_ROUNDING = 1e-3


class FenceLimit(LineLimit):
    """
    No UAV leaves the convex hull of the geofence: every control point is within its sides.

    Points that no UAV could take so far, with its speed, have no c.

    :ivar normals: of the sides of every UAV, inwards, (G, 2).
    :ivar offsets: likewise, (G,) in units.
    """

    kind = 'FenceLimit'

    def __init__(self, scenario: Scenario, grid: Grid | None = None) -> None:
        super().__init__(scenario, grid)
        number = np.arange(self.grid.slots + 2.0)[:, None]
        # The curve may begin and end up to half a slot beyond the points, see Tracks.
        number[0], number[-1] = 0.5, number[-1] + 0.5
        steps = (scenario.max_speeds * self.grid.slot_duration / self.grid.length)[self.first]
        for ends, moves in ((self.grid.starts, number), (self.grid.goals, number[::-1])):
            slack = (self.normals * ends[self.first]).sum(axis=-1) - self.offsets
            self.ignored |= (slack > (1 + _ROUNDING) * moves * steps)[..., None]

    @classmethod
    def applies_to(cls, scenario: Scenario) -> bool:
        """Return whether there is a fence."""
        return scenario.geofence is not None

    def _subjects(self) -> tuple[Tracks, NDArray[np.intp], NDArray[np.intp] | None]:
        outward, offsets = airspace_of(self.scenario).hull
        uavs = len(self.scenario.uavs)
        self.normals = np.tile(-outward, (uavs, 1))
        self.offsets = np.tile(outward @ self.grid.origin - offsets, uavs) / self.grid.length
        return (Tracks.of_points(self.grid), np.repeat(np.arange(uavs), len(offsets)), None)

    def _obstacles(self) -> dict[str, Any]:
        return {'normals': self.normals, 'offsets': self.offsets}
