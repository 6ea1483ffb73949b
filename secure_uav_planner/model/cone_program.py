"""
Second-order cone programs, solved by Clarabel, and the flights of least utilisation by them.

These flights stay farthest from the limits of speed and acceleration; see kinematics.
"""

from collections.abc import Callable
from importlib import import_module
import logging
import math
from queue import SimpleQueue
import threading
from typing import Any

import numpy as np
from numpy.typing import NDArray
import scipy

from ..errors import name_missing_package
from ..mission.kinematics import Vehicle
from ..mission.scenario import Scenario
from ..mission.validation import Array, read_only

# Statuses of Clarabel whose answers are used: rounding may allow no further progress.
_ANSWERS = 'Solved', 'AlmostSolved', 'InsufficientProgress'
_ACCURACY = 1e-9  # Accuracy of the least utilisation.
_LOG = logging.getLogger(__name__)


def solve_cone_program(
        quadratic: Any, linear: NDArray[np.float64], matrix: Any, right: NDArray[np.float64], *,
        equalities: int = 0, inequalities: int = 0, accuracy: float = 1e-8,
        raise_if_over: Callable[[], None] = lambda: None) -> NDArray[np.float64] | None:
    """
    Minimise x^T P x / 2 + q^T x subject to A x + s = b.

    The first rows of s are 0, the next are not negative, and the rest are cones of three rows
    each, (s_1, s_2, s_3) with |(s_2, s_3)| <= s_1. Clarabel runs in a thread of its own, so that
    the calling thread handles signals: in the main thread, Ctrl-C ends a solve.

    :param quadratic: P, a sparse matrix (K, K).
    :param linear: q, (K,).
    :param matrix: A, a sparse matrix (M, K).
    :param right: b, (M,).
    :param equalities: number of rows of s that are 0.
    :param inequalities: number of rows of s that are not negative.
    :param accuracy: tolerance of the duality gap and of the constraints.
    :param raise_if_over: called after each iteration; its exception ends the solve and is passed
        on.
    :return: x, (K,), or None if Clarabel finds no solution.
    """
    with name_missing_package():
        clarabel: Any = import_module('clarabel')  # Here, since few missions need it.
    cones = [clarabel.ZeroConeT(equalities), clarabel.NonnegativeConeT(inequalities),
             *[clarabel.SecondOrderConeT(3)] * ((len(right) - equalities - inequalities) // 3)]
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    settings.tol_gap_abs = settings.tol_gap_rel = settings.tol_feas = accuracy
    stop, solutions, iterations = threading.Event(), [], SimpleQueue[bool]()

    def note_iteration(_: Any) -> bool:
        iterations.put(True)
        return stop.is_set()

    def run() -> None:
        """Append the solution to `solutions`, or log a failure; then put False in `iterations`."""
        try:
            solver = clarabel.DefaultSolver(
                quadratic.tocsc(), linear, matrix.tocsc(), right, cones, settings)
            solver.set_termination_callback(note_iteration)
            solutions.append(solver.solve())
        except BaseException as error:
            if not is_solver_failure(error):
                raise
            _LOG.debug('Clarabel failed', exc_info=True)
        finally:
            iterations.put(False)

    try:
        threading.Thread(target=run).start()
        while iterations.get():
            raise_if_over()
    finally:
        stop.set()
    if not solutions or str(solutions[0].status) not in _ANSWERS:
        return None
    return np.array(solutions[0].x)


def is_solver_failure(error: BaseException) -> bool:
    """Return True for any Exception, and for Rust panics, whose class Clarabel does not export."""
    return isinstance(error, Exception) or type(error).__name__ == 'PanicException'


class LeastFlights:
    """
    A cache of flights of least utilisation.

    A cone program of 200 slots takes 9 ms, and a call of solve asks for some flights 100 times.
    """

    def __init__(self) -> None:
        self._flights: dict[tuple[Vehicle, int, float], tuple[float, Array]] = {}

    def find(self, vehicle: Vehicle, slots: int, step: float,
             raise_if_over: Callable[[], None] = lambda: None) -> tuple[float, Array]:
        """Return minimise_utilisation(vehicle, slots, step), computed once and then kept."""
        key = vehicle, slots, step
        if key not in self._flights:
            self._flights[key] = minimise_utilisation(*key, raise_if_over)
        return self._flights[key]

    def find_utilisations(self, scenario: Scenario,
                          raise_if_over: Callable[[], None] = lambda: None) -> Array:
        """Return the least utilisation of each UAV's flight in the scenario's slots, (U,)."""
        slots = scenario.slots
        # Rounded like Grid.slot_duration, so that both are the same key of the cache.
        step = scenario.slot_duration * (slots + 1) / (slots + 1)
        return np.array([self.find(uav.vehicle, slots, step, raise_if_over)[0]
                         for uav in scenario.uavs])


def minimise_utilisation(vehicle: Vehicle, slots: int, step: float,
                         raise_if_over: Callable[[], None] = lambda: None) -> tuple[float, Array]:
    """
    Return the least utilisation, and its flight's points (N+2, 2) in m from the start, read-only.

    The utilisation is the largest ratio of a speed or an acceleration to its limit. If it is above
    1, no flight of N slots of `step` seconds keeps the limits. If the solver fails, which happens
    only far above 1, the utilisation is infinite, with the points of the straight flight. The
    straight flight is returned without a cone program if there is no limit of acceleration, or if
    each velocity at an end is free or zero.

    The cone program minimises r subject to |w[n]| <= r V and |w[n] - w[n-1]| <= r a step, with the
    largest speed V and acceleration a. The velocities w, (N+1, 2) in m/s, add up to the
    displacement; velocities beyond both ends are given or free.

    :param raise_if_over: called in the search; what it raises is passed on.
    """
    straight = read_only(vehicle.fly_straight(slots, step))
    if vehicle.is_straight_optimal:
        return vehicle.straight_utilisation(slots, step), straight
    displacement = np.array(vehicle.displacement)
    begin, end = (np.zeros((0, 2)) if velocity is None else np.array([velocity])
                  for velocity in (vehicle.start_velocity, vehicle.goal_velocity))
    rows, right_side = _list_cones(vehicle, slots, step, begin, end)
    size = rows.shape[1]
    solution = solve_cone_program(
        scipy.sparse.csc_matrix((size, size)), np.eye(1, size)[0], rows, right_side,
        equalities=2, accuracy=_ACCURACY, raise_if_over=raise_if_over)
    if solution is None or not np.isfinite(solution).all():
        return math.inf, straight
    velocities = solution[1:].reshape(-1, 2) * vehicle.max_speed
    # The displacement is nearly right: the moves share the rest.
    velocities += (displacement / step - velocities.sum(axis=0)) / (slots + 1)
    changes = np.diff(np.concatenate([begin, velocities, end]), axis=0)
    utilisation = max(np.hypot(*velocities.T).max() / vehicle.max_speed,
                      np.hypot(*changes.T).max(initial=0.0) / (vehicle.max_acceleration * step))
    points = np.concatenate([np.zeros((1, 2)), np.cumsum(velocities, axis=0) * step])
    points[-1] = displacement
    return float(utilisation), read_only(points)


def _list_cones(vehicle: Vehicle, slots: int, step: float, begin: Array, end: Array
                ) -> tuple[Any, Array]:
    """
    Return the matrix A and the right side b of minimise_utilisation as A x + s = b.

    The unknowns x are r, then the N + 1 velocities in units of the top speed. The first two rows
    have s = 0: the velocities add up to the displacement. Each cone |vector| <= limit r has three
    rows with s = b - A x = (limit r, vector), so A has entries -limit and minus the vector's. The
    vectors are the velocities, with limit 1, then the N to N + 2 changes of velocities.

    :param begin: velocity before the start, (1, 2) in m/s, or (0, 2) if it is free.
    :param end: velocity after the goal, (1, 2) in m/s, or (0, 2) if it is free.
    """
    moves, top, most_change = slots + 1, vehicle.max_speed, vehicle.max_acceleration * step
    # The given velocities beyond both ends, with zeros in place of the unknown velocities.
    ends = np.concatenate([begin, np.zeros((moves, 2)), end])
    change = scipy.sparse.diags([-1.0, 1.0], [0, 1], shape=(len(ends) - 1, len(ends)))
    vectors = scipy.sparse.vstack([
        scipy.sparse.identity(moves), change @ scipy.sparse.eye(len(ends), moves, k=-len(begin))])
    constants = np.concatenate([np.zeros((moves, 2)), np.diff(ends / top, axis=0)])
    limits = np.zeros((len(constants), 3))
    limits[:, 0] = np.where(np.arange(len(limits)) < moves, 1.0, most_change / top)
    unit = max(1.0, math.hypot(*vehicle.displacement))  # Scale of the first two rows [m].
    rows = scipy.sparse.bmat([
        [None, scipy.sparse.kron(np.full((1, moves), step * top / unit), np.eye(2))],
        [scipy.sparse.csr_matrix(-limits.reshape(-1, 1)),
         -scipy.sparse.kron(vectors, np.eye(3, 2, k=-1))]])
    return rows, np.concatenate([np.array(vehicle.displacement) / unit,
                                 np.pad(constants, ((0, 0), (1, 0))).ravel()])
