"""How CVXPY hands a problem to Clarabel, and what becomes of a failure."""

import logging
import math
import time
from typing import Any
import warnings

import cvxpy as cp

from ...mission.cone_program import is_solver_failure

_LOG = logging.getLogger(__name__)


def solve_problem(problem: Any, time_left: float = math.inf) -> tuple[bool, float, float]:
    """
    Solve a CVXPY problem by a solver of its own.

    Whatever the solver raises is an answer and not an exception, as the callers keep their best
    iterate. A problem that breaks CVXPY's rules still raises: that is an error in the program.

    :param time_left: the limit for compiling and solving in s.
    :return: whether the variables hold a solution, the time inside Clarabel in s, and the time
        that CVXPY took to compile the problem in s.
    """
    started = time.monotonic()
    # Without solver_opts, CVXPY 1.9 fails when it unpacks the results.
    data, chain, inverse_data = problem.get_problem_data(cp.CLARABEL, solver_opts={})
    compile_time = time.monotonic() - started
    options = {}
    if time_left < math.inf:
        options['time_limit'] = time_left - compile_time
        if options['time_limit'] <= 0:
            return False, 0.0, compile_time
    try:
        # Without a warm start: CVXPY's updates the solver of the last call, which Clarabel
        # refuses when an entry of a matrix has become zero, or is zero no longer. CVXPY 1.6.7 to
        # 1.8.1 pass the refusal on. Clarabel's iterations do not start warm in any case.
        solution = chain.solve_via_data(
            problem, data, warm_start=False, verbose=False, solver_opts=options)
    except BaseException as error:
        if not is_solver_failure(error):
            raise
        _LOG.debug('Clarabel failed', exc_info=True)
        return False, 0.0, compile_time
    with warnings.catch_warnings():
        # An inaccurate solution is as good: the caller measures it by the true objective.
        warnings.filterwarnings('ignore', message='Solution may be inaccurate')
        try:
            problem.unpack_results(solution, chain, inverse_data)
        except cp.SolverError:
            return False, solution.solve_time, compile_time
    solved = problem.status in (cp.OPTIMAL, cp.OPTIMAL_INACCURATE)
    return solved, solution.solve_time, compile_time
