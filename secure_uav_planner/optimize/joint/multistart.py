"""
Multistart: Newton steps from random starts on a coarse grid, of which the best are finished.

Start, step, polish, finish: the best starts are polished from further inside, where steps lead
past the nearest optimum, on the coarse grid; the best few are finished on the full grid, and the
best plan is polished there. Where the first starts end in one optimum far above fly-hover-fly, no
other is begun; where not, fly-hover-fly with the best powers is tried as well.
"""

from collections.abc import Iterator
from contextlib import suppress
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from .powers import improve_powers
from .starts import several_starts, strictly_feasible
from .stepper import COARSE_MU, COARSE_SLOTS, FINAL_MU, Stepper, WARM_MU, WARM_SHARE
from ..search import Search
from ...errors import NumericalError
from ...mission.scenario import Array
from ...model.grid import Grid
from ...plan.plan import Status

STEPS = 37  # Newton steps from each start on the coarse grid.
DISTINCT = 2e-4  # Relative difference in rate between distinct optima.
AGREED = 0.7  # Share of the first starts that ends the search where it finds the best optimum.
GAP = 0.1  # Starts whose rates are lower than the best by a larger share are pruned.
POLISHED = 12  # The most starts that are polished,
POLISH_STEPS = 15  # each by so many Newton steps on the coarse grid
POLISH_MUS = (0.05, 0.01)  # from each of these barrier parameters, in shares of its rate.
CLOSE = 0.02  # Share, or bit/s/Hz, below the best up to which fly-hover-fly is finished, too.
FINISHED = 2  # The most starts that are finished on the full grid.

_FAILURES = NumericalError, np.linalg.LinAlgError  # Of a part, without which the others go on.
_Starts: TypeAlias = tuple[Array, Array]


def improve_from_several_starts(stepper: Stepper) -> Status:
    """
    Improve the search of a Stepper from several starts; return the status of the best.

    :raises NumericalError: when there are no starts, or no step can be computed from any.
    """
    search = stepper.search
    baseline = search.with_objective('guaranteed')
    baseline.try_less_jamming()
    grid, first, others = _coarse_starts(stepper)
    x, rates = _stepped(stepper, grid, *first, STEPS)
    agreed = ((rates > (1 - DISTINCT) * rates.max()).mean() >= AGREED
              and (1 - GAP) * rates.max() > np.log(2) * (baseline.rate + CLOSE))
    if not agreed:
        with suppress(*_FAILURES):
            further, their_rates = _stepped(stepper, grid, *next(others), STEPS)
            x, rates = np.concatenate([x, further]), np.append(rates, their_rates)
        near = _best(rates, GAP, POLISHED)
        x, rates = _polished(stepper, grid, x[near], rates[near])
    near = _best(rates, GAP, 1 if agreed else FINISHED)
    fine = stepper.on_full_grid(grid, x[near], COARSE_MU)
    status = stepper.finish(fine)
    if not agreed:
        _try_powers_of(baseline, search)
        with suppress(*_FAILURES):
            for share in POLISH_MUS:
                if search.rate > 0:
                    improve_present(stepper, share * np.log(2) * search.rate)
    return 'converged' if fine.finished.any() else status


def improve_present(stepper: Stepper, mu: float = WARM_MU) -> Status:
    """Improve the present plan, with a barrier parameter to begin with; return the status."""
    search, grid = stepper.search, stepper.grid
    x = strictly_feasible(grid, search.positions, search.powers, WARM_SHARE, stepper.check)
    return stepper.finish(stepper.barrier(grid, x[None], mu))


def _coarse_starts(stepper: Stepper) -> tuple[Grid, _Starts, Iterator[_Starts]]:
    """Return the coarsest grid with room for most starts, the first of them, and the others."""
    slots = COARSE_SLOTS
    while True:
        grid = stepper.grid.divided(min(stepper.grid.slots, slots))
        batches = several_starts(grid, stepper.check)
        try:
            return grid, next(batches), batches
        except NumericalError:
            if slots >= stepper.grid.slots:
                raise
        slots *= 2


def _stepped(stepper: Stepper, grid: Grid, x: Array, mu: Array,
             steps: int) -> tuple[Array, Array]:
    """Return starts (S, N, U, 3) after Newton steps, and their rates in nats, (S,)."""
    barrier = stepper.barrier(grid, x, mu)
    stepper.advance(barrier, steps, min(mu.min(), COARSE_MU))
    stepper.try_best(barrier)
    return barrier.x, barrier.rates()


def _polished(stepper: Stepper, grid: Grid, x: Array, rates: Array) -> tuple[Array, Array]:
    """Return starts (S, N, U, 3) and their rates, (S,), where higher after a polish."""
    with suppress(*_FAILURES):
        for share in POLISH_MUS:
            mu = np.maximum(share * rates, FINAL_MU)
            found, their_rates = _stepped(stepper, grid, x, mu, POLISH_STEPS)
            x = np.where((their_rates > rates)[:, None, None, None], found, x)
            rates = np.maximum(their_rates, rates)
    return x, rates


def _try_powers_of(baseline: Search, search: Search) -> None:
    """Try the first flights with the best powers, where these come near the present rate."""
    with suppress(*_FAILURES):
        improve_powers(Stepper(baseline), np.log(2) * ((1 - CLOSE) * search.rate - CLOSE))
        baseline.settle_idle_slots()
    search.try_improve(baseline.positions, baseline.powers)


def _best(rates: Array, gap: float, most: int) -> NDArray[np.intp]:
    """Return one start of each distinct rate, best first, as far as within a gap of the best."""
    order = np.argsort(-rates)
    best = rates[order[0]]
    new = np.append(True, -np.diff(rates[order]) > DISTINCT * best)
    return order[new & (rates[order] >= (1 - gap) * best)][:most]
