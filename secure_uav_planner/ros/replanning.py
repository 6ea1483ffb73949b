"""Replanning of the rest of a mission during the flight."""

from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Future
import math
from typing import Any

from .mission_parameters import objective_from
from .plan_tracking import PlanTracking
from .poses import PoseBook
from .scenarios import has_moved, updated
from .worker import Worker
from ..errors import (
    BusyError, InfeasibleMissionError, LateError, PlanningError, StoppedError, SupersededError)
from ..mission.scenario import Scenario
from ..optimize.rejoin import first_point, Rejoin, rejoined
from ..plan.plan import Plan
from ..plan.tracking import Flight, Sighting

_RESERVE = 0.5  # For what follows a solve, in s; at most half of the time there is.
_DELIVERY = 0.2  # s that a plan needs to the one who flies it, before it takes effect.
_REASONS = ('period', 'distance', 'deviation')


class Replanning:
    """
    Starts a solve of the rest of the mission when one is due, and continues the plan with it.

    :param publish: called in the solver's thread with the new plan of the whole mission, the
        Rejoin with which it begins, and the last plan when it was begun.
    :param refuse: called with the error if there is no new plan, or publish raised it; with a
        SupersededError if another plan came first, which has been reported already.
    """

    def __init__(self, worker: Worker, poses: PoseBook, tracking: PlanTracking,
                 publish: Callable[[Plan, Rejoin, Plan], None],
                 refuse: Callable[[Exception], None]) -> None:
        self._worker, self._poses, self._tracking = worker, poses, tracking
        self._publish, self._refuse = publish, refuse
        self._last_planned = -math.inf
        self._failed = False  # The last replan that was due.

    def planned(self, now: float) -> None:
        """Note the time in s of a new plan, from which the next period is counted."""
        self._last_planned, self._failed = now, False

    def start_when_due(self, last_plan: Callable[[], Plan | None], settings: Mapping[str, Any],
                       now: float) -> None:
        """Start a solve of the rest of a plan, if one is due and no other solve is under way."""
        if self._worker.busy or not any(settings[f'replan_{reason}'] for reason in _REASONS):
            return
        last = last_plan()  # Only now: a solve that was under way may have published another.
        flight = self._tracking.flight(now)
        if last is None or flight is None or not flight.rate:
            return  # There is no plan, or its time stands.
        plan = flight.playback.plan
        if plan.start_ns != last.start_ns:
            return  # The last plan is not flown yet.
        lead = settings['replan_lead']
        first = first_point(plan.scenario, flight.time + lead * flight.rate)
        if first >= plan.scenario.slots:
            return  # The mission ends before a new plan could take effect.
        try:
            known = updated(plan.scenario, settings, self._poses, now)
        except PlanningError:
            return  # Poses are missing or too old; the diagnostics report it.
        is_due = self._is_due(plan, known, settings, now)
        if not is_due and not (flight.state == 'flying' and self._is_off(settings, now)):
            return
        sightings = self._tracking.sightings(flight, settings, now)

        def replan(solve: Callable[..., Plan]) -> tuple[Plan, Rejoin]:
            rejoin = _rejoined(plan, first, sightings, settings, known, must_meet=not is_due)
            found = solve(rejoin.scenario, method=settings['method'],
                          objective=objective_from(settings), initial=rejoin.tail,
                          time_limit=lead - min(_RESERVE, lead / 2))
            return rejoin.continued(found), rejoin

        def finish(future: 'Future[tuple[Plan, Rejoin]]') -> None:
            try:
                self._publish(*future.result(), last)
            except Exception as error:
                if not isinstance(error, SupersededError):
                    self._failed = is_due
                self._refuse(error)

        try:
            self._worker.start(replan, finish)
        except (BusyError, StoppedError):
            return  # A request was faster.
        self._last_planned = now

    def _is_due(self, plan: Plan, known: Scenario, settings: Mapping[str, Any], now: float
                ) -> bool:
        """Return whether the period is over, or a receiver has moved."""
        period, distance = settings['replan_period'], settings['replan_distance']
        # If the clock has jumped back, the last plan may be in the future; it is then ignored.
        since = now - self._last_planned
        if period and not 0 <= since < period:
            return True
        # After a failure, a move does not count before the lead is over.
        waits = self._failed and 0 <= since < settings['replan_lead']
        return bool(distance and not waits and has_moved(plan.scenario, known, distance))

    def _is_off(self, settings: Mapping[str, Any], now: float) -> bool:
        """Return whether a UAV is too far from its plan, and has had the time to come back."""
        most = settings['replan_deviation']
        if not most or 0 <= now - self._last_planned < settings['replan_lead']:
            return False
        return any(distance > most and settings[f'{name}.use_pose']
                   for name, distance in self._tracking.distances(settings, now).items())


def _rejoined(plan: Plan, first: int, sightings: Sequence[Sighting | None],
              settings: Mapping[str, Any], known: Scenario, must_meet: bool) -> Rejoin:
    """Return the beginning of a replan; unless must_meet, from the plan if need be."""
    arguments = (settings['track_tolerance'], known.ground_node, known.eavesdroppers)
    try:
        return rejoined(plan, first, sightings, *arguments)
    except InfeasibleMissionError:
        if must_meet:
            raise
        return rejoined(plan, first, [None] * len(sightings), *arguments)


def check_in_time(is_last: bool, rejoin: Rejoin, flight: Flight | None) -> None:
    """Raise an error if a replan comes too late for what is flown, or after another plan."""
    if not is_last or flight is None or flight.playback.plan is not rejoin.plan:
        raise SupersededError('replan: another plan came in between')
    if flight.time + _DELIVERY * flight.rate > rejoin.effect:
        raise LateError('replan: the new plan came after the moment it was to take effect; '
                        'a longer replan_lead gives it more time')
