"""
Feasibility of a single flight, and the flight that stays farthest from its limits.

Points q[0..N+1] are the control points of a uniform quadratic B-spline whose slots last `step`
seconds. Its velocities are the moves w[n] = (q[n+1] - q[n]) / step, n = 0..N, with w[-1] and
w[N+1] given by the velocities at the ends; its acceleration in a slot is (w[n] - w[n-1]) / step.
The effort of a flight is its largest speed or acceleration as a share of the limit.
"""

from dataclasses import dataclass
import math

import numpy as np
from numpy.typing import NDArray
import scipy

from .cone_program import solve_cone_program
from ..errors import NumericalError

_ACCURACY = 1e-9


@dataclass(frozen=True)
class Vehicle:
    """
    The ends of a flight and the limits of its vehicle.

    :param displacement: from start to goal, (x, y) in m.
    :param max_speed: V in m/s.
    :param max_acceleration: in m/s^2, infinite for no limit.
    :param start_velocity: (x, y) in m/s, or None for a free one.
    :param goal_velocity: likewise.
    """

    displacement: tuple[float, float]
    max_speed: float
    max_acceleration: float = math.inf
    start_velocity: tuple[float, float] | None = None
    goal_velocity: tuple[float, float] | None = None

    def least_effort(self, slots: int, step: float) -> tuple[float, NDArray[np.float64]]:
        """
        Return the least effort of a flight, and its points (N+2, 2) in m from the start.

        If the effort is above 1, no flight of N slots of `step` seconds keeps the limits.

        :raises NumericalError: if the solver fails.
        """
        if math.isinf(self.max_acceleration) or all(
                velocity in (None, (0.0, 0.0))
                for velocity in (self.start_velocity, self.goal_velocity)):
            return self._straight(slots, step)
        return self._solve_cone_program(slots, step)

    def shortest_step(self, slots: int) -> float:
        """Return the shortest slot in s with which a flight of N slots is feasible."""
        distance = math.hypot(*self.displacement)
        if math.isinf(self.max_acceleration):
            return distance / ((slots + 1) * self.max_speed)
        high = max(distance / ((slots + 1) * self.max_speed), 1e-9)
        while self.least_effort(slots, high)[0] > 1:
            high *= 2
        low = high / 2
        while high - low > 1e-7 * high:
            middle = (low + high) / 2
            if self.least_effort(slots, middle)[0] <= 1:
                high = middle
            else:
                low = middle
        return high

    def _straight(self, slots: int, step: float) -> tuple[float, NDArray[np.float64]]:
        """Return the flight whose moves are all the same share of the longest allowed ones."""
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

    def _solve_cone_program(self, slots: int, step: float) -> tuple[float, NDArray[np.float64]]:
        """
        Return the flight of least effort, by a second-order cone program.

        It minimises the effort r subject to |w[n]| <= r V and |w[n] - w[n-1]| <= r a step.
        """
        moves, top = slots + 1, self.max_speed
        given, first = self._with_ends(np.zeros((moves, 2)))
        change = scipy.sparse.diags([-1.0, 1.0], [0, 1], shape=(len(given) - 1, len(given)))
        vectors = scipy.sparse.vstack([
            scipy.sparse.identity(moves), change @ scipy.sparse.eye(len(given), moves, k=-first)])
        constants = np.concatenate([np.zeros((moves, 2)), np.diff(given / top, axis=0)])
        cones = len(constants)
        limits = np.where(np.arange(cones) < moves, 1.0, self.max_acceleration * step / top)
        unit = max(1.0, math.hypot(*self.displacement))
        both = scipy.sparse.identity(2)
        rows = scipy.sparse.bmat([
            [None, scipy.sparse.kron(np.full((1, moves), step * top / unit), both)],
            [scipy.sparse.csr_matrix(-limits[:, None]), None],
            [None, -scipy.sparse.kron(vectors, both)]], format='csr')
        right = np.concatenate([
            np.array(self.displacement) / unit, np.zeros(cones), constants.ravel()])
        # The displacement, then for every cone its limit times r and its vector.
        number = 2 + np.arange(cones)
        order = np.append([0, 1], np.stack(
            [number, cones + 2 * number - 2, cones + 2 * number - 1], axis=1))
        size = 1 + 2 * moves
        solution = solve_cone_program(
            scipy.sparse.csc_matrix((size, size)), np.eye(1, size)[0], rows[order], right[order],
            equalities=2, accuracy=_ACCURACY)
        if solution is None:
            raise NumericalError(f'no flight of least effort was found for {self}')
        velocities = solution[1:].reshape(-1, 2) * top
        # The displacement is nearly right: the moves share the rest.
        missing = np.array(self.displacement) - velocities.sum(axis=0) * step
        velocities = velocities + missing / (moves * step)
        changes = np.linalg.norm(np.diff(self._with_ends(velocities)[0], axis=0), axis=1)
        effort = max(np.linalg.norm(velocities, axis=1).max() / top,
                     changes.max(initial=0.0) / (self.max_acceleration * step))
        points = np.concatenate([np.zeros((1, 2)), np.cumsum(velocities, axis=0) * step])
        points[-1] = self.displacement
        return float(effort), points

    def _with_ends(self, velocities: NDArray[np.float64]) -> tuple[NDArray[np.float64], int]:
        """Add the given end velocities; return all, and the index of the first move's."""
        before, after = (np.zeros((0, 2)) if velocity is None else np.array([velocity])
                         for velocity in (self.start_velocity, self.goal_velocity))
        return np.concatenate([before, velocities, after]), len(before)


def clip_norm(x: float, y: float, most: float) -> tuple[float, float]:
    """Return a vector, shortened to a limit if it is longer."""
    factor = min(1.0, most / max(math.hypot(x, y), 1e-300))
    return x * factor, y * factor
