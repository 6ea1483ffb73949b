"""The status that the planner reports: a level and a text for diagnostics, and values by key."""

from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

from diagnostic_msgs.msg import DiagnosticStatus
from rclpy.impl.rcutils_logger import RcutilsLogger
from rclpy.node import Node

from .poses import PoseBook
from ..topics import member_topics
from ...errors import brief, describe_error, PlanningError, StoppedError
from ...plan.plan import Iteration, Plan
from ...plan.promise import rate_text
from ...plan.results import Bound

_LONGEST_REASON = 4000
_MOST_WARNINGS = 5  # About a subject, until it is cleared.

STATUS_KEYS = {
    'state': '`idle` or `solving`',
    'outcome.code': 'of the last request or replan: `ok`, or the code of its error',
    'plans': 'plans made by request since the start',
    'replans': 'plans made in flight by the planner itself',
    'refusals': 'requests and replans without a plan',
    'progress.iteration': 'during a solve: its last iteration',
    'progress.step': 'what that iteration was',
    'progress.rate': 'the rate so far, bit/s/Hz',
    'progress.elapsed': 'since the solve began, s',
    'plan.identity': '8 digits that tell the last plan from others',
    'plan.stamp': 'the time of its point 0, s',
    'plan.age': 'since that time, s; below zero before it',
    'plan.promised_until': 'where receivers move: until when its rates are promised, s from '
                           'point 0',
    'plan.promised_slots': 'number of slots whose rates are promised; rates are means over these '
                           'slots, `none` without any',
    'plan.guaranteed_rate': 'its guaranteed rate, bit/s/Hz',
    'plan.worst_case_rate': 'its worst-case rate, bit/s/Hz',
    'plan.node_rate.<ground_node>': 'mean rate of a ground node by the objective, bit/s/Hz',
    'plan.curve_rate': 'its guaranteed rate along the flown curve, bit/s/Hz',
    'plan.bound': 'what no plan can exceed, bit/s/Hz, with the parameter `bound`',
    'plan.claim': 'that bound in words',
    'plan.uav_distance': 'smallest distance between any two UAVs, m; below 5 m without a '
                         '`separation`, the level is WARN',
    'plan.zone_distance': 'smallest distance of any UAV from a no-fly zone as given, m',
    'plan.<which>_distance.beyond_margin': 'what is left of that distance if every UAV is off by '
                                           '`tracking_margin`, m',
    'plan.<which>_distance.between': 'which two come so close',
    'plan.<which>_distance.time': 'when they do, s from point 0',
    'plan.energy.<uav>': 'energy of the flight of a UAV by the model of its propulsion, J',
    'plan.energy.<uav>.<part>': 'the part of it while `hovering`, or `flying`, J',
    'plan.method': 'what made the plan',
    'plan.objective': 'which rate that maximised',
    'plan.status': 'why it stopped',
    'plan.iterations': 'how many it took',
    'plan.solve_time': 'how long it took, s',
    'pose_age.<topic>': 'age of the last pose or odometry on a topic, s; `none` before the first',
    'relay.<uav>': 'what becomes of the setpoints of a UAV by its relay: `passing`, `holding` '
                   'the last place, `refused`, `disabled`, `silent` (no setpoints come), or '
                   '`lost` if the relay has ceased to report; without a relay there is none',
    'track.plan': 'identity of the plan that is flown, by the reports on `plan_time`; without any '
                  'there is no `track`',
    'track.time': 'progress of the flight, s from point 0',
    'track.state': '`waiting`, `flying`, `held` or `ended`, with `, silent` after a second '
                   'without a report',
    'track.distance.<uav>': 'distance of a UAV from its plan when it was measured, m; `none` '
                            'without odometry and poses. Beyond `track_tolerance` the level is '
                            'WARN',
    'track.rate': 'guaranteed rate so far where the UAVs really were, with the planned powers, '
                  'of all ground nodes together, bit/s/Hz',
    'track.planned_rate': 'the same where the plan had them',
    'track.measured': 'share of the slots so far in which all UAVs were measured, over which both '
                      'are means',
}
"""The meaning of each value of the status by its key."""


class RequestOutcome(NamedTuple):
    """The outcome of the last request or replan, with a summary of its plan, or the refusal."""

    level: bytes  # Of DiagnosticStatus.
    code: str  # 'ok', or that of the error.
    text: str
    is_replan: bool = False  # Set for a refusal.


@dataclass
class State:
    """The last published plan, the refusal of the last request or replan, and counts."""

    plan: Plan | None = None
    prefix: str = ''  # Of its summary.
    is_replan: bool = False
    bound: Bound | None = None
    refusal: RequestOutcome | None = None
    counts: dict[str, int] = field(
        default_factory=lambda: {'plans': 0, 'replans': 0, 'refusals': 0})

    @property
    def outcome(self) -> RequestOutcome:
        """Outcome of the last request or replan."""
        plan = self.plan
        if self.refusal is not None:
            return self.refusal
        if plan is None:
            return RequestOutcome(DiagnosticStatus.OK, 'ok', 'no plan yet')
        # A replan has a short deadline, at which it is no worse than the plan before.
        is_done = plan.status == 'converged' or self.is_replan and plan.status == 'time_limit'
        good = is_done and not plan.clearance.is_close and plan.promise.slots
        return RequestOutcome(DiagnosticStatus.OK if good else DiagnosticStatus.WARN, 'ok',
                              self.prefix + plan_summary(plan, self.bound))

    def keep(self, plan: Plan, count: str = '', prefix: str = '') -> None:
        """Make a plan the last one and, if it is announced, increase a count."""
        self.plan, self.bound, self.refusal = plan, plan.bound, None
        self.is_replan = count != 'plans'
        if count:
            self.counts[count] += 1
            self.prefix = prefix

    def forget_replan(self) -> None:
        """Forget the refusal of a replan that is due no more."""
        if self.refusal is not None and self.refusal.is_replan:
            self.refusal = None

    def refuse(self, error: Exception, is_replan: bool) -> RequestOutcome:
        """Note and return the refusal of a new plan; its text tells if the last plan stands."""
        level, reason = DiagnosticStatus.WARN, brief(error, _LONGEST_REASON)
        if not isinstance(error, PlanningError):
            kind = 'replan' if is_replan else 'solve'
            level, reason = DiagnosticStatus.ERROR, f'the {kind} failed: {describe_error(error)}'
        elif is_replan and isinstance(error, StoppedError):
            level = DiagnosticStatus.OK
        self.counts['refusals'] += 1
        self.refusal = RequestOutcome(
            level, getattr(error, 'code', PlanningError.code),
            reason + ('' if self.plan is None else '; the last plan stands'), is_replan)
        return self.refusal


def plan_summary(plan: Plan, bound: Bound | None) -> str:
    """Return a summary of a plan in one line, without any position."""
    near, name = closest_approach_text(plan), plan.scenario.channel.rate_name
    promise, names = plan.promise, plan.scenario.ground_node_names
    nodes = '' if len(names) == 1 else '; ' + ', '.join(
        f'{name} {rate_text(rate)}' for name, rate in zip(names, promise.node_rates, strict=True))
    of_all = (f'; {promise.text}; all slots: {plan.guaranteed_rate:.4f}, '
              f'{plan.worst_case_rate:.4f} bit/s/Hz' if promise.is_partial else '')
    return (f'{brief(plan.method, 60)} plan of {plan.scenario.slots} slots: '
            f'{name("guaranteed")} {rate_text(promise.guaranteed_rate)}, '
            f'{name("worst_case")} {rate_text(promise.worst_case_rate)} bit/s/Hz{of_all}, '
            f'{plan.solve_time:.2f} s, '
            f'{_iterations(plan)} iterations, {plan.message}; along the curve '
            f'{rate_text(promise.curve_rate)}{nodes}' + (f'; {near}' if near else '')
            + ('' if bound is None else f'; {bound.claim(plan)}'))


def level_and_text(outcome: RequestOutcome, problems: Sequence[object],
                   progress: Iteration | None) -> tuple[bytes, str]:
    """
    Return the level of the planner's status and a text that explains it.

    ERROR: a solve failed. WARN: planning is not possible now, or a UAV is off its plan, or a
    promise has ended, or the last request was refused, or its plan has not converged or lets UAVs
    come close without a separation. OK: none of these. During a solve, its progress replaces the
    last outcome. STALE is not used, because tools take it for a node that has stopped reporting.
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
    """Logs each warning about a subject once, and few of them, until it is cleared."""

    def __init__(self, log: RcutilsLogger) -> None:
        self._log, self._logged = log, defaultdict[str, set[str]](set)

    def warn(self, subject: str, text: str) -> None:
        """Log a warning, unless it has been."""
        logged = self._logged[subject]
        if text not in logged and len(logged) < _MOST_WARNINGS:
            logged.add(text)
            self._log.warning(text)

    def clear(self, subject: str) -> None:
        """Log warnings about a subject again."""
        self._logged[subject].clear()


def log_at(log: RcutilsLogger, level: bytes, text: str) -> None:
    """Log at a level of DiagnosticStatus; rclpy needs a separate call for each severity."""
    if level == DiagnosticStatus.ERROR:
        log.error(text)
    elif level == DiagnosticStatus.WARN:
        log.warning(text)
    else:
        log.info(text)


def status_values(state: State, progress: Iteration | None, is_solving: bool, poses: PoseBook,
                  settings: Mapping[str, Any], now: float) -> dict[str, Any]:
    """Return the values of the status by key; `progress` is that of a solve under way, or None."""
    values: dict[str, Any] = {'state': 'solving' if is_solving else 'idle',
                              'outcome.code': state.outcome.code, **state.counts}
    if progress is not None:
        values |= {
            'progress.iteration': progress.number, 'progress.step': progress.step,
            'progress.rate': progress.rate, 'progress.elapsed': progress.elapsed}
    plan = state.plan
    if plan is not None:
        values |= {
            'plan.identity': plan.identity, 'plan.stamp': f'{plan.start_ns * 1e-9:.9f}',
            'plan.age': now - plan.start_ns * 1e-9, **plan_values(plan)}
        if state.bound is not None:
            values |= {'plan.bound': state.bound.rate, 'plan.claim': state.bound.claim(plan)}
    for name in (
            *settings['ground_nodes'], *settings['eavesdroppers'], *settings['uavs']):
        for topic in member_topics(name):
            pose = poses.get(topic)
            values[f'pose_age.{topic}'] = 'none' if pose is None else pose.age(now)
    return values


def plan_values(plan: Plan) -> dict[str, Any]:
    """Return rates, clearances, energies and the solve of a plan by key of the status."""
    promise = plan.promise
    return {'plan.promised_slots': promise.slots,
            'plan.guaranteed_rate': promise.guaranteed_rate, 'plan.curve_rate': promise.curve_rate,
            **closest_approach_values(plan), **_energy_values(plan),
            'plan.worst_case_rate': promise.worst_case_rate, **{
                f'plan.node_rate.{name}': rate for name, rate in zip(
                    plan.scenario.ground_node_names, promise.node_rates.tolist(), strict=True)},
            'plan.method': brief(plan.method, 60), 'plan.objective': plan.objective,
            'plan.status': plan.status, 'plan.iterations': _iterations(plan),
            'plan.solve_time': plan.solve_time}


def closest_approach_text(plan: Plan) -> str:
    """Return the smallest distances of a plan in words, with a warning where UAVs are close."""
    clearance = plan.clearance
    zones, margin = clearance.to_zones, plan.scenario.boundaries.margin_text
    texts = [clearance.between_uavs_text]
    if zones is not None:
        left = margin and f' ({clearance.zones_beyond_margin:.1f} m{margin})'
        texts.append(f'{zones.names[0]} comes within {zones.distance:.1f} m of {zones.names[1]}'
                     f'{left}')
    return '; '.join(filter(None, texts))


def closest_approach_values(plan: Plan) -> dict[str, Any]:
    """Return the smallest distances of a plan as values of the status by key."""
    values: dict[str, Any] = {}
    clearance = plan.clearance
    for key, approach, left in (
            ('uav_distance', clearance.between_uavs, clearance.uavs_beyond_margin),
            ('zone_distance', clearance.to_zones, clearance.zones_beyond_margin)):
        if approach is not None:
            values |= {f'plan.{key}': approach.distance, f'plan.{key}.beyond_margin': left,
                       f'plan.{key}.between': ', '.join(approach.names),
                       f'plan.{key}.time': approach.time}
    return values


def _energy_values(plan: Plan) -> dict[str, float]:
    """Return the energy of each UAV that has a propulsion in J by key."""
    return {key: joules for uav, energy in zip(plan.scenario.uavs, plan.energies, strict=True)
            if energy is not None for key, joules in (
                (f'plan.energy.{uav.name}', energy.total),
                (f'plan.energy.{uav.name}.hovering', energy.hovering),
                (f'plan.energy.{uav.name}.flying', energy.flying))}


def _iterations(plan: Plan) -> int:
    return max(0, len(plan.history) - 1)  # The first entry is the start.
