"""
Multistart: Newton steps from random starts on a coarse grid; the best starts are finished.

Many starts are ranked after a few steps, and only the best take further ones. The best are
polished on the coarse grid from further inside: steps from there lead past the nearest optimum.
With several ground nodes, or many UAVs, the best also hop: one UAV and the jamming change for a
while. A few starts are finished on the full grid, and the best plan is polished there. If the
first starts end in one optimum far above fly-hover-fly, the rest are not begun. Otherwise
fly-hover-fly with the best powers is tried, too.

Power control on a fixed trajectory starts from several levels of jamming, in which its local
optima differ.
"""

from collections.abc import Iterator
from contextlib import suppress
from dataclasses import replace
import math
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from .interior_point import Optima, SolverDriver
from .settings import DESCENT, Hops, MULTISTART, Search
from .starts import generate_hops, generate_starts, limit_powers, make_strictly_feasible
from ..incumbent import Incumbent
from ...errors import NumericalError
from ...mission.scenario import Array
from ...model.grid import Grid
from ...plan.plan import Status

_FAILURES = NumericalError, np.linalg.LinAlgError  # Errors that end a part of the search only.
_Starts: TypeAlias = tuple[Array, Array]


def improve_by_multistart(driver: SolverDriver) -> Status:
    """
    Improve the incumbent of a SolverDriver from several starts, and return the status.

    Starts take Newton steps, polish and hop on a coarse grid. The best are finished on the full
    grid, and the status is 'converged' if any start converges there. A rate r [bit/s/Hz] of an
    incumbent is r * log(2) * grid.weight / grid.rate in the units of solvers.

    :raises NumericalError: when there are no starts, or no step can be computed from any.
    """
    incumbent = driver.incumbent
    baseline = incumbent.with_objective('guaranteed')
    baseline.try_less_jamming()
    counts_sights = incumbent.scenario.channel.counts_sights
    offsets = (*MULTISTART.elevation_offsets, 0.0) if counts_sights else (0.0,)  # [degrees]
    early = SolverDriver(incumbent, elevation_offset=offsets[0])  # On the coarse grid.
    is_single = len(incumbent.scenario.ground_nodes) == 1
    search = (MULTISTART.several_nodes if not is_single
              else MULTISTART.many_uavs if len(incumbent.scenario.uavs) >= MULTISTART.many
              else MULTISTART.single_node)
    grid, first, batches = _generate_coarse_starts(driver, search)
    x, rates = _advance_starts(early, grid, *first, ((1.0, MULTISTART.steps),), search.lowered)
    # If most of the first starts end in the best optimum, and this is far above the baseline, the
    # rest are not begun. Rates at an elevation offset do not compare with the baseline's.
    in_best = (rates > (1 - MULTISTART.distinct) * rates.max()).mean()
    agreed = in_best >= MULTISTART.agreed and (
        counts_sights or (1 - MULTISTART.gap) * rates.max() > np.log(2) * (
            baseline.rate * grid.weight / grid.rate + MULTISTART.close))
    if not agreed:
        with suppress(*_FAILURES):
            for more_x, mu in batches:
                more_x, more_rates = _advance_starts(
                    early, grid, more_x, mu, search.ranking, search.lowered)
                x, rates = np.concatenate([x, more_x]), np.append(rates, more_rates)
        chosen = select_best(rates, search.gap, MULTISTART.polished)
        x, rates = _polish(early, grid, x[chosen], rates[chosen], search)
        x, rates = _hop(early, grid, x, rates, search, search.hops)
        driver.optima = Optima(grid, x[select_best(rates, MULTISTART.gap, MULTISTART.polished)])
    # The best are finished on the full grid, while elevation offsets fall to 0.
    best = select_best(rates, MULTISTART.gap, 1 if agreed else search.finished)
    if is_single:
        fine = early.refine_to_full_grid(grid, x[best], DESCENT.coarse_mu)
    else:
        fine = early.refine_to_full_grid(
            grid, x[best], np.minimum(MULTISTART.nodes_mu * rates[best], DESCENT.coarse_mu),
            scale=min(rates.max(), 1.0))
    for offset in offsets[1:]:
        driver.descend(fine, MULTISTART.offset_mu, MULTISTART.offset_steps)
        fine = SolverDriver(incumbent, elevation_offset=offset).build_solver(
            fine.grid, fine.x, np.maximum(fine.mu, DESCENT.coarse_mu))
    status = driver.finish(fine)
    if not agreed:
        if search.full_hops.rounds and driver.grid.slots <= MULTISTART.hop_slots:
            _hop(driver, fine.grid, fine.x, fine.rates(), search, search.full_hops)
        _try_baseline(baseline, incumbent)
        with suppress(*_FAILURES):
            for share in search.polish_mus:
                if incumbent.rate > 0:
                    mu = share * np.log(2) * incumbent.rate * grid.weight / grid.rate
                    improve_incumbent(driver, mu)
    return 'converged' if fine.finished.any() else status


def improve_incumbent(driver: SolverDriver, mu: float = DESCENT.warm_mu) -> Status:
    """Improve the incumbent from its own iterate, with the first barrier parameter mu."""
    incumbent, grid = driver.incumbent, driver.grid
    x = make_strictly_feasible(grid, incumbent.positions, incumbent.powers, DESCENT.warm_share,
                               driver.raise_if_over)
    return driver.finish(driver.build_solver(grid, x[None], mu))


def improve_powers(incumbent: Incumbent, least: float = 0.0) -> Status:
    """
    Improve only the powers of an Incumbent; return the status of the steps on the full grid.

    The flights are fixed. One start has the incumbent's powers. Each other start has the powers
    of limit_powers, with the jammers' powers scaled by one of MULTISTART.levels.

    :param least: rate in the units of solvers. If no start reaches it on a coarse grid, the
        search ends there as 'converged'.
    :raises NumericalError: when no step can be computed from any start.
    """
    incumbent.try_less_jamming()
    driver = SolverDriver(incumbent, replace(incumbent.problem.grid, is_fixed=True))
    grid = driver.grid.with_slots(min(driver.grid.slots, DESCENT.coarse_slots))
    levels = np.repeat(
        [limit_powers(incumbent.scenario)] * len(MULTISTART.levels), driver.grid.slots, -1)
    levels[:, 1:] *= np.reshape(MULTISTART.levels, (-1, 1, 1))
    solver = driver.build_solver(grid, np.array([
        make_strictly_feasible(grid, incumbent.positions, powers, MULTISTART.level_share)
        for powers in (incumbent.powers, *levels)]), MULTISTART.level_mu)
    driver.advance(solver, MULTISTART.level_steps, DESCENT.coarse_mu)
    if grid.slots < driver.grid.slots and solver.rates().max() < least:
        return 'converged'
    return driver.finish(driver.refine_to_full_grid(grid, solver.x, solver.mu))


def _generate_coarse_starts(driver: SolverDriver, search: Search
                            ) -> tuple[Grid, _Starts, Iterator[_Starts]]:
    """Return the coarsest grid tried that has enough flights, and its first and other batches."""
    is_whole = driver.grid.slots <= search.whole_slots
    slots = driver.grid.slots if is_whole else DESCENT.coarse_slots
    while True:
        grid = driver.grid.with_slots(min(driver.grid.slots, slots))
        batches = generate_starts(grid, driver.incumbent.problem, driver.incumbent.positions,
                                  driver.raise_if_over)
        try:
            return grid, next(batches), batches
        except NumericalError:
            if slots >= driver.grid.slots:
                raise
        slots *= 2


def _advance_starts(driver: SolverDriver, grid: Grid, x: Array, mu: Array,
                    ranking: tuple[tuple[float, int], ...], lowered: float
                    ) -> tuple[Array, Array]:
    """
    Return the S' starts (S', N, U, 3) that took all Newton steps, and their rates (S',).

    The best of these starts is proposed to the driver's incumbent.

    :param x: variables of the starts, (S, N, U, 3).
    :param mu: first barrier parameters, (S,).
    :param ranking: pairs (p, n), in turn: the present best ceil(p S) starts take n further steps.
    :param lowered: the last barrier parameter is lowered * min(mu), at most DESCENT.coarse_mu.
    """
    final = min(lowered * mu.min(), DESCENT.coarse_mu)
    solver = driver.build_solver(grid, x, mu)
    for share, steps in ranking:
        if share < 1:
            best = np.argsort(-solver.rates(), kind='stable')[:math.ceil(share * len(x))]
            solver = driver.build_solver(grid, solver.x[best], solver.mu[best])
        driver.advance(solver, steps, final)
    driver.try_best(solver)
    return solver.x, solver.rates()


def _polish(driver: SolverDriver, grid: Grid, x: Array, rates: Array,
            search: Search) -> tuple[Array, Array]:
    """
    Return starts (S, N, U, 3) and their rates (S,), each polished where this raises its rate.

    A polish is Newton steps from the barrier parameter share * rate, at least DESCENT.final_mu.
    Each share in search.polish_mus has one, in turn. An error of _FAILURES ends them.
    """
    with suppress(*_FAILURES):
        for share in search.polish_mus:
            mu = np.maximum(share * rates, DESCENT.final_mu)
            new_x, new_rates = _advance_starts(
                driver, grid, x, mu, ((1.0, search.polish_steps),), search.lowered)
            x = np.where((new_rates > rates)[:, None, None, None], new_x, x)
            rates = np.maximum(new_rates, rates)
    return x, rates


def _hop(driver: SolverDriver, grid: Grid, x: Array, rates: Array,
         search: Search, hops: Hops) -> tuple[Array, Array]:
    """
    Return the starts x (S, N, U, 3) and `rates` (S,) after hops, which change both in place.

    A hop changes a start by generate_hops, takes hops.steps Newton steps, and replaces the start
    if its rate is higher. Each of hops.rounds rounds, or fewer, hops MULTISTART.hops_at_once times
    from the hops.starts best distinct starts in turn, one start fewer after rounds of little gain.
    """
    rng, most_starts = np.random.default_rng(6), hops.starts
    with suppress(*_FAILURES):
        for _ in range(hops.rounds):
            best = rates.max()
            chosen = select_best(rates, search.gap, most_starts)
            chosen = np.resize(chosen, MULTISTART.hops_at_once)
            hopped, tried, mu = generate_hops(
                grid, x[chosen], rates[chosen], rng, driver.raise_if_over)
            new_x, new_rates = _advance_starts(
                driver, grid, tried, mu, ((1.0, hops.steps),), search.lowered)
            for start, new, rate in zip(chosen[hopped], new_x, new_rates):
                if rate > rates[start]:
                    x[start], rates[start] = new, rate
            if rates.max() < (1 + MULTISTART.distinct) * best:
                most_starts -= 1
            if not most_starts:
                break
    return x, rates


def _try_baseline(baseline: Incumbent, incumbent: Incumbent) -> None:
    """Improve the baseline's powers, and let the incumbent try the baseline."""
    with suppress(*_FAILURES):
        grid = incumbent.problem.grid
        # Powers are finished if their rate on a coarse grid is below the incumbent's by at most a
        # share of the rate plus an absolute term, both MULTISTART.close.
        improve_powers(baseline, np.log(2) * (
            (1 - MULTISTART.close) * incumbent.rate * grid.weight / grid.rate
            - MULTISTART.close))
        baseline.try_idle_slots()
    incumbent.try_improve(baseline.positions, baseline.powers)


def select_best(rates: Array, gap: float, most: int) -> NDArray[np.intp]:
    """Return the indices of up to `most` distinct rates >= (1 - gap) * best, the best first."""
    order = np.argsort(-rates)
    best = rates[order[0]]
    new = np.append(True, -np.diff(rates[order]) > MULTISTART.distinct * best)
    return order[new & (rates[order] >= (1 - gap) * best)][:most]
