"""Section III: powers and trajectories in turn, by successive convex approximation."""

from .powers import PowerProblem
from .trajectory import TrajectoryProblem
from ..search import Search
from ...plan.plan import Status

TOLERANCE = 1e-5
"""A round of all steps that gains less, in bit/s/Hz, is the last."""
MAX_ROUNDS = 100
POWER_STEPS = 3
"""Steps of Section III-A, which cost a fifth of one of Section III-B, before each of those."""
STRETCH = 2.0
"""
The factor by which a step is made longer while the true rate rises.

Without, as in the paper, solves take 3.6 times as long and end lower.
"""
COMPILE_RATIO = 12.0
"""How much longer CVXPY takes to compile the trajectory problem than the power problem."""

_Problem = PowerProblem | TrajectoryProblem


def alternate(search: Search) -> Status:
    """
    Improve a search by the paper's algorithm until a round gains less than the tolerance.

    :param search: whose positions and powers are improved.
    :return: why the method stopped.
    """
    powers = PowerProblem(search.scenario)
    steps = [powers] * POWER_STEPS + [TrajectoryProblem(search.scenario)]
    for _ in range(MAX_ROUNDS):
        before = search.rate
        solved = True
        for problem in steps:
            reason = search.stop_reason()
            if reason is not None:
                return reason
            if _compile_time(problem, powers) > search.termination.time_left:
                return 'time_limit'
            solved &= _step(search, problem)
        if search.rate - before < TOLERANCE:
            return search.stop_reason() or ('converged' if solved else 'numerical_trouble')
    return 'iteration_limit'


def _compile_time(problem: _Problem, powers: PowerProblem) -> float:
    """
    Return how long compiling a problem will take in s, which nothing can interrupt.

    It takes as long as the last time. The first trajectory problem is judged by the powers'.
    """
    if problem.compile_time is not None:
        return problem.compile_time
    return COMPILE_RATIO * (powers.compile_time or 0.0)


def _step(search: Search, problem: _Problem) -> bool:
    """Solve a restriction at the present iterate; return whether the solver succeeded."""
    local = getattr(search, problem.block)
    answer, seconds = problem.solve(
        search.positions, search.powers, search.termination.time_left)
    search.solver_time += seconds
    if answer is not None:
        # The restriction is cautious: go further along its step while the true rate rises.
        length = 1.0
        while search.try_improve(**{problem.block: local + length * (answer - local)}):
            length *= STRETCH
    search.report(problem.step)
    return answer is not None
