"""
Whether a UAV can fly a mission at all, and the flight that stays farthest from its limits.

Points q[0..N+1] are the control points of a uniform quadratic B-spline whose slots last `step`
seconds. Its velocities are the moves w[n] = (q[n+1] - q[n]) / step, n = 0..N, with w[-1] and
w[N+1] given by the velocities at the ends; its acceleration in a slot is (w[n] - w[n-1]) / step.
The effort of a flight is the largest share of a limit that it uses, so that 1 is all of it.
"""

from dataclasses import dataclass
from importlib import import_module
import math
from typing import Any

import numpy as np
from numpy.typing import NDArray
import scipy

_ACCURACY = 1e-9
_DOUBLINGS, _HALVINGS = 60, 50


@dataclass(frozen=True)
class Vehicle:
    """
    The ends of a flight and the limits of who flies it.

    :param displacement: from start to goal, (x, y) in m.
    :param max_speed: V in m/s.
    :param max_acceleration: in m/s^2, infinite for none.
    :param start_velocity: (x, y) in m/s, or None where it is free.
    :param goal_velocity: likewise.
    """

    displacement: tuple[float, float]
    max_speed: float
    max_acceleration: float = math.inf
    start_velocity: tuple[float, float] | None = None
    goal_velocity: tuple[float, float] | None = None

    @property
    def _is_simple(self) -> bool:
        """Whether the flight of least effort is straight, with a profile of known shape."""
        ends = (self.start_velocity, self.goal_velocity)
        return math.isinf(self.max_acceleration) or all(
            velocity is None or velocity == (0.0, 0.0) for velocity in ends)

    def least_effort(self, slots: int, step: float) -> tuple[float, NDArray[np.float64]]:
        """
        Return the least effort of a flight, and one that has it, (N+2, 2) in m from the start.

        An effort above 1 says that no flight keeps the limits.

        :param slots: N.
        :param step: the length of a slot in s.
        """
        if self._is_simple:
            return self._straight(slots, step)
        return self._by_clarabel(slots, step)

    def shortest_step(self, slots: int) -> float:
        """Return the shortest slot in s with which a flight of so many slots is possible."""
        distance = math.hypot(*self.displacement)
        if math.isinf(self.max_acceleration):
            return distance / ((slots + 1) * self.max_speed)
        high = max(distance / ((slots + 1) * self.max_speed), 1e-9)
        for _ in range(_DOUBLINGS):
            if self.least_effort(slots, high)[0] <= 1:
                break
            high *= 2
        else:
            return math.inf
        low = high / 2
        for _ in range(_HALVINGS):
            if high - low <= 1e-7 * high:
                break
            middle = (low + high) / 2
            if self.least_effort(slots, middle)[0] <= 1:
                high = middle
            else:
                low = middle
        return high

    def _straight(self, slots: int, step: float) -> tuple[float, NDArray[np.float64]]:
        """Return the flight whose every move is the same share of the longest that is allowed."""
        count = np.arange(slots + 1.0)
        most = np.full(slots + 1, self.max_speed)
        if not math.isinf(self.max_acceleration):
            gain = self.max_acceleration * step
            if self.start_velocity is not None:
                most = np.minimum(most, (count + 1) * gain)
            if self.goal_velocity is not None:
                most = np.minimum(most, (slots + 1 - count) * gain)
        share = np.append(0.0, np.cumsum(most)) / most.sum()
        effort = math.hypot(*self.displacement) / (most.sum() * step)
        return effort, share[:, None] * np.array(self.displacement)

    def _by_clarabel(self, slots: int, step: float) -> tuple[float, NDArray[np.float64]]:
        """
        Return the flight of least effort as the solution of a second-order cone problem.

        It minimises the effort r subject to |w[n]| <= r V and |w[n] - w[n-1]| <= r a step.
        """
        clarabel: Any = import_module('clarabel')  # Here, for few flights need it.
        moves = slots + 1
        identity = scipy.sparse.identity(2 * moves, format='csr')
        change = identity - scipy.sparse.eye(2 * moves, k=-2, format='csr')
        first, last = (np.zeros(2) if velocity is None else np.array(velocity) / self.max_speed
                       for velocity in (self.start_velocity, self.goal_velocity))
        begin = 2 if self.start_velocity is None else 0
        blocks = [identity, change[begin:]]
        constants = [np.zeros(2 * moves), np.append(-first, np.zeros(2 * moves - 2))[begin:]]
        if self.goal_velocity is not None:
            blocks.append(-identity[-2:])
            constants.append(last)
        vectors, constant = scipy.sparse.vstack(blocks).tocoo(), np.concatenate(constants)
        cones = len(constant) // 2
        gain = self.max_acceleration * step / self.max_speed
        limits = np.where(np.arange(cones) < moves, 1.0, gain)

        # Rows: the displacement, then for every cone its limit times r and its vector.
        unit = max(1.0, math.hypot(*self.displacement))
        columns = 1 + np.arange(2 * moves)
        rows = [(columns - 1) % 2, 2 + 3 * np.arange(cones), 3 + vectors.row + vectors.row // 2]
        matrix = scipy.sparse.csc_matrix(
            (np.concatenate([np.full(2 * moves, step * self.max_speed / unit), -limits,
                             -vectors.data]),
             (np.concatenate(rows), np.concatenate(
                 [columns, np.zeros(cones, int), 1 + vectors.col]))),
            shape=(2 + 3 * cones, 1 + 2 * moves))
        right = np.zeros(2 + 3 * cones)
        right[:2] = np.array(self.displacement) / unit
        right[2:].reshape(-1, 3)[:, 1:] = constant.reshape(-1, 2)
        cost = np.zeros(1 + 2 * moves)
        cost[0] = 1.0
        settings = clarabel.DefaultSettings()
        settings.verbose = False
        settings.tol_gap_abs = settings.tol_gap_rel = settings.tol_feas = _ACCURACY
        solution = clarabel.DefaultSolver(
            scipy.sparse.csc_matrix((len(cost), len(cost))), cost, matrix, right,
            [clarabel.ZeroConeT(2), *[clarabel.SecondOrderConeT(3)] * cones], settings).solve()
        velocities = np.array(solution.x)[1:].reshape(-1, 2) * self.max_speed
        return self._effort_of(velocities, slots, step)

    def _effort_of(self, velocities: NDArray[np.float64], slots: int,
                   step: float) -> tuple[float, NDArray[np.float64]]:
        """Return the effort of a flight with nearly the right displacement, and its points."""
        missing = np.array(self.displacement) - velocities.sum(axis=0) * step
        velocities = velocities + missing / (len(velocities) * step)
        ends = [velocities]
        if self.start_velocity is not None:
            ends.insert(0, np.array([self.start_velocity]))
        if self.goal_velocity is not None:
            ends.append(np.array([self.goal_velocity]))
        changes = np.linalg.norm(np.diff(np.concatenate(ends), axis=0), axis=1)
        effort = max(np.linalg.norm(velocities, axis=1).max() / self.max_speed,
                     changes.max(initial=0.0) / (self.max_acceleration * step))
        points = np.concatenate([np.zeros((1, 2)), np.cumsum(velocities, axis=0) * step])
        points[-1] = self.displacement
        return float(effort), points


def shortened(x: float, y: float, most: float) -> tuple[float, float]:
    """Return a vector that is not longer than a limit, in its direction."""
    factor = min(1.0, most / max(math.hypot(x, y), 1e-300))
    return x * factor, y * factor
