"""A request for a new mission: its call and answer, its parameters and poses, and its plan."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
import math
import time
from typing import Any, Literal, TypeAlias

from rclpy.task import Future

from .followed_plans import check_continuation, start_of
from .poses import PoseBook
from .receivers import predict_receivers, Receivers
from .settings import PlannerSettings
from .solver import Job
from ..messages import serialize_plan
from ...errors import (
    brief, InfeasibleMissionError, LateError, PlanningError, ScenarioError, TimeLimitError)
from ...mission.scenario import Array, Eavesdropper, Point, Scenario, Uav
from ...optimize.incumbent import mute_negative_slots
from ...plan.flight import Flight
from ...plan.plan import Plan
from ...plan.tracking import (
    deviation, MeasuredState, PlanClock, predict_state, start_from_state)

DELIVERY_S = 0.2
"""Time from the publication of a plan until the follower has it."""

# Time between a solve and the effect of its plan; at most half of the available time.
_RESERVE_S = 1.0
_RELEASE_S = 1.0  # Time from a solve without a start_delay to point 0, where receivers move.
_SHORTEST_SOLVE_S = 0.01
_MEASURED = 0.01  # Error of a playback speed that reports tell, relative to real time.

Outgoing: TypeAlias = tuple[Plan, dict[str, bytes]]
"""A plan and its serialized messages by topic."""


@dataclass(eq=False)
class Call:
    """
    A call of ~/plan, which is answered once.

    It `waits` until a follower of a restored plan is heard or discovery is over, is then `solved`,
    and is `answered` at the end.
    """

    state: Literal['waits', 'solved', 'answered'] = 'waits'
    answer: Future = field(default_factory=Future)
    has_jumped: bool = False  # Whether the clock has jumped since the call.

    def reply(self, success: bool, text: str) -> None:
        """Answer the call, unless it has been answered."""
        if self.state != 'answered':
            self.state = 'answered'
            self.answer.set_result((success, text))


@dataclass(frozen=True)
class StartTime:
    """
    The start of the plan of a request.

    :param asked_ns: time of the request [ns].
    :param delay: delay of point 0 after the request [s]; 0 for a plan that begins once it is
        solved.
    :param lead_in: time [s] from the first setpoint to point 0. With a limit of acceleration it is
        half a slot, because UAVs leave their starts then.
    :param until: time [s] after the request by which the plan must come in any case.
    """

    asked_ns: int
    delay: float
    lead_in: float
    until: float = math.inf

    @classmethod
    def from_settings(cls, settings: PlannerSettings, now_ns: int, flight: Flight | None,
                      until: float = math.inf) -> 'StartTime':
        """Return the StartTime by start_delay; while flying, `ahead` is at least replan_lead."""
        is_smooth = any(uav.mission.max_acceleration for uav in settings.uavs.values())
        lead_in = settings.slot_duration / 2 if is_smooth else 0.0
        delay = settings.start_delay
        if flight is not None and flight.state == 'flying':
            delay = max(delay, settings.replan_lead + lead_in)
        return cls(now_ns, delay, lead_in, until)

    @property
    def ahead(self) -> float:
        """Time [s] from the request to the first setpoint of the plan."""
        return max(0.0, self.delay - self.lead_in)

    @property
    def effect_ns(self) -> int:
        """Time of the first setpoint of the plan [ns]."""
        return self.asked_ns + round(self.ahead * 1e9)

    def time_limit(self, limit: float | None) -> float | None:
        """
        Return the time limit of the solve [s]: the lesser of `limit` and the time left.

        The time left is t - min(_RESERVE_S, t / 2), where t is the lesser of `until` and, with a
        delay, the time to the plan's effect. None is no limit.

        :param limit: value of the parameter time_limit [s], or None.
        """
        ahead = min(self.ahead if self.delay else math.inf, self.until)
        if math.isinf(ahead):
            return limit
        time_left = ahead - min(_RESERVE_S, ahead / 2)
        return time_left if limit is None else min(limit, time_left)

    def explain(self, error: Exception, settings: PlannerSettings) -> Exception:
        """
        Return the error of a solve, or a TimeLimitError that says to set a longer start_delay.

        A TimeLimitError is replaced if the plan's effect, and not the parameter time_limit, set
        the limit.
        """
        limit = self.time_limit(None)
        if not isinstance(error, TimeLimitError) or limit is None or (
                0 < settings.time_limit <= limit):
            return error
        if self.until < (self.ahead if self.delay else math.inf):
            return TimeLimitError(
                f'an earlier plan takes effect in {self.until:.3g} s, which leaves {limit:.2g} s '
                'to solve it; ask again when the earlier one is flown')
        return TimeLimitError(
            f'the plan is to take effect in {self.ahead:.3g} s, which leaves {limit:.2g} s to '
            'solve it, too short to find flights that keep the limits; give it a longer '
            'start_delay, and in flight a longer replan_lead')

    def point_0_ns(self, now_ns: int) -> int:
        """Return the clock's time of point 0 [ns] of a plan whose solve ends at now_ns."""
        return (self.effect_ns if self.delay else now_ns) + round(self.lead_in * 1e9)

    def check_in_time(self, now_ns: int) -> None:
        """Raise a LateError if a plan with a delay has its effect in less than DELIVERY_S."""
        if self.delay and now_ns + DELIVERY_S * 1e9 > self.effect_ns:
            raise LateError('the new plan came too late for the moment it was to take effect; a '
                            'longer start_delay gives it more time, and in flight a longer '
                            'replan_lead')


@dataclass(frozen=True)
class Request:
    """
    A new mission, which is to be planned.

    :param start: the StartTime of the mission's plan.
    :param clock: clock of the plan for which the receivers are predicted.
    :param receivers: Receivers of the mission.
    :param settings: settings of the planner when the request came.
    :param flight: the Flight that the mission continues, or None.
    :param solved: the plan of a mission that is solved; only its receivers are predicted again.
    """

    scenario: Scenario
    start: StartTime
    clock: PlanClock
    receivers: Receivers
    settings: PlannerSettings
    flight: Flight | None
    solved: Plan | None = None

    def solve(self, job: Job, initial: Plan | None, until: float | None,
              now_ns: Callable[[], int]) -> Outgoing:
        """
        Return the plan of the mission and its messages; called in the solver's thread.

        If there is a plan `solved`, that plan is dated, and nothing is solved.

        :param initial: a Plan from which the solve begins, or None.
        :param until: time of time.monotonic() at which the solve must end, or None.
        :param now_ns: returns the time of the node's clock in ns.
        """
        plan = self.solved
        if plan is None:
            limit = None if until is None else max(_SHORTEST_SOLVE_S, until - time.monotonic())
            plan = job.solve(self.scenario, self.settings, limit, initial, self.settings.deliver)
        plan = self.date(plan, now_ns())
        return plan, serialize_plan(plan, self.settings.frame_id)

    def is_outlasted_by(self, plan: Plan) -> bool:
        """Return True if the solve outlasted the predictions: no slot of the plan is promised."""
        return not (plan.promise.slots or self.start.delay or self.solved)

    def check_flight(self, flight: Flight | None, now: float) -> None:
        """Raise a LateError unless the flight has continued steadily since the request."""
        check_continuation(self.flight, flight, now - self.start.asked_ns * 1e-9)

    @property
    def flight_text(self) -> str:
        """Text that says which flight the plan continues; empty without a flight in the air."""
        flight = self.flight
        return '' if flight is None or not flight.is_under_way else (
            f'; it goes on from plan {flight.playback.plan.identity}, which is {flight.state}')

    def date(self, plan: Plan, now_ns: int) -> Plan:
        """
        Return the solved plan with its start time, and with its promise until predictions end.

        With predicted receivers and without a start_delay, point 0 was not known at the
        prediction. It is then set _RELEASE_S after the solve, and the tracks of predicted
        receivers are moved to it. With these tracks, the transmitter is muted in slots in which
        the rates of all ground nodes are negative.
        """
        start_ns, until = self.start.point_0_ns(now_ns), self.receivers.promised_until
        if until is None:
            return replace(plan, start_ns=start_ns, promised_until=None)
        if self.start.delay:
            return replace(plan, start_ns=start_ns, promised_until=until,
                           promise_speed=self.clock.time_scale,
                           promise_delay=self.clock.clock - start_ns * 1e-9)
        start_ns += round(_RELEASE_S * 1e9)
        # Time [s] by which point 0 is later than the prediction took it to be.
        later = start_ns * 1e-9 - self.clock.clock
        scenario = self.receivers.postpone(plan.scenario, later)
        powers, _ = mute_negative_slots(scenario, plan.positions, plan.powers, plan.objective)
        return replace(plan, scenario=scenario, powers=powers, start_ns=start_ns,
                       promised_until=until - later)

    def predict_again(self, plan: Plan, poses: PoseBook, now_ns: int) -> 'Request':
        """
        Return this request, solved by `plan`, with receivers predicted from now_ns on.

        :raises PoseError: if a receiver has no usable pose any more.
        """
        poses.check(self.settings, now_ns * 1e-9, with_uavs=False)
        clock = PlanClock(0.0, self.start.point_0_ns(now_ns) * 1e-9 + _RELEASE_S)
        receivers = predict_receivers(
            self.settings, poses, now_ns * 1e-9, clock, float(plan.curve.end))
        scenario = replace(plan.scenario, **receivers.fields)
        return replace(self, scenario=scenario, clock=clock, receivers=receivers,
                       solved=replace(plan, scenario=scenario))


def earliest_request(plan: Plan, settings: PlannerSettings) -> float:
    """Return the earliest time [s] at which a plan with a start was asked for, by the settings."""
    return start_of(plan) * 1e-9 - _RELEASE_S - plan.scenario.slot_duration - max(
        settings.start_delay, settings.replan_lead)


def make_request(settings: PlannerSettings, poses: PoseBook, start: StartTime,
                 states: Sequence[MeasuredState | None], flight: Flight | None) -> Request:
    """
    Return the Request of a new mission, which begins where the UAVs will be.

    :param states: the measured state of each UAV, in the time of the flight, or of the clock
        without a flight; None for a UAV that is on the flight's plan, or at its start if no flight
        has begun.
    :param flight: the Flight that the mission continues, or None.
    :raises PlanningError: if poses cannot be used, or for a mission that cannot be flown.
    """
    asked = start.asked_ns * 1e-9
    poses.check(settings, asked)
    uavs = [_with_start_state(uav.mission, index, state, settings, start, flight)
            for index, (uav, state) in enumerate(
                zip(settings.uavs.values(), states, strict=True))]
    # Without a start_delay, receivers are predicted as if the solve took no time; see `date`.
    later, time_scale = _RELEASE_S, 1.0  # By how many s point 0 is flown after point_0_ns.
    if start.delay:
        # A new plan is flown on at the playback speed of the flight, from its first setpoint on.
        time_scale = flight.time_scale if flight and flight.state == 'flying' else 1.0
        if abs(time_scale - 1.0) < _MEASURED:
            time_scale = 1.0
        later = start.lead_in * (1 / time_scale - 1)
    clock = PlanClock(0.0, start.point_0_ns(start.asked_ns) * 1e-9 + later, time_scale)
    end = settings.duration * (settings.slots + 1) / settings.slots  # Point N+1 [s].
    receivers = predict_receivers(settings, poses, asked, clock, end)
    return Request(
        _scenario(settings, uavs, receivers.fields), start, clock, receivers, settings, flight)


def explain_infeasible(settings: PlannerSettings) -> str:
    """Return why the mission of the parameters, with receivers at (0, 0), is wrong, or ''."""
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
    Return a UAV whose start is where the UAV will be when the plan takes effect.

    :param index: index of the UAV in the plan in flight.
    :param state: measured state in the time of the flight, or of the clock without a flight.

    | flight            | state of the UAV    | it starts                       |
    | ----------------- | ------------------- | ------------------------------- |
    | under way         | None or measured    | on the flight's plan            |
    | ended             | None                | at the end of the flight's plan |
    | none, or waiting  | None                | where its parameters say        |
    | ended, or waiting | measured            | where it is predicted to be     |
    | none              | measured, delay     | where it is predicted to be     |
    | none              | measured, no delay  | where it is                     |

    :raises InfeasibleMissionError: for a UAV that is held off the plan in flight.
    :raises ScenarioError: for a UAV that flies at another altitude or above its max_speed.
    """
    is_flown = flight is not None and flight.state != 'waiting'
    if state is None and not is_flown:
        return uav
    if state is not None and flight is None and not start.delay:
        return replace(uav, start=state.position)
    time = (start.effect_ns * 1e-9 if flight is None else
            flight.time + flight.time_scale * start.ahead)
    position: Point
    velocity: Point | None
    if flight is not None and (state is None or flight.is_under_way):
        if state is not None and state.is_held:
            _check_distance(uav.name, deviation(flight.playback, index, state), settings)
        position, velocity = _planned_state(uav, index, flight, time)
    else:
        assert state is not None
        position, velocity = predict_state(
            state, time, uav.max_acceleration, None if flight is None else flight.playback, index,
            settings.track_tolerance)
    return start_from_state(uav, position, velocity, settings.slot_duration)


def _check_distance(name: str, offset: Array, settings: PlannerSettings) -> None:
    """Raise an InfeasibleMissionError if a held UAV's offset (x, y) [m] is > track_tolerance."""
    distance = math.hypot(*offset)
    if distance > settings.track_tolerance:
        raise InfeasibleMissionError(
            f'{name} is held {distance:.1f} m from the plan in flight, on which a new plan would '
            f'begin: ask again when {name} is back on it, or after ~/pause and ~/reset of the '
            f'replay, with which the new plan begins where {name} is')


def _planned_state(uav: Uav, index: int, flight: Flight, time: float) -> tuple[Point, Point]:
    """
    Return a UAV's position [m] and velocity [m/s] on the flight's plan at a time [s] of the plan.

    The velocity is per s of the plan's time, and 0 while the flight is held.

    :raises ScenarioError: if its altitude is not the plan's, or if it has an acceleration limit
        and flies faster than its max_speed.
    """
    flown = flight.playback.plan.scenario.uavs[index]
    if uav.altitude != flown.altitude:
        raise ScenarioError(
            f'{uav.name}.altitude is {uav.altitude:g} m and {uav.name} flies at '
            f'{flown.altitude:g} m; it can change when the flight has ended')
    moment = flight.playback.at(time)
    (x, y), (u, v) = moment.positions[index].tolist(), moment.velocities[index].tolist()
    if flight.time_scale == 0.0:
        u = v = 0.0
    if uav.max_acceleration is not None and math.hypot(u, v) > uav.max_speed * (1 + 1e-6):
        raise ScenarioError(
            f'{uav.name}.max_speed is {uav.max_speed:g} m/s and {uav.name} flies at '
            f'{math.hypot(u, v):.1f} m/s; it can be lower when the flight has ended')
    return (x, y), (u, v)
