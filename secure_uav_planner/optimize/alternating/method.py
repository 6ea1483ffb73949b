"""Section III: powers and trajectories in turn, by successive convex approximation."""

from collections.abc import Sequence

from .powers import PowerProblem
from .schedule import Schedule
from .trajectory import TrajectoryProblem
from ..search import Search
from ...plan.plan import Status

_Problem = PowerProblem | TrajectoryProblem


def alternate(search: Search, schedule: Schedule = Schedule()) -> Status:
    """
    Improve a search by the paper's algorithm until a round gains less than the tolerance.

    Unless an earlier plan is the start, the powers come first, as far as they go: the result is
    no worse than theirs alone.

    :param search: whose positions and powers are improved.
    :param schedule: the tuned numbers.
    :return: why the method stopped.
    """
    powers = PowerProblem(search.scenario)
    if not search.warm:
        # Powers have local optima; the start is the best of several levels of jamming.
        search.try_less_jamming()
        _rounds(search, [powers], schedule.powers_tolerance, schedule)
    trajectory = TrajectoryProblem(search.scenario)
    return _rounds(search, [powers] * schedule.power_steps + [trajectory], schedule.tolerance,
                   schedule)


def _rounds(search: Search, steps: Sequence[_Problem], tolerance: float,
            schedule: Schedule) -> Status:
    """Take the steps in turn until a round of them gains less than the tolerance."""
    for _ in range(schedule.max_rounds):
        before = search.rate
        solved = True
        for problem in steps:
            reason = search.stop_reason()
            if reason is not None:
                return reason
            if _compile_time(problem, steps, schedule) > search.time_left:
                return 'time_limit'
            solved &= _step(search, problem, schedule.stretch)
        if search.rate - before < tolerance:
            return search.stop_reason() or ('converged' if solved else 'numerical_trouble')
    return 'iteration_limit'


def _compile_time(problem: _Problem, steps: Sequence[_Problem], schedule: Schedule) -> float:
    """
    Return how long compiling a problem will take in s, which nothing can interrupt.

    It takes as long as the last time. The first trajectory problem is judged by the powers'.
    """
    if problem.compile_time is not None:
        return problem.compile_time
    return schedule.compile_ratio * (steps[0].compile_time or 0.0)


def _step(search: Search, problem: _Problem, factor: float) -> bool:
    """Solve a restriction at the present iterate; return whether the solver succeeded."""
    local = getattr(search, problem.block)
    answer, seconds = problem.solve(search.positions, search.powers, search.time_left)
    search.solver_time += seconds
    if answer is not None:
        # The restriction is cautious: go further along its step while the true rate rises.
        length = 1.0
        while search.try_improve(**{problem.block: local + length * (answer - local)}):
            length *= factor
    search.report(problem.step)
    return answer is not None
