"""
Limits of energy: starts from the best flights without them, and from flights of little energy.

In the kernel a limit of energy has a barrier term as any limit, or a price while it is exceeded;
see `kernel/constraints.hpp`. Which optimum a flight ends in depends on its start more than on
anything else. So there are many starts: a few Newton steps rank them, and the best are finished.
"""

from collections.abc import Iterable, Iterator, Sequence
from contextlib import suppress
import math
from typing import NamedTuple

import numpy as np

from .exchange import improve_from_start
from .interior_point import InteriorPointSolver, Optima, SolverDriver
from .multistart import select_best
from .settings import Beginning, DESCENT, ENERGY, EXCHANGE
from .starts import make_strictly_feasible
from ..incumbent import Incumbent
from ...errors import InfeasibleMissionError, NumericalError
from ...mission.fields import raise_all
from ...mission.scenario import Scenario
from ...mission.validation import Array, find_runs
from ...model.grid import Grid, resample, resample_flights
from ...model.limits import measure_energies
from ...plan.plan import Status

CIRCLES = ((0.0, 1), (2 * math.pi / 3, -1), (4 * math.pi / 3, 1))
"""Loiter circles: bearing of the centre [rad], turn (+1 counterclockwise)."""


class _Start(NamedTuple):
    """Flights (U, M+2, 2) in m, powers (U, M) in W, and how Newton's method begins."""

    positions: Array
    powers: Array
    beginning: Beginning


def improve_within_energy(driver: SolverDriver, unlimited: Sequence[Incumbent],
                          optima: Optima | None = None) -> Status:
    """
    Improve the incumbent of a SolverDriver from starts within energy limits; return 'converged'.

    A plan of (P2) is sought first. For (P1) the best flights of this search are then improved.

    :param unlimited: the best incumbents without limits of energy, for (P2) first.
    :param optima: further optima of (P2) without limits of energy.
    :raises InfeasibleMissionError: when no flights are found that keep the limits of energy.
    """
    incumbent = driver.incumbent
    search = _drive_guaranteed(driver)
    plan = search.incumbent
    try:
        for solver in _advance_in_turn(
                search, list(_generate_starts(driver, unlimited, optima))):
            finished = list(_finish(search, solver))
            if math.isfinite(plan.rate):
                break
        else:
            _, energies = _measure_energies(solver)
            # Iterates may break other limits, and take more than flights that keep them.
            energies = np.stack([*energies, *(measure_energies(
                incumbent.scenario, flights.positions) for flights in unlimited)])
            raise_all(_refuse_budgets(incumbent.scenario, energies.min(axis=0)))
    finally:
        if math.isfinite(plan.rate):
            incumbent.try_improve(plan.positions, plan.useful_powers)
    if incumbent.objective == 'worst_case':
        plan.try_idle_slots()  # As the plan of (P2) is returned, which (P1) is never below.
        incumbent.try_improve(plan.positions, plan.useful_powers)
        for x, prices in finished:
            improve_from_start(driver, x, EXCHANGE.places_mu, prices)
    return 'converged'


def improve_warm(driver: SolverDriver) -> Status:
    """Improve an incumbent within its limits of energy by several searches from one start."""
    incumbent, grid = driver.incumbent, driver.grid
    # Every search starts at the incumbent of this moment, moved strictly inside the limits.
    x = make_strictly_feasible(grid, incumbent.positions, incumbent.powers, ENERGY.share,
                               driver.raise_if_over)
    status: Status = 'converged'
    for mu, price in ENERGY.as_they_are:  # First barrier parameter and price of a search.
        status = (driver.finish(driver.build_solver(grid, x[None], mu, price))
                  if incumbent.objective == 'guaranteed' else
                  improve_from_start(driver, x, mu, price))
    return status


def find_within_energy(driver: SolverDriver) -> Status:
    """Try plans of (P2) with direct flights and loiter circles; return 'converged' in any case."""
    search, incumbent = _drive_guaranteed(driver), driver.incumbent
    _advance(search, search.grid, _circle_reference_flights(driver, incumbent.powers))
    if math.isfinite(search.incumbent.rate):
        incumbent.try_improve(search.incumbent.positions, search.incumbent.useful_powers)
    return 'converged'


def _drive_guaranteed(driver: SolverDriver) -> SolverDriver:
    """Return a SolverDriver for problem (P2): the same one if its incumbent has this objective."""
    incumbent = driver.incumbent
    return driver if incumbent.objective == 'guaranteed' else SolverDriver(
        incumbent.with_objective('guaranteed'))


def _advance_in_turn(driver: SolverDriver, starts: Sequence[_Start]
                     ) -> Iterator[InteriorPointSolver]:
    """
    Yield up to three solvers, each after ENERGY.steps Newton steps from its starts.

    The first has the starts on a coarse grid, on which flights take more energy. The caller stops
    when it has a plan. Otherwise the second has the same starts on the full grid, if it is finer,
    and the last has the starts of _mix_least_energies.
    """
    full = driver.grid
    slots = max(ENERGY.coarse_slots, math.ceil(full.scenario.duration / ENERGY.slot_duration))
    grid = full.with_slots(min(full.slots, slots))
    solver = _advance(driver, grid, starts)
    yield solver
    if grid.slots < full.slots:
        solver = _advance(driver, full, starts)
        yield solver
    yield _advance(driver, full, _mix_least_energies(solver))


def _finish(driver: SolverDriver, solver: InteriorPointSolver) -> Iterator[tuple[Array, Array]]:
    """Yield x (N, U, 3), prices (U,) of the best starts on the full grid; none if rates are 0."""
    rates = solver.rates()
    for start in select_best(rates, ENERGY.gap, ENERGY.finished) if rates.any() else ():
        with suppress(NumericalError):
            fine = driver.refine_to_full_grid(
                solver.grid, solver.x[[start]], solver.mu[[start]], solver.prices[[start]])
            driver.finish(fine)
            # Simpson's rule for energies is exact at the flights from which a solver is built.
            fine = driver.build_solver(fine.grid, fine.x, DESCENT.warm_mu, fine.prices)
            driver.finish(fine)
            yield fine.x[0], fine.prices[0]


def _advance(driver: SolverDriver, grid: Grid, starts: Iterable[_Start]) -> InteriorPointSolver:
    """
    Return a solver on a grid after ENERGY.steps Newton steps, and propose its best iterate.

    Starts without flights strictly inside the limits are left out; NumericalError if all are.
    """
    x, beginnings = [], []
    for positions, powers, beginning in starts:
        with suppress(NumericalError):
            x.append(make_strictly_feasible(
                grid, positions, powers, ENERGY.share, driver.raise_if_over))
            beginnings.append(beginning)
    if not x:
        raise NumericalError('no flight strictly inside the limits was found')
    mu, prices = np.array(beginnings).T  # First barrier parameter and price of each start.
    solver = driver.build_solver(grid, np.array(x), mu, prices[:, None])
    driver.advance(solver, ENERGY.steps, DESCENT.coarse_mu)
    driver.try_best(solver)
    return solver


def _measure_energies(solver: InteriorPointSolver) -> tuple[Array, Array]:
    """Return the flights of a solver, (S, U, N+2, 2) in m, and their energies, (S, U) in J."""
    flights = np.array([solver.grid.positions(x) for x in solver.x])
    return flights, np.array([
        measure_energies(solver.grid.scenario, flight) for flight in flights])


def _mix_least_energies(solver: InteriorPointSolver) -> Iterator[_Start]:
    """Yield a start for each of ENERGY.least, of the flights of least energy in a solver."""
    flights, energies = _measure_energies(solver)
    least = energies.argmin(axis=0)
    # All powers are of the start from which the transmitter's flight is.
    powers = solver.grid.powers(solver.x[least[0]])
    for beginning in ENERGY.least:
        yield _Start(flights[least, np.arange(len(least))], powers, beginning)


def _generate_starts(driver: SolverDriver, unlimited: Sequence[Incumbent],
                     optima: Optima | None) -> Iterator[_Start]:
    """Yield plans without limits of energy, as they are and with circles, then direct circles."""
    flights = [(best.positions, best.powers, 3) for best in unlimited]  # 3 beginnings each.
    if optima is not None:
        slots, grid = driver.grid.slots, optima.grid
        for x in optima.x[1:1 + ENERGY.optima]:
            flights.append((resample_flights(grid.positions(x), slots),
                            resample(grid.powers(x).T, slots, inner=True).T, 1))
    for positions, powers, count in flights:
        for beginning in ENERGY.as_they_are[:count]:
            yield _Start(positions, powers, beginning)
        for circle, beginning in list(zip(CIRCLES, ENERGY.with_circles))[-count:]:
            circled = add_circles(driver.incumbent.scenario, positions, *circle)
            if not np.array_equal(circled, positions):
                yield _Start(circled, powers, beginning)
    yield from _circle_reference_flights(driver, unlimited[0].powers)


def _circle_reference_flights(driver: SolverDriver, powers: Array) -> Iterator[_Start]:
    """Yield a _Start for each of CIRCLES: reference flights with such circles all the way."""
    for circle in CIRCLES:
        circled = add_circles(driver.incumbent.scenario, driver.grid.reference_flight, *circle,
                              slow=math.inf)
        yield _Start(driver.incumbent.problem.retract(circled), powers, ENERGY.direct)


def _refuse_budgets(scenario: Scenario, energies: Array) -> list[InfeasibleMissionError]:
    """
    Return errors of the UAVs whose least energies (U,) [J] are above max_energy, worst first.

    If there are none, the error is of the UAV with the least reserve, since not all of these
    flights keep all other limits.
    """
    excess = energies / scenario.max_energies - 1
    return [InfeasibleMissionError(
        f'{scenario.uavs[index].name}.max_energy is {scenario.max_energies[index]:g} J; no '
        f'flight of {scenario.duration:g} s was found that ' + (
            f'takes less than {energies[index]:.5g} J by the model of its propulsion'
            if excess[index] > 0 else 'keeps it and all other limits'),
        ('uavs', int(index), 'max_energy'))
        for index in np.argsort(-excess)[:max(1, np.count_nonzero(excess > 0))]]


def add_circles(scenario: Scenario, positions: Array, direction: float, sense: int,
                slow: float = ENERGY.slow) -> Array:
    """
    Return flights with circles where UAVs hover, (U, N+2, 2) in m.

    While a UAV is slower than slow * max_speed, whole circles through its place are added to its
    flight. Speed on the circles rises from 0 to a top speed and falls to 0 again. In a short time
    the top is lower, or no circle is added. UAVs without max_energy or max_acceleration have none.

    :param positions: flights, (U, N+2, 2) in m.
    :param direction: bearing of the circles' centres from the places, relative to the bearing of
        the goal from the start [rad].
    :param sense: 1 for counterclockwise, -1 for clockwise.
    """
    step, flights = scenario.slot_duration, positions.copy()
    for uav, flight in zip(scenario.uavs, flights, strict=True):
        if uav.max_energy is None or uav.max_acceleration is None:
            continue
        away = direction + math.atan2(uav.goal[1] - uav.start[1], uav.goal[0] - uav.start[0])
        speeds = np.linalg.norm(np.gradient(flight, step, axis=0), axis=1)
        acceleration = ENERGY.speeding * uav.max_acceleration
        for first, end in find_runs(speeds < slow * uav.max_speed).tolist():
            times = np.arange(end - first) * step
            # The highest speed at which a whole circle fits into 95 % of the time.
            top = min(ENERGY.circle_speed * uav.max_speed, 0.95 * times[-1] / (
                1 / acceleration + 2 * np.pi / (ENERGY.turning * uav.max_acceleration)))
            # On two points the speed is 0.
            if end - first < 3 or top < ENERGY.slow * uav.max_speed:
                continue
            speed = np.minimum(top, acceleration * np.minimum(times, times[-1] - times))
            covered = np.append(0.0, np.cumsum((speed[1:] + speed[:-1]) / 2) * step)
            turns = max(1, int(
                covered[-1] / (2 * np.pi * top**2 / (ENERGY.turning * uav.max_acceleration))))
            angles = sense * covered * (2 * np.pi * turns / covered[-1]) + away
            offsets = np.stack([np.cos(angles), np.sin(angles)], axis=-1)
            flight[first:end] += covered[-1] / (2 * np.pi * turns) * (offsets[0] - offsets)
    return flights
