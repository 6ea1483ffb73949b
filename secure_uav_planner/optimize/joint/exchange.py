"""
Problem (P1), in which the worst place of every disc counts, by the exchange method.

Discs have infinitely many places (semi-infinite programming): a few of them stand for each, and
are exchanged for worse ones between the Newton steps.
"""

import numpy as np

from .barrier import Barrier
from .starts import strictly_feasible
from .stepper import Stepper, Stop
from .worst_places import WorstPlaces
from ...plan.plan import Status


def improve_by_exchange(stepper: Stepper) -> Status:
    """Improve the present plan against the worst places of the discs, problem (P1)."""
    schedule, search = stepper.schedule, stepper.search
    before = search.rate
    status, at_rest = _improve_once(stepper, schedule.steps)
    # Where places still moved to and fro, and much could be gained, there may be more.
    if not (at_rest or search.warm or search.rate < (1 + schedule.places_worth) * before):
        _improve_once(stepper, schedule.places_steps)
    return status


def _improve_once(stepper: Stepper, steps: int) -> tuple[Status, bool]:
    """Improve the present plan once; return also whether places came to rest."""
    schedule, search = stepper.schedule, stepper.search
    grid = stepper.grid
    x = strictly_feasible(grid, search.positions, search.powers, share=schedule.warm_share,
                          check=stepper.check)
    places = WorstPlaces(grid, x)
    barrier = Barrier(
        grid, x[None], schedule.warm_mu if search.warm else schedule.places_mu, schedule,
        stepper.check, places)
    # Only what seems better than the present plan is worth a proof of its worst case.
    best, rate, tried = x, places.rate, search.rate * np.log(2)
    last_steps = 0
    for step in range(1, steps + 1):
        try:
            stepper.step(barrier, schedule.places_final_mu)
        except Stop:
            stepper.try_variables(best)
            raise
        last_steps += int(barrier.mu[0] <= schedule.places_final_mu)
        barrier.exchange(places, places.exchange(barrier.x[0], schedule.worse))
        if places.rate > rate:
            best, rate = barrier.x[0].copy(), places.rate
        at_rest = bool(barrier.finished.all())
        # Places may go on moving to and fro, by ever less.
        done = at_rest or last_steps >= schedule.places_patience
        if rate > tried and (done or step == steps or step % schedule.try_every == 0):
            stepper.try_variables(best)
            tried = rate
        if done:
            search.report('joint')
            return 'converged', at_rest
    return 'iteration_limit', False
