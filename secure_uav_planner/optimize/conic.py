"""How a CVXPY problem is handed to Clarabel."""

import logging
import warnings

import cvxpy as cp
import numpy as np

# Below this a solver could not even set up; above it the deadline is the caller's.
_LEAST_TIME = 1e-3

_LOG = logging.getLogger(__name__)


def solve_with_clarabel(problem, time_left=np.inf):
    """
    Solve a problem with its present parameter values, by a solver of its own.

    Whatever the solver raises is an answer, not an exception: the callers keep their best
    iterate. A problem that breaks CVXPY's rules still raises, as that is an error in the program.

    :param time_left: limit for the solver in s.
    :return: whether the variables hold a solution, and the time inside Clarabel in s.
    """
    options = {} if np.isinf(time_left) else {'time_limit': max(time_left, _LEAST_TIME)}
    # The problems follow DPP, but the map from parameters to matrices that CVXPY would
    # keep has as many rows as a matrix has entries: 3 GB and seconds for 200 slots,
    # where filling in the values before compiling takes megabytes and 20 ms.
    data, chain, inverse_data = problem.get_problem_data(
        cp.CLARABEL, ignore_dpp=True, solver_opts=options)
    try:
        # Without a warm start: CVXPY's updates the solver of the last call, which Clarabel
        # refuses when an entry of a matrix has become zero, or is zero no longer. CVXPY 1.6.7 to
        # 1.8.1 pass the refusal on. Clarabel's iterations do not start warm in any case.
        solution = chain.solve_via_data(
            problem, data, warm_start=False, verbose=False, solver_opts=options)
    except BaseException as error:
        # A panic of Clarabel's Rust code is a BaseException that no module exports.
        if not isinstance(error, Exception) and type(error).__name__ != 'PanicException':
            raise
        _LOG.debug('Clarabel failed', exc_info=True)
        return False, 0.0
    with warnings.catch_warnings():
        # An inaccurate solution is as good: the caller measures it by the true objective.
        warnings.filterwarnings('ignore', message='Solution may be inaccurate')
        try:
            problem.unpack_results(solution, chain, inverse_data)
        except cp.SolverError:
            return False, solution.solve_time
    return problem.status in (cp.OPTIMAL, cp.OPTIMAL_INACCURATE), solution.solve_time
