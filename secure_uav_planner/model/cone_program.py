"""Second-order cone programs, solved by Clarabel."""

from collections.abc import Callable
from importlib import import_module
import logging
from queue import SimpleQueue
import threading
from typing import Any

import numpy as np
from numpy.typing import NDArray

_ANSWERS = 'Solved', 'AlmostSolved', 'InsufficientProgress'  # As near as doubles come.
_LOG = logging.getLogger(__name__)


def solve_cone_program(
        quadratic: Any, linear: NDArray[np.float64], matrix: Any, right: NDArray[np.float64], *,
        equalities: int = 0, inequalities: int = 0, accuracy: float = 1e-8,
        check: Callable[[], None] = lambda: None) -> NDArray[np.float64] | None:
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
    :param accuracy: of the duality gap and of the constraints.
    :param check: called after each iteration; its exception ends the solve and is passed on.
    :return: x, (K,), or None if Clarabel finds no solution.
    """
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
            check()
    finally:
        stop.set()
    if not solutions or str(solutions[0].status) not in _ANSWERS:
        return None
    return np.array(solutions[0].x)


def is_solver_failure(error: BaseException) -> bool:
    """Return True for errors of Clarabel; it does not export the class of its Rust panics."""
    return isinstance(error, Exception) or type(error).__name__ == 'PanicException'
