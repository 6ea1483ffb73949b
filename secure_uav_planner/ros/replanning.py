"""Replanning of the rest of a mission during the flight."""

from collections.abc import Callable, Mapping
from concurrent.futures import Future
from dataclasses import replace
import math
from typing import Any

from .poses import PoseBook
from .scenarios import has_moved, updated
from .worker import Worker
from ..errors import BusyError, LateError, PlanningError, StoppedError, SupersededError
from ..plan import Plan


class Replanning:
    """
    Starts a solve of the rest of the mission when one is due, and continues the plan with it.

    :param worker: the Worker that solves.
    :param poses: the PoseBook.
    :param publish: called in the solver's thread with the new plan of the whole mission, the plan
        that it continues, and the time in ns at which it takes effect; it raises a PlanningError
        if that is too late.
    :param refuse: called with the error if there is no new plan.
    """

    def __init__(self, worker: Worker, poses: PoseBook,
                 publish: Callable[[Plan, Plan, int], None],
                 refuse: Callable[[Exception], None],
                 superseded: Callable[[], None]) -> None:
        self._worker = worker
        self._poses = poses
        self._publish = publish
        self._refuse = refuse
        self._superseded = superseded
        self._last_planned = -math.inf

    def planned(self, now: float) -> None:
        """Note the time in s of a new plan, from which the next period is counted."""
        self._last_planned = now

    def start_when_due(self, last_plan: Callable[[], Plan | None],
                       settings: Mapping[str, Any], now: float) -> None:
        """
        Start a solve of the rest of a plan, if one is due and no other solve is under way.

        :param last_plan: returns the last plan that was published, or None.
        :param settings: values of the planner's parameters by name.
        :param now: the node's time in s.
        """
        period, distance = settings['replan_period'], settings['replan_distance']
        if not (period or distance) or self._worker.busy:
            return
        plan = last_plan()  # Only now: a solve that was under way may have published another.
        if plan is None:
            return
        elapsed = now - plan.start_ns * 1e-9
        point = max(0, math.ceil(
            (elapsed + settings['replan_lead']) / plan.scenario.slot_duration))
        if point >= plan.scenario.slots:
            return  # The mission ends before a new plan could take effect.
        try:
            known = updated(plan.scenario, settings, self._poses, now)
        except PlanningError:
            return  # Poses are missing or too old; the diagnostics report it.
        # If the clock has jumped back, the last plan may be in the future; it is then ignored.
        due = period and not 0 <= now - self._last_planned < period
        if not (due or (distance and has_moved(plan.scenario, known, distance))):
            return
        tail = plan.tail(point)
        scenario = replace(tail.scenario, ground_node=known.ground_node,
                           eavesdroppers=known.eavesdroppers)

        def finish(future: 'Future[Plan]') -> None:
            self._finish(future, plan, point, tail.start_ns)

        try:
            self._worker.start(scenario, finish, method=settings['method'],
                               objective=settings['objective'], initial=tail,
                               time_limit=settings['replan_lead'])
        except (BusyError, StoppedError):
            return  # A request was faster.
        self._last_planned = now

    def _finish(self, future: 'Future[Plan]', plan: Plan, point: int, start_ns: int) -> None:
        """Continue a plan from a point with the result of a replan, in the solver's thread."""
        try:
            found = future.result()
            if found.status == 'cancelled':
                raise StoppedError('the replan was cancelled')
            self._publish(plan.continued(point, found), plan, start_ns)
        except SupersededError:
            self._superseded()
        except Exception as error:
            self._refuse(error)


def check_in_time(plan: Plan | None, continued: Plan, start_ns: int, now_ns: int) -> None:
    """
    Check that a replan may take effect.

    :param plan: the last plan that was published.
    :param continued: the plan that the replan continues.
    :param start_ns: when the replan takes effect.
    :raises SupersededError: if another plan has been published in the meantime.
    :raises LateError: if the time at which it takes effect has passed.
    """
    if plan is not continued:
        raise SupersededError('replan: another plan came in between')
    if now_ns > start_ns:
        raise LateError('replan: the new plan came after the moment it was to take effect; '
                        'a longer replan_lead gives it more time')
