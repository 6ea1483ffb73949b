"""
The plan in flight: its progress in plan time, where the UAVs are then, and what it promises.

Only the reports of a follower on `plan_time` say that a plan is flown.
"""

from collections import defaultdict
from collections.abc import Iterable, Mapping
import math

import numpy as np
from sensor_msgs.msg import TimeReference

from .poses import PoseBook
from .receivers import SHORTEST_TRACK
from .settings import PlannerSettings
from ..messages import nanoseconds, read_plan_time
from ..planner_status import TrackStatus
from ..relay_reports import RelayReports
from ...errors import LateError, quote, SupersededError
from ...mission.scenario import Array
from ...plan.flight import Flight
from ...plan.plan import Plan
from ...plan.playback import Playback
from ...plan.tracking import (
    AchievedRates, deviation, FollowerReports, MeasuredState, predict_stop, PUNCTUAL,
    SILENCE, Watch)

_MOST_PLANS = 8  # Number of last plans that are kept for the reports of a follower.
_SAME_TIME = 0.01  # Largest time [s] between the expected and the present time of a plan.
_ROUNDING = 1e-6  # Tolerance of a time [s].
_LEAST_AHEAD = 3.0  # Least time [s] before the effect of a plan at which another can replace it.
ADOPTION_GRACE = 2.0  # Time [s] that a follower has to adopt a plan after it comes or begins.


class PlanTracking:
    """
    Tracks the flight of the last plans by the reports of its follower.

    The follower that flies first is followed until its flight ends or it is silent. `now` is the
    node's time in s.

    :ivar relays: what becomes of the setpoints of each UAV, where a relay reports it.
    """

    def __init__(self, poses: PoseBook) -> None:
        self._poses, self.relays = poses, RelayReports()
        self._plans: dict[str, Playback] = {}  # The last plans by identity.
        self._published_ns = 0  # Time of the newest plan's publication [ns].
        # Time [s] of the plan in flight at which the newest plan is to replace it.
        self._takeover = -math.inf
        self._achieved = AchievedRates()
        self._watches = defaultdict[str, Watch](Watch)  # Recent motion of each UAV.
        self.forget_reports()

    def forget_reports(self) -> None:
        """Forget the reports of followers: when the clock is set back they are of another time."""
        self._reports: FollowerReports | None = None
        self._unknown: FollowerReports | None = None  # About a plan that this planner lacks.
        self._ignored: tuple[str, float] | None = None  # Name and last report [s] of another one.
        self._last_arrival = -math.inf, 0.0  # Arrival [s] of the last report, and its age then.

    def add_plan(self, plan: Plan, now: float) -> None:
        """Track a plan published at `now` [s] as the newest one; drop all but the last few."""
        playback, flight = Playback(plan), self.flight(now)
        if not self._plans or plan.identity != self._newest.plan.identity:
            ahead = max(0.0, (playback.begin_ns or 0) * 1e-9 - now)
            self._takeover = -math.inf if flight is None else (
                flight.time + flight.time_scale * ahead)
        # The plan that the follower reports and the last _MOST_PLANS - 1 plans are kept.
        reported = self._reports.identity if self._reports else None
        # A plan that is published again moves to the end of the dict.
        kept = {reported, *list(self._plans)[1 - _MOST_PLANS:]} - {plan.identity}
        for identity in {*self._plans} - kept:
            del self._plans[identity]
        self._plans[plan.identity] = playback
        self._published_ns = round(now * 1e9)

    def add_report(self, message: TimeReference, now: float) -> None:
        """
        Use a follower's report of its plan's time, which arrived at the clock's time `now` [s].

        A report on an untracked plan is only kept as _unknown. A second follower is ignored until
        the first has been silent for SILENCE, or until the second alone is flying or held.
        """
        clock_ns, plan_ns = nanoseconds(message.header.stamp), nanoseconds(message.time_ref)
        self._last_arrival = now, now - clock_ns * 1e-9
        identity, follower = read_plan_time(message)
        last = self._reports
        if identity not in self._plans:
            if self._unknown is None or self._unknown.identity != identity:
                self._unknown = FollowerReports(follower, identity, 0.0)
            self._unknown.add(clock_ns, plan_ns)
            return
        is_other = last is not None and follower != last.follower
        if last and is_other and abs(clock_ns - last.last_ns) <= SILENCE * 1e9 and (
                self._is_under_way(last.identity, last.plan_ns)
                or not self._is_under_way(identity, plan_ns)):
            self._ignored = follower, clock_ns * 1e-9
            return
        if last is None or (last.follower, last.identity) != (follower, identity):
            # The playback speed is kept, because a follower does not stop between plans.
            scale = 0.0
            if last is not None:
                _, scale = last.at(clock_ns, 0)
            is_same_flight = last is not None and not is_other and (
                self._start_ns(last.identity) == self._start_ns(identity))
            self._reports = FollowerReports(
                follower, identity, scale, last if is_same_flight else None)
        self._followed.add(clock_ns, plan_ns)

    @property
    def _followed(self) -> FollowerReports:
        """Return the reports on the plan in flight, once a follower has reported."""
        assert self._reports is not None
        return self._reports

    def _start_ns(self, identity: str) -> int | None:
        playback = self._plans.get(identity)
        return None if playback is None else playback.plan.start_ns

    def _is_under_way(self, identity: str, plan_ns: int) -> bool:
        playback = self._plans.get(identity)
        return playback is not None and Flight(
            playback, (plan_ns - start_of(playback.plan)) * 1e-9, 0.0).is_under_way

    def flight(self, now: float) -> Flight | None:
        """
        Return the Flight at a time [s], or None before any report on a tracked plan.

        A newest plan with the start time of the reported plan is in flight from its publication.
        If the follower still reports the old plan ADOPTION_GRACE later, the old plan is in flight.
        """
        reports, now_ns = self._reports, round(now * 1e9)
        if reports is None or reports.identity not in self._plans:
            return None
        reported = self._plans[reports.identity]
        is_newest = self._newest.plan.start_ns == reported.plan.start_ns and (
            reports.last_ns - self._published_ns <= ADOPTION_GRACE * 1e9)
        time, time_scale = reports.at(now_ns, start_of(reported.plan))
        return Flight(self._newest if is_newest else reported, time, time_scale,
                      reports.is_current(now_ns))

    # The promise

    def _lateness(self, flight: Flight, times_ns: tuple[int, int] | None = None) -> float:
        """
        Return the delay [s] of a flight behind the schedule of its promise; < 0 if early.

        :param times_ns: the clock's time, and start_ns plus the plan's time, in a report of the
            follower [ns]. By default they are taken from its last report.
        """
        clock_ns, plan_ns = times_ns or (self._followed.last_ns, self._followed.plan_ns)
        start_ns = start_of(flight.playback.plan)
        return flight._replace(time=(plan_ns - start_ns) * 1e-9).lateness(clock_ns * 1e-9)

    def check_promise(self, now: float) -> Plan | None:
        """
        Return the plan in flight with an ended promise, or None if its promise does not end now.

        In a plan with a promised_until, moving receivers are predicted for a schedule of the
        flight. The promise ends if the flight is over PUNCTUAL [s] early or late for the schedule.
        The returned plan replaces the plan in flight among the tracked plans.
        """
        flight = self.flight(now)
        if flight is None or not flight.is_reported or flight.state == 'ended':
            return None
        plan = flight.playback.plan
        if plan.promised_until is None or abs(self._lateness(flight)) <= PUNCTUAL:
            return None
        time = flight.time
        if self._followed.identity == plan.identity:
            # The promise ends before the slot that was flown when the flight left its schedule.
            left_ns = self._followed.find_first_unpunctual(
                lambda *times_ns: abs(self._lateness(flight, times_ns)) > PUNCTUAL)
            time = (left_ns - start_of(plan)) * 1e-9
        ended = plan.end_promise(time)
        if ended is plan:  # Its promise had ended before.
            return None
        self._plans[plan.identity] = Playback(ended)
        return ended

    def is_waiting(self, plan: Plan, now: float) -> bool:
        """Return True if the flight of a plan is not reported, or waits at its start."""
        flight = self.flight(now)
        return flight is None or flight.state == 'waiting' or (
            flight.playback.plan.start_ns != plan.start_ns)

    def promise_ends(self, flight: Flight, ahead: float) -> bool:
        """Return True if a flight's promise ends less than `ahead` s of plan time from now."""
        return _promise_end(flight.playback.plan) < flight.time + ahead

    def _promise_problems(self, flight: Flight) -> list[str]:
        """Return at most one text: why the promise of a flight has ended, or the present gap."""
        plan, end = flight.playback.plan, _promise_end(flight.playback.plan)
        if flight.state == 'ended':
            return []
        if end <= flight.time:
            late = self._lateness(flight)
            if abs(late) > PUNCTUAL:
                reason = (f'the flight is {abs(late):.1f} s {"later" if late > 0 else "earlier"} '
                          'than the receivers that move are predicted for')
            elif _predictions_end(plan) > end + SHORTEST_TRACK:
                reason = 'the flight was early or late, or the clock jumped'
            else:
                reason = 'the receivers that move are predicted no further'
            return [f'the promise of plan {plan.identity} ended at {end:.1f} s: {reason}; '
                    'plan again']
        return [f'the promise ended at {end:.1f} s; the next begins at {begin:.1f} s'
                for end, begin in plan.gaps if end <= flight.time < begin][:1]

    # Time

    def is_steady(self, now: float) -> bool:
        """Return False while a follower slows down or speeds up, and True while it is silent."""
        return not self._reports or not self._reports.is_current(round(now * 1e9)) or (
            self._reports.is_steady())

    def check_steady(self, now: float) -> None:
        """Raise a LateError while a follower slows down or speeds up."""
        if not self.is_steady(now):
            raise LateError('the flight is slowing down or speeding up at the moment; '
                            'ask again when it is flown at a constant rate, or is paused')

    @property
    def has_time_scale(self) -> bool:
        """Whether two reports of a follower tell how fast it flies a plan of this planner."""
        return self._reports is not None and self._reports.has_time_scale

    def unknown_plan(self, now: float) -> str | None:
        """Return the identity of a reported plan that this planner lacks, or None."""
        unknown = self._unknown
        return unknown.identity if unknown and (
            0 <= now - unknown.last_ns * 1e-9 <= SILENCE) else None

    def check_known(self, now: float) -> None:
        """
        Raise an error while a plan unknown here is flown; a held one is no error.

        :raises LateError: if the newest plan, which the follower may adopt, has not begun.
        :raises SupersededError: otherwise.
        """
        unknown = self._unknown
        _, time_scale = unknown.at(round(now * 1e9), 0) if unknown else (0.0, 0.0)
        if not (unknown and self.unknown_plan(now) and time_scale > 0):
            return
        text = f'a follower flies plan {unknown.identity}, which this planner does not have; '
        if takeover := self._describe_takeover(now):
            raise LateError(f'{text}{takeover}; ask again when it is flown')
        raise SupersededError(
            f'{text}end that flight first, as by ~/pause and ~/reset of the replay')

    def _describe_takeover(self, now: float) -> str:
        """Say when the newest plan takes effect; empty if it was due over ADOPTION_GRACE ago."""
        ahead = (self._newest.begin_ns or 0) * 1e-9 - now if self._plans else -math.inf
        return '' if ahead < -ADOPTION_GRACE else (
            f'plan {self._newest.plan.identity} takes effect in {max(0.0, ahead):.1f} s')

    def until_superseded(self, flight: Flight | None, now: float) -> float:
        """
        Return the time [s] until the newest plan replaces the plan in flight, or infinity.

        It is infinite if no plan is flying, or if the flight does not await the newest plan.

        :raises LateError: if less than _LEAST_AHEAD [s] is left.
        """
        if flight is None or flight.state != 'flying' or not self.awaits_newest(flight, now):
            return math.inf
        ahead = max(0.0, -self._lateness_of_newest(flight, now))
        if ahead < _LEAST_AHEAD:
            raise LateError(f'plan {self._newest.plan.identity} takes effect in {ahead:.1f} s; '
                            'ask again when it is flown')
        return ahead

    @property
    def _newest(self) -> Playback:
        """Return the newest plan, once there is one."""
        return next(reversed(self._plans.values()))

    def awaits_newest(self, flight: Flight, now: float) -> bool:
        """
        Return True if the newest plan, with another start time, is to replace the plan in flight.

        It is False if the newest plan was due more than ADOPTION_GRACE ago, since the follower has
        then refused it.
        """
        return self._newest.plan.start_ns != flight.playback.plan.start_ns and (
            self._lateness_of_newest(flight, now) <= ADOPTION_GRACE)

    def _lateness_of_newest(self, flight: Flight, now: float) -> float:
        """
        Return how long ago [s] the newest plan was due to be flown; negative before that.

        A flight that is paused or slower before the newest plan begins delays it as much.
        """
        late = flight.time - self._takeover  # Lateness in the plan's time [s].
        if flight.time_scale:
            late /= flight.time_scale
        elif late >= -_ROUNDING or flight.state == 'ended':
            late = math.inf  # Held or at the end when the newest plan was already due.
        return late if math.isfinite(late) else now - (self._newest.begin_ns or 0) * 1e-9

    def states(self, flight: Flight | None, settings: PlannerSettings, now: float
               ) -> list[MeasuredState | None]:
        """
        Return the state of each UAV to plan from; None if unknown or if use_pose is false.

        In a flight, a state `is_held` if the UAV's relay stops it, or if the UAV stands or brakes
        instead of returning to its plan.
        """
        states = [self._state(name, flight, settings, now) if uav.use_pose else None
                  for name, uav in settings.uavs.items()]
        return [state if state is None or flight is None else state._replace(
            is_held=self._is_held(name, index, flight))
            for index, (name, state) in enumerate(zip(settings.uavs, states, strict=True))]

    def _state(self, name: str, flight: Flight | None, settings: PlannerSettings, now: float
               ) -> MeasuredState | None:
        """
        Return the state of a UAV by its usable pose, or None.

        With a flight, the state's time [s] counts from point 0 of the plan. The state's velocity
        is the measured one divided by the playback speed, or None if this is 0. Without a flight,
        the time is the clock's. A pose from before the first kept report of a flight that has
        begun gives no state, because the plan's time at this pose is unknown.
        """
        pose = self._poses.usable_pose(name, settings, now)
        if pose is None:
            return None
        if flight is None:
            return MeasuredState(pose.time, pose.position, pose.velocity)
        pose_ns = round(pose.time * 1e9)
        time, _ = self._followed.at(pose_ns, start_of(flight.playback.plan))
        if pose_ns < self._followed.first_ns and time > flight.playback.begin:
            return None
        velocity = None
        if pose.velocity is not None and flight.time_scale:
            u, v = pose.velocity
            velocity = (u / flight.time_scale, v / flight.time_scale)
        return MeasuredState(time, pose.position, velocity)

    def _is_held(self, name: str, index: int, flight: Flight) -> bool:
        """Return True if a UAV is held, by what its relay reports or by how it moves."""
        return self._is_stopped(name) or self._watches[name].is_held(flight.playback, index)

    def _is_stopped(self, name: str) -> bool:
        relay = self.relays.state(name)
        return relay is not None and relay.stops_vehicle

    def find_stopped(self, names: Iterable[str]) -> frozenset[str]:
        """Return the names of the UAVs that their relays stop."""
        return frozenset(filter(self._is_stopped, names))

    def _offsets(self, flight: Flight | None, settings: PlannerSettings, now: float
                 ) -> dict[str, Array]:
        """Return measured minus planned position [m] of each UAV whose state is known, by name."""
        if flight is None:
            return {}
        states = {name: self._state(name, flight, settings, now)
                  for name in settings.uavs}
        return {name: deviation(flight.playback, index, state)
                for index, (name, state) in enumerate(states.items())
                if state is not None}

    def distances(self, settings: PlannerSettings, now: float) -> dict[str, float]:
        """Return the known distances of UAVs from their plan in m, by name."""
        return {name: math.hypot(*offset)
                for name, offset in self._offsets(self.flight(now), settings, now).items()}

    def predict_distances(self, settings: PlannerSettings, now: float, ahead: float
                          ) -> dict[str, float]:
        """
        Return the distance [m] from its plan of each UAV whose state is known, by name.

        It is the distance at the measurement. For a UAV that its relay stops, it is the distance
        `ahead` s from now, between where the UAV stands or brakes and where its plan is then.
        """
        flight, distances = self.flight(now), self.distances(settings, now)
        for index, name in enumerate(settings.uavs):
            state = self._state(name, flight, settings, now)
            if flight is not None and state is not None and self._is_stopped(name):
                time = flight.time + flight.time_scale * ahead
                ((x, y),), _ = predict_stop(
                    state, [time], flight.playback.plan.scenario.uavs[index].max_acceleration)
                distances[name] = math.hypot(*deviation(
                    flight.playback, index, MeasuredState(time, (x, y))))
        return distances

    def observe(self, settings: PlannerSettings, now: float) -> None:
        """
        Add the present positions to the achieved rates, and each known state to its UAV's Watch.

        By its last states, a Watch judges whether the UAV is held. The rates include only times at
        which the state of every UAV is known.
        """
        flight = self.flight(now)
        for name in settings.uavs:
            state = None if flight is None else self._state(name, flight, settings, now)
            if state is not None:
                self._watches[name].add(state)
        offsets = self._offsets(flight, settings, now)
        if flight is None or len(offsets) < len(settings.uavs):
            return
        # States are older than `now`, so the offsets from the plan are taken to be unchanged.
        positions = flight.playback.at(flight.time).positions + np.array(list(offsets.values()))
        self._achieved.add(flight.playback, flight.time, positions, flight.time_scale)

    def _distance_problems(self, flight: Flight, distances: Mapping[str, float],
                           settings: PlannerSettings) -> list[str]:
        """Return in words which UAVs are farther than track_tolerance [m] from their plan."""
        most = settings.track_tolerance
        margin = flight.playback.plan.scenario.tracking_margin
        return [
            f'{name} is held {distance:.1f} m from its plan; nothing is sent beyond '
            f'{max(most, margin):g} m'
            if flight.is_under_way and self._is_held(name, [*settings.uavs].index(name), flight)
            else f'{name} is {distance:.1f} m from its plan, beyond the track_tolerance of '
                 f'{most:g} m' for name, distance in distances.items() if distance > most]

    def status(self, settings: PlannerSettings, now: float) -> tuple[list[str], TrackStatus]:
        """Return the problems of the flight in words, and the TrackStatus for `planner/status`."""
        flight = self.flight(now)
        is_under_way = flight is not None and flight.is_under_way
        problems = self._follower_problems(now) + [
            problem for name in settings.uavs
            if (problem := self.relays.problem(name, is_under_way))]
        newest = next(reversed(self._plans.values()), None)
        if flight is None or flight.state != 'ended' or flight.playback is not newest:
            problems += self._poses.left_discs
        if flight is None or newest is None:
            return problems, TrackStatus()
        problems += self._promise_problems(flight)
        silence = now - self._last_arrival[0]
        if flight.is_under_way and silence > SILENCE:
            problems.append(
                f'the follower {quote(self._followed.follower)} is silent for {silence:.0f} s')
        distances = self.distances(settings, now)
        if flight.state != 'waiting':
            problems += self._distance_problems(flight, distances, settings)
        rates = self._achieved.rates or (math.nan, math.nan)
        if self._newest is not flight.playback and (
                self._lateness_of_newest(flight, now) > ADOPTION_GRACE):
            problems.append(f'plan {self._newest.plan.identity} is not flown: the follower has '
                            f'not adopted it and flies {flight.playback.plan.identity}')
        return problems, TrackStatus(
            flight.playback.plan.identity, flight.time,
            flight.state if flight.is_reported else f'{flight.state}, silent',
            {name: distances.get(name, math.nan) for name in settings.uavs}, *rates,
            self._achieved.measured)

    def _follower_problems(self, now: float) -> list[str]:
        """Return what is wrong with the reports on plan_time, in words."""
        problems, unknown = [], self.unknown_plan(now)
        if unknown is not None:
            problems.append(
                f'the follower plays plan {unknown}, which this planner does not have: ' + (
                    self._describe_takeover(now)
                    or 'it adopts a new plan only after its ~/pause and ~/reset'))
        ignored, time = self._ignored or ('', -math.inf)
        if 0 <= now - time <= SILENCE:
            problems.append(
                f'two followers report on plan_time: following {quote(self._followed.follower)}, '
                f'ignoring {quote(ignored)}; stop one')
        received, age = self._last_arrival
        if now - received <= SILENCE < abs(age):
            problems.append(
                f'the reports on plan_time are stamped {abs(age):.1f} s in the '
                f'{"past" if age > 0 else "future"} and do not count: the clocks of the hosts '
                'differ; synchronise them (NTP or PTP)')
        return problems


def start_of(plan: Plan) -> int:
    """Return the time of point 0 [ns] of a plan that has one, as any plan of the planner."""
    assert plan.start_ns is not None
    return plan.start_ns


def _promise_end(plan: Plan) -> float:
    """Return the end of the promise [s] from point 0; infinite if it lasts to the plan's end."""
    until, last = plan.promised_until, float(plan.times[-1])
    return math.inf if until is None or until >= last - _ROUNDING else until


def _predictions_end(plan: Plan) -> float:
    """Return the time [s] from point 0 at which the first track of a receiver ends."""
    receivers = *plan.scenario.ground_nodes, *plan.scenario.eavesdroppers
    return min((receiver.track[-1][0] for receiver in receivers if receiver.track),
               default=-math.inf)


def check_continuation(before: Flight | None, now: Flight | None, elapsed: float) -> None:
    """
    Check that now.time = before.time + before.time_scale * elapsed, within _SAME_TIME, in s.

    Nothing is checked unless the flight `before` was flying or held, and reported.

    :raises LateError: if the flight was paused, released or replaced in the time `elapsed` [s].
    """
    if before is None or not (before.is_reported and before.is_under_way):
        return
    if now is not None and now.playback.plan.start_ns != before.playback.plan.start_ns:
        raise LateError(f'plan {now.playback.plan.identity} took effect while the new plan was '
                        'made; ask again')
    if now is None or (
            abs(now.time - before.time - before.time_scale * elapsed) > _SAME_TIME):
        raise LateError('the flight was paused or released while the plan was made; ask again')
