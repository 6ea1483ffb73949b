"""
Problems for the solver, from parameters, poses and the flight.

A request plans a new mission, which begins at a StartTime; Replanning finds when the remainder of
the mission in flight is due to be planned again.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
import math
from typing import Any, NamedTuple

import numpy as np

from .parameters import SCENARIO_FIELDS
from .plan_tracking import PlanTracking
from .poses import error_radius, KnownPose, PoseBook
from .settings import airspace_from, channel_from, uav_from
from ..errors import (
    brief, InfeasibleMissionError, LateError, PlanningError, ScenarioError, SupersededError)
from ..mission.scenario import Eavesdropper, Point, Scenario, Uav
from ..mission.tracks import Track
from ..optimize.rejoin import find_first_point, find_rejoin, Rejoin
from ..plan.plan import Plan
from ..plan.tracking import Flight, MeasuredState, predict_state, start_from_state

# s between a solve and the effect of its plan; at most half of the available time.
_PLAN_RESERVE, _REPLAN_RESERVE = 1.0, 0.5
_SHORTEST_TRACK = 1.0  # s
_DELIVERY = 0.2  # s from the publication of a replan until the follower has it.
_REASONS = ('period', 'distance', 'deviation')


@dataclass(frozen=True)
class StartTime:
    """
    The start of the plan of a request.

    :param asked_ns: time of the request in ns.
    :param delay: s from the request to point 0; 0 for a plan that begins once it is solved.
    :param lead_in: s from the first setpoint to point 0: half a slot if any UAV has a limit of
        acceleration, because it leaves its start then.
    """

    asked_ns: int
    delay: float
    lead_in: float

    @classmethod
    def from_settings(cls, settings: Mapping[str, Any], now_ns: int, flight: Flight | None
                      ) -> 'StartTime':
        """Return the start of a request; in flight, it is at least replan_lead ahead."""
        is_smooth = any(settings[f'{name}.max_acceleration'] for name in settings['uavs'])
        lead_in = settings['duration'] / settings['slots'] / 2 if is_smooth else 0.0
        delay = settings['start_delay']
        if flight is not None and flight.state == 'flying':
            delay = max(delay, settings['replan_lead'] + lead_in)
        return cls(now_ns, delay, lead_in)

    @property
    def ahead(self) -> float:
        """Time in s from the request to the first setpoint of the plan."""
        return max(0.0, self.delay - self.lead_in)

    @property
    def effect_ns(self) -> int:
        """Time of the first setpoint of the plan in ns."""
        return self.asked_ns + round(self.ahead * 1e9)

    def time_limit(self, limit: float | None) -> float | None:
        """Return the parameter's time limit in s, shortened to the time until the effect."""
        if not self.delay:
            return limit
        left = self.ahead - min(_PLAN_RESERVE, self.ahead / 2)
        return left if limit is None else min(limit, left)

    def point_0_ns(self, now_ns: int) -> int:
        """Return the time in ns of point 0 of a plan that is solved now."""
        return (self.effect_ns if self.delay else now_ns) + round(self.lead_in * 1e9)

    def check_in_time(self, now_ns: int) -> None:
        """Raise a LateError if the time at which the plan takes effect has passed."""
        if self.delay and now_ns > self.effect_ns:
            raise LateError('the new plan came after the moment it was to take effect; a longer '
                            'start_delay gives it more time, and in flight a longer replan_lead')


def scenario_from(settings: Mapping[str, Any], poses: PoseBook, start: StartTime,
                  states: Sequence[MeasuredState | None], flight: Flight | None) -> Scenario:
    """
    Return the Scenario of a new mission, which begins where the UAVs will be.

    :param states: the measured state of each UAV, in the time of the flight or else of the
        clock; None for a UAV that is on the flight's plan, or at its start without a flight.
    :param flight: the Flight that the mission continues, or None.
    :raises PlanningError: if poses cannot be used, or for a mission that cannot be flown.
    """
    poses.check(settings, start.asked_ns * 1e-9)
    uavs = [_with_start_state(uav_from(settings, name), index, state, settings, start, flight)
            for index, (name, state) in enumerate(
                zip(settings['uavs'], states, strict=True))]
    point_0 = start.point_0_ns(start.asked_ns) * 1e-9
    return _scenario(settings, uavs, _receivers(
        settings, poses, start.asked_ns * 1e-9, PlanClock(0.0, point_0, 1.0)))


def explain_infeasible(settings: Mapping[str, Any]) -> str:
    """Return the reason why the mission of the parameters cannot be flown, or an empty string."""
    receivers = {'ground_node': (0.0, 0.0), 'eavesdroppers': (Eavesdropper((0.0, 0.0)),)}
    try:
        _scenario(settings, [uav_from(settings, name) for name in settings['uavs']], receivers)
    except PlanningError as error:
        return brief(error)
    return ''


def _scenario(settings: Mapping[str, Any], uavs: Sequence[Uav], receivers: Mapping[str, Any]
              ) -> Scenario:
    return Scenario(
        uavs=tuple(uavs), channel=channel_from(settings), **receivers,
        **airspace_from(settings), **{field: settings[field] for field in SCENARIO_FIELDS})


def _with_start_state(uav: Uav, index: int, state: MeasuredState | None,
                      settings: Mapping[str, Any], start: StartTime, flight: Flight | None
                      ) -> Uav:
    """Return a UAV that starts in its state at the effect of the plan."""
    if state is None and (flight is None or flight.state == 'waiting'):
        return uav
    time = start.effect_ns * 1e-9 if flight is None else flight.time + flight.rate * start.ahead
    is_reported = flight is not None and flight.is_reported
    if state is None or is_reported and flight.is_under_way:
        start_state = _planned_state(uav, index, flight, time)
    elif is_reported or start.delay:
        start_state = predict_state(
            state, time, uav.max_acceleration, flight and flight.playback, index,
            settings['track_tolerance'])
    else:
        return replace(uav, start=state.position)
    return start_from_state(uav, *start_state, settings['duration'] / settings['slots'])


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


def update_receivers(scenario: Scenario, settings: Mapping[str, Any], poses: PoseBook, now: float,
                     flight: Flight) -> Scenario:
    """Return the scenario with the present estimates of the ground node and the eavesdroppers."""
    poses.check(settings, now, with_uavs=False)
    return replace(scenario, **_receivers(
        settings, poses, now, PlanClock(flight.time, now, flight.rate)))


def has_moved(before: Scenario, now: Scenario, time: float, distance: float) -> bool:
    """
    Return True if a receiver is not where a plan expects it at a time in s from point 0.

    So it is if it is more than a distance in m away, or if it moves and is outside its disc; or
    if a radius has changed by a tenth of the distance. That of one that moves may have become
    smaller, since a prediction grows with time.
    """
    (old_ground,), old_centres, old_radii = before.receivers_at([time])
    (ground,), centres, radii = now.receivers_at([time])
    moving = np.array([old.track is not None or new.track is not None for old, new in zip(
        before.eavesdroppers, now.eavesdroppers, strict=True)])
    moves = np.linalg.norm(centres - old_centres, axis=-1)[:, 0]
    grown = (radii - old_radii)[:, 0]
    is_left = moving & (moves > old_radii[:, 0])
    if not distance:
        return bool(is_left.any())
    return bool(math.dist(old_ground, ground) > distance or (
        is_left | (moves > distance)
        | (np.where(moving, grown, np.abs(grown)) > 0.1 * distance)).any())


class PlanClock(NamedTuple):
    """The time of a plan from its point 0 at a time of the clock, in s, and its rate."""

    time: float
    clock: float
    rate: float

    def to_plan(self, clock: float) -> float:
        """Return the time of the plan at a time of the clock."""
        return self.time + self.rate * (clock - self.clock)


def _receivers(settings: Mapping[str, Any], poses: PoseBook, now: float, clock: PlanClock
               ) -> dict[str, Any]:
    """Return the ground node and the eavesdroppers by the fields of Scenario."""
    until = max(now, clock.clock) + _horizon(settings)
    eavesdroppers = []
    for name in settings['eavesdroppers']:
        pose = poses.usable_pose(name, settings, now, True)
        radius = (error_radius(pose.covariance, settings['confidence'])
                  if pose.covariance.any() else settings[f'{name}.error_radius'])
        eavesdroppers.append(Eavesdropper(
            pose.position, radius, name, settings[f'{name}.receiver_advantage_db'],
            _predict(pose, radius, settings[f'{name}.max_speed'], settings['confidence'], until,
                     clock)))
    ground = poses.usable_pose('ground_node', settings, now, True)
    track = _predict(ground, 0.0, 0.0, settings['confidence'], until, clock)
    return {'ground_node': ground.position, 'eavesdroppers': tuple(eavesdroppers),
            'ground_node_track': track and tuple(knot[:3] for knot in track)}


def _horizon(settings: Mapping[str, Any]) -> float:
    """Return for how long receivers are predicted in s."""
    if settings['prediction_horizon']:
        return float(settings['prediction_horizon'])
    if any(settings[f'replan_{reason}'] for reason in _REASONS):
        return float(settings['replan_period'] + 2 * settings['replan_lead'])
    return float(settings['duration'] * (settings['slots'] + 2) / settings['slots'])


def _predict(pose: KnownPose, radius: float, max_speed: float, confidence: float, until: float,
             clock: PlanClock) -> Track | None:
    """
    Return the track of a receiver from its measurement to a time of the clock; None if it stands.

    With a max_speed it may go anywhere from where it was measured. Otherwise it goes straight on.
    As a message does not say how position and velocity correlate, the root of the covariance of
    the place after t s is at most that of the position plus t times that of the velocity.
    """
    x, y = 0.0, 0.0
    growth = max_speed
    if not max_speed:
        if pose.velocity_covariance is None:
            return None
        x, y = pose.velocity
        growth = error_radius(pose.velocity_covariance, confidence)
        if not (x or y or growth):
            return None
    duration = max(until - pose.time, _SHORTEST_TRACK)
    return tuple((clock.to_plan(pose.time + age), pose.position[0] + age * x,
                  pose.position[1] + age * y, radius + age * growth) for age in (0.0, duration))


class Remainder(NamedTuple):
    """
    The remainder of a mission, which is to be planned again.

    :param plan: the plan in flight.
    :param first: the first point of its path that may change.
    :param updated: its scenario with the present receivers.
    :param must_meet: raise an error if the UAVs cannot be met where they will be; otherwise the
        new plan then begins on the plan in flight.
    """

    plan: Plan
    first: int
    states: Sequence[MeasuredState | None]
    updated: Scenario
    must_meet: bool
    tolerance: float
    time_limit: float

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


class Replanning:
    """Finds when the remainder of the mission is due to be planned again; times in s."""

    def __init__(self, poses: PoseBook, tracking: PlanTracking) -> None:
        self._poses, self._tracking = poses, tracking
        self._last_planned = -math.inf
        self._has_failed = False  # The last replan that was due.
        self._was_due = False

    def note_plan(self, now: float) -> None:
        """Begin the next period at a new plan."""
        self._last_planned, self._has_failed = now, False

    def note_failure(self) -> None:
        """Note that the last replan gave no plan."""
        self._has_failed = self._was_due

    def find_due(self, last: Plan, settings: Mapping[str, Any], now: float) -> Remainder | None:
        """Return the remainder of the mission if it is due to be planned again, or None."""
        if not any(settings[f'replan_{reason}'] for reason in _REASONS):
            return None
        flight = self._tracking.flight(now)
        if flight is None or not flight.rate:
            return None
        plan = flight.playback.plan
        if plan.start_ns != last.start_ns:
            return None  # The last plan has not begun.
        lead = settings['replan_lead']
        first = find_first_point(plan.scenario, flight.time + lead * flight.rate)
        if first >= plan.scenario.slots:
            return None  # The mission ends before a new plan could take effect.
        try:
            updated = update_receivers(plan.scenario, settings, self._poses, now, flight)
        except PlanningError:
            return None  # Poses are missing or too old; the diagnostics report it.
        is_due = self._is_due(plan, updated, settings, now, flight.time)
        if not is_due and not (flight.state == 'flying' and self._deviates(settings, now)):
            return None
        self._last_planned, self._was_due = now, is_due
        states = self._tracking.states(flight, settings, now)
        return Remainder(plan, first, states, updated, not is_due, settings['track_tolerance'],
                         lead - min(_REPLAN_RESERVE, lead / 2))

    def _is_due(self, plan: Plan, updated: Scenario, settings: Mapping[str, Any], now: float,
                time: float) -> bool:
        """Return True if the period is over, or a receiver is not where the plan expects it."""
        period, distance = settings['replan_period'], settings['replan_distance']
        since = now - self._last_planned  # Negative after the clock has jumped back.
        if period and not 0 <= since < period:
            return True
        # After a failure, and where receivers are predicted, a move waits for the lead.
        waits = (self._has_failed or updated.has_tracks) and 0 <= since < settings['replan_lead']
        return bool((distance or period) and not waits and has_moved(
            plan.scenario, updated, time, distance))

    def _deviates(self, settings: Mapping[str, Any], now: float) -> bool:
        """Return True if a UAV is too far from its plan, and has had the lead to come back."""
        most = settings['replan_deviation']
        if not most or 0 <= now - self._last_planned < settings['replan_lead']:
            return False
        return any(distance > most and settings[f'{name}.use_pose']
                   for name, distance in self._tracking.distances(settings, now).items())


def check_in_time(rejoin: Rejoin, flight: Flight | None) -> None:
    """Raise an error if a replan comes too late for the flight, or after another plan."""
    if flight is None or flight.playback.plan is not rejoin.plan:
        raise SupersededError('replan: another plan came in between')
    if flight.time + _DELIVERY * flight.rate > rejoin.effect:
        raise LateError('replan: the new plan came after the moment it was to take effect; '
                        'a longer replan_lead gives it more time')
