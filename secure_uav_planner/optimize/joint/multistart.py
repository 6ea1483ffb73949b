"""
Multistart: Newton steps from random starts on a coarse grid; the best starts are finished.

Many starts are ranked after a few steps, and only the best take further ones. The best are
polished on the coarse grid from further inside: steps from there lead past the nearest optimum.
A few starts are finished on the full grid, and the best plan is polished there.
Where the first starts end in one optimum far above fly-hover-fly, the rest are not begun.
Otherwise fly-hover-fly with the best powers is tried, too.

Power control on a fixed trajectory starts from several levels of jamming, in which its local
optima differ.
"""

from collections.abc import Iterator
from contextlib import suppress
from dataclasses import replace
import math
from typing import NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from .interior_point import (
    COARSE_MU, COARSE_SLOTS, FINAL_MU, InteriorPointSolver, Optima, SolverDriver, WARM_MU,
    WARM_SHARE)
from .starts import generate_hops, generate_starts, limit_powers, make_strictly_feasible
from ..incumbent import Incumbent
from ...errors import NumericalError
from ...mission.scenario import Array
from ...model.grid import Grid
from ...plan.plan import Status

STEPS = 37  # Newton steps from each of the first starts on the coarse grid.
DISTINCT = 2e-4  # Relative difference in rate between distinct optima.
AGREED = 0.7  # Share of the first starts in the best optimum that ends the multistart.
GAP = 0.1  # Relative distance below the best rate within which starts are finished.
POLISH_MUS = (0.05, 0.01)  # Barrier parameters that polishes begin with, in shares of the rate.
MOST_UAVS = 3  # The most UAVs with which starts of a single node are not ranked.
CLOSE = 0.02  # Share, or units of rates, below the best up to which fly-hover-fly is finished.
LOWERED = 0.3  # Ratio of the last barrier parameter and the least first one; several nodes only.
HOPS = (8, 4)  # Starts that are kept for each round of hops.
HOPS_AT_ONCE = 8  # Hops in a round.
NODES_MU = 0.003  # First barrier parameter on the full grid with several nodes, in rates.


class Search(NamedTuple):
    """
    How starts are searched on the coarse grid.

    :param ranking: pairs of a share of the starts, the best, and a number of Newton steps that
        they take; each pair follows on the one before.
    :param gap: relative distance below the best rate within which starts are polished.
    :param polished: the most starts that are polished.
    :param polish_steps: Newton steps of each polish, and of each hop.
    :param finished: the most starts that are finished on the full grid.
    """

    ranking: tuple[tuple[float, int], ...]
    gap: float
    polished: int
    polish_steps: int
    finished: int


FEW_UAVS = Search(((1.0, STEPS),), GAP, polished=12, polish_steps=15, finished=2)
MANY_UAVS = Search(((1.0, 16), (0.4, 21)), GAP, polished=12, polish_steps=15, finished=2)
SEVERAL_NODES = Search(
    ((1.0, 12), (0.4, 10), (0.2, 12)), gap=0.5, polished=12, polish_steps=25, finished=3)

_LEVELS = (1.0, 0.1, 0.01, 0.001)  # Jamming levels of power control, in shares of limit_powers.
_LEVEL_STEPS = 20  # Newton steps from each level on the coarse grid.
_LEVEL_MU = 0.03  # Barrier parameter to begin with at each level.
_LEVEL_SHARE = 0.01  # Share by which powers are moved into the interior at each level.

_ELEVATION_OFFSETS = (8.0, 4.0, 2.0)  # Elevations added to links early in the search [degrees].
_OFFSET_STEPS = 25  # The most Newton steps with each elevation offset on the full grid.
_OFFSET_MU = 1e-4  # Barrier parameter that ends the steps with an elevation offset.

_FAILURES = NumericalError, np.linalg.LinAlgError  # Errors that end a part of the search only.
_Starts: TypeAlias = tuple[Array, Array]


def improve_by_multistart(driver: SolverDriver) -> Status:
    """
    Improve the incumbent of a SolverDriver from several starts; return the status of the best.

    :raises NumericalError: when there are no starts, or no step can be computed from any.
    """
    incumbent = driver.incumbent
    baseline = incumbent.with_objective('guaranteed')
    baseline.try_less_jamming()
    counts_sights = incumbent.scenario.channel.counts_sights
    driver.elevation_offset = _ELEVATION_OFFSETS[0] if counts_sights else 0.0
    grid, first, batches = _generate_coarse_starts(driver)
    is_single = len(incumbent.scenario.ground_nodes) == 1
    is_small = len(incumbent.scenario.uavs) <= MOST_UAVS
    search = SEVERAL_NODES if not is_single else FEW_UAVS if is_small else MANY_UAVS
    x, rates = _advance(driver, grid, *first, ((1.0, STEPS),))
    agreed = ((rates > (1 - DISTINCT) * rates.max()).mean() >= AGREED
              and (counts_sights
                   or (1 - GAP) * rates.max() > np.log(2) * (baseline.rate / grid.rate + CLOSE)))
    if not agreed:
        with suppress(*_FAILURES):
            for more_x, mu in batches:
                more_x, more_rates = _advance(driver, grid, more_x, mu, search.ranking)
                x, rates = np.concatenate([x, more_x]), np.append(rates, more_rates)
        near = select_best(rates, search.gap, search.polished)
        x, rates = _polish(driver, grid, x[near], rates[near], search)
        if not is_single:
            x, rates = _hop(driver, grid, x, rates, search)
        driver.optima = Optima(grid, x[select_best(rates, GAP, search.polished)])
    near = select_best(rates, GAP, 1 if agreed else search.finished)
    if is_single:
        fine = driver.refine_to_full_grid(grid, x[near], COARSE_MU)
    else:
        fine = driver.refine_to_full_grid(
            grid, x[near], np.minimum(NODES_MU * rates[near], COARSE_MU),
            scale=min(rates.max(), 1.0))
    fine = _reduce_elevation_offset(driver, fine)
    status = driver.finish(fine)
    if not agreed:
        _try_baseline(baseline, incumbent)
        with suppress(*_FAILURES):
            for share in POLISH_MUS:
                if incumbent.rate > 0:
                    improve_incumbent(
                        driver, share * np.log(2) * incumbent.rate / grid.rate)
    return 'converged' if fine.finished.any() else status


def _reduce_elevation_offset(driver: SolverDriver,
                             solver: InteriorPointSolver) -> InteriorPointSolver:
    """Return a solver without elevation offset, after steps with smaller and smaller offsets."""
    for offset in (*_ELEVATION_OFFSETS[1:], 0.0) if driver.elevation_offset else ():
        driver.descend(solver, _OFFSET_MU, _OFFSET_STEPS)
        driver.elevation_offset = offset
        solver = driver.build_solver(solver.grid, solver.x, np.maximum(solver.mu, COARSE_MU))
    return solver


def improve_incumbent(driver: SolverDriver, mu: float = WARM_MU) -> Status:
    """Improve the incumbent as it is, from a barrier parameter on; return the status."""
    incumbent, grid = driver.incumbent, driver.grid
    x = make_strictly_feasible(grid, incumbent.positions, incumbent.powers, WARM_SHARE,
                               driver.raise_if_over)
    return driver.finish(driver.build_solver(grid, x[None], mu))


def improve_powers(driver: SolverDriver, least: float = 0.0) -> Status:
    """
    Improve only the powers of a SolverDriver's incumbent; return the status of the best level.

    :param least: a mean rate in units; if no level reaches it on a coarse grid, none is finished.
    :raises NumericalError: when no step can be computed from any level.
    """
    incumbent = driver.incumbent
    incumbent.try_less_jamming()
    driver.grid = replace(driver.grid, is_fixed=True)
    grid = driver.grid.with_slots(min(driver.grid.slots, COARSE_SLOTS))
    levels = np.repeat([limit_powers(incumbent.scenario)] * len(_LEVELS), driver.grid.slots, -1)
    levels[:, 1:] *= np.reshape(_LEVELS, (-1, 1, 1))
    solver = driver.build_solver(grid, np.array([
        make_strictly_feasible(grid, incumbent.positions, powers, _LEVEL_SHARE)
        for powers in (incumbent.powers, *levels)]), _LEVEL_MU)
    driver.advance(solver, _LEVEL_STEPS, COARSE_MU)
    if grid.slots < driver.grid.slots and solver.rates().max() < least:
        return 'converged'
    return driver.finish(driver.refine_to_full_grid(grid, solver.x, solver.mu))


def _generate_coarse_starts(driver: SolverDriver) -> tuple[Grid, _Starts, Iterator[_Starts]]:
    """Return the coarsest grid with room for most starts, their first batch, and the rest."""
    slots = COARSE_SLOTS
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


def _advance(driver: SolverDriver, grid: Grid, x: Array, mu: Array,
             ranking: tuple[tuple[float, int], ...]) -> tuple[Array, Array]:
    """
    Return starts (S, N, U, 3) after Newton steps, and their rates in units, (S,).

    :param ranking: shares of the starts that take steps, and how many; see Search.
    """
    least = LOWERED * mu.min() if len(grid.scenario.ground_nodes) > 1 else mu.min()
    solver = driver.build_solver(grid, x, mu)
    for share, steps in ranking:
        if share < 1:
            best = np.argsort(-solver.rates(), kind='stable')[:math.ceil(share * len(x))]
            solver = driver.build_solver(grid, solver.x[best], solver.mu[best])
        driver.advance(solver, steps, min(least, COARSE_MU))
    driver.try_best(solver)
    return solver.x, solver.rates()


def _polish(driver: SolverDriver, grid: Grid, x: Array, rates: Array,
            search: Search) -> tuple[Array, Array]:
    """Return starts (S, N, U, 3) and their rates, (S,), polished where that raises a rate."""
    with suppress(*_FAILURES):
        for share in POLISH_MUS:
            mu = np.maximum(share * rates, FINAL_MU)
            new_x, new_rates = _advance(driver, grid, x, mu, ((1.0, search.polish_steps),))
            x = np.where((new_rates > rates)[:, None, None, None], new_x, x)
            rates = np.maximum(new_rates, rates)
    return x, rates


def _hop(driver: SolverDriver, grid: Grid, x: Array, rates: Array,
         search: Search) -> tuple[Array, Array]:
    """Return starts (S, N, U, 3) and their rates, (S,), after hops where those raise a rate."""
    rng = np.random.default_rng(6)
    with suppress(*_FAILURES):
        for kept in HOPS:
            number = np.resize(select_best(rates, search.gap, kept), HOPS_AT_ONCE)
            hopped, tried, mu = generate_hops(
                grid, x[number], rates[number], rng, driver.raise_if_over)
            new_x, new_rates = _advance(driver, grid, tried, mu, ((1.0, search.polish_steps),))
            for start, new, rate in zip(number[hopped], new_x, new_rates):
                if rate > rates[start]:
                    x[start], rates[start] = new, rate
    return x, rates


def _try_baseline(baseline: Incumbent, incumbent: Incumbent) -> None:
    """Try the baseline with the best powers, where its rate comes close to the incumbent's."""
    with suppress(*_FAILURES):
        driver = SolverDriver(baseline)
        improve_powers(driver, np.log(2) * (
            (1 - CLOSE) * incumbent.rate / driver.grid.rate - CLOSE))
        baseline.try_idle_slots()
    incumbent.try_improve(baseline.positions, baseline.powers)


def select_best(rates: Array, gap: float, most: int) -> NDArray[np.intp]:
    """Return a start of each distinct rate within a gap of the best, the best first."""
    order = np.argsort(-rates)
    best = rates[order[0]]
    new = np.append(True, -np.diff(rates[order]) > DISTINCT * best)
    return order[new & (rates[order] >= (1 - gap) * best)][:most]
