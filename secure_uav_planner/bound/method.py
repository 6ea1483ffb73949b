"""From a scenario to a bound: choose eavesdroppers, search for multipliers, certify."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from itertools import count
import math

import numpy as np

from .proof.certificate import certify
from .proof.detours import DetourSearch
from .proof.reachable_set import Team
from .proof.relaxation import EavesdropperSubset, find_reference_snrs, MOST_GROUPS
from .search.multipliers import build_multipliers, MultiplierSearch
from ..errors import OptionError, PlanningError, TimeLimitError
from ..mission import OBJECTIVES
from ..mission.fields import check_argument, Choice
from ..mission.scenario import Scenario
from ..mission.validation import Array, checked_callback, checked_kind, checked_time_limit
from ..model.airspace import Airspace
from ..model.channel.links import has_free_space_links
from ..optimize import solve
from ..optimize.deadline import Deadline, DeadlineCheck, run_to_end
from ..plan.plan import Plan, POWER_TOLERANCE
from ..plan.results import Bound, check_plan, Iteration, Status

FEWEST_PLACES, MOST_PLACES = 3, 8
"""
Least and largest number of eavesdroppers' places; between these one place for each eavesdropper.

With a single disc and the objective 'worst_case', all 3 places lie in this disc. More places bound
the paper's missions no closer.
"""

COARSE = ((0.3, 2), (0.1, 2), (0.03, 3))
"""
Schedule for coarse groups: pairs of a temperature [nats] and its number of rounds.

Measured against the schedule with one round for each temperature, in the same time: the gap is
0.4% instead of 2% at T = 102 s with 'worst_case', and 0.4% instead of 25% in a mission of 8 slots.
"""

FINE = ((0.03, 1),)
"""First schedule for fine groups, with linear potentials; pairs as in COARSE."""

QUADRATIC = ((0.03, 2), (0.01, 2), (0.003, 2))
"""Second schedule for fine groups, with quadratic potentials; pairs as in COARSE."""

LINEAR = ((0.01, 3), (0.003, 3), (0.001, 1))
"""
Second schedule for fine groups, with linear potentials; pairs as in COARSE.

It is used for groups of several slots, and after QUADRATIC if the gap is above LARGE_GAP.
"""

DIVIDED = ((0.003, 6), (0.001, 4))
"""Schedule for fine groups after the first CUTS cells were added; pairs as in COARSE."""

SETTLED = ((0.01, 8), (0.003, 12), (0.001, 8))
"""Schedule for fine groups after the second CUTS cells were added; pairs as in COARSE."""

CUTS = 3
"""Number of cells that are added to every group before a certificate."""

SMALL_GAP = 0.005
"""
Gap above which a search adds exact best columns, and cells with multipliers of their own.

Measured: the three loosest of 38 missions with two to four eavesdroppers have gaps of 5.7, 5.0 and
2.0%, and 6.3, 8.1 and 2.6% if every cell is divided into four instead. They take three to five
times as long.
"""

WIDE_GAP = 0.02
"""Gap above which a search adds more cells, and takes as many rounds as SETTLED has."""

STUCK = 0.8
"""Largest part of a gap that the first CUTS cells may leave if more are to follow."""

DIVIDED_COST = 12.0
"""Largest ratio of the times of certificates with and without these cells."""

LARGE_GAP = 0.1
"""
Gap above which linear potentials are tried after quadratic ones.

Measured: 8 of 40 missions take 1.7 times as long, and 2 of the 8 get closer, 19.7% becoming 17.1%.
"""

SLOTS_A_GROUP, FEWEST_GROUPS = 4, 20
"""Slots of a coarse group, and the least number of coarse groups."""

ITERATIONS = 5
"""Largest number of Newton steps in a round."""

FIRST_CERTIFICATE = 0.7
"""Fraction of a time limit that is reserved for the first certificate."""

FINE_COST = 1.5
"""Largest ratio of a certificate's time per fine group to its time per coarse group."""

REPORT_PERIOD = 0.5
"""Time [s] without a better bound after which progress is reported again."""


def upper_bound(scenario: Scenario, *, objective: str = 'worst_case', plan: Plan | None = None,
                time_limit: float | None = None,
                on_progress: Callable[[Iteration], bool | None] | None = None) -> Bound:
    """
    Return a proven upper bound on the mean rate of every feasible plan of a scenario.

    It holds for every plan that Plan accepts for this scenario, tolerances included. It does not
    hold for the rates between the points, nor for another scenario or objective. It ignores
    separation and max_energy, and zones and a geofence of more than about 200 corners. These
    limits only lower the rates of plans.

    :param scenario: a Scenario with at most one jammer.
    :param objective: 'guaranteed' for the rate of problem (P2), by formula, or 'worst_case' for
        the rate of problem (P1), against the worst place of every disc.
    :param plan: a good Plan of the scenario, from which the search for multipliers starts; by
        default one that solve finds. A better plan may make the bound lower.
    :param time_limit: time [s] after which the best bound so far is returned.
    :param on_progress: called with an Iteration after every proven bound, and twice a second;
        returning True ends the search.
    :return: a Bound.
    :raises OptionError: for an unknown objective, a time limit that is not above 0, a plan of
        another scenario, or a scenario for which nothing is proven. These are scenarios with
        several jammers, several ground nodes, tracks, or a channel other than free space. Fading
        is allowed.
    """
    checked_kind('scenario', scenario, Scenario)
    check_argument('objective', objective, Choice(OBJECTIVES))
    if refusal := explain_refusal(scenario):
        raise OptionError(refusal)
    limit = checked_time_limit(time_limit)
    checked_callback('on_progress', on_progress)
    if plan is not None:
        check_plan(plan, scenario)
    numbers = count()

    def report(progress: Iteration) -> object:
        return on_progress is not None and on_progress(replace(progress, number=next(numbers)))

    detours = DetourSearch(Airspace(scenario))
    best = _BestBound(Deadline(report, limit, REPORT_PERIOD), FIRST_CERTIFICATE * (limit or 0.0))
    best.offer(compute_plain_bound(scenario))
    # A NaN in the computation makes a bound infinite, never wrong; see certify.
    with np.errstate(all='ignore'):
        status = run_to_end(_search_multipliers, best, detours, objective, plan)
    return Bound(scenario, best.rate, objective, list_ignored_limits(detours),
                 best.deadline.elapsed, status)


def explain_refusal(scenario: Scenario) -> str:
    """Return in one line why upper_bound refuses a scenario; empty if it accepts the scenario."""
    jammers, nodes = len(scenario.uavs) - 1, scenario.ground_nodes
    if len(nodes) > 1:
        return (f'scenario has {len(nodes)} ground_nodes; the proof of upper_bound holds for a '
                'single one')
    if jammers > 1:
        return f'scenario has {jammers} jammers; the proof of upper_bound holds for at most one'
    if not has_free_space_links(scenario):
        return (f'channel is {scenario.channel}; the proof of upper_bound holds for free space '
                'only, with or without fading')
    if scenario.has_tracks:
        return 'scenario has tracks; the proof of upper_bound holds for receivers that stand'
    return ''


def compute_plain_bound(scenario: Scenario) -> float:
    """
    Return a bound [bit/s/Hz] of the mean rate that needs no search.

    It is log2(1 + g p / H^2) at the average power p, with the transmitter above the ground node,
    the SNR g per W at 1 m, and no eavesdropper. It holds for every plan: the rate is concave in
    the power, so unequal powers only lower its mean. It ignores how far the transmitter must fly.
    """
    uav = scenario.uavs[0]
    log_snr = (math.log(find_reference_snrs(scenario)[0, 0])
               + math.log(uav.average_power + 2 * POWER_TOLERANCE) - 2 * math.log(uav.altitude))
    return float(np.logaddexp(0.0, log_snr) / math.log(2.0) * (1 + 1e-12))


def list_ignored_limits(detours: DetourSearch) -> tuple[str, ...]:
    """Return the names of the limits that a scenario has and the bound does not use."""
    # Obstacles with more than MOST_CORNERS corners at a UAV's altitude are not used.
    names = ('separation',) if detours.is_complete else (
        'separation', 'no_fly_zones', 'geofence')
    energy = ('max_energy',) if detours.scenario.limits_energy else ()
    return (*(name for name in names if getattr(detours.scenario, name)), *energy)


class _BestBound:
    """
    The best bound of a call of upper_bound, and the time that its certificates need.

    :param reserved: time [s] that is reserved for the first certificate.
    :ivar status: 'time_limit' after a search that ended early to leave time for its certificate.
    """

    def __init__(self, deadline: Deadline, reserved: float) -> None:
        self.deadline, self.rate = deadline, math.inf
        self.status: Status = 'converged'
        self._proving = reserved

    def reserve_time(self, ratio: float) -> DeadlineCheck:
        """
        Return a check that raises a TimeLimitError when only the next certificate's time is left.

        :param ratio: expected time of the next certificate over the time of the last one.
        """
        return partial(self.deadline.raise_if_over, ratio * self._proving)

    @contextmanager
    def proving(self, search: MultiplierSearch) -> Iterator[None]:
        """Run the with statement, a search; prove a bound, even if the reserved time ended it."""
        try:
            yield
        except TimeLimitError:
            self.status = 'time_limit'
        # If the whole time is over, the error is raised again and nothing is proven.
        self.deadline.raise_if_over()
        before = self.deadline.elapsed
        search.raise_if_over = self.deadline.raise_if_over
        self.offer(certify(search.team, build_multipliers(search), self.deadline.poll).rate)
        self._proving = self.deadline.elapsed - before
        self.deadline.raise_if_over()

    def has_gap(self, rate: float, gap: float) -> bool:
        """Return whether the bound exceeds (1 + gap) times a plan's rate; False for rate 0."""
        return bool(rate) and self.rate > (1 + gap) * rate

    def offer(self, rate: float) -> None:
        """Keep a proven bound if it is the lowest so far, and report the lowest."""
        self.rate = min(self.rate, rate)
        self.deadline.report(Iteration(0, 'bound', self.rate, self.deadline.elapsed, 0.0))


def _search_multipliers(best: _BestBound, detours: DetourSearch, objective: str,
                        plan: Plan | None) -> Status:
    """
    Search for multipliers on coarse groups, on fine groups, then with cells; prove each bound.

    Fine groups are tried with quadratic potentials if each is one slot, and with linear ones if
    that is not possible or leaves a gap to the plan above LARGE_GAP. The fine search with the
    lower bound gets cells.
    """
    scenario = detours.scenario
    positions, powers, rate = find_start(scenario, best.deadline, objective, plan)
    best.deadline.raise_if_over()
    subset = _select_eavesdroppers(scenario, objective, positions, powers)
    groups = min(scenario.slots, MOST_GROUPS)
    coarse_groups = max(-(-groups // SLOTS_A_GROUP), min(groups, FEWEST_GROUPS))
    coarse_team, fine_team = (Team.of(scenario, subset, detours.detours, most)
                              for most in (coarse_groups, groups))
    coarse = MultiplierSearch(coarse_team, positions, powers, best.reserve_time(1.0))
    with best.proving(coarse):
        _anneal(coarse, COARSE)
    leading = coarse
    ratio = FINE_COST * groups / coarse_groups
    for quadratic in (False,) if scenario.slots > MOST_GROUPS else (True, False):
        fine = MultiplierSearch(fine_team, positions, powers, best.reserve_time(ratio))
        fine.begin_from(coarse)
        before = best.rate
        _prove_on_fine_groups(best, fine, quadratic)
        if leading is coarse or best.rate < before:
            leading = fine
        if not best.has_gap(rate, LARGE_GAP):
            break
        ratio = 1.0
    _prove_with_cells(best, leading, rate)
    return best.status


def _select_eavesdroppers(scenario: Scenario, objective: str, positions: Array, powers: Array
                          ) -> EavesdropperSubset:
    """
    Return the places of eavesdroppers that leak most in a plan.

    For E eavesdroppers the number of places is max(3, min(E, 8)), or less if there are not so
    many. `positions` (U, N + 2, 2) in m and `powers` (U, N) in W are the plan's.
    """
    most = max(FEWEST_PLACES, min(len(scenario.eavesdroppers), MOST_PLACES))
    subset = EavesdropperSubset.of(scenario, objective)
    # 400 slots suffice to show which eavesdroppers matter.
    sample = np.unique(np.linspace(
        1, scenario.slots, min(scenario.slots, MOST_GROUPS)).astype(int))
    sinrs = subset.compute_sinrs(
        scenario, positions[:, [0, *sample, scenario.slots + 1]], powers[:, sample - 1])
    return subset.select_loudest(sinrs, most, scenario.colluding)


def _prove_on_fine_groups(best: _BestBound, fine: MultiplierSearch, quadratic: bool) -> None:
    """Search with linear potentials (FINE), then QUADRATIC or LINEAR ones, and prove a bound."""
    fine.raise_if_over()
    with best.proving(fine):
        _anneal(fine, FINE)
        if quadratic:
            fine.add_quadratic_part()
        _anneal(fine, QUADRATIC if quadratic else LINEAR)


def _prove_with_cells(best: _BestBound, search: MultiplierSearch, rate: float) -> None:
    """
    Add CUTS cells to every group, search thoroughly, and prove a bound; up to two such passes.

    The first pass needs a gap (bound / rate - 1) above SMALL_GAP, the second one above WIDE_GAP.
    The second is left out if the first kept more than the share STUCK of the gap.

    :param rate: the plan's rate [bit/s/Hz], or 0 without a plan, which allows no pass.
    """
    ratio = DIVIDED_COST
    for gap, schedule in ((SMALL_GAP, DIVIDED), (WIDE_GAP, SETTLED)):
        if not best.has_gap(rate, gap):
            return
        search.raise_if_over = best.reserve_time(ratio)
        search.raise_if_over()
        search.thorough = True
        before = best.rate
        with best.proving(search):
            for _ in range(CUTS):
                search.cut_cells(schedule[0][0])
                search.minimise(schedule[0][0], ITERATIONS)
            _anneal(search, schedule)
        if best.rate - rate > STUCK * (before - rate):
            return
        ratio = 2.0  # Time of the second certificate over the time of the first one.


def find_start(scenario: Scenario, deadline: Deadline, objective: str,
               plan: Plan | None) -> tuple[Array, Array, float]:
    """
    Return positions (U, N + 2, 2) in m, powers (U, N) in W and the rate [bit/s/Hz] of a plan.

    By default solve has half of the time left for a plan of at most MOST_GROUPS slots, whose
    nearest points and powers are repeated in all N slots. If it finds no plan, the positions are
    straight lines, the powers are the average powers, and the rate is 0.

    :param plan: the plan, or None.
    """
    if plan is not None:
        return plan.positions, plan.powers, getattr(plan, f'{objective}_rate')
    slots = min(scenario.slots, MOST_GROUPS)
    try:
        plan = solve(replace(scenario, slots=slots), objective=objective,  # type: ignore[arg-type]
                     on_iteration=lambda _: deadline.poll(),
                     time_limit=max(deadline.time_left / 2, 1e-3))
        positions, powers, rate = plan.positions, plan.powers, plan.rate
    except PlanningError:
        # The mission cannot be flown in 400 slots, or was not planned in time.
        start = np.array([[uav.start] for uav in scenario.uavs])
        goal = np.array([[uav.goal] for uav in scenario.uavs])
        positions = start + (goal - start) * np.linspace(0, 1, slots + 2)[:, None]
        powers, rate = np.array([[uav.average_power] * slots for uav in scenario.uavs]), 0.0
    point = np.round(np.linspace(0, slots + 1, scenario.slots + 2)).astype(int)
    return positions[:, point], powers[:, np.clip(point[1:-1] - 1, 0, slots - 1)], rate


def _anneal(search: MultiplierSearch, schedule: tuple[tuple[float, int], ...]) -> None:
    """Minimise the dual function at falling temperatures [nats], with rounds of steps at each."""
    for tau, rounds in schedule:
        for _ in range(rounds):
            search.raise_if_over()
            search.minimise(tau, ITERATIONS)
