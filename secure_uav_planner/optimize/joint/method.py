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
        self._left_out: list[tuple[Array, Array]] = []

    def from_present_plan(self) -> Status:
        """Improve the present plan."""
        return self._improve_present(self._schedule.warm_mu)

    def from_several_starts(self) -> Status:
        """
        Find the best of several starts on a coarse grid and finish it, and a close rival.

        Where starts end in different places, and jammers and eavesdroppers can be matched in
        several ways, those that were left out have a second chance.
        """
        schedule, scenario = self._schedule, self._search.scenario
        coarse, x, mus, others = self._starts()
        barrier = self._compete(coarse, x, mus, others)
        rates = barrier.rates()
        rivals = self._near_best(rates, schedule.rival_gap, schedule.rivals)
        statuses = [
            self._finish(self._on_finer_grids(coarse, barrier.x[[rival]], barrier.mu[rival]))
            for rival in rivals]
        self._try_powers_alone(coarse, rates[0])
        agreed = len(rates) == 1
        if not agreed or self._search.rate < schedule.low_rate:
            self._improve_again()
        if not agreed and (len(scenario.uavs) > 2 or len(scenario.eavesdroppers) > 1):
            self._try_left_out(barrier, rates[rivals])
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

    def _try_left_out(self, barrier: Barrier, known: Array) -> None:
        """
        Go on with the starts that were left out, and finish those that end in new places.

        :param barrier: the best starts, on the coarse grid.
        :param known: the rates there of those that have been finished.
        """
        schedule, coarse = self._schedule, barrier.grid
        x, mu = (np.concatenate(parts) for parts in zip(*self._left_out, strict=True))
        if not len(x):
            return
        with suppress(NumericalError, np.linalg.LinAlgError):
            others = self._barrier(coarse, x, mu)
            self._advance(others, schedule.left_out_steps, schedule.coarse_mu)
            x = np.concatenate([barrier.x, others.x])
            rates = np.concatenate([barrier.rates(), others.rates()])
            best = self._near_best(rates, schedule.left_out_gap, schedule.left_out_starts)
            x, rates = self._improved(
                coarse, x[best], rates[best],
                lambda again: self._advance(again, schedule.last_steps, schedule.coarse_mu))
            best = self._near_best(rates, schedule.left_out_gap, len(rates))
            new = (abs(rates[best, None] - known) > schedule.distinct * known).all(axis=1)
            chosen = best[new][:schedule.rivals]
            if len(chosen):
                fine = self._on_finer_grids(coarse, x[chosen], schedule.coarse_mu)
                self._finish(fine)
                self._improved(self._grid, fine.x, fine.rates(), self._finish)

    def _improved(self, grid: Grid, x: Array, rates: Array,
                  improve: Callable[[Barrier], object]) -> tuple[Array, Array]:
        """
        Improve starts from further inside, as _improve_again does the best plan.

        :param x: (S, N, U, 3).
        :param rates: of x, all positive, in nats, (S,).
        :param improve: improves the starts of a Barrier.
        :return: the better x, and their rates.
        """
        schedule = self._schedule
        for share in schedule.again_mus:
            barrier = self._barrier(grid, np.array([
                strictly_feasible(grid, grid.positions(one), grid.powers(one),
                                  share=schedule.warm_share) for one in x]), share * rates)
            improve(barrier)
            found = barrier.rates()
            x = np.where((found > rates)[:, None, None, None], barrier.x, x)
            rates = np.maximum(found, rates)
        return x, rates

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
        """Keep a share of the distinct starts of a Barrier, and at least all rivals."""
        distinct = self._distinct(barrier.rates())
        kept = max(self._schedule.rivals, int(np.ceil(share * len(distinct))))
        self._left_out.append((barrier.x[distinct[kept:]], barrier.mu[distinct[kept:]]))
        barrier.keep(distinct[:kept])

    def _near_best(self, rates: Array, gap: float, most: int) -> NDArray[np.intp]:
        """Return distinct starts, best first, that are at most a share below the best."""
        distinct = self._distinct(rates)
        return distinct[rates[distinct] >= (1 - gap) * rates[distinct[0]]][:most]

    def _distinct(self, rates: Array) -> NDArray[np.intp]:
        """Return one start of each rate, best first."""
        order = np.argsort(-rates)
        rates = rates[order]
        new = np.append(True, -np.diff(rates) > self._schedule.distinct * abs(rates[0]))
        distinct: NDArray[np.intp] = order[new]
        return distinct

    def _on_finer_grids(self, coarse: Grid, x: Array, mu: float | Array) -> Barrier:
        """
        Return starts on the full grid, by way of grids in between.

        :param x: on the coarse grid, (S, N, U, 3).
        :param mu: the barrier parameter that they have there, for all or for each.
        """
        schedule, full = self._schedule, self._grid.slots
        grid, mu = coarse, np.full(len(x), 1.0) * mu
        while grid.slots < full:
            if grid is not coarse:
                middle = self._barrier(grid, x, mu)
                self._converge(middle)
                x, mu = middle.x, middle.mu
            grids = int(np.ceil(np.log(full / grid.slots) / np.log(schedule.refinement)))
            finer = grid.divided(round(grid.slots * (full / grid.slots)**(1 / grids)))
            found = [refined(grid, one, finer) for one in x]
            inside = [one is not None for one in found]
            if not any(inside):
                raise NumericalError('no flight strictly inside the limits was found')
            grid, x, mu = finer, np.array([one for one in found if one is not None]), mu[inside]
            if (np.isfinite(grid.scenario.max_accelerations).any()
                    or not is_open(grid.scenario)):
                mu = np.maximum(mu, schedule.refined_mu)
        return self._barrier(grid, x, mu)

    def _converge(self, barrier: Barrier) -> None:
        """Converge on a grid in between."""
        for _ in range(self._schedule.steps):
            self._step(barrier, self._schedule.middle_mu)
            if barrier.finished.all():
                return

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
        alone = powers_without_jamming(search.scenario, flight)
        others = [] if alone is None else [alone]
        probe = self._fixed_flight(
            coarse, flight, schedule.powers_jamming, schedule.powers_mu, *others)
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
            self._grid, flight, schedule.powers_jamming, schedule.powers_mu, at_once.powers,
            *others))
        # A barrier that weighs much beside the rate leads away from jammers that are all but off.
        low_mu = min(schedule.powers_low_mu,
                     schedule.powers_low_share * np.log(2) * search.rate)
        if low_mu > 0:
            self._finish_powers(self._fixed_flight(
                self._grid, flight, schedule.powers_low_jamming, low_mu, at_once.powers,
                *others))

    def _finish_powers(self, barrier: Barrier) -> None:
        """Converge powers on a fixed flight, with many slots those of the best starts only."""
        if barrier.grid.slots > self._schedule.powers_few_slots:
            self._advance(barrier, self._schedule.powers_steps, self._schedule.coarse_mu)
            barrier.keep(self._distinct(barrier.rates())[:self._schedule.rivals])
        self._finish(barrier)

    def _fixed_flight(self, grid: Grid, flight: Array, jamming: tuple[float, ...], mu: float,
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
        """Take a number of steps from every start."""
        while steps > 0:
            steps -= self._step(barrier, mu, steps)

    def _step(self, barrier: Barrier, mu: float, steps: int = 1,
              try_finished: bool = False) -> int:
        """
        Take a step, or more, report them, and raise _Stop where the search must end.

        :param steps: the most that are taken together.
        :param try_finished: whether to propose what has finished before it is reported.
        :return: how many were taken.
        """
        before = barrier.solver_time
        try:
            taken = barrier.advance(steps, mu)
        except _Stop:
            self._try_best(barrier)
            raise
        self._search.solver_time += barrier.solver_time - before
        if self._search.stop_reason() is not None or try_finished and barrier.finished.all():
            self._try_best(barrier)
        for _ in range(taken):
            self._search.report('joint')
            self._check()
        return taken

    def _try_best(self, barrier: Barrier) -> None:
        """Propose the best start of a Barrier to the search, on the full grid."""
        x = barrier.x[barrier.rates().argmax()]
        if barrier.grid.slots != self._grid.slots:
            x = barrier.grid.refined(x, self._grid.slots)
        self._try(x)

    def _try(self, x: Array) -> None:
        """Propose variables of the full grid, (N, U, 3), to the search."""
        self._search.try_improve(self._grid.positions(x), self._grid.powers(x))
