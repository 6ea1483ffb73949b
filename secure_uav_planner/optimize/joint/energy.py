"""
Limits of energy: prices on energy in the objective, found so that the budgets hold.

A price is a smooth term that couples neighbouring slots only and needs no feasible start. Flying
takes less energy than hovering, but hovering is nearly stationary at any price: starts are the
best flights without the limits, with circles where they hover. The first price is high, so that
circles stay.
"""

from collections.abc import Callable, Sequence
from contextlib import suppress
import math
from typing import TypeAlias

import numpy as np

from .exchange import descend_by_exchange
from .interior_point import FINAL_MU, SolverDriver
from .starts import make_strictly_feasible
from ..incumbent import Incumbent
from ...errors import InfeasibleMissionError, NumericalError
from ...mission.fields import raise_all
from ...mission.scenario import Array, Scenario
from ...model.limits import measure_energies
from ...plan.plan import Status

CIRCLES = ((0.0, 1), (2 * math.pi / 3, -1), (4 * math.pi / 3, 1))
"""Starts: directions of the centres of circles from where UAVs hover, in rad, and senses."""

SLOW = 0.25  # Share of the largest speed below which a UAV counts as hovering.
SPEED = 0.7  # Of circles, in shares of the largest,
TURNING, SPEEDING = 0.6, 0.5  # with these shares of the acceleration across and along.
FIRST_PRICE = 0.5  # Of a budget, in shares of all that is delivered.
FACTOR = 4.0  # Ratio of prices until the budget lies between those of two flights.
PRICES, LATER_PRICES = 8, 4  # The most prices from a start, and from one that keeps budgets.
UNUSED = 5e-4  # Share of what is delivered that what is left of a budget may be worth.
RAISE = 10.0  # By which prices are raised, twice, where they are too low for circles to stay.
STEPS = 30  # The most Newton steps at a price.
SHARE = 0.01  # Of the slack that a start at another price leaves,
MU, FIRST_MU = 1e-3, 1e-2  # and barrier parameters, there and at the first price.

_Descend: TypeAlias = Callable[[SolverDriver, Array, float], Array]
"""Descends at a SolverDriver's prices from starts (S, N, U, 3), and a barrier parameter, on."""


def improve_within_energy(driver: SolverDriver, free: Incumbent | None) -> Status:
    """
    Improve the incumbent of a SolverDriver, which has limits of energy.

    :param free: the best incumbent without them; None where a feasible start is to be improved.
    :raises InfeasibleMissionError: when no flights are found that keep them.
    """
    incumbent = driver.incumbent
    search = _build_search(driver, incumbent.rate if free is None else free.rate)
    plan = search.driver.incumbent
    try:
        if free is None:
            search.improve(search.prices)
        else:
            flights, prices = search.begin(free)
            for x in flights:
                search.find_prices(x, prices)
    finally:
        incumbent.try_improve(plan.positions, plan.useful_powers)
    if incumbent.objective == 'worst_case':
        _PriceSearch(driver, descend_by_exchange, incumbent.rate).improve(search.prices)
    return 'converged'


def find_within_energy(driver: SolverDriver) -> Status:
    """Try the incumbent of a SolverDriver with circles at a high price; see _PriceSearch.begin."""
    search = _build_search(driver, 0.0)
    flights, _ = search.begin(driver.incumbent, CIRCLES[:1])
    for x in flights:
        driver.try_variables(x)
    return 'converged'


def _build_search(driver: SolverDriver, rate: float) -> '_PriceSearch':
    """Return a search for problem (P2), which the incumbent of a SolverDriver may have."""
    incumbent = driver.incumbent
    return _PriceSearch(driver if incumbent.objective == 'guaranteed' else SolverDriver(
        incumbent.with_objective('guaranteed')), _descend, rate)


def _descend(driver: SolverDriver, x: Array, mu: float) -> Array:
    """Descend for problem (P2); see _Descend."""
    solver = driver.build_solver(driver.grid, x, mu)
    driver.descend(solver, FINAL_MU * mu / MU, STEPS)
    return solver.x


class _PriceSearch:
    """
    The search for prices at which flights use up their budgets.

    Every flight is proposed to the SolverDriver's incumbent, which keeps those within the budgets.

    :param rate: that a plan may have, in bit/s/Hz.
    :ivar prices: those of the incumbent, or first ones, in nats per J, (U,).
    """

    def __init__(self, driver: SolverDriver, descend: _Descend, rate: float) -> None:
        self.driver, self._descend = driver, descend
        self._scenario = driver.incumbent.scenario
        self._budgets = self._scenario.max_energies
        self._least = np.full(len(self._budgets), math.inf)
        # Prices at which budgets cost as much as all that is delivered, 0 without a budget.
        self._unit = self._scenario.slots / self._budgets * max(
            np.log(2) * rate, driver.grid.rate)
        self.prices = FIRST_PRICE * self._unit

    def improve(self, prices: Array) -> None:
        """Improve the incumbent from where it is, from prices on."""
        incumbent = self.driver.incumbent
        x = self._descend_at(prices, [(incumbent.positions, incumbent.powers)], MU)
        self.find_prices(x[0], prices, LATER_PRICES)

    def begin(self, free: Incumbent, circles: Sequence[tuple[float, int]] = CIRCLES
              ) -> tuple[Array, Array]:
        """
        Return flights (S, N, U, 3) from an incumbent with circles where it hovers, and prices.

        At these, each flight keeps all limits; or there is a single one, of each UAV's flight that
        takes the least.

        :raises InfeasibleMissionError: when no flights are found that keep the limits.
        """
        flights = [add_circles(self._scenario, free.positions, *circle) for circle in circles]
        if np.array_equal(flights[0], flights[-1]):
            flights = flights[:1]  # No UAV hovers.
        starts = [(flight, free.powers) for flight in flights]
        prices, grid = self.prices, self.driver.grid
        for raised in (1, RAISE, RAISE**2):
            x = self._descend_at(prices, starts, raised * FIRST_MU)
            energies = np.array([measure_energies(self._scenario, grid.positions(start))
                                 for start in x])
            self._least = np.minimum(self._least, energies.min(axis=0))
            over = energies.min(axis=0) > self._budgets
            if not over.any():
                break
            prices = np.where(over, RAISE * prices, prices)
        else:
            raise_all(_refuse_budgets(self._scenario, self._least))
        within = (energies <= self._budgets).all(axis=1)
        # Else of each UAV the flight that takes the least.
        return x[within] if within.any() else x[
            energies.argmin(axis=0), :, np.arange(len(over))].swapaxes(0, 1)[None], prices

    def _descend_at(self, prices: Array, starts: Sequence[tuple[Array, Array]], mu: float
                    ) -> Array:
        """Return starts, positions and powers of plans, descended at prices, (S, N, U, 3)."""
        driver = self.driver
        driver.prices = prices
        inside = []
        for positions, powers in starts:
            with suppress(NumericalError):
                inside.append(make_strictly_feasible(
                    driver.grid, positions, powers, SHARE, driver.raise_if_over))
        if not inside:
            raise NumericalError('no flight strictly inside the limits was found')
        return self._descend(driver, np.array(inside), mu)

    def find_prices(self, x: Array, prices: Array, most: int = PRICES) -> None:
        """
        Find prices for which flights use up their budgets.

        :param x: variables (N, U, 3) that have descended at prices.
        :param most: number of prices.
        """
        grid = self.driver.grid
        bounds = np.stack([np.zeros_like(prices), np.full_like(prices, math.inf)])
        excesses = np.stack([np.ones_like(prices), -np.ones_like(prices)])
        inside = None  # The last flight within all budgets; from others, UAVs hover again.
        for _ in range(most):
            excess = self._propose(x, prices)
            over = excess > 0
            for end, reached in enumerate((over, ~over)):
                bounds[end, reached], excesses[end, reached] = prices[reached], excess[reached]
            if not over.any():
                inside = x
            start = x if inside is None else inside
            settled = ~over & (-excess * prices <= UNUSED * self._unit)
            if settled.all():
                break
            prices = np.where(settled, prices, _choose_prices(bounds, excesses))
            x = self._descend_at(prices, [(grid.positions(start), grid.powers(start))], MU)[0]

    def _propose(self, x: Array, prices: Array) -> Array:
        """Propose variables (N, U, 3) found at prices; return the excess over budgets, (U,)."""
        incumbent = self.driver.incumbent
        before = incumbent.rate
        self.driver.try_variables(x)
        if incumbent.rate > before:
            self.prices = prices
        energies = measure_energies(self._scenario, self.driver.grid.positions(x))
        self._least = np.minimum(self._least, energies)
        return energies / self._budgets - 1


def _choose_prices(bounds: Array, excesses: Array) -> Array:
    """
    Return prices between some that are too low and some that are too high, or beyond, (U,).

    :param bounds: these, (2, U); 0 and infinite where none is known.
    :param excesses: of energy over budgets there, in shares, (2, U).
    """
    low, high = bounds
    share = np.clip(excesses[0] / (excesses[0] - excesses[1]), 0.1, 0.9)
    with np.errstate(divide='ignore', invalid='ignore'):
        between = np.exp((1 - share) * np.log(low) + share * np.log(high))
    return np.where(np.isinf(high), FACTOR * low, np.where(low == 0.0, high / FACTOR, between))


def _refuse_budgets(scenario: Scenario, energies: Array) -> list[InfeasibleMissionError]:
    """Return the errors of UAVs whose least energies (U,) in J are above their budgets."""
    excess = energies / scenario.max_energies - 1
    return [InfeasibleMissionError(
        f'{scenario.uavs[index].name}.max_energy is {scenario.max_energies[index]:g} J; no '
        f'flight of {scenario.duration:g} s was found that takes less than {energies[index]:.5g} '
        'J by the model of its propulsion', ('uavs', int(index), 'max_energy'))
        for index in np.argsort(-excess) if excess[index] > 0 or excess.max() <= 0]


def add_circles(scenario: Scenario, positions: Array, direction: float, sense: int) -> Array:
    """
    Return flights with circles where UAVs hover, (U, N+2, 2) in m.

    A UAV flies whole circles through its place, and begins and ends them at rest relative to the
    flight; where there is no time for one, it stays as it is.

    :param positions: (U, N+2, 2) in m.
    :param direction: of the centres from the places, in rad from that of the goal.
    :param sense: 1 for counterclockwise, -1 for clockwise.
    """
    step, flights = scenario.slot_duration, positions.copy()
    for uav, flight in zip(scenario.uavs, flights, strict=True):
        assert uav.max_acceleration is not None
        away = direction + math.atan2(uav.goal[1] - uav.start[1], uav.goal[0] - uav.start[0])
        speeds = np.linalg.norm(np.gradient(flight, step, axis=0), axis=1)
        slow = np.concatenate([[False], speeds < SLOW * uav.max_speed, [False]])
        ends = np.flatnonzero(np.diff(slow.astype(int)))
        top, gain = SPEED * uav.max_speed, SPEEDING * uav.max_acceleration
        for first, last in zip(ends[::2], ends[1::2] - 1, strict=True):
            times = np.arange(last - first + 1.0) * step
            speed = np.minimum(top, gain * np.minimum(times, times[-1] - times))
            covered = np.append(0.0, np.cumsum((speed[1:] + speed[:-1]) / 2) * step)
            turns = int(covered[-1] / (2 * np.pi * top**2 / (TURNING * uav.max_acceleration)))
            if turns:
                angles = sense * covered * (2 * np.pi * turns / covered[-1]) + away
                offsets = np.stack([np.cos(angles), np.sin(angles)], axis=-1)
                flight[first:last + 1] += covered[-1] / (2 * np.pi * turns) * (
                    offsets[0] - offsets)
    return flights
