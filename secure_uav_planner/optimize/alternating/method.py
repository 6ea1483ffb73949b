"""Section III: powers and trajectories in turn, by successive convex approximation."""

from .restrictions import PowerProblem, TrajectoryProblem
from ..incumbent import Incumbent
from ...plan.plan import Status

TOLERANCE = 1e-5
"""A round of all steps that gains less, in bit/s/Hz, is the last."""
MAX_ROUNDS = 100
POWER_STEPS = 3
"""Steps of Section III-A, which cost a fifth of one of Section III-B, before each of those."""
STRETCH = 2.0
"""
The factor by which a step is lengthened while the true rate rises.

Without it, as in the paper, solves take 3.6 times as long and end lower.
"""
COMPILE_RATIO = 12.0
"""Ratio of CVXPY's times to compile the trajectory problem and the power problem."""

_Problem = PowerProblem | TrajectoryProblem


def alternate(incumbent: Incumbent) -> Status:
    """Improve an incumbent by the paper's algorithm until a round gains less than TOLERANCE."""
    powers = PowerProblem(incumbent.scenario)
    steps = [powers] * POWER_STEPS + [TrajectoryProblem(incumbent.scenario)]
    for _ in range(MAX_ROUNDS):
        before = incumbent.rate
        solved = True
        for problem in steps:
            incumbent.deadline.check(_predict_compile_time(problem, powers))
            solved &= _step(incumbent, problem)
        if incumbent.rate - before < TOLERANCE:
            incumbent.deadline.check()
            return 'converged' if solved else 'numerical_trouble'
    return 'iteration_limit'


def _predict_compile_time(problem: _Problem, powers: PowerProblem) -> float:
    """Return the last compile time of a problem in s, or for the first trajectory a guess."""
    if problem.compile_time is not None:
        return problem.compile_time
    return COMPILE_RATIO * (powers.compile_time or 0.0)


def _step(incumbent: Incumbent, problem: _Problem) -> bool:
    """Solve a restriction at the present iterate; return True if the solver succeeded."""
    local = getattr(incumbent, problem.block)
    answer, seconds = problem.solve(
        incumbent.positions, incumbent.powers, incumbent.deadline.time_left)
    incumbent.solver_time += seconds
    if answer is not None:
        # A restriction is a lower bound: go further along its step while the true rate rises.
        length = 1.0
        while incumbent.try_improve(**{problem.block: local + length * (answer - local)}):
            length *= STRETCH
    incumbent.report(problem.step)
    return answer is not None
