"""A second chance for starts that were left out of the competition."""

from collections.abc import Callable
from contextlib import suppress

import numpy as np

from .barrier import Barrier
from .competition import Competition, near_best
from .starts import strictly_feasible
from .stepper import Stepper
from ...errors import NumericalError
from ...grid import Grid
from ...scenario import Array


def try_left_out(stepper: Stepper, competition: Competition, known: Array) -> None:
    """
    Go on with the starts that were left out, and finish those that end in new places.

    :param known: the rates, on the coarse grid, of the starts that have been finished.
    """
    schedule, best, coarse = stepper.schedule, competition.best, competition.best.grid
    x, mu = competition.left_out()
    if not len(x):
        return
    with suppress(NumericalError, np.linalg.LinAlgError):
        others = stepper.barrier(coarse, x, mu)
        stepper.advance(others, schedule.left_out_steps, schedule.coarse_mu)
        x = np.concatenate([best.x, others.x])
        rates = np.concatenate([best.rates(), others.rates()])
        near = near_best(rates, schedule.left_out_gap, schedule.left_out_starts, schedule)
        x, rates = _improved(
            stepper, coarse, x[near], rates[near],
            lambda again: stepper.advance(again, schedule.last_steps, schedule.coarse_mu))
        near = near_best(rates, schedule.left_out_gap, len(rates), schedule)
        new = (abs(rates[near, None] - known) > schedule.distinct * known).all(axis=1)
        chosen = near[new][:schedule.rivals]
        if len(chosen):
            fine = stepper.on_full_grid(coarse, x[chosen], schedule.coarse_mu)
            stepper.finish(fine)
            _improved(stepper, fine.grid, fine.x, fine.rates(), stepper.finish)


def _improved(stepper: Stepper, grid: Grid, x: Array, rates: Array,
              improve: Callable[[Barrier], object]) -> tuple[Array, Array]:
    """
    Improve starts from further inside, where steps lead past the nearest optimum.

    :param x: (S, N, U, 3).
    :param rates: of x, in nats, (S,).
    :param improve: improves the starts of a Barrier.
    :return: the better x, and their rates.
    """
    schedule = stepper.schedule
    for share in schedule.again_mus:
        inside = [strictly_feasible(grid, grid.positions(one), grid.powers(one),
                                    share=schedule.warm_share) for one in x]
        barrier = stepper.barrier(
            grid, np.array(inside), np.maximum(share * rates, schedule.final_mu))
        improve(barrier)
        found = barrier.rates()
        x = np.where((found > rates)[:, None, None, None], barrier.x, x)
        rates = np.maximum(found, rates)
    return x, rates
