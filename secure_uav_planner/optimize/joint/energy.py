"""
Limits of energy: prices on energy in the objective, found so that the budgets hold.

A price is a smooth term that couples neighbouring slots only and needs no feasible start. Which
optimum a flight ends in depends on its start more than on anything else, so there are several: the
best flights without the limits, for (P2) and for (P1), as they are and with circles where they
hover. Flying takes less energy than hovering, but hovering is nearly stationary at any price. A
high first price keeps the circles; the first price of flights as they are is low.
"""

from collections.abc import Callable, Iterator, Sequence
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

SLOW = 0.25
"""A UAV hovers if it is slower than this share of its largest speed."""

CIRCLE_SPEED, TURNING, SPEEDING = 0.7, 0.6, 0.5
"""Speed of circles as a share of the largest; shares of the acceleration across and along."""

FIRST_PRICE, LOW_PRICE, WORST_PRICE = 0.5, 0.1, 0.03
"""
First prices of circles, of flights as they are, and of these for (P1).

They are prices of a whole budget, as shares of all that is delivered.
"""

FACTOR = 4.0  # Ratio of prices until the budget lies between those of two flights.
PRICES, LATER_PRICES = 4, 4  # The most prices from a start, and from one that keeps budgets.
UNUSED = 5e-4  # Share of what is delivered that what is left of a budget may be worth.
RAISE = 10.0  # Ratio by which prices that leave no flight within the budgets are raised, twice.
STEPS = 30  # The most Newton steps at a price.
SHARE = 0.01  # Share of its slack that a start at another price leaves.
MU, FIRST_MU = 1e-3, 1e-2  # Barrier parameters at a price and at the first price of a start.
POLISHES, GAIN = 3, 1e-3  # The most polishes of the best plan, while each gains this share.

_Descend: TypeAlias = Callable[[SolverDriver, Array, float], Array]
"""Descends at a SolverDriver's prices from starts (S, N, U, 3), and a barrier parameter, on."""


def improve_within_energy(driver: SolverDriver, frees: Sequence[Incumbent]) -> Status:
    """
    Improve the incumbent of a SolverDriver, which has limits of energy.

    :param frees: the best incumbents without them; none where a feasible start is to be improved.
    :raises InfeasibleMissionError: when no flights are found that keep them.
    """
    incumbent = driver.incumbent
    search = _build_search(driver, frees[0].rate if frees else incumbent.rate)
    plan = search.driver.incumbent
    try:
        for x, prices in search.generate_starts(frees):
            inside = search.find_prices(x, prices)
            if inside is not None and incumbent is not plan:
                driver.try_variables(inside)
        if not frees:
            search.improve(MU)
        before = 0.0
        for _ in range(POLISHES if frees else 0):
            if not plan.rate > (1 + GAIN) * before:
                break
            before = plan.rate
            search.improve(FIRST_MU)
    finally:
        if math.isfinite(plan.rate):
            incumbent.try_improve(plan.positions, plan.useful_powers)
    if math.isinf(plan.rate):
        search.refuse()
    if incumbent.objective == 'worst_case':
        plan.try_idle_slots()  # As the plan of (P2) is returned, which (P1) is never below.
        incumbent.try_improve(plan.positions, plan.useful_powers)
        worst = _PriceSearch(driver, descend_by_exchange, incumbent.rate)
        worst.prices = search.prices
        worst.improve(FIRST_MU if frees else MU)
        for x, prices in worst.keep_flight(frees[-1], WORST_PRICE) if frees else ():
            worst.find_prices(x, prices, LATER_PRICES)
    return 'converged'


def find_within_energy(driver: SolverDriver) -> Status:
    """Try the incumbent of a SolverDriver with circles at a high price."""
    search = _build_search(driver, 0.0)
    for x, _ in search.add_circles(driver.incumbent, CIRCLES[:1]):
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
    :ivar prices: at which the incumbent was found, or first prices, in nats per J, (U,).
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

    def improve(self, mu: float) -> None:
        """Improve the incumbent from its flight and prices, and a barrier parameter, on."""
        incumbent, prices = self.driver.incumbent, self.prices
        x = self._descend_at(prices, [(incumbent.positions, incumbent.powers)], mu)
        self.find_prices(x[0], prices, LATER_PRICES)

    def generate_starts(self, frees: Sequence[Incumbent]) -> Iterator[tuple[Array, Array]]:
        """
        Yield flights, variables (N, U, 3), that have descended at prices (U,), and these.

        :param frees: incumbents without limits of energy.
        """
        for free in frees:
            with suppress(NumericalError):
                yield from self.add_circles(free, CIRCLES)
            yield from self.keep_flight(free, LOW_PRICE)
        if math.isinf(self.driver.incumbent.rate):
            with suppress(NumericalError):
                yield from self._save_energy(frees[0].powers if frees else (
                    self.driver.incumbent.powers))

    def keep_flight(self, free: Incumbent, price: float) -> Iterator[tuple[Array, Array]]:
        """Yield the flight of a free incumbent, as generate_starts, at a share of budgets."""
        with suppress(NumericalError):
            prices = price * self._unit
            [x] = self._descend_at(prices, [(free.positions, free.powers)], FIRST_MU)
            yield x, prices

    def add_circles(self, free: Incumbent, circles: Sequence[tuple[float, int]]
                    ) -> Iterator[tuple[Array, Array]]:
        """Yield flights and prices, as generate_starts, with circles where a free one hovers."""
        flights = [add_circles(self._scenario, free.positions, *circle) for circle in circles]
        if np.array_equal(flights[0], flights[-1]):
            flights = flights[:1]  # No UAV hovers.
        return self._raise_prices([(flight, free.powers) for flight in flights])

    def _save_energy(self, powers: Array) -> Iterator[tuple[Array, Array]]:
        """Yield flights, as generate_starts, from direct ones with circles all the way."""
        flights = [self.driver.incumbent.problem.retract(add_circles(
            self._scenario, self.driver.grid.reference_flight, *circle, slow=math.inf))
            for circle in CIRCLES]
        return self._raise_prices([(flight, powers) for flight in flights])

    def _raise_prices(self, starts: Sequence[tuple[Array, Array]]
                      ) -> Iterator[tuple[Array, Array]]:
        """
        Yield flights and prices, as generate_starts, at the first prices that keep budgets.

        Where each UAV keeps its budget in another flight, there is one of all their flights. Where
        none does at the highest prices, there is no flight.

        :param starts: positions and powers.
        """
        prices = self.prices.copy()
        for raised in (1.0, RAISE, RAISE**2):
            x = self._descend_at(prices, starts, raised * FIRST_MU)
            energies = np.array([self._measure(start) for start in x])
            over = energies.min(axis=0) > self._budgets
            if not over.any():
                break
            prices = np.where(over, RAISE * prices, prices)
        else:
            return
        within = (energies <= self._budgets).all(axis=1)
        if not within.any():
            x = x[energies.argmin(axis=0), :, np.arange(len(over))].swapaxes(0, 1)[None]
            within = np.array([True])
        for start in x[within]:
            yield start, prices

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

    def find_prices(self, x: Array, prices: Array, most: int = PRICES) -> Array | None:
        """
        Find prices for which flights use up their budgets; return the last flight within all.

        :param x: variables (N, U, 3) that have descended at prices.
        :param most: number of prices.
        """
        grid = self.driver.grid
        bounds = np.stack([np.zeros_like(prices), np.full_like(prices, math.inf)])
        excesses = np.stack([np.ones_like(prices), -np.ones_like(prices)])
        inside = None  # From flights beyond budgets, UAVs hover again.
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
        return inside

    def _propose(self, x: Array, prices: Array) -> Array:
        """Propose variables (N, U, 3) found at prices; return the excess over budgets, (U,)."""
        incumbent = self.driver.incumbent
        before = incumbent.rate
        self.driver.try_variables(x)
        if incumbent.rate > before:
            self.prices = prices
        return self._measure(x) / self._budgets - 1

    def _measure(self, x: Array) -> Array:
        """Return the energies of variables (N, U, 3), (U,) in J, and remember the least."""
        energies = measure_energies(self._scenario, self.driver.grid.positions(x))
        self._least = np.minimum(self._least, energies)
        return energies

    def refuse(self) -> None:
        """Raise the errors of the UAVs whose least energies are above their budgets."""
        raise_all(_refuse_budgets(self._scenario, self._least))


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


def add_circles(scenario: Scenario, positions: Array, direction: float, sense: int,
                slow: float = SLOW) -> Array:
    """
    Return flights with circles where UAVs hover, (U, N+2, 2) in m.

    A UAV flies whole circles through its place, and begins and ends them at rest relative to the
    flight; where there is no time for one, it stays as it is.

    :param positions: (U, N+2, 2) in m.
    :param direction: of the centres from the places, in rad from that of the goal.
    :param sense: 1 for counterclockwise, -1 for clockwise.
    :param slow: a UAV hovers if it is slower than this share of its largest speed.
    """
    step, flights = scenario.slot_duration, positions.copy()
    for uav, flight in zip(scenario.uavs, flights, strict=True):
        assert uav.max_acceleration is not None
        away = direction + math.atan2(uav.goal[1] - uav.start[1], uav.goal[0] - uav.start[0])
        speeds = np.linalg.norm(np.gradient(flight, step, axis=0), axis=1)
        hovers = np.concatenate([[False], speeds < slow * uav.max_speed, [False]])
        ends = np.flatnonzero(np.diff(hovers.astype(int)))
        top, gain = CIRCLE_SPEED * uav.max_speed, SPEEDING * uav.max_acceleration
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
