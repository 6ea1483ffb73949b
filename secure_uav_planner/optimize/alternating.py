"""Section III: powers and trajectories in turn, by successive convex approximation."""

from .powers import PowerProblem
from .starts import offer_quieter
from .trajectory import TrajectoryProblem

TOLERANCE = 1e-5
"""A round that gains less than this, in bit/s/Hz, is the last."""

MAX_ROUNDS = 100

_POWER_STEPS = 3
"""Steps of III-A to one of III-B: they cost a tenth and gain more."""


def alternate(run):
    """
    Improve the run by the paper's algorithm until a round gains less than TOLERANCE.

    Powers come first, as far as they go: the result is no worse than theirs alone.

    :param run: a Run.
    :return: the status it ends with, one of plan.STATUSES.
    """
    shape = _shape(run.scenario)
    if not run.warm:
        optimise_powers(run)
    return _rounds(run, [('power', PowerProblem(*shape))] * _POWER_STEPS
                   + [('trajectory', TrajectoryProblem(*shape))])


def optimise_powers(run):
    """
    Improve only the powers of the run, by Section III-A; the rest is as for alternate.

    The powers have local optima; the start is the best of several levels of jamming.
    """
    offer_quieter(run)
    return _rounds(run, [('power', PowerProblem(*_shape(run.scenario)))], TOLERANCE / 100)


def _shape(scenario):
    return len(scenario.uavs), len(scenario.eavesdroppers), scenario.slots


def _rounds(run, steps, tolerance=TOLERANCE):
    """Take the steps in turn until a round of them gains less than the tolerance."""
    for _ in range(MAX_ROUNDS):
        before = run.rate
        solved = True
        for name, problem in steps:
            if run.stop_reason():
                return run.stop_reason()
            solved &= _step(run, name, problem)
        if run.rate - before < tolerance:
            return run.stop_reason() or ('converged' if solved else 'numerical_trouble')
    return 'iteration_limit'


def _step(run, name, problem):
    """Solve one restriction at the present iterate; return whether the solver succeeded."""
    block = 'powers' if name == 'power' else 'positions'
    local = getattr(run, block)
    answer, seconds = problem.solve(run.scenario, run.positions, run.powers, run.time_left)
    run.solver_time += seconds
    if answer is not None:
        # The restriction is cautious: go further along its step while the true rate rises.
        stretch = 1
        while run.offer(**{block: local + stretch * (answer - local)}):
            stretch *= 2
    run.report(name)
    return answer is not None
