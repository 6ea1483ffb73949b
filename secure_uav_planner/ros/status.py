"""The status that the planner reports: a level and a text for diagnostics, and values by key."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

from diagnostic_msgs.msg import DiagnosticStatus
from rclpy.impl.rcutils_logger import RcutilsLogger

from .poses import PoseBook
from .topics import GROUND_NODE_TOPIC, odometry_topic, pose_topic
from ..errors import brief, PlanningError
from ..plan.bound import Bound
from ..plan.plan import Iteration, Plan

LAST_PLAN_STANDS = '; the last plan stands'


class RequestOutcome(NamedTuple):
    """
    How the last request or replan ended.

    :ivar level: a level of DiagnosticStatus.
    :ivar code: 'ok', or the code of the error.
    :ivar text: a summary of the plan in one line, or the reason why there is no new plan.
    :ivar is_replan: whether it is a replan that was refused.
    """

    level: bytes
    code: str
    text: str
    is_replan: bool = False


@dataclass
class State:
    """
    The last plan, whether the last request or replan was refused, and counts.

    :ivar plan: the last plan that was published, or None.
    :ivar prefix: what its summary begins with.
    :ivar evaluated: the last plan whose worst-case rate has been evaluated, or None.
    :ivar bound: the Bound of the last plan, or None.
    :ivar upcoming: a plan whose worst-case rate is known and that is not published yet, or None.
    :ivar refusal: the RequestOutcome of the last request or replan if it led to no plan, or None.
    """

    plan: Plan | None = None
    prefix: str = ''
    evaluated: Plan | None = None
    bound: Bound | None = None
    upcoming: Plan | None = None
    refusal: RequestOutcome | None = None
    counts: dict[str, int] = field(
        default_factory=lambda: {'plans': 0, 'replans': 0, 'refusals': 0})

    @property
    def outcome(self) -> RequestOutcome:
        """Return how the last request or replan ended, with what is known of its plan now."""
        plan = self.plan
        if self.refusal is not None:
            return self.refusal
        if plan is None:
            return RequestOutcome(DiagnosticStatus.OK, 'ok', 'no plan yet')
        good = plan.status == 'converged' and not plan.clearance.is_close
        return RequestOutcome(
            DiagnosticStatus.OK if good else DiagnosticStatus.WARN, 'ok',
            self.prefix + plan_summary(plan, self.evaluated is plan, self.bound))

    def publish(self, plan: Plan, count: str, prefix: str = '') -> str:
        """
        Note a plan that is being published; return its summary in one line.

        :param count: the name of the count to increase.
        :param prefix: put before the summary.
        """
        self.plan, self.bound, self.prefix, self.refusal = plan, plan.bound, prefix, None
        self.evaluated = plan if self.upcoming is plan else None
        self.counts[count] += 1
        return self.outcome.text

    def evaluate(self, plan: Plan) -> None:
        """Note that the worst-case rate of a plan is known; the plan may not be published yet."""
        if self.plan is plan:
            self.evaluated = plan
        else:
            self.upcoming = plan

    def take_bound(self, plan: Plan, bound: Bound) -> bool:
        """Take up the bound of the last plan; return whether it still is the last."""
        if self.plan is not plan:
            return False
        self.evaluated, self.bound = plan, bound
        return True

    def end_flight(self) -> None:
        """Note that the last plan has been flown; a replan of it is no longer missed."""
        if self.refusal is not None and self.refusal.is_replan:
            self.refusal = None

    def refuse(self, error: Exception, reason: str, level: bytes, is_replan: bool = False) -> str:
        """Note why there is no new plan; return the reason, and whether the last plan remains."""
        text = reason + (LAST_PLAN_STANDS if self.plan is not None else '')
        self.counts['refusals'] += 1
        self.refusal = RequestOutcome(
            level, getattr(error, 'code', PlanningError.code), text, is_replan)
        return text


def plan_summary(plan: Plan, evaluated: bool, bound: Bound | None = None) -> str:
    """
    Return a summary of a plan in one line, without any position.

    :param evaluated: whether its worst-case rate is known; evaluating it can take long.
    :param bound: its Bound, if that is known.
    """
    worst = (f'{plan.worst_case_rate:.4f} bit/s/Hz' if evaluated
             else 'not evaluated yet (bit/s/Hz)')
    near = closest_approach_text(plan)
    return (f'{brief(plan.method, 60)} plan of {plan.scenario.slots} slots: guaranteed rate '
            f'{plan.guaranteed_rate:.4f}, worst-case rate {worst}, {plan.solve_time:.2f} s, '
            f'{_iterations(plan)} iterations, {plan.message}; along the curve '
            f'{plan.curve_rate:.4f}' + (f'; {near}' if near else '')
            + ('' if bound is None else f'; {bound.claim(plan)}'))


def level_and_text(outcome: RequestOutcome, problems: Sequence[object],
                   progress: Iteration | None) -> tuple[bytes, str]:
    """
    Return the level of the planner's status and a text that explains it.

    ERROR: a solve failed. WARN: planning is not possible now, or a UAV is off its plan, or the
    last request was refused, or its plan has not converged or lets UAVs come close without a
    separation. OK: none of these. While a solve is under way, its progress stands for the last
    outcome. STALE is not used, because tools take it for a node that has stopped reporting.

    :param problems: errors of poses that prevent planning, and texts about UAVs off their plan.
    :param progress: the latest Iteration of the solve that is under way, or None.
    """
    texts = [str(problem) for problem in problems]
    if progress is not None:
        texts.insert(0, f'solving: iteration {progress.number}, {progress.rate:.4f} bit/s/Hz')
    elif outcome.level != DiagnosticStatus.OK or not problems:
        return outcome.level, outcome.text
    return DiagnosticStatus.WARN if problems else DiagnosticStatus.OK, '; '.join(texts)


def log_at(log: RcutilsLogger, level: bytes, text: str) -> None:
    """Log at a level of DiagnosticStatus; rclpy needs a separate call for each severity."""
    if level == DiagnosticStatus.ERROR:
        log.error(text)
    elif level == DiagnosticStatus.WARN:
        log.warning(text)
    else:
        log.info(text)


def values(state: State, progress: Iteration | None, busy: bool, poses: PoseBook,
           parameters: Mapping[str, Any], now: float) -> dict[str, Any]:
    """
    Return the values of the status by key.

    :param progress: the latest Iteration of the solve that is under way, or None.
    :param busy: whether a solve is under way.
    :param parameters: values of the planner's parameters by name.
    :param now: the node's time in s.
    """
    found: dict[str, Any] = {'state': 'solving' if busy else 'idle',
                             'outcome.code': state.outcome.code, **state.counts}
    if progress is not None:
        found.update({
            'progress.iteration': progress.number, 'progress.step': progress.step,
            'progress.rate': progress.rate, 'progress.elapsed': progress.elapsed})
    plan = state.plan
    if plan is not None:
        found.update({
            'plan.identity': plan.identity, 'plan.stamp': f'{plan.start_ns * 1e-9:.9f}',
            'plan.age': now - plan.start_ns * 1e-9,
            'plan.guaranteed_rate': plan.guaranteed_rate, 'plan.curve_rate': plan.curve_rate,
            **closest_approach_values(plan), **_energy_values(plan)})
        if state.evaluated is plan:
            found['plan.worst_case_rate'] = plan.worst_case_rate
        found.update({
            'plan.method': brief(plan.method, 60), 'plan.objective': plan.objective,
            'plan.status': plan.status,
            **({} if state.bound is None else {
                'plan.bound': state.bound.rate, 'plan.claim': state.bound.claim(plan)}),
            'plan.iterations': _iterations(plan), 'plan.solve_time': plan.solve_time})
    names = parameters['eavesdroppers'] + parameters['uavs']
    for topic in [GROUND_NODE_TOPIC, *map(pose_topic, names),
                  *map(odometry_topic, parameters['uavs'])]:
        known = poses.get(topic)
        found[f'pose_age.{topic}'] = 'none' if known is None else known.age(now)
    return found


def closest_approach_text(plan: Plan) -> str:
    """Return the smallest distances of a plan in words, with a warning where UAVs are close."""
    clearance = plan.clearance
    zones, margin = clearance.to_zones, plan.scenario.margin_text
    found = [clearance.between_uavs_text]
    if zones is not None:
        left = margin and f' ({clearance.zones_beyond_margin:.1f} m{margin})'
        found.append(f'{zones.names[0]} comes within {zones.distance:.1f} m of {zones.names[1]}'
                     f'{left}')
    return '; '.join(filter(None, found))


def closest_approach_values(plan: Plan) -> dict[str, Any]:
    """Return the smallest distances of a plan as values of the status by key."""
    found: dict[str, Any] = {}
    clearance = plan.clearance
    for key, approach, left in (
            ('uav_distance', clearance.between_uavs, clearance.uavs_beyond_margin),
            ('zone_distance', clearance.to_zones, clearance.zones_beyond_margin)):
        if approach is not None:
            found[f'plan.{key}'] = approach.distance
            found[f'plan.{key}.beyond_margin'] = left
            found[f'plan.{key}.between'] = ', '.join(approach.names)
            found[f'plan.{key}.time'] = approach.time
    return found


def _energy_values(plan: Plan) -> dict[str, float]:
    """Return the energy of each UAV that has a propulsion in J by key."""
    return {key: joules for uav, energy in zip(plan.scenario.uavs, plan.energies, strict=True)
            if energy is not None for key, joules in (
                (f'plan.energy.{uav.name}', energy.total),
                (f'plan.energy.{uav.name}.hovering', energy.hovering),
                (f'plan.energy.{uav.name}.flying', energy.flying))}


def _iterations(plan: Plan) -> int:
    return max(0, len(plan.history) - 1)  # The first entry is the start.
