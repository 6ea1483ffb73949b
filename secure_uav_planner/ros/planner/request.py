"""
Problems for the solver, from parameters, poses and the flight.

A request plans a new mission, which begins at a StartTime; Replanning says when and why the
remainder of the mission in flight is due to be planned again.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
import math
from typing import Any, NamedTuple

from .plan_tracking import check_continuation, PlanTracking
from .poses import PoseBook
from .receivers import has_moved, predict_receivers, Receivers
from .settings import PlannerSettings
from ...errors import (
    brief, InfeasibleMissionError, LateError, PlanningError, ScenarioError, SupersededError,
    TimeLimitError)
from ...mission.scenario import Eavesdropper, Point, Scenario, Uav
from ...optimize.incumbent import mute_nonpositive_slots
from ...optimize.rejoin import find_first_point, find_rejoin, Rejoin
from ...plan.flight import Flight
from ...plan.plan import Plan
from ...plan.tracking import MeasuredState, PlanClock, predict_state, start_from_state

# s between a solve and the effect of its plan; at most half of the available time.
_PLAN_RESERVE, _REPLAN_RESERVE = 1.0, 0.5
_RELEASE = 1.0  # s from a solve without a start_delay to point 0, where receivers move.
_EFFECT_SLOTS = 1.5  # From the lead to the first point that can change, at most.
_DELIVERY = 0.2  # s from the publication of a plan until the follower has it.


@dataclass(frozen=True)
class StartTime:
    """
    The start of the plan of a request.

    :param asked_ns: time of the request in ns.
    :param delay: s from the request to point 0; 0 for a plan that begins once it is solved.
    :param lead_in: s from the first setpoint to point 0: half a slot with a limit of
        acceleration, because UAVs leave their starts then.
    """

    asked_ns: int
    delay: float
    lead_in: float

    @classmethod
    def from_settings(cls, settings: PlannerSettings, now_ns: int, flight: Flight | None
                      ) -> 'StartTime':
        """Return the start of a request; in flight, it is at least replan_lead ahead."""
        is_smooth = any(uav.mission.max_acceleration for uav in settings.uavs.values())
        lead_in = settings.slot_duration / 2 if is_smooth else 0.0
        delay = settings.start_delay
        if flight is not None and flight.state == 'flying':
            delay = max(delay, settings.replan_lead + lead_in)
        return cls(now_ns, delay, lead_in)

    @property
    def ahead(self) -> float:
        """Time in s from the request to the first setpoint of the plan."""
        return max(0.0, self.delay - self.lead_in)

    @property
    def effect_ns(self) -> int:
        """Time of the first setpoint of the plan in ns."""
        return self.asked_ns + round(self.ahead * 1e9)

    def time_limit(self, limit: float | None, until: float = math.inf) -> float | None:
        """
        Return the parameter's time limit in s, shortened to the time until the effect.

        :param until: time in s after which the plan may not come in any case.
        """
        ahead = min(self.ahead if self.delay else math.inf, until)
        if math.isinf(ahead):
            return limit
        left = ahead - min(_PLAN_RESERVE, ahead / 2)
        return left if limit is None else min(limit, left)

    def explain(self, error: Exception, settings: PlannerSettings) -> Exception:
        """Return an error of the solve that names start_delay if that was its time limit."""
        limit = self.time_limit(None)
        if not isinstance(error, TimeLimitError) or limit is None or (
                0 < settings.time_limit <= limit):
            return error
        return TimeLimitError(
            f'the plan is to take effect in {self.ahead:.3g} s, which leaves {limit:.2g} s to '
            'solve it, too short to find flights that keep the limits; give it a longer '
            'start_delay, and in flight a longer replan_lead')

    def point_0_ns(self, now_ns: int) -> int:
        """Return the time in ns of point 0 of a plan that is solved now."""
        return (self.effect_ns if self.delay else now_ns) + round(self.lead_in * 1e9)

    def check_in_time(self, now_ns: int) -> None:
        """Raise a LateError if a follower would get the plan after the time of its effect."""
        if self.delay and now_ns + _DELIVERY * 1e9 > self.effect_ns:
            raise LateError('the new plan came too late for the moment it was to take effect; a '
                            'longer start_delay gives it more time, and in flight a longer '
                            'replan_lead')


class Request(NamedTuple):
    """
    A new mission, which is to be planned.

    :param start: the StartTime of its plan.
    :param clock: of its plan, for which its receivers are predicted.
    :param receivers: its Receivers.
    """

    scenario: Scenario
    start: StartTime
    clock: PlanClock
    receivers: Receivers

    def date(self, plan: Plan, now_ns: int) -> Plan:
        """Return its plan, solved now, with its start and with the receivers at that time."""
        start_ns, until = self.start.point_0_ns(now_ns), self.receivers.promised_until
        if until is None or self.start.delay:
            return replace(plan, start_ns=start_ns, promised_until=until)
        start_ns += round(_RELEASE * 1e9)
        later = start_ns * 1e-9 - self.clock.clock
        scenario = self.receivers.postpone(plan.scenario, later)
        powers, _ = mute_nonpositive_slots(scenario, plan.positions, plan.powers, plan.objective)
        return replace(plan, scenario=scenario, powers=powers, start_ns=start_ns,
                       promised_until=until - later)

    def predict_again(self, plan: Plan, settings: PlannerSettings, poses: PoseBook, now_ns: int
                      ) -> tuple['Request', Plan]:
        """Return this request and its plan with receivers that are predicted from now."""
        clock = PlanClock(0.0, self.start.point_0_ns(now_ns) * 1e-9 + _RELEASE)
        receivers = predict_receivers(
            settings, poses, now_ns * 1e-9, clock, float(plan.curve.end))
        scenario = replace(plan.scenario, **receivers.fields)
        return (self._replace(scenario=scenario, clock=clock, receivers=receivers),
                replace(plan, scenario=scenario))


def make_request(settings: PlannerSettings, poses: PoseBook, start: StartTime,
                 states: Sequence[MeasuredState | None], flight: Flight | None) -> Request:
    """
    Return the Request of a new mission, which begins where the UAVs will be.

    :param states: the measured state of each UAV, in the time of the flight or else of the
        clock; None for a UAV that is on the flight's plan, or at its start without a flight.
    :param flight: the Flight that the mission continues, or None.
    :raises PlanningError: if poses cannot be used, or for a mission that cannot be flown.
    """
    asked = start.asked_ns * 1e-9
    poses.check(settings, asked)
    uavs = [_with_start_state(uav.mission, index, state, settings, start, flight)
            for index, (uav, state) in enumerate(
                zip(settings.uavs.values(), states, strict=True))]
    clock = PlanClock(0.0, start.point_0_ns(start.asked_ns) * 1e-9 + (
        0.0 if start.delay else _RELEASE))
    end = settings.duration * (settings.slots + 1) / settings.slots
    receivers = predict_receivers(settings, poses, asked, clock, end)
    return Request(_scenario(settings, uavs, receivers.fields), start, clock, receivers)


def explain_infeasible(settings: PlannerSettings) -> str:
    """Return the reason why the mission of the parameters cannot be flown, or an empty string."""
    receivers = {'ground_node': (0.0, 0.0), 'eavesdroppers': (Eavesdropper((0.0, 0.0)),)}
    try:
        _scenario(settings, [uav.mission for uav in settings.uavs.values()], receivers)
    except PlanningError as error:
        return brief(error)
    return ''


def _scenario(settings: PlannerSettings, uavs: Sequence[Uav], receivers: Mapping[str, Any]
              ) -> Scenario:
    return Scenario(uavs=tuple(uavs), **receivers, **settings.mission)


def _with_start_state(uav: Uav, index: int, state: MeasuredState | None,
                      settings: PlannerSettings, start: StartTime, flight: Flight | None
                      ) -> Uav:
    """
    Return a UAV that starts where it will be when the plan takes effect.

    | flight            | state of the UAV    | it starts                       |
    | ----------------- | ------------------- | ------------------------------- |
    | under way         | any                 | on the plan in flight           |
    | ended             | None                | on the plan in flight           |
    | none, or waiting  | None                | where its parameters say        |
    | ended, or waiting | measured            | where it is predicted to be     |
    | none              | measured, delay     | where it is predicted to be     |
    | none              | measured, no delay  | where it is                     |
    """
    is_flown = flight is not None and flight.state != 'waiting'
    if state is None and not is_flown:
        return uav
    if state is not None and flight is None and not start.delay:
        return replace(uav, start=state.position)
    time = start.effect_ns * 1e-9 if flight is None else flight.time + flight.rate * start.ahead
    if state is None or flight is not None and flight.is_under_way:
        start_state = _planned_state(uav, index, flight, time)
    else:
        playback = None if flight is None else flight.playback
        start_state = predict_state(
            state, time, uav.max_acceleration, playback, index, settings.track_tolerance)
    return start_from_state(uav, *start_state, settings.slot_duration)


def _planned_state(uav: Uav, index: int, flight: Flight, time: float) -> tuple[Point, Point]:
    """Return position and velocity on the plan in flight, or raise an error beyond a limit."""
    flown = flight.playback.plan.scenario.uavs[index]
    if uav.altitude != flown.altitude:
        raise ScenarioError(
            f'{uav.name}.altitude is {uav.altitude:g} m and {uav.name} flies at '
            f'{flown.altitude:g} m; it can change when the flight has ended')
    moment = flight.playback.at(time)
    (x, y), (u, v) = moment.positions[index].tolist(), moment.velocities[index].tolist()
    if flight.rate == 0.0:
        u = v = 0.0
    if uav.max_acceleration is not None and math.hypot(u, v) > uav.max_speed * (1 + 1e-6):
        raise ScenarioError(
            f'{uav.name}.max_speed is {uav.max_speed:g} m/s and {uav.name} flies at '
            f'{math.hypot(u, v):.1f} m/s; it can be lower when the flight has ended')
    return (x, y), (u, v)


class Remainder(NamedTuple):
    """
    The remainder of a mission, which is to be planned again.

    :param flight: of the plan, when it became due.
    :param now: the time of the clock then, in s.
    :param first: the first point of its path that may change.
    :param updated: its scenario with the present receivers.
    :param receivers: these, as predicted.
    :param must_meet: raise an error if the UAVs cannot be met where they will be; otherwise the
        new plan then begins on the plan in flight.
    """

    flight: Flight
    now: float
    first: int
    states: Sequence[MeasuredState | None]
    updated: Scenario
    receivers: Receivers
    must_meet: bool
    tolerance: float
    time_limit: float

    @property
    def plan(self) -> Plan:
        """Plan in flight."""
        return self.flight.playback.plan

    @property
    def clock(self) -> PlanClock:
        """Clock of the plan, for which the receivers are predicted."""
        return PlanClock(self.flight.time, self.now, self.flight.rate)

    def date(self, plan: Plan) -> Plan:
        """Return its plan with the promise of its receivers."""
        until, clock = self.receivers.promised_until, self.clock
        if until is None:
            return plan
        return replace(plan, promised_until=until, promise_speed=clock.rate,
                       promise_delay=clock.to_clock(0.0) - plan.start_ns * 1e-9)

    def find_rejoin(self) -> Rejoin:
        """Return the beginning of the replan, or raise an InfeasibleMissionError."""
        try:
            return find_rejoin(
                self.plan, self.first, self.states, self.tolerance, self.updated)
        except InfeasibleMissionError:
            if self.must_meet:
                raise
            return find_rejoin(self.plan, self.first, [None] * len(self.states), self.tolerance,
                               self.updated)

    def check_in_time(self, rejoin: Rejoin, flight: Flight | None, now: float) -> None:
        """Raise an error if its plan comes too late for the flight, or for another flight."""
        if flight is None or flight.playback.plan is not self.plan:
            raise SupersededError('replan: another plan came in between')
        check_continuation(self.flight, flight, now - self.now)
        if flight.time + _DELIVERY * flight.rate > rejoin.effect:
            raise LateError('replan: the new plan came after the moment it was to take effect; '
                            'a longer replan_lead gives it more time')


class Replanning:
    """When and why the remainder of the mission is planned again; times in s."""

    def __init__(self, poses: PoseBook, tracking: PlanTracking) -> None:
        self._poses, self._tracking = poses, tracking
        self._last_planned = -math.inf
        self._stopped = frozenset[str]()  # UAVs that relays stopped at the last replan.
        self._has_failed = False  # The last replan that was due, not only useful.
        self._counts_from = -math.inf  # Time of the plan from which its present receivers count.

    def find_reason(self, last: Plan, settings: PlannerSettings, now: float) -> str:
        """
        Return the reason to plan the rest of the mission again, or an empty string.

        It is 'period', 'promise' at its end, 'receivers' that have moved, 'deviation', or
        'release' of a UAV that was to be met where its relay had stopped it.

        :raises PlanningError: if the receivers cannot be predicted.
        """
        period, distance = settings.replan_period, settings.replan_distance
        if not settings.has_replans:
            return ''
        flight = self._tracking.flight(now)
        if flight is None or not flight.rate or not self._tracking.is_steady(now):
            return ''
        plan = flight.playback.plan
        if plan.start_ns != last.start_ns:
            return ''  # The last plan has not begun.
        if self._first_point(flight, settings) >= plan.scenario.slots or (
                self._poses.problems(settings, now, with_uavs=False)):
            return ''  # The mission ends before; or poses are missing, which the status tells.
        since = now - self._last_planned  # Negative after the clock has jumped back.
        if period and not 0 <= since < period:
            return 'period'
        lead, is_recent = settings.replan_lead, 0 <= since < settings.replan_lead
        # After a failure, and where receivers are predicted, the rest waits for the lead.
        if not (is_recent and (self._has_failed or plan.scenario.has_tracks)):
            if self._tracking.promise_ends(flight, (lead + _DELIVERY) * flight.rate
                                           + _EFFECT_SLOTS * plan.scenario.slot_duration):
                return 'promise'
            if (distance or period) and has_moved(
                    plan.scenario, self._update(flight, settings, now)[0],
                    max(flight.time, self._counts_from), distance):
                return 'receivers'
        most = settings.replan_deviation
        if not most or flight.state != 'flying':
            return ''
        stopped = self._find_stopped(settings)
        if self._stopped - stopped:
            return 'release'
        # A UAV has the lead to come back, unless its relay has stopped it since.
        if not (is_recent and self._stopped == stopped) and any(
                distance > most and settings.uavs[name].use_pose for name, distance in
                self._tracking.predict_distances(settings, now, lead).items()):
            return 'deviation'
        return ''

    def begin(self, reason: str, settings: PlannerSettings, now: float) -> Remainder:
        """
        Begin a replan for a reason: note its time, and return the remainder of the mission.

        :raises PlanningError: if the receivers cannot be predicted.
        """
        flight, lead = self._tracking.flight(now), settings.replan_lead
        assert flight is not None
        updated, receivers = self._update(flight, settings, now)
        self._last_planned = now
        self._stopped = self._find_stopped(settings)
        return Remainder(
            flight, now, self._first_point(flight, settings),
            self._tracking.states(flight, settings, now), updated, receivers,
            reason == 'deviation', settings.track_tolerance,
            lead - min(_REPLAN_RESERVE, lead / 2))

    def is_settled(self, settings: PlannerSettings, now: float) -> bool:
        """Return True if all UAVs are on their plan, and the last replan was a lead ago."""
        return not 0 <= now - self._last_planned < settings.replan_lead and all(
            distance <= settings.track_tolerance
            for distance in self._tracking.distances(settings, now).values())

    def end(self, now: float, counts_from: float = -math.inf) -> None:
        """Note a new plan, in which the present receivers count from a time of the plan on."""
        self._last_planned, self._has_failed, self._counts_from = now, False, counts_from

    def fail(self, remainder: Remainder) -> None:
        """Note that the remainder was not planned again."""
        self._has_failed = not remainder.must_meet

    def _find_stopped(self, settings: PlannerSettings) -> frozenset[str]:
        """Return the names of the UAVs with a pose to plan from that their relays stop."""
        return self._tracking.find_stopped(
            name for name, uav in settings.uavs.items() if uav.use_pose)

    def _first_point(self, flight: Flight, settings: PlannerSettings) -> int:
        """Return the first point of a flight that a replan of now may change."""
        return find_first_point(flight.playback.plan.scenario,
                                flight.time + settings.replan_lead * flight.rate)

    def _update(self, flight: Flight, settings: PlannerSettings, now: float
                ) -> tuple[Scenario, Receivers]:
        """Return the scenario of a flight with the present receivers, and these."""
        receivers = predict_receivers(
            settings, self._poses, now, PlanClock(flight.time, now, flight.rate),
            flight.playback.duration)
        return replace(flight.playback.plan.scenario, **receivers.fields), receivers
