"""
The limits of speed, equation (1), and of acceleration: lengths of differences of points.

With a limit of acceleration, the points are the control points of a uniform quadratic B-spline,
which has the acceleration (q[n+1] - 2 q[n] + q[n-1]) / t_s^2 in each slot.
"""

from abc import abstractmethod
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from .base import compile_vectors, Limit
from ..airspace import Airspace
from ..curve import add_end_moves
from ..grid import Grid
from ..kernel import core
from ...errors import PlanError
from ...mission.scenario import Array, POSITION_TOLERANCE
from ...mission.validation import round_down


_LEAST_TOLERANCE = 1e-9  # Tolerance of the shortest differences [m].
_ROUNDING = 1e-15  # Rounding error of differences of points, as a share of coordinates.


class NormLimit(Limit):
    """
    A limit c = 1 - |d|^2 / r^2 on differences d = sum_k a_k q[m + 1 - order + k] of points.

    A UAV that is fixed has c = 1.

    :cvar stencil: the weights a_k, (order + 1,).
    :param longest: r, (U,) in m.
    :ivar absent: True for differences without a limit, (M, U).
    """

    stencil: ClassVar[tuple[float, ...]]

    def __init__(self, grid: Grid, longest: Array) -> None:
        super().__init__(grid)
        self.longest = longest
        self.absent: NDArray[np.bool_] = np.full(
            (self.grid.slots + self.order, len(self.longest)), False)
        self._end_moves: Array = np.zeros((2, len(self.longest), 2))  # Beyond start and goal [m].

    @property
    def order(self) -> int:
        """Order of the differences: 1 for moves, 2 for their changes."""
        return len(self.stencil) - 1

    @property
    def compiled(self) -> core.Limit:
        """Return the limit as the kernel reads it, in units of the grid."""
        grid, uavs = self.grid, len(self.longest)
        # q[-1] and q[N+2] are replaced by q[0] and q[N+1]; constants add the moves in between.
        point = np.arange(len(self.absent))[:, None] + np.arange(1 - self.order, 2)
        inside = np.clip(point, 0, grid.slots + 1)[:, None]
        constant = np.zeros((*self.absent.shape, 2))
        constant[0] -= self._end_moves[0] / grid.length
        constant[-1] += self._end_moves[1] / grid.length
        vectors = compile_vectors(
            grid, inside * uavs + np.arange(uavs)[:, None], self.stencil, constant,
            differences=True)
        squares = np.broadcast_to((self.longest / grid.length)**2, self.absent.shape)
        return core.Limit(vectors, self.absent | grid.fixed, np.ascontiguousarray(squares))

    @abstractmethod
    def _describe_excess(self, uav: int, point: int, value: float) -> str:
        """Return the error's text for the difference d[point] of length `value` [m]."""

    @abstractmethod
    def differences(self, positions: Array) -> Array:
        """Return d of positions (U, N+2, 2) in m, (U, M, 2) in m; M = N + order."""

    def validate(self, positions: Array, powers: Array) -> None:
        lengths = self._lengths(positions)
        rounding = _ROUNDING * np.abs(positions).max()
        for uav, (length, most) in enumerate(zip(lengths, self.longest.tolist(), strict=True)):
            # POSITION_TOLERANCE is a multiple of a limit of acceleration in slots of milliseconds.
            tolerance = max(min(POSITION_TOLERANCE, 1e-3 * most), _LEAST_TOLERANCE, rounding)
            if length.max() > most + tolerance:
                raise PlanError(self._describe_excess(
                    uav, int(length.argmax()), float(length.max())))

    def retract(self, positions: Array, margin: float = 0.0) -> Array:
        """
        Return positions (U, N+2, 2) in m whose flights keep the limit, with exact ends.

        A flight that exceeds the limit is blended with the UAV's reference flight, which has the
        least utilisation, at the share excess / (excess + reference's slack). Others stay.

        :param margin: share of the limit to keep free, if the reference keeps as much free.
        """
        positions = positions.copy()
        positions[:, 0], positions[:, -1] = self.scenario.starts, self.scenario.goals
        longest = self._lengths(positions).max(axis=1)
        most = (1 - margin) * self.longest
        exceeds = longest > most
        if exceeds.any():
            reference = self.grid.reference_flight
            excess = (longest - most)[exceeds]
            least = self._lengths(reference).max(axis=1)
            slack = np.maximum(most - least, 0)[exceeds]
            share = excess / (excess + slack)
            positions[exceeds, 1:-1] += share[:, None, None] * (
                reference - positions)[exceeds, 1:-1]
        return positions

    def utilisations(self, positions: Array) -> Array:
        """Return the largest |d| / r of each flight (N+2, 2) in m, (U,)."""
        return np.asarray((self._lengths(positions) / self.longest[:, None]).max(axis=1))

    def _lengths(self, positions: Array) -> Array:
        """Return |d|, 0 for differences without a limit, (U, M) in m."""
        differences = self.differences(positions)
        # The explicit root is several times as fast as np.linalg.norm over an axis of two.
        lengths: Array = np.sqrt(differences[..., 0]**2 + differences[..., 1]**2)
        lengths[self.absent.T] = 0.0
        return lengths


class SpeedLimit(NormLimit):
    """No UAV flies faster than its largest speed: d[n] = q[n+1] - q[n], n = 0..N."""

    stencil = (-1.0, 1.0)

    def __init__(self, grid: Grid) -> None:
        super().__init__(grid, grid.scenario.max_speeds * grid.slot_duration)

    def _describe_excess(self, uav: int, point: int, value: float) -> str:
        return (f'{self.scenario.uavs[uav].name} moves {value:.9g} m after point {point}; '
                f'at most {round_down(self.longest[uav], 9):.9g} m are allowed')

    def differences(self, positions: Array) -> Array:
        return np.diff(positions, axis=1)


class AccelerationLimit(NormLimit):
    """
    No UAV accelerates more than it can: d[n] = q[n+1] - 2 q[n] + q[n-1], n = 0..N+1.

    q[-1] = q[0] - v_start t_s and q[N+2] = q[N+1] + v_goal t_s. An end whose velocity is free has
    no limit.
    """

    stencil = (1.0, -2.0, 1.0)

    def __init__(self, grid: Grid) -> None:
        super().__init__(grid, grid.scenario.max_accelerations * grid.slot_duration**2)
        self.absent[[0, -1]] |= np.isnan(self.scenario.end_velocities[..., 0])
        # The moves before the start and after the goal, (2, U, 2) in m.
        self._end_moves = self.grid.slot_duration * np.nan_to_num(self.scenario.end_velocities)

    @classmethod
    def applies_to(cls, airspace: Airspace) -> bool:
        return airspace.scenario.limits_acceleration

    def _describe_excess(self, uav: int, point: int, value: float) -> str:
        square = self.grid.slot_duration**2
        most = round_down(self.longest[uav] / square, 9)
        return (f'{self.scenario.uavs[uav].name} accelerates by {value / square:.9g} m/s^2 at '
                f'point {point}; at most {most:.9g} m/s^2 are allowed')

    def differences(self, positions: Array) -> Array:
        return np.diff(add_end_moves(np.diff(positions, axis=1), self._end_moves), axis=1)
