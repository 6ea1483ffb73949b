"""From a scenario to a bound: choose eavesdroppers, search for multipliers, certify."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
import math
import time

import numpy as np

from .proof.certificate import certify
from .proof.detours import uses_detours
from .proof.reachable_set import Team
from .proof.relaxation import EavesdropperSubset, find_reference_snrs, MOST_GROUPS, SlotGroups
from .search.multipliers import build_multipliers, MultiplierSearch
from .search.variables import DualPoint, InitialMultipliers
from ..errors import OptionError, PlanningError
from ..mission import OBJECTIVES
from ..mission.scenario import Scenario
from ..mission.validation import (
    Array, checked_callback, checked_choice, checked_kind, checked_time_limit)
from ..optimize import solve
from ..plan.plan import Plan, POWER_TOLERANCE
from ..plan.results import Bound, check_plan, Progress

FEWEST_PLACES, MOST_PLACES = 3, 8
"""
Limits of the number of places that the bound uses; between them a place for every eavesdropper.

Against the worst case in a single disc they all lie in it: more places bound the paper's missions
no closer.
"""

COARSE = ((0.3, 2), (0.1, 2), (0.03, 3))
"""
Temperatures of coarse groups in nats, with the rounds of new columns at each.

Measured: a single round at each leaves 2% at T = 102 s against the worst case instead of 0.4%, and
25% instead of 0.4% in a mission of 8 slots, in the same time.
"""

FINE = ((0.03, 1),)
"""The same of fine groups, with linear potentials."""

QUADRATIC = ((0.03, 2), (0.01, 2), (0.003, 2))
"""The same after these, with quadratic potentials."""

LINEAR = ((0.01, 3), (0.003, 3), (0.001, 1))
"""The same with linear potentials, where a group has several slots or the gap is large."""

LARGE_GAP = 0.1
"""
Gap above which linear potentials are tried, too.

Measured: 8 of 40 missions take 1.7 times as long, 2 of them get closer, 19.7% becoming 17.1%.
"""

SLOTS_A_GROUP, FEWEST_GROUPS = 4, 20
"""Slots of a coarse group, and the least number of coarse groups."""

ITERATIONS = 5
"""Newton steps of a round."""

FIRST_CERTIFICATE = 0.7
"""Share of a time limit that is reserved for the first certificate."""

FINE_COST = 1.5
"""Time that a certificate takes per fine group, over that per coarse group, at most."""

REPORT_PERIOD = 0.5
"""Time in s after which progress is reported without a better bound."""


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
        another scenario, or a scenario for which nothing is proven: with several jammers,
        tracks, or another channel than free space, with or without fading.
    """
    started = time.monotonic()
    checked_kind('scenario', scenario, Scenario)
    checked_choice('objective', objective, OBJECTIVES)
    if refusal := explain_refusal(scenario):
        raise OptionError(refusal)
    limit = checked_time_limit(time_limit)
    checked_callback('on_progress', on_progress)
    if plan is not None:
        check_plan(plan, scenario)
    run = _Run(started, limit, on_progress)
    run.offer(compute_plain_bound(scenario))
    # A NaN on the way makes a bound infinite, never wrong; see certify.
    with np.errstate(all='ignore'):
        _search_multipliers(run, scenario, objective, plan)
    return Bound(scenario, run.rate, objective, list_ignored_limits(scenario),
                 time.monotonic() - started, run.outcome)


def explain_refusal(scenario: Scenario) -> str:
    """Return the reason for which a scenario has no bound, in one line; empty if it has one."""
    jammers = len(scenario.uavs) - 1
    if jammers > 1:
        return f'scenario has {jammers} jammers; the proof of upper_bound holds for at most one'
    if not scenario.channel.is_inverse_square:
        return (f'channel is {scenario.channel}; the proof of upper_bound holds for free space '
                'only, with or without fading')
    if scenario.has_tracks:
        return 'scenario has tracks; the proof of upper_bound holds for receivers that stand'
    return ''


def compute_plain_bound(scenario: Scenario) -> float:
    """
    Return a bound that needs no search, in bit/s/Hz.

    No plan does better than with the transmitter above the ground node and no eavesdropper: then
    log(1 + g p / H^2) in every slot, whose mean is at most that of the mean power.
    """
    uav = scenario.uavs[0]
    log_snr = (math.log(find_reference_snrs(scenario)[0, 0])
               + math.log(uav.average_power + 2 * POWER_TOLERANCE) - 2 * math.log(uav.altitude))
    return float(np.logaddexp(0.0, log_snr) / math.log(2.0) * (1 + 1e-12))


def list_ignored_limits(scenario: Scenario) -> tuple[str, ...]:
    """Return the names of a scenario's limits that the bound does not use."""
    names = ('separation',) if uses_detours(scenario) else (
        'separation', 'no_fly_zones', 'geofence')
    return tuple(name for name in names if getattr(scenario, name))


class _Run:
    """The clock, the callback and the best bound of a call of upper_bound."""

    def __init__(self, started: float, limit: float | None,
                 on_progress: Callable[[Progress], bool | None] | None) -> None:
        self.rate, self.status = math.inf, ''
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

    def reserve_time(self, ratio: float) -> Callable[[], bool]:
        """
        Return the `stop` of a search that leaves time for its certificate.

        :param ratio: of the time of that certificate to the time of the last one.
        """
        def stop() -> bool:
            if not self.status and self.time_left <= ratio * self._proving:
                self._late = True
                return True
            return self.stop()
        return stop

    def prove(self, search: MultiplierSearch) -> None:
        """Offer the bound that a search's multipliers prove in the time left."""
        if self.stop():
            return
        before = time.monotonic()
        self.offer(certify(search.team, build_multipliers(search), self.stop).rate)
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
        """Return True if the search must end; report progress if it is due."""
        if not self.status and self.time_left <= 0:
            self.status = 'time_limit'
        elif not self.status and time.monotonic() - self._reported > REPORT_PERIOD:
            self._report()
        return bool(self.status)


def _search_multipliers(run: _Run, scenario: Scenario, objective: str, plan: Plan | None) -> None:
    """Search for multipliers on coarse and on fine groups, and prove a bound with each."""
    positions, powers, rate = find_start(scenario, run.time_left, objective, plan, run.stop)
    if run.stop():
        return
    most = max(FEWEST_PLACES, min(len(scenario.eavesdroppers), MOST_PLACES))
    subset = EavesdropperSubset.of(scenario, objective)
    # A few hundred slots show which eavesdroppers matter.
    sample = np.unique(np.linspace(
        1, scenario.slots, min(scenario.slots, MOST_GROUPS)).astype(int))
    sinrs = subset.compute_sinrs(
        scenario, positions[:, [0, *sample, scenario.slots + 1]], powers[:, sample - 1])
    subset = subset.select_loudest(sinrs, most, scenario.colluding)

    def build_level(groups: int) -> tuple[Team, InitialMultipliers]:
        team = Team.of(scenario, subset, groups)
        return team, InitialMultipliers.of(team, positions, powers)

    groups = min(scenario.slots, MOST_GROUPS)
    coarse_groups = max(-(-groups // SLOTS_A_GROUP), min(groups, FEWEST_GROUPS))
    coarse = MultiplierSearch(*build_level(coarse_groups), None, run.reserve_time(1.0))
    _anneal(coarse, COARSE)
    run.prove(coarse)
    team, initial = build_level(groups)
    point = _refine_point(coarse, team.groups, initial.weight)
    ratio = FINE_COST * groups / coarse_groups
    for quadratic in (False,) if scenario.slots > MOST_GROUPS else (True, False):
        fine = MultiplierSearch(team, initial, point, run.reserve_time(ratio))
        if fine.stop():
            break
        _anneal(fine, FINE)
        if quadratic:
            fine.add_quadratic_part()
        _anneal(fine, QUADRATIC if quadratic else LINEAR)
        run.prove(fine)
        if not rate or run.rate <= (1 + LARGE_GAP) * rate:
            break
        ratio = 1.0


def find_start(scenario: Scenario, time_left: float, objective: str, plan: Plan | None,
               stop: Callable[[], bool]) -> tuple[Array, Array, float]:
    """
    Return positions (U, N + 2, 2) in m and powers (U, N) in W of a plan, and its rate.

    Without a plan these are straight lines at the average powers, and the rate is 0.

    :param time_left: in s.
    :param plan: by default the one that solve finds in half of that time.
    :param stop: asked after every iteration of solve; True ends it.
    """
    if plan is not None:
        return plan.positions, plan.powers, getattr(plan, f'{objective}_rate')
    slots = min(scenario.slots, MOST_GROUPS)
    try:
        plan = solve(replace(scenario, slots=slots), objective=objective,  # type: ignore[arg-type]
                     on_iteration=lambda _: stop(),
                     time_limit=None if math.isinf(time_left) else max(time_left / 2, 1e-3))
        positions, powers, rate = plan.positions, plan.powers, plan.rate
    except PlanningError:
        # A mission that cannot be flown in so few slots, or not be planned before the search ends.
        start = np.array([[uav.start] for uav in scenario.uavs])
        goal = np.array([[uav.goal] for uav in scenario.uavs])
        positions = start + (goal - start) * np.linspace(0, 1, slots + 2)[:, None]
        powers, rate = np.array([[uav.average_power] * slots for uav in scenario.uavs]), 0.0
    point = np.round(np.linspace(0, slots + 1, scenario.slots + 2)).astype(int)
    return positions[:, point], powers[:, np.clip(point[1:-1] - 1, 0, slots - 1)], rate


def _anneal(search: MultiplierSearch, schedule: tuple[tuple[float, int], ...]) -> None:
    """Minimise the dual function at falling temperatures."""
    for tau, rounds in schedule:
        for _ in range(rounds):
            if search.stop():
                return
            search.minimise(tau, ITERATIONS)


def _refine_point(search: MultiplierSearch, new: SlotGroups, weights: Array) -> DualPoint:
    """
    Return a search's multipliers, interpolated to shorter groups.

    :param weights: w0 of the new groups.
    """
    point, old, weight = search.point, search.team.groups, search.weight
    x = point.potentials.reshape(len(old.edges), -1)
    potentials = np.stack([np.interp(new.edges, old.edges, column) for column in x.T], -1)
    group = np.searchsorted(old.last, (new.first + new.last) // 2)
    # The slack w0 - s, which may be tiny, stays the same.
    v = point.v[group]
    total = v.sum(-1)
    new_total = np.clip(weights - (weight[group] - total), 0.02, weights * (1 - 1e-7))
    return replace(point, potentials=potentials.reshape(-1, *point.potentials.shape[1:]),
                   v=v * (new_total / total)[..., None])
