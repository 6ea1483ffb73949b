"""From a scenario to a bound: who counts, a search for multipliers, a certificate."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
import math
import time

import numpy as np

from .proof.certificate import certify
from .proof.conjugate import Array
from .proof.detours import are_used
from .proof.rounding import negative_power
from .proof.stages import MOST_STAGES, Stages
from .proof.subset import EavesdropperSubset
from .proof.team import Team
from .search import reference
from .search.breakpoints import breakpoint_multipliers
from .search.initial_multipliers import InitialMultipliers
from .search.multiplier_search import MultiplierSearch
from .search.newton import DualPoint
from ..errors import OptionError
from ..mission import OBJECTIVES
from ..mission.scenario import Scenario
from ..mission.validation import (
    checked_callback, checked_choice, checked_kind, checked_time_limit)
from ..plan.bound import Bound, checked_plan, Progress
from ..plan.plan import Plan, POWER_TOLERANCE

FEWEST_PLACES, MOST_PLACES = 3, 8
"""
Places of eavesdroppers that are counted with: one for everybody who listens, within these.

With one disc all are places in it, for the worst case: more bound the paper's missions no closer.
"""

COARSE = ((0.3, 2), (0.1, 2), (0.03, 3))
"""
Temperatures in nats, and how often columns are chosen anew at each, of coarse stages.

Measured: once each leaves 2% at T = 102 s against the worst case instead of 0.4%, and 25% instead
of 0.4% in a mission of 8 slots, in the same time.
"""

FINE = ((0.03, 1),)
"""The same where every slot is a stage, with linear potentials."""

CURVED = ((0.03, 2), (0.01, 2), (0.003, 2))
"""The same with quadratic potentials."""

LINEAR = ((0.01, 3), (0.003, 3), (0.001, 1))
"""What follows instead where potentials must stay linear."""

SLOTS_A_STAGE, FEWEST = 4, 20
"""Slots in a coarse stage, and how many such stages there are at least."""

ITERATIONS = 5
"""Newton steps on the same columns."""

FIRST_CERTIFICATE = 0.7
"""Share of a time limit that is kept for the first certificate."""

LONGER = 1.5
"""How many times longer a stage's certificate may take than on coarse stages, if time is short."""

REPORT_PERIOD = 0.5
"""Time in s after which progress is reported although no better bound was proven."""


def upper_bound(scenario: Scenario, *, objective: str = 'worst_case', plan: Plan | None = None,
                time_limit: float | None = None,
                on_progress: Callable[[Progress], bool | None] | None = None) -> Bound:
    """
    Return a proven upper bound on the mean rate of every feasible plan of a scenario.

    It holds for everything that a Plan accepts, with its tolerances. It does not use separation,
    nor zones and a geofence of very many corners: they only lower what plans can reach.

    :param scenario: a Scenario with at most one jammer.
    :param objective: 'guaranteed' for the rate of problem (P2), by formula, or 'worst_case' for
        that of (P1), against the worst place of every disc.
    :param plan: a good Plan of the scenario, from which the search for multipliers starts; by
        default one that solve finds. A better plan may make the bound lower.
    :param time_limit: in s; past it the best bound so far is returned.
    :param on_progress: called with a Progress after every bound that was proven, and twice a
        second; returning True ends the search.
    :return: a Bound.
    :raises OptionError: for an unknown objective, a time limit that is not above 0, a plan of
        another scenario, or a scenario for which nothing is proven: with several jammers, or
        another channel than free space without fading.
    """
    started = time.monotonic()
    checked_kind('scenario', scenario, Scenario)
    checked_choice('objective', objective, OBJECTIVES)
    if refusal := explain_refusal(scenario):
        raise OptionError(refusal)
    limit = checked_time_limit(time_limit)
    checked_callback('on_progress', on_progress)
    if plan is not None:
        checked_plan(plan, scenario)
    run = _Run(started, limit, on_progress)
    run.offer(plain_bound(scenario))
    # Where nothing but infinity is true, or where the plain bound is nothing, no search helps.
    if 0 < run.rate < math.inf:
        # Whatever is not a number on the way makes a bound infinite, never wrong; see boxes.
        with np.errstate(all='ignore'):
            _search(run, scenario, objective, plan)
    return Bound(scenario, run.rate, objective, ignored_limits(scenario),
                 time.monotonic() - started, run.outcome)


def explain_refusal(scenario: Scenario) -> str:
    """Return why nothing is proven for a scenario, in one line; nothing where a bound is."""
    jammers = len(scenario.uavs) - 1
    if jammers > 1:
        return f'scenario has {jammers} jammers; the proof of upper_bound holds for at most one'
    if not scenario.channel.is_free_space:
        return (f'channel is {scenario.channel}; the proof of upper_bound holds for free space '
                'without fading only')
    return ''


def plain_bound(scenario: Scenario) -> float:
    """
    Return a bound that takes no search, in bit/s/Hz, perhaps infinite.

    No plan does better than with the transmitter above the ground node and nobody listening: then
    log(1 + g p / H^2) in every slot, whose mean is at most that of the mean power. Jammers below
    zero may lower the noise by the share delta, as in rounding.negative_power.
    """
    negative, delta = negative_power(scenario)
    if not math.isfinite(negative):
        return math.inf
    uav = scenario.uavs[0]
    power = uav.average_power + 2 * POWER_TOLERANCE
    noise = 1.0 - float(delta[1:].sum())
    log_snr = (math.log(scenario.reference_snr) + math.log(power) - 2 * math.log(uav.altitude)
               - math.log(noise))
    return float((np.logaddexp(0.0, log_snr) + negative) / math.log(2.0) * (1 + 1e-12))


def ignored_limits(scenario: Scenario) -> tuple[str, ...]:
    """Return the names of a scenario's limits that the bound does not use."""
    names = ['separation'] if are_used(scenario) else ['separation', 'no_fly_zones', 'geofence']
    return tuple(name for name in names if getattr(scenario, name))


class _Run:
    """The clock, the callback and the best bound of one call."""

    def __init__(self, started: float, limit: float | None,
                 on_progress: Callable[[Progress], bool | None] | None) -> None:
        self.rate, self.status, self.limited = math.inf, '', limit is not None
        self._started, self._on_progress = started, on_progress
        self._deadline = math.inf if limit is None else started + limit
        self._proving = 0.0 if limit is None else FIRST_CERTIFICATE * limit
        self._number = 0
        self._reported = started
        self._late = False

    @property
    def time_left(self) -> float:
        """Time until the deadline in s, infinite without one."""
        return self._deadline - time.monotonic()

    def keeping(self, times: float) -> Callable[[], bool]:
        """
        Return what tells a search to end while there is time for its certificate.

        :param times: how much longer than the last certificate the next one may take.
        """
        def stop() -> bool:
            if not self.status and self.time_left <= times * self._proving:
                self._late = True
                return True
            return self.stop()
        return stop

    def prove(self, search: MultiplierSearch) -> None:
        """Offer what a search's multipliers prove, in the time that is left."""
        before = time.monotonic()
        self.offer(certify(
            search.team, breakpoint_multipliers(search), self.stop).rate)
        self._proving = time.monotonic() - before

    def offer(self, rate: float) -> None:
        """Keep a proven bound if it is the lowest, and report."""
        self.rate = min(self.rate, rate)
        self._report()

    def _report(self) -> None:
        self._reported = time.monotonic()
        if self._on_progress is not None:
            progress = Progress(self._number, self.rate, time.monotonic() - self._started)
            if self._on_progress(progress):
                self.status = self.status or 'cancelled'
        self._number += 1

    @property
    def outcome(self) -> str:
        """Return the status of the bound."""
        return self.status or ('time_limit' if self._late else 'converged')

    def stop(self) -> bool:
        """Return whether the search must end, and remember why."""
        if not self.status and self.time_left <= 0:
            self.status = 'time_limit'
        elif not self.status and time.monotonic() - self._reported > REPORT_PERIOD:
            self._report()
        return bool(self.status)


def _search(run: _Run, scenario: Scenario, objective: str, plan: Plan | None) -> None:
    """Offer what the search proves."""
    positions, powers = reference.start(scenario, run.time_left, objective, plan)
    if run.stop():
        return
    most = max(FEWEST_PLACES, min(len(scenario.eavesdroppers), MOST_PLACES))
    everyone = EavesdropperSubset.of(scenario, objective)
    # A few hundred slots tell who counts.
    some = np.unique(np.linspace(1, scenario.slots, min(scenario.slots, MOST_STAGES)).astype(int))
    chosen = everyone.loudest(everyone.leaks(
        scenario, positions[:, [0, *some, scenario.slots + 1]], powers[:, some - 1]), most)

    def level(slots: int) -> tuple[Team, InitialMultipliers]:
        team = Team.of(scenario, chosen, slots)
        return team, InitialMultipliers.of(team, positions, powers)

    slots = min(scenario.slots, MOST_STAGES)
    coarse = max(-(-slots // SLOTS_A_STAGE), min(slots, FEWEST))
    search = MultiplierSearch(*level(coarse), None, run.keeping(1.0))
    _follow(search, COARSE)
    proven = run.limited
    if proven:
        run.prove(search)
    team, initial = level(slots)
    finer = MultiplierSearch(team, initial, _finer(search, team.stages, initial.weight),
                             run.keeping(LONGER * slots / coarse))
    if not finer.stop():
        search, proven = finer, False
        _follow(search, FINE)
        if scenario.slots > MOST_STAGES:
            _follow(search, LINEAR)
        else:
            search.curve()
            _follow(search, CURVED)
    if not proven and not run.stop():
        run.prove(search)


def _follow(search: MultiplierSearch, schedule: tuple[tuple[float, int], ...]) -> None:
    """Take a search through temperatures."""
    for tau, times in schedule:
        for _ in range(times):
            if search.stop():
                return
            search.minimise(tau, ITERATIONS)


def _finer(search: MultiplierSearch, new: Stages, weights: Array) -> DualPoint:
    """
    Return a search's multipliers for shorter stages.

    :param weights: w0 of the new stages.
    """
    point, old, weight = search.point, search.team.stages, search.weight
    x = point.potentials.reshape(len(old.edges), -1)
    potentials = np.stack([np.interp(new.edges, old.edges, column) for column in x.T], -1)
    stage = np.searchsorted(old.last, (new.first + new.last) // 2)
    # What matters is w0 - s, which may be tiny: it is kept.
    v = point.shares[stage]
    total = v.sum(-1)
    wanted = np.clip(weights - (weight[stage] - total), 0.02, weights * (1 - 1e-7))
    return replace(point, potentials=potentials.reshape(-1, *point.potentials.shape[1:]),
                   shares=v * (wanted / total)[..., None])
