"""The speed limit, equation (1): the largest displacement from one point to the next."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from .norm import NormLimit
from ...mission.scenario import Array


class SpeedLimit(NormLimit):
    """No UAV flies faster than its largest speed: d[n] = q[n+1] - q[n], n = 0..N."""

    stencil = (-1.0, 1.0)
    lead = 0

    def _longest(self) -> Array:
        return self.scenario.max_speeds * self.grid.slot_duration

    def _free_ends(self) -> NDArray[np.bool_]:
        return np.zeros((self.grid.slots + 1, len(self.scenario.uavs)), bool)

    def _excess(self, uav: int, place: int, value: float) -> str:
        return (f'{self.scenario.uavs[uav].name} moves {value:.9g} m after point {place}; '
                f'at most {self.longest[uav]:.9g} m are allowed')

    def differences(self, positions: Array) -> Array:
        """Return the moves, (U, N+1, 2)."""
        return np.diff(positions, axis=1)

    def _of_expression(self, path: Any, uav: int, scale: Any) -> Any:
        return path[1:] - path[:-1]
