"""What the planner says of its last request and plan: outcomes, summaries, and its status."""

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass
import time
from typing import NamedTuple

from diagnostic_msgs.msg import DiagnosticStatus
from rclpy.impl.rcutils_logger import RcutilsLogger
from rclpy.node import Node

from ..planner_status import (
    ApproachStatus, EnergyStatus, OutcomeStatus, PlannerStatus, PlanStatus, ProgressStatus)
from ...errors import brief, describe_error, PlanningError, StoppedError
from ...mission.validation import rate_text
from ...model.airspace.clearance import Approach
from ...plan.plan import Iteration, Plan
from ...plan.results import Bound

_LONGEST_REASON = 4000  # Largest number of characters of a refusal's reason.
_MOST_WARNINGS = 5  # Largest number of warnings about a subject until it is cleared.


class RequestOutcome(NamedTuple):
    """The outcome of the last request or replan, with a summary of its plan, or the refusal."""

    level: bytes  # A level of DiagnosticStatus.
    code: str  # 'ok', or the code of the error.
    text: str
    is_replan: bool = False  # Set for a refusal.


@dataclass
class State:
    """The last published plan, the refusal of the last request or replan, and counts."""

    plan: Plan | None = None
    prefix: str = ''  # Text before the summary of the plan.
    is_replan: bool = False
    bound: Bound | None = None
    refusal: RequestOutcome | None = None
    plans: int = 0
    replans: int = 0
    refusals: int = 0

    @property
    def outcome(self) -> RequestOutcome:
        """Outcome of the last request or replan: its refusal, or the summary of the last plan."""
        plan = self.plan
        if self.refusal is not None:
            return self.refusal
        if plan is None:
            return RequestOutcome(DiagnosticStatus.OK, 'ok', 'no plan yet')
        # A replan that reaches its short time limit is good: it is no worse than the last plan.
        is_done = plan.status == 'converged' or self.is_replan and plan.status == 'time_limit'
        good = is_done and not plan.clearance.is_close and plan.promise.slots
        return RequestOutcome(DiagnosticStatus.OK if good else DiagnosticStatus.WARN, 'ok',
                              self.prefix + plan_summary(plan, self.bound))

    def keep_requested(self, plan: Plan, prefix: str = '') -> None:
        """Make a requested plan the last plan, whose summary follows `prefix`, and count it."""
        self._keep(plan, is_replan=False)
        self.plans += 1
        self.prefix = prefix

    def keep_restored(self, plan: Plan) -> None:
        """Make the plan of the plan file the last plan, and count it as requested."""
        self.keep_requested(plan, 'restored: ')

    def keep_replan(self, plan: Plan) -> bool:
        """Make a replan the last plan; return False if the last plan has the same identity."""
        is_new = self.plan is None or plan.identity != self.plan.identity
        self._keep(plan, is_replan=True)
        if is_new:
            self.replans += 1
            self.prefix = ''
        return is_new

    def _keep(self, plan: Plan, is_replan: bool) -> None:
        self.plan, self.bound, self.refusal = plan, plan.bound, None
        self.is_replan = is_replan

    def forget_replan(self) -> None:
        """Forget the refusal of a replan that is no longer due."""
        if self.refusal is not None and self.refusal.is_replan:
            self.refusal = None

    def refuse(self, error: Exception, is_replan: bool) -> RequestOutcome:
        """Note and return a refusal: WARN; OK for a stopped replan; ERROR if no PlanningError."""
        level, reason = DiagnosticStatus.WARN, brief(error, _LONGEST_REASON)
        if not isinstance(error, PlanningError):
            kind = 'replan' if is_replan else 'solve'
            level, reason = DiagnosticStatus.ERROR, f'the {kind} failed: {describe_error(error)}'
        elif is_replan and isinstance(error, StoppedError):
            level = DiagnosticStatus.OK
        self.refusals += 1
        self.refusal = RequestOutcome(
            level, getattr(error, 'code', PlanningError.code),
            reason + ('' if self.plan is None else '; the last plan stands'), is_replan)
        return self.refusal


def plan_summary(plan: Plan, bound: Bound | None) -> str:
    """Return one line on a plan: method, promised rates, time, distances and bound."""
    near, rate_name = closest_approach_text(plan), plan.scenario.channel.rate_name
    promise, names = plan.promise, plan.scenario.ground_node_names
    nodes = '' if len(names) == 1 else '; ' + ', '.join(
        f'{name} {rate_text(rate)}' for name, rate in zip(names, promise.node_rates, strict=True))
    of_all = (f'; {promise.text}; all slots: {plan.guaranteed_rate:.4f}, '
              f'{plan.worst_case_rate:.4f} bit/s/Hz' if promise.is_partial else '')
    return (f'{brief(plan.method, 60)} plan of {plan.scenario.slots} slots: '
            f'{rate_name("guaranteed")} {rate_text(promise.guaranteed_rate)}, '
            f'{rate_name("worst_case")} {rate_text(promise.worst_case_rate)} bit/s/Hz{of_all}, '
            f'{plan.solve_time:.2f} s, '
            f'{_iterations(plan)} iterations, {plan.message}; along the curve '
            f'{rate_text(promise.curve_rate)}{nodes}' + (f'; {near}' if near else '')
            + ('' if bound is None else f'; {bound.claim(plan)}'))


def level_and_text(outcome: RequestOutcome, problems: Sequence[object],
                   progress: Iteration | None) -> tuple[bytes, str]:
    """
    Return the level of the planner's status and a text that explains it.

    The level is the outcome's, or OK during a solve, whose progress then replaces the outcome's
    text. With problems, the level is at least WARN, and their texts come first. STALE is not used,
    because tools take it for a node that is silent.
    """
    level, text = outcome.level, outcome.text
    if progress is not None:
        level = DiagnosticStatus.OK
        text = f'solving: iteration {progress.number}, {progress.rate:.4f} bit/s/Hz'
    if problems:
        level = max(level, DiagnosticStatus.WARN)
    return level, '; '.join(map(str, [*problems, text]))


def warn_of_namesakes(node: Node) -> str:
    """Return a warning of other nodes with the name of a node, or an empty string."""
    count = node.get_node_names_and_namespaces().count((node.get_name(), node.get_namespace()))
    return '' if count <= 1 else (
        f'{count} nodes are named {node.get_fully_qualified_name()}; stop the others')


class WarningLog:
    """Logs each warning about a subject once, at most 5 until the subject is cleared."""

    def __init__(self, log: RcutilsLogger) -> None:
        self._log = log
        # When each warning was logged [s of time.monotonic()], by subject and text.
        self._logged = defaultdict[str, dict[str, float]](dict)

    def warn(self, subject: str, text: str) -> None:
        """Log a warning once, at most _MOST_WARNINGS about a subject until it is cleared."""
        logged = self._logged[subject]
        if text not in logged and len(logged) < _MOST_WARNINGS:
            logged[text] = time.monotonic()
            self._log.warning(text)

    def clear(self, subject: str, age: float = 0.0) -> None:
        """Forget the warnings about a subject of this age [s] or more; they are logged again."""
        if logged := self._logged[subject]:
            newest = time.monotonic() - age
            self._logged[subject] = {text: at for text, at in logged.items() if at > newest}


def log_at(log: RcutilsLogger, level: bytes, text: str) -> None:
    """Log at a level of DiagnosticStatus; rclpy needs a separate call for each severity."""
    if level == DiagnosticStatus.ERROR:
        log.error(text)
    elif level == DiagnosticStatus.WARN:
        log.warning(text)
    else:
        log.info(text)


def make_status(state: State, progress: Iteration | None, is_solving: bool,
                problems: Sequence[object], now: float) -> PlannerStatus:
    """
    Return the PlannerStatus without pose_age, relay and track, which the node adds.

    :param progress: last iteration of the present solve, or None.
    """
    level, text = level_and_text(state.outcome, problems, progress)
    return PlannerStatus(
        level, text, 'solving' if is_solving else 'idle', OutcomeStatus(state.outcome.code),
        state.plans, state.replans, state.refusals,
        progress=ProgressStatus() if progress is None else ProgressStatus(
            progress.number, progress.step, progress.rate, progress.elapsed),
        plan=PlanStatus() if state.plan is None else plan_status(state.plan, state.bound, now))


def plan_status(plan: Plan, bound: Bound | None, now: float) -> PlanStatus:
    """Return the part of the status about a plan, at a time of the clock [s]."""
    promise, clearance, start_ns = plan.promise, plan.clearance, plan.start_ns or 0
    until, last = plan.promised_until, float(plan.times[-1])
    return PlanStatus(
        identity=plan.identity, stamp=start_ns * 1e-9, age=now - start_ns * 1e-9,
        promised_until=None if not plan.scenario.has_tracks else
        last if until is None else min(until, last),
        promised_slots=promise.slots, guaranteed_rate=promise.guaranteed_rate,
        worst_case_rate=promise.worst_case_rate,
        node_rate=dict(zip(
            plan.scenario.ground_node_names, promise.node_rates.tolist(), strict=True)),
        curve_rate=promise.curve_rate, bound=None if bound is None else bound.rate,
        claim=None if bound is None else bound.claim(plan),
        uav_distance=_approach_status(clearance.between_uavs, clearance.uavs_beyond_margin),
        zone_distance=_approach_status(clearance.to_zones, clearance.zones_beyond_margin),
        energy={uav.name: EnergyStatus(energy.total, energy.hovering, energy.flying)
                for uav, energy in zip(plan.scenario.uavs, plan.energies, strict=True)
                if energy is not None},
        method=brief(plan.method, 60), objective=plan.objective, status=plan.status,
        iterations=_iterations(plan), solve_time=plan.solve_time)


def _approach_status(approach: Approach | None, beyond_margin: float) -> ApproachStatus:
    return ApproachStatus() if approach is None else ApproachStatus(
        approach.distance, beyond_margin, ', '.join(approach.names), approach.time)


def closest_approach_text(plan: Plan) -> str:
    """Return in words how close UAVs come to each other (with advice if close) and to zones."""
    clearance = plan.clearance
    zones, margin = clearance.to_zones, plan.scenario.boundaries.margin_text
    texts = [clearance.between_uavs_text]
    if zones is not None:
        left = margin and f' ({clearance.zones_beyond_margin:.1f} m{margin})'
        texts.append(f'{zones.names[0]} comes within {zones.distance:.1f} m of {zones.names[1]}'
                     f'{left}')
    return '; '.join(filter(None, texts))


def _iterations(plan: Plan) -> int:
    return max(0, len(plan.history) - 1)  # The first entry is the start.
