"""Replans: when and why the rest of the mission in flight is planned again, and from where."""

from collections.abc import Callable, Sequence
from dataclasses import replace
import math
from typing import NamedTuple

from .followed_plans import check_continuation, start_of
from .plan_tracking import PlanTracking
from .poses import PoseBook
from .receivers import has_moved, predict_receivers, Receivers
from .request import DELIVERY_S
from .settings import PlannerSettings
from .solver import Job
from ..messages import serialize_plan
from ...errors import InfeasibleMissionError, LateError, SupersededError
from ...mission.scenario import Scenario
from ...optimize.rejoin import find_last_kept_point, find_rejoin, Rejoin
from ...plan.flight import Flight
from ...plan.plan import Plan
from ...plan.tracking import MeasuredState, PlanClock

# Time reserved between the end of a solve and the effect of its plan, unless half of the lead is
# shorter.
_RESERVE_S = 0.5
_EFFECT_SLOTS = 1.5  # Largest number of slots from the lead to the first point that changes.


class Rule(NamedTuple):
    """
    A rule for replans.

    :param reason: name of the reason for the replan.
    :param is_due: function of a Replanning, the flight, the settings and the time [s]; True if a
        replan is due now.
    :param must_meet: what happens if no path meets the UAVs at their predicted states: True for an
        error, False to begin the new plan on the plan in flight.
    """

    reason: str
    is_due: 'Callable[[Replanning, Flight, PlannerSettings, float], bool]'
    must_meet: bool = False


class Replanned(NamedTuple):
    """
    A remainder that is planned again.

    :param begin: time of the plan [s] from which its receivers are the present ones.
    :param outgoing: the plan's serialized messages by topic.
    """

    plan: Plan
    rejoin: Rejoin
    begin: float
    outgoing: dict[str, bytes]


class Remainder(NamedTuple):
    """
    The remainder of a mission, which is to be planned again.

    :param rule: the Rule by which it is due.
    :param flight: flight of the plan when the replan became due.
    :param now: time of the clock [s] when the replan became due.
    :param last_kept: the last point of the plan's path that must be kept.
    :param states: measured state of each UAV, or None for a UAV that is on its plan.
    :param updated: scenario of the plan with the present receivers.
    :param receivers: the present receivers, as predicted.
    """

    rule: Rule
    flight: Flight
    now: float
    last_kept: int
    states: Sequence[MeasuredState | None]
    updated: Scenario
    receivers: Receivers
    settings: PlannerSettings

    @property
    def plan(self) -> Plan:
        """Plan in flight."""
        return self.flight.playback.plan

    @property
    def clock(self) -> PlanClock:
        """Clock of the plan for which the receivers are predicted."""
        return PlanClock(self.flight.time, self.now, self.flight.time_scale)

    @property
    def time_limit(self) -> float:
        """Time limit of the solve [s]."""
        lead = self.settings.replan_lead
        return lead - min(_RESERVE_S, lead / 2)

    def solve(self, job: Job) -> Replanned:
        """Return the whole plan with its remainder solved again; called in the solver's thread."""
        rejoin = self.find_rejoin()
        plan = self.date(rejoin.splice(
            job.solve(rejoin.scenario, self.settings, self.time_limit, rejoin.tail)))
        begin = (rejoin.last_kept + 1) * plan.scenario.slot_duration  # The first new point.
        return Replanned(
            plan, rejoin, begin, serialize_plan(plan, self.settings.frame_id, begin))

    def date(self, plan: Plan) -> Plan:
        """
        Return the new plan with a promise until the receivers' predictions end.

        The promise holds if plan time t is flown at start + promise_delay + t / promise_speed.
        """
        until, clock = self.receivers.promised_until, self.clock
        if until is None:
            return plan
        return replace(plan, promised_until=until, promise_speed=clock.time_scale,
                       promise_delay=clock.to_clock(0.0) - start_of(plan) * 1e-9)

    def find_rejoin(self) -> Rejoin:
        """
        Return the Rejoin of a new path that meets the UAVs at their predicted states.

        If no path meets these states, the new path begins on the plan in flight.

        :raises InfeasibleMissionError: if no path meets the states and the rule must meet them.
        """
        try:
            return find_rejoin(self.plan, self.last_kept, self.states,
                               self.settings.track_tolerance, self.updated)
        except InfeasibleMissionError:
            if self.rule.must_meet:
                raise
            return find_rejoin(self.plan, self.last_kept, [None] * len(self.states),
                               self.settings.track_tolerance, self.updated)

    def check_in_time(self, rejoin: Rejoin, flight: Flight | None, now: float) -> None:
        """Raise SupersededError unless `plan` is flown; LateError after a pause or if too late."""
        if flight is None or flight.playback.plan.identity != self.plan.identity:
            raise SupersededError('replan: superseded by a newer plan')
        if flight.playback.plan is not self.plan:
            raise SupersededError('replan: the promise of the plan in flight ended meanwhile')
        check_continuation(self.flight, flight, now - self.now)
        if flight.time + DELIVERY_S * flight.time_scale > rejoin.effect:
            raise LateError('replan: the new plan came after the moment it was to take effect; '
                            'a longer replan_lead gives it more time')


class Replanning:
    """Decides by RULES when the remainder of the mission is planned again; times are in s."""

    def __init__(self, poses: PoseBook, tracking: PlanTracking) -> None:
        self._poses, self._tracking, self._followed = poses, tracking, tracking.followed
        self._last_planned = -math.inf  # When a plan was last published or a replan began [s].
        self._stopped = frozenset[str]()  # UAVs that relays stopped at the last replan.
        self._has_failed = False  # Whether the last replan failed, by a rule without must_meet.
        self._updated_from = -math.inf  # Plan time [s] from which receivers are updated.

    def find_rule(self, settings: PlannerSettings, now: float) -> Rule | None:
        """
        Return the first Rule that is due in the flight, or None.

        None is due while the flight is held or changes its speed, while it awaits the newest plan,
        near the end of the flight, or without a usable pose of a receiver that needs one.

        :raises PlanningError: if the receivers cannot be predicted.
        """
        flight = self._followed.flight(now)
        if not settings.has_replans or flight is None or not flight.time_scale or (
                not self._followed.is_steady(now)):
            return None
        slots = flight.playback.plan.scenario.slots
        if self._followed.awaits_newest(flight, now):
            return None
        if self._last_kept_point(flight, settings) >= slots or (
                self._poses.problems(settings, now, with_uavs=False)):
            return None  # The mission ends before the effect, or poses are missing.
        return next((rule for rule in RULES if rule.is_due(self, flight, settings, now)), None)

    def is_period_over(self, _: Flight, settings: PlannerSettings, now: float) -> bool:
        """Return True if no plan or replan was in the last replan_period; False if this is 0."""
        period = settings.replan_period
        return period > 0 and not 0 <= now - self._last_planned < period

    def is_promise_ending(self, flight: Flight, settings: PlannerSettings, now: float) -> bool:
        """Return True if the promise ends before a replan takes effect; False if _must_wait."""
        ahead = (settings.replan_lead + DELIVERY_S) * flight.time_scale + (
            _EFFECT_SLOTS * flight.playback.plan.scenario.slot_duration)
        return not self._must_wait(flight, settings, now) and (
            self._tracking.promise_ends(flight, ahead))

    def have_receivers_moved(self, flight: Flight, settings: PlannerSettings, now: float) -> bool:
        """
        Return True if has_moved finds a receiver that is not where the plan in flight expects it.

        With replan_distance 0, only an eavesdropper with a track that has left its disc counts.
        With replan_period 0 as well, or while _must_wait, the answer is False.
        """
        distance = settings.replan_distance
        if not (distance or settings.replan_period) or self._must_wait(flight, settings, now):
            return False
        updated, _ = self._update_receivers(flight, settings, now)
        return has_moved(flight.playback.plan.scenario, updated,
                         max(flight.time, self._updated_from), distance)

    def is_uav_released(self, flight: Flight, settings: PlannerSettings, _: float) -> bool:
        """Return True if, in flight, a relay no longer stops a UAV that it stopped at a replan."""
        return settings.replan_deviation > 0 and flight.state == 'flying' and bool(
            self._stopped - self._find_stopped(settings))

    def is_uav_off(self, flight: Flight, settings: PlannerSettings, now: float) -> bool:
        """
        Return True if a UAV with use_pose flies farther than replan_deviation [m] from its plan.

        For a UAV that its relay stops, the distance after replan_lead counts. While _is_recent the
        answer is False, so that UAVs can come back to their plan, unless a relay has stopped or
        released a UAV since the last replan began. With replan_deviation 0 it is always False.
        """
        most, lead = settings.replan_deviation, settings.replan_lead
        if not most or flight.state != 'flying' or self._is_recent(settings, now) and (
                self._stopped == self._find_stopped(settings)):
            return False
        return any(distance > most and settings.uavs[name].use_pose for name, distance in
                   self._tracking.predict_distances(settings, now, lead).items())

    def _is_recent(self, settings: PlannerSettings, now: float) -> bool:
        """Return True within replan_lead after a plan was published or a replan began."""
        return 0 <= now - self._last_planned < settings.replan_lead

    def _must_wait(self, flight: Flight, settings: PlannerSettings, now: float) -> bool:
        """
        Return True if the rules 'promise' and 'receivers' must not be due yet.

        They wait for replan_lead after a plan was published or a replan began, but only if the
        last replan failed or if a receiver of the plan in flight has a track.
        """
        return self._is_recent(settings, now) and (
            self._has_failed or flight.playback.plan.scenario.has_tracks)

    def take_remainder(self, rule: Rule, settings: PlannerSettings, now: float) -> Remainder:
        """
        Return the remainder of the mission, due by a rule; note its time and the stopped UAVs.

        :raises PlanningError: if the receivers cannot be predicted.
        """
        flight = self._followed.flight(now)
        assert flight is not None
        updated, receivers = self._update_receivers(flight, settings, now)
        self._last_planned = now
        self._stopped = self._find_stopped(settings)
        return Remainder(rule, flight, now, self._last_kept_point(flight, settings),
                         self._tracking.states(flight, settings, now), updated, receivers,
                         settings)

    def is_settled(self, settings: PlannerSettings, now: float) -> bool:
        """Return True if all UAVs are on their plan, and no plan or replan is recent."""
        return not self._is_recent(settings, now) and all(
            distance <= settings.track_tolerance
            for distance in self._tracking.distances(settings, now).values())

    def note_plan(self, now: float, updated_from: float = -math.inf) -> None:
        """Note a new plan, whose receivers are updated from the time `updated_from` [s] on."""
        self._last_planned, self._has_failed, self._updated_from = now, False, updated_from

    def note_failure(self, rule: Rule) -> None:
        """Note that a replan failed, which counts only if its rule is without must_meet."""
        self._has_failed = not rule.must_meet

    def _find_stopped(self, settings: PlannerSettings) -> frozenset[str]:
        """Return the names of the UAVs with use_pose that their relays stop."""
        return self._tracking.find_stopped(
            name for name, uav in settings.uavs.items() if uav.use_pose)

    def _last_kept_point(self, flight: Flight, settings: PlannerSettings) -> int:
        """Return the index of the last point of the path that is kept by a replan begun now."""
        return find_last_kept_point(flight.playback.plan.scenario,
                                    flight.time + settings.replan_lead * flight.time_scale)

    def _update_receivers(self, flight: Flight, settings: PlannerSettings, now: float
                          ) -> tuple[Scenario, Receivers]:
        """Return the flight's scenario with newly predicted receivers, and these Receivers."""
        receivers = predict_receivers(
            settings, self._poses, now, PlanClock(flight.time, now, flight.time_scale),
            flight.playback.duration)
        return replace(flight.playback.plan.scenario, **receivers.fields), receivers


RULES = (
    Rule('period', Replanning.is_period_over),
    Rule('promise', Replanning.is_promise_ending),
    Rule('receivers', Replanning.have_receivers_moved),
    Rule('release', Replanning.is_uav_released),
    Rule('deviation', Replanning.is_uav_off, must_meet=True),
)
"""The rules for replans, in order: the first rule that is due gives the reason."""
