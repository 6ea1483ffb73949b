"""
Problem (P1), in which the worst place of every disc counts, by the exchange method.

Discs have infinitely many places (semi-infinite programming): a few of them stand for each, and
are exchanged for worse ones between the Newton steps.
"""

import numpy as np

from .barrier import Barrier
from .starts import strictly_feasible
from .stepper import MOST_STEPS, Stepper, Stop, TRY_EVERY, WARM_MU, WARM_SHARE
from .worst_places import WorstPlaces
from ...plan.plan import Status

WORSE = 1e-7  # The leak, in nats, by which a place must be worse to count.
PLACES_MU = 0.02  # The barrier parameter at the beginning
PLACES_FINAL_MU = 1e-7  # and at the end,
PATIENCE = 8  # and the most steps at the end.
WORTH = 0.01  # The gain that is worth a second round,
MORE_STEPS = 40  # and its most steps.


def improve_by_exchange(stepper: Stepper) -> Status:
    """Improve the present plan against the worst places of the discs, problem (P1)."""
    search = stepper.search
    before = search.rate
    status, at_rest = _improve_once(stepper, MOST_STEPS)
    # Where places still moved to and fro, and much could be gained, there may be more.
    if not (at_rest or search.warm or search.rate < (1 + WORTH) * before):
        _improve_once(stepper, MORE_STEPS)
    return status


def _improve_once(stepper: Stepper, steps: int) -> tuple[Status, bool]:
    """Improve the present plan once; return also whether places came to rest."""
    search, grid = stepper.search, stepper.grid
    x = strictly_feasible(grid, search.positions, search.powers, share=WARM_SHARE,
                          check=stepper.check)
    places = WorstPlaces(grid, x)
    barrier = Barrier(
        grid, x[None], WARM_MU if search.warm else PLACES_MU,
        stepper.check, places)
    # Only what seems better than the present plan is worth a proof of its worst case.
    best, rate, tried = x, places.rate, search.rate * np.log(2)
    last_steps = 0
    for step in range(1, steps + 1):
        try:
            stepper.step(barrier, PLACES_FINAL_MU)
        except Stop:
            stepper.try_variables(best)
            raise
        last_steps += int(barrier.mu[0] <= PLACES_FINAL_MU)
        barrier.exchange(places, places.exchange(barrier.x[0], WORSE))
        if places.rate > rate:
            best, rate = barrier.x[0].copy(), places.rate
        at_rest = bool(barrier.finished.all())
        # Places may go on moving to and fro, by ever less.
        done = at_rest or last_steps >= PATIENCE
        if rate > tried and (done or step == steps or step % TRY_EVERY == 0):
            stepper.try_variables(best)
            tried = rate
        if done:
            search.report('joint')
            return 'converged', at_rest
    return 'iteration_limit', False
