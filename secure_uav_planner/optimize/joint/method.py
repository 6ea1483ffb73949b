"""
The joint method: positions and powers together.

Several starts are improved for problem (P2), `multistart.py`; where (P1) is the objective, the
best plans are then improved for it, `exchange.py`. Limits of energy are kept last, `energy.py`.
"""

import math

from .energy import find_within_energy, improve_warm, improve_within_energy
from .exchange import improve_by_exchange
from .interior_point import SolverDriver
from .multistart import improve_by_multistart, improve_incumbent, improve_powers
from ..deadline import run_to_end
from ..incumbent import Incumbent
from ...errors import InfeasibleMissionError
from ...mission import OBJECTIVES
from ...plan.plan import Status


def improve(incumbent: Incumbent) -> Status:
    """
    Improve an Incumbent by the joint method until it has converged or must stop.

    :param incumbent: an Incumbent. Its iterate is the only start if `warm` and within max_energy.
    :return: the status.
    """
    driver = SolverDriver(incumbent)
    if incumbent.scenario.limits_energy:
        return _improve_within_energy(driver)
    if incumbent.objective == 'guaranteed' or not incumbent.scenario.receivers.radii.any():
        return _improve_guaranteed(driver)
    if incumbent.warm:
        return run_to_end(improve_by_exchange, driver)
    guaranteed = SolverDriver(incumbent.with_objective('guaranteed'))
    _improve_guaranteed(guaranteed)
    return _improve_worst_case(driver, guaranteed)


def _improve_worst_case(driver: SolverDriver, guaranteed: SolverDriver) -> Status:
    """
    Improve the incumbent of a SolverDriver for (P1), and never leave it below the plan of (P2).

    :param guaranteed: the driver that has found the plan of (P2), from which this begins.
    """
    incumbent, plan = driver.incumbent, guaranteed.incumbent
    incumbent.try_improve(plan.positions, plan.useful_powers)
    status = run_to_end(improve_by_exchange, driver, guaranteed.optima)
    if not incumbent.deadline.poll():
        plan.try_idle_slots()
        incumbent.try_improve(plan.positions, plan.useful_powers)
    return status


def _improve_within_energy(driver: SolverDriver) -> Status:
    """
    Improve the incumbent of a SolverDriver whose scenario has limits of energy; see improve.

    A warm iterate within the limits is the only start. Otherwise plans without these limits are
    sought first, and are starts of improve_within_energy unless all of the plans keep the limits.
    The search for (P2) is the same for both objectives, so that the plan of (P1) is never below
    the plan of (P2).
    """
    incumbent = driver.incumbent
    if incumbent.warm and math.isfinite(incumbent.rate):
        return run_to_end(improve_warm, driver)
    if incumbent.deadline.may_end:  # So that there is a plan if time is short.
        run_to_end(find_within_energy, driver)
    guaranteed, worst_case = (SolverDriver(incumbent.without_energy_limits(objective))
                              for objective in OBJECTIVES)
    unlimited = [guaranteed.incumbent]
    status = _improve_guaranteed(guaranteed)
    if incumbent.scenario.receivers.radii.any() and not (
            incumbent.objective == 'guaranteed'
            and incumbent.problem.keeps_energy(guaranteed.incumbent.positions)):
        unlimited.append(worst_case.incumbent)
        status = _improve_worst_case(worst_case, guaranteed)
    for plan in unlimited:
        incumbent.try_improve(plan.positions, plan.useful_powers)
    if all(incumbent.problem.keeps_energy(plan.positions) for plan in unlimited):
        return status
    status = run_to_end(improve_within_energy, driver, unlimited, guaranteed.optima)
    if math.isinf(incumbent.rate):
        incumbent.raise_if_over()
        raise InfeasibleMissionError(
            'no flights were found that keep max_energy and all other limits', ('uavs',))
    return status


def _improve_guaranteed(driver: SolverDriver) -> Status:
    """Improve the incumbent of a SolverDriver for (P2), which equals (P1) if all radii are 0."""
    incumbent = driver.incumbent
    if incumbent.warm:
        return run_to_end(improve_incumbent, driver)
    if not incumbent.problem.airspace.is_open:
        # Around obstacles few flights are tried. All may be worse than the baseline's flights.
        optimise_powers(incumbent)
    return run_to_end(improve_by_multistart, driver)


def optimise_powers(incumbent: Incumbent) -> Status:
    """Improve only the powers of an Incumbent; return the status."""
    return run_to_end(improve_powers, incumbent)
