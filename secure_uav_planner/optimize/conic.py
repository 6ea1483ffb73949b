"""How a CVXPY problem is handed to Clarabel."""

import warnings

import cvxpy as cp
import numpy as np

# Below this a solver could not even set up; above it the deadline is the caller's.
_LEAST_TIME = 1e-3


def solve_with_clarabel(problem, time_left=np.inf):
    """
    Solve a problem with its present parameter values.

    A failure is an answer, not an exception: the callers keep their best iterate.

    :param time_left: limit for the solver in s.
    :return: whether the variables hold a solution, and the time inside Clarabel in s.
    """
    options = {} if np.isinf(time_left) else {'time_limit': max(time_left, _LEAST_TIME)}
    with warnings.catch_warnings():
        # An inaccurate solution is as good: the caller measures it by the true objective.
        warnings.filterwarnings('ignore', message='Solution may be inaccurate')
        try:
            # The problems follow DPP, but the map from parameters to matrices that CVXPY would
            # keep has as many rows as a matrix has entries: 3 GB and seconds for 200 slots,
            # where filling in the values before compiling takes megabytes and 20 ms.
            problem.solve(solver=cp.CLARABEL, ignore_dpp=True, **options)
        except cp.SolverError:
            return False, 0.0
    solved = problem.status in (cp.OPTIMAL, cp.OPTIMAL_INACCURATE)
    return solved, problem.solver_stats.solve_time or 0.0
