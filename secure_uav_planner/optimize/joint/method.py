"""
The joint method: positions and powers together.

Several starts are improved for problem (P2), `multistart.py`; where (P1) is the objective, the
best plans are then improved for it, `exchange.py`. Limits of energy are kept last, `energy.py`.
"""

import math

from .barrier import Stepper
from .energy import improve_within_energy
from .exchange import improve_by_exchange
from .multistart import improve_by_multistart, improve_incumbent, improve_powers
from ..deadline import run_to_end
from ..incumbent import Incumbent
from ...errors import InfeasibleMissionError
from ...plan.plan import Status


def improve(incumbent: Incumbent) -> Status:
    """
    Improve an Incumbent by the joint method until it has converged or must stop.

    :param incumbent: when `warm`, it is the only start.
    :return: the status.
    """
    stepper = Stepper(incumbent)
    if incumbent.scenario.limits_energy:
        return _improve_within_energy(stepper)
    if incumbent.objective == 'guaranteed' or not incumbent.scenario.receivers.radii.any():
        return _improve_guaranteed(stepper)
    if incumbent.warm:
        return run_to_end(improve_by_exchange, stepper)
    # The plan of (P2) is where (P1) begins, and what it is never below.
    guaranteed = Stepper(incumbent.with_objective('guaranteed'))
    plan = guaranteed.incumbent
    _improve_guaranteed(guaranteed)
    incumbent.try_improve(plan.positions, plan.useful_powers)
    status = run_to_end(improve_by_exchange, stepper, guaranteed.optima)
    if not incumbent.deadline.is_over():
        plan.try_idle_slots()
        incumbent.try_improve(plan.positions, plan.useful_powers)
    return status


def _improve_within_energy(stepper: Stepper) -> Status:
    """Improve the incumbent of a Stepper whose scenario has limits of energy; see improve."""
    incumbent, free = stepper.incumbent, None
    if not incumbent.warm or math.isinf(incumbent.rate):
        free = incumbent.without_energy_limits()
        status = improve(free)
        incumbent.try_improve(free.positions, free.useful_powers)
        if incumbent.problem.keeps_energy(free.positions):
            return status
    status = run_to_end(improve_within_energy, stepper, free)
    if math.isinf(incumbent.rate):
        incumbent.deadline.check()
        raise InfeasibleMissionError(
            'no flights were found that keep max_energy and all other limits', ('uavs',))
    return status


def _improve_guaranteed(stepper: Stepper) -> Status:
    """Improve the incumbent of a Stepper for (P2), or where discs are points; see improve."""
    incumbent = stepper.incumbent
    if incumbent.warm:
        return run_to_end(improve_incumbent, stepper)
    if not incumbent.problem.airspace.is_open:
        # So few flights are tried there that all may be worse than the baseline's.
        optimise_powers(incumbent)
    return run_to_end(improve_by_multistart, stepper)


def optimise_powers(incumbent: Incumbent) -> Status:
    """Improve only the powers of an Incumbent; return the status."""
    return run_to_end(improve_powers, Stepper(incumbent))
