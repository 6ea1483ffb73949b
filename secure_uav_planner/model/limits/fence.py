"""The convex hull of the geofence; what else is outside the fence are pieces as of zones."""

import numpy as np

from .lines import LineLimit, Subjects
from .tracks import Tracks
from ..airspace import airspace_of
from ..grid import Grid
from ...mission.scenario import Scenario

_ROUNDING = 1e-3


class FenceLimit(LineLimit):
    """
    No UAV leaves the convex hull of the geofence: every control point is within its sides.

    Points that no UAV could take so far, with its speed, have no c.
    """

    def __init__(self, scenario: Scenario, grid: Grid | None = None) -> None:
        super().__init__(scenario, grid)
        number = np.arange(self.grid.slots + 2.0)[:, None]
        # The curve may begin and end up to half a slot beyond the points, see Tracks.
        number[0], number[-1] = 0.5, number[-1] + 0.5
        steps = (scenario.max_speeds * self.grid.slot_duration / self.grid.length)[self.first]
        for ends, moves in ((self.grid.starts, number), (self.grid.goals, number[::-1])):
            slack = (self._obstacles['normals'] * ends[self.first]).sum(
                axis=-1) - self._obstacles['offsets']
            self.ignored |= (slack > (1 + _ROUNDING) * moves * steps)[..., None]

    @classmethod
    def applies_to(cls, scenario: Scenario) -> bool:
        """Return whether there is a fence."""
        return scenario.geofence is not None

    def _subjects(self) -> Subjects:
        outward, offsets = airspace_of(self.scenario).hull
        uavs = len(self.scenario.uavs)
        inwards = np.tile(outward @ self.grid.origin - offsets, uavs) / self.grid.length
        return (Tracks.of_points(self.grid), np.repeat(np.arange(uavs), len(offsets)), None,
                {'normals': np.tile(-outward, (uavs, 1)), 'offsets': inwards})
