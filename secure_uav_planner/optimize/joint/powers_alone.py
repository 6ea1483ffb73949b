"""Powers alone, on the flights of fly-hover-fly."""

import numpy as np

from .barrier import Barrier
from .competition import distinct
from .starts import strictly_feasible
from .stepper import Stepper
from ..baselines import constant_powers, fly_hover_fly_positions
from ..search import powers_without_jamming, Search
from ...grid import Grid
from ...scenario import Array


def try_powers_alone(stepper: Stepper, coarse: Grid, joint_rate: float) -> None:
    """
    Try fly-hover-fly with optimised powers where that may be better than what was found.

    When the duration leaves almost no slack, the trajectory cannot change; with few slots,
    the power schedule decides. In both cases optimising the powers alone can win.

    :param joint_rate: of the best start on the coarse grid, in nats.
    """
    schedule, search = stepper.schedule, stepper.search
    flight = fly_hover_fly_positions(search.scenario)
    alone = powers_without_jamming(search.scenario, flight)
    others = [] if alone is None else [alone]
    probe = _on_flight(
        stepper, coarse, flight, schedule.powers_jamming, schedule.powers_mu, *others)
    stepper.advance(probe, schedule.powers_probe_steps, schedule.coarse_mu)
    at_once = Search(search.scenario, flight, constant_powers(search.scenario))
    at_once.try_less_jamming()
    if (coarse.slots > schedule.powers_few_slots and search.rate > schedule.low_rate
            and probe.rates().max() < schedule.powers_near * joint_rate
            and at_once.rate < schedule.powers_near_at_once * search.rate):
        return
    if search.try_improve(flight, at_once.powers):
        search.report('power')
    others = [at_once.powers, *others]
    _finish(stepper, _on_flight(
        stepper, stepper.grid, flight, schedule.powers_jamming, schedule.powers_mu, *others))
    # A barrier that weighs much beside the rate leads away from jammers that are all but off.
    low_mu = min(schedule.powers_low_mu, schedule.powers_low_share * np.log(2) * search.rate)
    if low_mu > 0:
        _finish(stepper, _on_flight(
            stepper, stepper.grid, flight, schedule.powers_low_jamming, low_mu, *others))


def _on_flight(stepper: Stepper, grid: Grid, flight: Array, jamming: tuple[float, ...], mu: float,
               *more: Array) -> Barrier:
    """
    Return a Barrier whose positions are fixed on a flight.

    :param jamming: shares of their average power with which the jammers begin.
    :param mu: barrier parameter to begin with.
    :param more: further powers to begin with, (U, N) in W.
    """
    fixed = grid.with_fixed_positions()
    powers = [constant_powers(grid.scenario, 0.9, share) for share in jamming]
    x = strictly_feasible(fixed, flight, np.array([*powers, *more]), share=0.0, least=1e-6)
    x[..., 0] *= 0.99
    return stepper.barrier(fixed, x, mu)


def _finish(stepper: Stepper, barrier: Barrier) -> None:
    """Converge powers on a flight, with many slots those of the best starts only."""
    schedule = stepper.schedule
    if barrier.grid.slots > schedule.powers_few_slots:
        stepper.advance(barrier, schedule.powers_steps, schedule.coarse_mu)
        barrier.keep(distinct(barrier.rates(), schedule)[:schedule.rivals])
    stepper.finish(barrier)
