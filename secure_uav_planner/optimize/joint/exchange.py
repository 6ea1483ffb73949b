"""
The exchange method for problem (P1), whose rate is against the worst place of every disc.

A disc has infinitely many places (semi-infinite programming). A few places represent each disc,
and are exchanged for worse places between the Newton steps.
"""

from contextlib import suppress

import numpy as np
from numpy.typing import NDArray

from .interior_point import Discs, InteriorPointSolver, Optima, SolverDriver
from .settings import DESCENT, EXCHANGE
from .starts import make_strictly_feasible
from ...errors import NumericalError
from ...mission.scenario import Array
from ...model.channel import leak_maximisers
from ...model.channel.rates import find_least_rate, include_listeners
from ...model.channel.shares import find_shares
from ...model.grid import Grid, Receivers
from ...plan.plan import Status

_NAT = 1 / np.log(2)  # One nat, in bit.


def improve_by_exchange(driver: SolverDriver, optima: Optima | None = None) -> Status:
    """
    Improve the incumbent for (P1), against worst places; return the status of the first start.

    :param optima: local optima of problem (P2), whose rate bounds the worst case by a formula. Of
        two or more, the one with the best rate in (P1) is a second start.
    """
    incumbent = driver.incumbent
    driver.raise_if_over()
    x = make_strictly_feasible(driver.grid, incumbent.positions, incumbent.powers,
                               DESCENT.warm_share, driver.raise_if_over)
    mu = DESCENT.warm_mu if incumbent.warm else EXCHANGE.places_mu
    status = improve_from_start(driver, x, mu)
    if optima is not None and len(optima.x) > 1:
        with suppress(NumericalError, np.linalg.LinAlgError):
            best = _explore(driver, optima)
            fine = driver.refine_to_full_grid(optima.grid, best[None], EXCHANGE.explored_mu)
            improve_from_start(driver, fine.x[0], EXCHANGE.explored_mu)
    return status


def improve_from_start(driver: SolverDriver, x: Array, mu: float,
                       prices: float | Array = DESCENT.first_price) -> Status:
    """Improve the incumbent for (P1) from x (N, U, 3); return the status of the first round."""
    incumbent = driver.incumbent
    before = incumbent.rate
    status, at_rest = _improve_once(driver, x, mu, DESCENT.most_steps, prices)
    # If places oscillated and the first round gained much, a second from the incumbent may, too.
    if not (at_rest or incumbent.warm or incumbent.rate < (1 + EXCHANGE.worth) * before):
        x = make_strictly_feasible(driver.grid, incumbent.positions, incumbent.powers,
                                   DESCENT.warm_share, driver.raise_if_over)
        _improve_once(driver, x, mu, EXCHANGE.more_steps, prices)
    return status


def _improve_once(driver: SolverDriver, x: Array, mu: float, steps: int,
                  prices: float | Array) -> tuple[Status, bool]:
    """Improve the incumbent in one round; return the status, and True if places came to rest."""
    exchange = _Exchange(driver, driver.grid, x, mu, prices)
    return driver.finish(exchange, EXCHANGE.places_final_mu, steps), exchange.at_rest


def _explore(driver: SolverDriver, optima: Optima) -> Array:
    """Return the iterate (N, U, 3) best in (P1) after a few steps from each optimum of (P2)."""
    best, rate = optima.x[0], 0.0
    for x in optima.x[:EXCHANGE.explored]:
        exchange = _Exchange(driver, optima.grid, x, EXCHANGE.exploring_mu)
        with suppress(NumericalError):
            driver.advance(exchange, EXCHANGE.exploring_steps, EXCHANGE.exploring_final_mu)
        if exchange.rate > rate:
            best, rate = exchange.best, exchange.rate
    return best


class _Exchange:
    """
    A Solver of Newton steps from a start, (N, U, 3), between which places are exchanged.

    :ivar best: best iterate so far, (N, U, 3).
    :ivar rate: rate of the best iterate, as in WorstPlaces [nats]; 0 before the first iterate with
        all energies within their limits.
    """

    def __init__(self, driver: SolverDriver, grid: Grid, x: Array, mu: float,
                 prices: float | Array = DESCENT.first_price) -> None:
        # The tolerance and all rates of this class are in nats.
        self.grid, self._tolerance = grid, EXCHANGE.worse * grid.rate
        self._places = WorstPlaces(grid, x)
        self._solver = InteriorPointSolver(
            grid, x[None], mu, driver.raise_if_over, self._places.receivers, self._places.discs,
            prices)
        self.best, self.rate = x, 0.0 if self._solver.over.any() else self._places.rate
        # Iterates are proposed only above this rate, because the proof of a worst case takes time.
        self._proposed = driver.incumbent.rate * np.log(2)
        self._last_steps = 0  # Number of steps with the last barrier parameter.

    @property
    def at_rest(self) -> bool:
        """Whether the steps have converged and no place is exchanged for a worse one."""
        return self._solver.is_done

    @property
    def is_done(self) -> bool:
        """Whether at rest, or after EXCHANGE.final_steps at the last mu: places may oscillate."""
        return self.at_rest or self._last_steps >= EXCHANGE.final_steps

    @property
    def solver_time(self) -> float:
        """Time [s] spent in the kernel."""
        return self._solver.solver_time

    def propose(self) -> Array | None:
        """Return the best iterate; None if not above the first incumbent and last proposal."""
        if self.rate <= self._proposed:
            return None
        self._proposed = self.rate
        return self.best

    def advance(self, steps: int, final: float) -> int:
        """Take one Newton step, whatever `steps` is, exchange places, and return 1."""
        self._solver.advance(1, final)
        x = self._solver.x[0]
        worse = self._places.exchange(x, self._solver.shares[0].T, self._tolerance)
        self._solver.exchange(self._places.receivers, self._places.discs, worse)
        self._last_steps += int(self._solver.mu[0] <= EXCHANGE.places_final_mu)
        if self._places.rate > self.rate and not self._solver.over.any():
            self.best, self.rate = x.copy(), self._places.rate
        return 1


class WorstPlaces:
    """
    A few places of every disc in every slot, exchanged for worse ones.

    Problem (P1) has the largest leak to any place of a disc. A few places are enough at an iterate
    if no place of the disc has a larger leak than the worst of the few.

    :param grid: a grid of any number of slots.
    :param x: the first iterate, (N, U, 3).
    :ivar receivers: the ground nodes, and eavesdroppers at the places.
    :ivar rate: least weighted mean rate against the worst places at the last x [nats], with 0 for
        negative rates.
    """

    def __init__(self, grid: Grid, x: Array) -> None:
        self._grid = grid
        self._scenario = grid.scenario
        self._discs = self._scenario.receivers_at(grid.times)
        self._centres = self._discs.centres.swapaxes(0, 1)  # (N, E, 2)
        self._radii = self._discs.radii.T  # (N, E)
        self._guarantee = Receivers.of(grid)
        worst, leaks = self._find_worst(x)  # Worst places (N, E, 2) in m, leaks (N, E) in nats.
        offset = worst - self._centres
        # The first places are the worst place of a disc turned about the centre by some angles.
        # The SINRs of colluding eavesdroppers add up over all places, so each has one place only.
        angles = EXCHANGE.angles[:1] if self._scenario.colluding else EXCHANGE.angles
        rotations = np.array([[[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]
                              for angle in angles])
        # (N, E, P, 2), P places for each disc.
        self._places = self._centres[:, :, None] + np.einsum('aij,nej->neai', rotations, offset)
        # True for the worst place of each disc at the last x, (N, E, P).
        self._largest: NDArray[np.bool_] = np.zeros(self._places.shape[:-1], bool)
        self._largest[..., 0] = True
        self.receivers = self._build_receivers()
        self.rate = self._compute_rate(*self.receivers.rates(x), leaks)

    def exchange(self, x: Array, shares: Array, tolerance: float) -> bool:
        """
        Exchange a place of each slot and disc for the worst at x, (N, U, 3), if near or worse.

        The worst place replaces the nearest of the disc's P places if it is within EXCHANGE.near
        radii; the dual of the near place carries over. Without a near place, it replaces the place
        with the smallest leak, and only if it is worse: its leak must exceed the largest leak to
        places (of its disc for colluding eavesdroppers, else of all discs) by a tolerance.

        :param shares: fraction of each slot for each ground node, (G, N).
        :param tolerance: the least excess of a leak [nats].
        :return: True if any worst place is worse.
        """
        worst, leaks = self._find_worst(x)
        grounds, place_leaks, heard = self.receivers.rates(x)
        self.rate = self._compute_rate(grounds, place_leaks, heard, leaks, shares)
        by_disc = place_leaks.reshape(*leaks.shape, -1)
        # Without collusion, the leak is the largest over all discs, so other discs do not matter.
        worse = leaks > tolerance + (by_disc.max(axis=2) if self._scenario.colluding else
                                     place_leaks.max(axis=1, keepdims=True))
        distances = np.linalg.norm(self._places - worst[:, :, None], axis=-1)
        near = distances.min(axis=-1) < EXCHANGE.near * self._radii
        replaced = np.where(near, distances.argmin(axis=-1), by_disc.argmin(axis=-1))
        slot, eve = np.nonzero(near | worse)
        replaced = replaced[slot, eve]
        self._places[slot, eve, replaced] = worst[slot, eve]
        self._largest[:] = False
        self._largest[slot, eve, replaced] = True
        self.receivers = self._build_receivers()
        return bool(worse.any())

    @property
    def discs(self) -> Discs:
        """
        Disc of each of E P places in a slot, by the names of core.pyi, in units of the grid.

        `radii` (N, E P), `offsets` of the places from the centres (N, E P, 2), and `moves_along`
        (N, E P): True for worst places, which move when the UAVs do.
        """
        slots, length = len(self._places), self._grid.length
        radii = np.repeat(self._radii / length, self._places.shape[2], axis=1)
        offsets = (self._places - self._centres[:, :, None]).reshape(slots, -1, 2) / length
        return {'radii': radii, 'offsets': offsets,
                'moves_along': self._largest.reshape(slots, -1) & (radii > 0)}

    def _find_worst(self, x: Array) -> tuple[Array, Array]:
        """Return the worst place of each disc (N, E, 2) in m, and its leak (N, E) in nats."""
        places, leaks = leak_maximisers(
            self._scenario, self._grid.positions(x)[:, 1:-1], self._grid.powers(x),
            self._discs)
        return places.swapaxes(0, 1), leaks.T * np.log(2)

    def _build_receivers(self) -> Receivers:
        places = self._places.reshape(len(self._places), -1, 2)
        return self._guarantee.at_places((places - self._grid.origin) / self._grid.length)

    def _compute_rate(self, grounds: Array, place_leaks: Array, heard: Array, leaks: Array,
                      shares: Array | None = None) -> float:
        """
        Return the least weighted mean rate over nodes [nats], by default with the best shares.

        :param grounds: rates of ground nodes, (N, G); `heard` has rates of listeners, (N, L).
        :param place_leaks: leaks to places, (N, E P); `leaks` has the worst of each disc, (N, E).
        """
        if self._scenario.colluding:
            most: Array = np.log1p(np.expm1(np.maximum(leaks, place_leaks)).sum(axis=1))
        else:
            most = np.maximum(leaks.max(axis=1), place_leaks.max(axis=1))
        most = include_listeners(self._scenario, most, heard.T, _NAT)
        rates = np.maximum(grounds.T - most, 0.0)
        if shares is None:
            shares = find_shares(self._scenario, rates, _NAT)
        return find_least_rate(self._scenario, (shares * rates).mean(axis=1), _NAT)
