"""
The joint method: positions and powers together.

Several starts are improved side by side on a coarse grid, the best are kept in stages, and the
winner is refined to the full grid, where a few more Newton steps finish it.
"""

from collections.abc import Callable
from contextlib import suppress

import numpy as np
from numpy.typing import NDArray

from .barrier import Barrier
from .kernel_barrier import make_barrier
from .schedule import SCHEDULE, Schedule
from .starts import refined, several_starts, strictly_feasible
from .worst_places import WorstPlaces
from ..baselines import constant_powers, fly_hover_fly_positions
from ..search import powers_without_jamming, Search
from ...errors import NumericalError
from ...grid import Grid
from ...limits import is_open
from ...plan import Status
from ...scenario import Array


def improve(search: Search, schedule: Schedule = SCHEDULE) -> Status:
    """
    Improve a Search by the joint method until it has converged or must stop; return its status.

    Whatever happens, the search keeps the best feasible iterate.

    :param search: a Search; when `warm`, its present plan is the only start.
    """
    if search.objective == 'worst_case' and search.scenario.error_radii.any():
        if not search.warm:
            # The plan of (P2) is where (P1) begins, and what it is never below.
            guaranteed = search.with_objective('guaranteed')
            plan = guaranteed.plan('joint', improve(guaranteed, schedule))
            search.try_improve(plan.positions, plan.powers)
            reason = search.stop_reason()
            if reason is not None:
                return reason
        return _until_stopped(_Joint(search, schedule).against_worst_places)
    method = _Joint(search, schedule)
    return _until_stopped(
        method.from_present_plan if search.warm else method.from_several_starts)


def _until_stopped(improve: Callable[[], Status]) -> Status:
    """Return the status in which a part of the method ends."""
    try:
        return improve()
    except _Stop as stop:
        return stop.status
    except (NumericalError, np.linalg.LinAlgError):
        return 'numerical_trouble'


class _Stop(Exception):
    """The search must end in a status."""

    def __init__(self, status: Status) -> None:
        super().__init__(status)
        self.status: Status = status


class _Joint:
    """The stages of the method on one Search."""

    def __init__(self, search: Search, schedule: Schedule) -> None:
        self._search = search
        self._schedule = schedule
        self._grid = Grid.of(search.scenario)

    def from_present_plan(self) -> Status:
        """Improve the present plan."""
        return self._improve_present(self._schedule.warm_mu)

    def from_several_starts(self) -> Status:
        """Find the best of several starts on a coarse grid and finish it, and a close rival."""
        schedule = self._schedule
        coarse, x, mus, others = self._starts()
        barrier = self._compete(coarse, x, mus, others)
        rates = barrier.rates()
        rivals = np.flatnonzero(rates >= (1 - schedule.rival_gap) * rates[0])[:schedule.rivals]
        statuses = [self._finish(self._on_finer_grids(barrier, rival)) for rival in rivals]
        self._try_powers_alone(coarse, rates[0])
        if len(rates) > 1 or self._search.rate < schedule.low_rate:
            self._improve_again()
        return 'converged' if 'converged' in statuses else statuses[0]

    def _starts(self) -> tuple[Grid, Array, Array, NDArray[np.bool_]]:
        """Return the coarsest grid on which there are starts, and these."""
        slots = self._schedule.coarse_slots
        while True:
            grid = self._grid.divided(min(self._grid.slots, slots))
            try:
                return grid, *several_starts(grid, self._schedule, self._check)
            except NumericalError:
                if slots >= self._grid.slots:
                    raise
            slots *= 2

    def _improve_again(self) -> None:
        """Improve the best plan from further inside, where steps lead past the nearest optimum."""
        with suppress(NumericalError, np.linalg.LinAlgError):
            for share in self._schedule.again_mus:
                if self._search.rate > 0:
                    self._improve_present(share * np.log(2) * self._search.rate)

    def _improve_present(self, mu: float) -> Status:
        """Improve the present plan, beginning with a barrier parameter."""
        x = strictly_feasible(self._grid, self._search.positions, self._search.powers,
                              share=self._schedule.warm_share)
        return self._finish(self._barrier(self._grid, x[None], mu))

    def against_worst_places(self) -> Status:
        """Improve the present plan against the worst places of the discs, problem (P1)."""
        schedule, search = self._schedule, self._search
        before = search.rate
        status, at_rest = self._with_places(schedule.steps)
        # Where places still moved to and fro, and much could be gained, there may be more.
        if not (at_rest or search.warm or search.rate < (1 + schedule.places_worth) * before):
            self._with_places(schedule.places_steps)
        return status

    def _with_places(self, steps: int) -> tuple[Status, bool]:
        """Improve the present plan as above, once; return also whether places came to rest."""
        schedule, search = self._schedule, self._search
        x = strictly_feasible(self._grid, search.positions, search.powers,
                              share=schedule.warm_share)
        places = WorstPlaces(self._grid, x)
        barrier = make_barrier(self._grid, x[None], schedule.warm_mu if search.warm
                               else schedule.places_mu, schedule, self._check, places)
        # Only what seems better than the present plan is worth a proof of its worst case.
        best, rate, tried = x, places.rate, search.rate * np.log(2)
        last_steps = 0
        for step in range(1, steps + 1):
            try:
                self._step(barrier, schedule.places_final_mu)
            except _Stop:
                self._try(best)
                raise
            last_steps += int(barrier.mu[0] <= schedule.places_final_mu)
            barrier.exchange(places, places.exchange(barrier.x[0], schedule.worse))
            if places.rate > rate:
                best, rate = barrier.x[0].copy(), places.rate
            at_rest = bool(barrier.finished.all())
            # Places may go on moving to and fro, by ever less.
            done = at_rest or last_steps >= schedule.places_patience
            if rate > tried and (
                    done or step == steps or step % schedule.try_every == 0):
                self._try(best)
                tried = rate
            if done:
                search.report('joint')
                return 'converged', at_rest
        return 'iteration_limit', False

    def _compete(self, grid: Grid, x: Array, mus: Array,
                 others: NDArray[np.bool_]) -> Barrier:
        """
        Return a Barrier of the best starts, best first.

        :param others: which of them are sent other ways.
        """
        schedule = self._schedule
        # A few of every kind first: in an easy mission all of them end in the same place.
        scouts = np.flatnonzero(others | (np.arange(len(x)) % schedule.scouts == 0))
        barrier = self._best_of(self._barrier(grid, x[scouts], mus[scouts]))
        self._try_best(barrier)
        if len(barrier.x) == 1:
            return barrier
        rest = np.setdiff1d(np.arange(len(x)), scouts)
        later = self._best_of(self._barrier(grid, x[rest], mus[rest]))
        barrier = self._barrier(grid, np.concatenate([barrier.x, later.x]),
                                np.concatenate([barrier.mu, later.mu]))
        self._select(barrier, 0.5)
        self._advance(barrier, schedule.last_steps, schedule.coarse_mu)
        self._select(barrier, 0.0)
        self._try_best(barrier)
        return barrier

    def _best_of(self, barrier: Barrier) -> Barrier:
        """Improve all starts of a Barrier and keep the best in stages."""
        for stage in self._schedule.stages:
            self._advance(barrier, stage.steps, self._schedule.coarse_mu)
            self._select(barrier, stage.keep)
            if len(barrier.x) == 1:
                break
        return barrier

    def _select(self, barrier: Barrier, share: float) -> None:
        """Keep a share of the distinct starts of a Barrier, best first."""
        barrier.keep(self._distinct(barrier.rates(), share))

    def _distinct(self, rates: Array, share: float) -> NDArray[np.intp]:
        """Return the best starts, one of each rate, best first, and at least all rivals."""
        order = np.argsort(-rates)
        rates = rates[order]
        new = np.append(True, -np.diff(rates) > self._schedule.distinct * abs(rates[0]))
        distinct: NDArray[np.intp] = order[new]
        return distinct[:max(self._schedule.rivals, int(np.ceil(share * len(distinct))))]

    def _on_finer_grids(self, barrier: Barrier, start: int) -> Barrier:
        """Return one start of a Barrier on the full grid, by way of grids in between."""
        schedule, full = self._schedule, self._grid.slots
        one = self._barrier(barrier.grid, barrier.x[[start]], barrier.mu[start])
        while one.grid.slots < full:
            slots = one.grid.slots
            if one.grid is not barrier.grid:
                self._advance(one, schedule.steps, schedule.middle_mu)
            grids = int(np.ceil(np.log(full / slots) / np.log(schedule.refinement)))
            finer = round(slots * (full / slots)**(1 / grids))
            grid = one.grid.divided(finer)
            x = refined(one.grid, one.x[0], grid)
            if x is None:
                raise NumericalError('no flight strictly inside the limits was found')
            mu = one.mu
            if (np.isfinite(grid.scenario.max_accelerations).any()
                    or not is_open(grid.scenario)):
                mu = np.maximum(mu, schedule.refined_mu)
            one = self._barrier(grid, x[None], mu)
        return one

    def _finish(self, barrier: Barrier) -> Status:
        """Converge on the full grid; return the status."""
        for step in range(1, self._schedule.steps + 1):
            self._step(barrier, self._schedule.final_mu, try_finished=True)
            if barrier.finished.all():
                return 'converged'
            if step % self._schedule.try_every == 0:
                self._try_best(barrier)
        self._try_best(barrier)
        return 'iteration_limit'

    def _try_powers_alone(self, coarse: Grid, joint_rate: float) -> None:
        """
        Try fly-hover-fly with optimised powers where that may be better than what was found.

        When the duration leaves almost no slack, the trajectory cannot change; with few slots,
        the power schedule decides. In both cases optimising the powers alone can win.

        :param joint_rate: of the best start on the coarse grid, in nats.
        """
        schedule, search = self._schedule, self._search
        flight = fly_hover_fly_positions(search.scenario)
        probe = self._fixed_flight(
            coarse, flight, schedule.powers_jamming, schedule.powers_mu)
        self._advance(probe, schedule.powers_probe_steps, schedule.coarse_mu)
        at_once = Search(search.scenario, flight, constant_powers(search.scenario))
        at_once.try_less_jamming()
        if (coarse.slots > schedule.powers_few_slots and search.rate > schedule.low_rate
                and probe.rates().max() < schedule.powers_near * joint_rate
                and at_once.rate < schedule.powers_near_at_once * search.rate):
            return
        if search.try_improve(flight, at_once.powers):
            search.report('power')
        self._finish_powers(self._fixed_flight(
            self._grid, flight, schedule.powers_jamming, schedule.powers_mu, at_once.powers))
        # A barrier that weighs much beside the rate leads away from jammers that are all but off.
        low_mu = min(schedule.powers_low_mu,
                     schedule.powers_low_share * np.log(2) * search.rate)
        if low_mu > 0:
            self._finish_powers(self._fixed_flight(
                self._grid, flight, schedule.powers_low_jamming, low_mu, at_once.powers))

    def _finish_powers(self, barrier: Barrier) -> None:
        """Converge powers on a fixed flight, with many slots those of the best starts only."""
        if barrier.grid.slots > self._schedule.powers_few_slots:
            self._advance(barrier, self._schedule.powers_steps, self._schedule.coarse_mu)
            self._select(barrier, 0.0)
        self._finish(barrier)

    def _fixed_flight(self, grid: Grid, flight: Array, jamming: tuple[float, ...], mu: float,
                      *more: Array) -> Barrier:
        """
        Return a Barrier whose positions are fixed on a flight.

        :param jamming: shares of their average power with which the jammers begin.
        :param mu: barrier parameter to begin with.
        :param more: further powers to begin with, (U, N) in W.
        """
        scenario = grid.scenario
        fixed = grid.with_fixed_positions()
        powers = [constant_powers(scenario, 0.9, share) for share in jamming]
        alone = powers_without_jamming(scenario, flight)
        found = [strictly_feasible(fixed, flight, one, share=0.0, least=1e-6)
                 for one in (*powers, *more, *([] if alone is None else [alone]))]
        x = np.array(found)
        x[..., 0] *= 0.99
        return self._barrier(fixed, x, mu)

    def _barrier(self, grid: Grid, x: Array, mu: float | Array) -> Barrier:
        """Return a Barrier that stops when the search must end."""
        return make_barrier(grid, x, mu, self._schedule, self._check)

    def _check(self) -> None:
        """Raise _Stop where the search must end."""
        reason = self._search.stop_reason()
        if reason is not None:
            raise _Stop(reason)

    def _advance(self, barrier: Barrier, steps: int, mu: float) -> None:
        """Take a number of steps, or fewer where a single start finishes sooner."""
        for _ in range(steps):
            self._step(barrier, mu)
            if len(barrier.x) == 1 and barrier.finished[0]:
                return

    def _step(self, barrier: Barrier, mu: float, try_finished: bool = False) -> None:
        """
        Take a step, report it, and raise _Stop where the search must end.

        :param try_finished: whether to propose what has finished before it is reported.
        """
        before = barrier.solver_time
        try:
            barrier.iterate(mu)
        except _Stop:
            self._try_best(barrier)
            raise
        self._search.solver_time += barrier.solver_time - before
        if self._search.stop_reason() is not None or try_finished and barrier.finished.all():
            self._try_best(barrier)
        self._search.report('joint')
        self._check()

    def _try_best(self, barrier: Barrier) -> None:
        """Propose the best start of a Barrier to the search, on the full grid."""
        x = barrier.x[barrier.rates().argmax()]
        if barrier.grid.slots != self._grid.slots:
            x = barrier.grid.refined(x, self._grid.slots)
        self._try(x)

    def _try(self, x: Array) -> None:
        """Propose variables of the full grid, (N, U, 3), to the search."""
        self._search.try_improve(self._grid.positions(x), self._grid.powers(x))
