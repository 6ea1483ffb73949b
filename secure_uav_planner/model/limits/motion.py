"""
The limits of speed, equation (1), and of acceleration.

For the latter, the points are the control points of a uniform quadratic B-spline, which has the
acceleration (q[n+1] - 2 q[n] + q[n-1]) / t_s^2 in each slot.
"""

import numpy as np

from .norm import NormLimit
from ..grid import Grid
from ...mission.scenario import Array, Scenario


class SpeedLimit(NormLimit):
    """No UAV flies faster than its largest speed: d[n] = q[n+1] - q[n], n = 0..N."""

    stencil = (-1.0, 1.0)
    lead = 0

    def _longest(self) -> Array:
        return self.scenario.max_speeds * self.grid.slot_duration

    def _excess(self, uav: int, place: int, value: float) -> str:
        return (f'{self.scenario.uavs[uav].name} moves {value:.9g} m after point {place}; '
                f'at most {self.longest[uav]:.9g} m are allowed')

    def differences(self, positions: Array) -> Array:
        """Return the moves, (U, N+1, 2)."""
        return np.diff(positions, axis=1)


class AccelerationLimit(NormLimit):
    """
    No UAV accelerates more than it can: d[n] = q[n+1] - 2 q[n] + q[n-1], n = 0..N+1.

    q[-1] = q[0] - v_start t_s and q[N+2] = q[N+1] + v_goal t_s. The d of an end whose velocity is
    free does not count, and neither do those of UAVs without a limit.
    """

    stencil = (1.0, -2.0, 1.0)
    lead = 1

    def __init__(self, scenario: Scenario, grid: Grid | None = None) -> None:
        super().__init__(scenario, grid)
        self.absent[[0, -1]] |= np.isnan(scenario.end_velocities[..., 0])
        # The moves before the start and after the goal, (2, U, 2) in m.
        self._end_moves = self.grid.slot_duration * np.nan_to_num(scenario.end_velocities)

    @classmethod
    def applies_to(cls, scenario: Scenario) -> bool:
        """Return whether any UAV has the limit."""
        return any(uav.max_acceleration is not None for uav in scenario.uavs)

    def _longest(self) -> Array:
        return self.scenario.max_accelerations * self.grid.slot_duration**2

    def _excess(self, uav: int, place: int, value: float) -> str:
        square = self.grid.slot_duration**2
        return (f'{self.scenario.uavs[uav].name} accelerates by {value / square:.9g} m/s^2 at '
                f'point {place}; at most {self.longest[uav] / square:.9g} m/s^2 are allowed')

    def differences(self, positions: Array) -> Array:
        """Return the second differences, (U, N+2, 2)."""
        first, last = self._end_moves[:, :, None]
        return np.diff(np.concatenate([first, np.diff(positions, axis=1), last], axis=1), axis=1)
