"""
The joint method: positions and powers together.

Several starts are improved side by side on a coarse grid, the best are kept in stages, and the
winner is refined to the full grid, where a few more Newton steps finish it.
"""

from collections.abc import Callable
from contextlib import suppress

import numpy as np

from .against_places import improve_against_places
from .competition import Competition, near_best
from .left_out import try_left_out
from .powers_alone import try_powers_alone
from .schedule import SCHEDULE, Schedule
from .starts import strictly_feasible
from .stepper import Stepper, Stop
from ..search import Search
from ...errors import NumericalError
from ...plan import Status


def improve(search: Search, schedule: Schedule = SCHEDULE) -> Status:
    """
    Improve a Search by the joint method until it has converged or must stop; return its status.

    Whatever happens, the search keeps the best feasible iterate.

    :param search: a Search; when `warm`, its present plan is the only start.
    """
    stepper = Stepper(search, schedule)
    if search.objective == 'worst_case' and search.scenario.error_radii.any():
        if not search.warm:
            # The plan of (P2) is where (P1) begins, and what it is never below.
            guaranteed = search.with_objective('guaranteed')
            plan = guaranteed.plan('joint', improve(guaranteed, schedule))
            search.try_improve(plan.positions, plan.powers)
            reason = search.stop_reason()
            if reason is not None:
                return reason
        return _until_stopped(improve_against_places, stepper)
    if search.warm:
        return _until_stopped(_improve_present, stepper)
    return _until_stopped(_improve_several, stepper)


def _until_stopped(improve: Callable[[Stepper], Status], stepper: Stepper) -> Status:
    """Return the status in which a part of the method ends."""
    try:
        return improve(stepper)
    except Stop as stop:
        return stop.status
    except (NumericalError, np.linalg.LinAlgError):
        return 'numerical_trouble'


def _improve_several(stepper: Stepper) -> Status:
    """
    Find the best of several starts on a coarse grid and finish it, and a close rival.

    Where starts end in different places, and jammers and eavesdroppers can be matched in several
    ways, those that were left out have a second chance.
    """
    schedule, search = stepper.schedule, stepper.search
    competition = Competition(stepper)
    coarse = competition.best
    rates = coarse.rates()
    rivals = near_best(rates, schedule.rival_gap, schedule.rivals, schedule)
    statuses = [
        stepper.finish(stepper.on_full_grid(coarse.grid, coarse.x[[rival]], coarse.mu[rival]))
        for rival in rivals]
    try_powers_alone(stepper, coarse.grid, rates[0])
    agreed = len(rates) == 1
    if not agreed or search.rate < schedule.low_rate:
        _improve_again(stepper)
    scenario = search.scenario
    if not agreed and (len(scenario.uavs) > 2 or len(scenario.eavesdroppers) > 1):
        try_left_out(stepper, competition, rates[rivals])
    return 'converged' if 'converged' in statuses else statuses[0]


def _improve_again(stepper: Stepper) -> None:
    """Improve the best plan from further inside, where steps lead past the nearest optimum."""
    with suppress(NumericalError, np.linalg.LinAlgError):
        for share in stepper.schedule.again_mus:
            if stepper.search.rate > 0:
                _improve_present(stepper, share * np.log(2) * stepper.search.rate)


def _improve_present(stepper: Stepper, mu: float | None = None) -> Status:
    """
    Improve the present plan.

    :param mu: the barrier parameter to begin with, by default that of an earlier plan.
    """
    schedule, search, grid = stepper.schedule, stepper.search, stepper.grid
    x = strictly_feasible(grid, search.positions, search.powers, share=schedule.warm_share)
    return stepper.finish(
        stepper.barrier(grid, x[None], schedule.warm_mu if mu is None else mu))
