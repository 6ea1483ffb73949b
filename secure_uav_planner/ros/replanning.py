"""Replanning of the rest of a mission during the flight."""

from collections.abc import Mapping, Sequence
import math
from typing import Any, NamedTuple

from .plan_tracking import PlanTracking
from .poses import PoseBook
from .scenarios import has_moved, update_receivers
from ..errors import InfeasibleMissionError, LateError, PlanningError, SupersededError
from ..mission.scenario import Scenario
from ..optimize.rejoin import find_first_point, find_rejoin, Rejoin
from ..plan.plan import Plan
from ..plan.tracking import Flight, MeasuredState

_RESERVE = 0.5  # For what follows a solve, in s; at most half of the time there is.
_DELIVERY = 0.2  # s that a plan needs to the one who flies it, before it takes effect.
_REASONS = ('period', 'distance', 'deviation')


class Rest(NamedTuple):
    """
    The rest of a mission that is to be solved anew.

    :param plan: the plan that is flown.
    :param first: the first point of its path that may change.
    :param known: its scenario with the receivers as they are known now.
    :param must_meet: whether the new plan must begin where the UAVs will be, even if no flight
        from there keeps the limits; otherwise it then begins on the plan that is flown.
    """

    plan: Plan
    first: int
    states: Sequence[MeasuredState | None]
    known: Scenario
    must_meet: bool
    tolerance: float
    time_limit: float

    def rejoin(self) -> Rejoin:
        """
        Return the beginning of the replan.

        :raises InfeasibleMissionError: if it cannot be flown.
        """
        receivers = self.tolerance, self.known.ground_node, self.known.eavesdroppers
        try:
            return find_rejoin(self.plan, self.first, self.states, *receivers)
        except InfeasibleMissionError:
            if self.must_meet:
                raise
            return find_rejoin(self.plan, self.first, [None] * len(self.states), *receivers)


class Replanning:
    """Says when the rest of the mission is due for a new solve, and what there is to solve."""

    def __init__(self, poses: PoseBook, tracking: PlanTracking) -> None:
        self._poses, self._tracking = poses, tracking
        self._last_planned = -math.inf
        self._failed = False  # The last replan that was due.
        self._was_due = False

    def planned(self, now: float) -> None:
        """Note the time in s of a new plan, from which the next period is counted."""
        self._last_planned, self._failed = now, False

    def failed(self) -> None:
        """Note that no plan came of the last replan."""
        self._failed = self._was_due

    def rest_if_due(self, last: Plan, settings: Mapping[str, Any], now: float) -> Rest | None:
        """Return the rest of the mission if a solve of it is due now, or None."""
        if not any(settings[f'replan_{reason}'] for reason in _REASONS):
            return None
        flight = self._tracking.flight(now)
        if flight is None or not flight.rate:
            return None  # The time of the plan stands.
        plan = flight.playback.plan
        if plan.start_ns != last.start_ns:
            return None  # The last plan is not flown yet.
        lead = settings['replan_lead']
        first = find_first_point(plan.scenario, flight.time + lead * flight.rate)
        if first >= plan.scenario.slots:
            return None  # The mission ends before a new plan could take effect.
        try:
            known = update_receivers(plan.scenario, settings, self._poses, now)
        except PlanningError:
            return None  # Poses are missing or too old; the diagnostics report it.
        is_due = self._is_due(plan, known, settings, now)
        if not is_due and not (flight.state == 'flying' and self._is_off(settings, now)):
            return None
        self._last_planned, self._was_due = now, is_due
        states = self._tracking.states(flight, settings, now)
        return Rest(plan, first, states, known, not is_due, settings['track_tolerance'],
                    lead - min(_RESERVE, lead / 2))

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


def check_in_time(rejoin: Rejoin, flight: Flight | None) -> None:
    """Raise an error if a replan comes too late for what is flown, or after another plan."""
    if flight is None or flight.playback.plan is not rejoin.plan:
        raise SupersededError('replan: another plan came in between')
    if flight.time + _DELIVERY * flight.rate > rejoin.effect:
        raise LateError('replan: the new plan came after the moment it was to take effect; '
                        'a longer replan_lead gives it more time')
