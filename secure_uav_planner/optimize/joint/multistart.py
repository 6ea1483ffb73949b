"""
Multistart: Newton steps from random starts on a coarse grid, of which the best are finished.

The best starts are polished on the coarse grid from further inside, where steps lead past the
nearest optimum. With several ground nodes they hop as well: from smoothly moved flights, steps
lead to other optima. The best few are finished on the full grid, and the best plan is polished
there.
Where the first starts end in one optimum far above fly-hover-fly, the rest are not begun; where
not, fly-hover-fly with the best powers is tried as well.

Power control on a fixed trajectory starts from several levels of jamming, in which its local
optima differ.
"""

from collections.abc import Iterator
from contextlib import suppress
from dataclasses import replace
from typing import TypeAlias

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

STEPS = 37  # Newton steps from each start on the coarse grid.
DISTINCT = 2e-4  # Relative difference in rate between distinct optima.
AGREED = 0.7  # Share of the first starts in the best optimum that ends the multistart.
GAP = 0.1  # Relative distance below the best rate beyond which starts are pruned.
POLISHED = 12  # The most starts that are polished,
POLISH_STEPS = 15  # each by so many Newton steps on the coarse grid
POLISH_MUS = (0.05, 0.01)  # from each of these barrier parameters, in shares of its rate.
CLOSE = 0.02  # Share, or units of rates, below the best up to which fly-hover-fly is finished.
NODES_GAP = 0.5  # GAP with several ground nodes, whose starts are farther from the best,
NODES_STEPS = 25  # and the Newton steps of each polish and hop.
HOPS = (8, 8, 8, 4, 4, 4)  # Starts that are kept for each round of hops, max(HOPS) in all.
FINISHED = 2  # The most starts that are finished on the full grid.
_LEVELS = (1.0, 0.1, 0.01, 0.001)  # Of jamming for power control, in shares of limit_powers.
_LEVEL_STEPS = 20  # Newton steps from each level on the coarse grid,
_LEVEL_MU = 0.03  # with this barrier parameter to begin with,
_LEVEL_SHARE = 0.01  # and the share by which powers are moved into the interior.

_ELEVATION_OFFSETS = (8.0, 4.0, 2.0)  # Degrees by which gains rise early, from the coarse grid on,
_OFFSET_STEPS = 25  # and the most Newton steps with each on the full grid,
_OFFSET_MU = 1e-4  # down to this barrier parameter.

_FAILURES = NumericalError, np.linalg.LinAlgError  # Of a part that the method can do without.
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
    x, rates = _advance(driver, grid, *first, STEPS)
    agreed = ((rates > (1 - DISTINCT) * rates.max()).mean() >= AGREED
              and (counts_sights
                   or (1 - GAP) * rates.max() > np.log(2) * (baseline.rate / grid.rate + CLOSE)))
    if not agreed:
        with suppress(*_FAILURES):
            more_x, more_rates = _advance(driver, grid, *next(batches), STEPS)
            x, rates = np.concatenate([x, more_x]), np.append(rates, more_rates)
        if len(incumbent.scenario.ground_nodes) == 1:
            near = select_best(rates, GAP, POLISHED)
            x, rates = _polish(driver, grid, x[near], rates[near], POLISH_STEPS)
        else:
            near = select_best(rates, NODES_GAP, POLISHED)
            x, rates = _polish(driver, grid, x[near], rates[near], NODES_STEPS)
            x, rates = _hop(driver, grid, x, rates)
        driver.optima = Optima(grid, x[select_best(rates, GAP, POLISHED)])
    near = select_best(rates, GAP, 1 if agreed else FINISHED)
    fine = _reduce_elevation_offset(driver, driver.refine_to_full_grid(grid, x[near], COARSE_MU))
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
    """Return a solver without elevation offset, after steps with ever less of it."""
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
             steps: int) -> tuple[Array, Array]:
    """Return starts (S, N, U, 3) after Newton steps, and their rates in units, (S,)."""
    solver = driver.build_solver(grid, x, mu)
    driver.advance(solver, steps, min(mu.min(), COARSE_MU))
    driver.try_best(solver)
    return solver.x, solver.rates()


def _polish(driver: SolverDriver, grid: Grid, x: Array, rates: Array,
            steps: int) -> tuple[Array, Array]:
    """Return starts (S, N, U, 3) and their rates, (S,), polished where that raises a rate."""
    with suppress(*_FAILURES):
        for share in POLISH_MUS:
            mu = np.maximum(share * rates, FINAL_MU)
            new_x, new_rates = _advance(driver, grid, x, mu, steps)
            x = np.where((new_rates > rates)[:, None, None, None], new_x, x)
            rates = np.maximum(new_rates, rates)
    return x, rates


def _hop(driver: SolverDriver, grid: Grid, x: Array, rates: Array) -> tuple[Array, Array]:
    """Return the best starts (S, N, U, 3) and their rates, (S,), after hops that raise a rate."""
    rng = np.random.default_rng(6)
    with suppress(*_FAILURES):
        for kept in HOPS:
            best = select_best(rates, NODES_GAP, kept)
            x, rates = x[best], rates[best]
            number = np.arange(max(HOPS)) % len(best)
            hopped, tried, mu = generate_hops(
                grid, x[number], rates[number], rng, driver.raise_if_over)
            new_x, new_rates = _advance(driver, grid, tried, mu, NODES_STEPS)
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
