"""The plan in flight: what it promises, where the UAVs are beside it, and what they achieve."""

from collections import defaultdict
from collections.abc import Iterable, Mapping
import math

import numpy as np

from .followed_plans import FollowedPlans, start_of
from .poses import PoseBook
from .receivers import SHORTEST_TRACK
from .settings import PlannerSettings
from ..planner_status import TrackStatus
from ..relay_reports import RelayReports
from ...mission.scenario import Array
from ...plan.flight import Flight
from ...plan.plan import Plan
from ...plan.tracking import (
    AchievedRates, deviation, MeasuredState, predict_stop, PUNCTUAL, Watch)

_ROUNDING = 1e-6  # Tolerance of a time [s].


class PlanTracking:
    """
    Tracks the promise of the plan in flight, and the UAVs beside it.

    `now` is the node's time in s.

    :ivar followed: the last plans, and the reports of their follower.
    :ivar relays: what becomes of the setpoints of each UAV, where a relay reports it.
    """

    def __init__(self, poses: PoseBook) -> None:
        self._poses, self.followed, self.relays = poses, FollowedPlans(), RelayReports()
        self._achieved = AchievedRates()
        self._watches = defaultdict[str, Watch](Watch)  # Recent motion of each UAV.

    def _lateness(self, flight: Flight, times_ns: tuple[int, int] | None = None) -> float:
        """
        Return the delay [s] of a flight behind the schedule of its promise; < 0 if early.

        :param times_ns: the clock's time, and start_ns plus the plan's time, in a report of the
            follower [ns]. By default they are taken from its last report.
        """
        clock_ns, plan_ns = times_ns or (
            self.followed.reports.last_ns, self.followed.reports.plan_ns)
        start_ns = start_of(flight.playback.plan)
        return flight._replace(time=(plan_ns - start_ns) * 1e-9).lateness(clock_ns * 1e-9)

    def check_promise(self, now: float) -> Plan | None:
        """
        Return the plan in flight with an ended promise, or None if its promise does not end now.

        In a plan with a promised_until, moving receivers are predicted for a schedule of the
        flight. The promise ends if the flight is over PUNCTUAL [s] early or late for the schedule.
        The returned plan replaces the plan in flight among the tracked plans.
        """
        flight = self.followed.flight(now)
        if flight is None or not flight.is_reported or flight.state == 'ended':
            return None
        plan = flight.playback.plan
        if plan.promised_until is None or abs(self._lateness(flight)) <= PUNCTUAL:
            return None
        time = flight.time
        if self.followed.reports.identity == plan.identity:
            # The promise ends before the slot that was flown when the flight left its schedule.
            left_ns = self.followed.reports.find_first_unpunctual(
                lambda *times_ns: abs(self._lateness(flight, times_ns)) > PUNCTUAL)
            time = (left_ns - start_of(plan)) * 1e-9
        ended = plan.end_promise(time)
        if ended is plan:  # Its promise had ended before.
            return None
        self.followed.replace_plan(ended)
        return ended

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
        time, _ = self.followed.reports.at(pose_ns, start_of(flight.playback.plan))
        if pose_ns < self.followed.reports.first_ns and time > flight.playback.begin:
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
        offsets = self._offsets(self.followed.flight(now), settings, now)
        return {name: math.hypot(*offset) for name, offset in offsets.items()}

    def predict_distances(self, settings: PlannerSettings, now: float, ahead: float
                          ) -> dict[str, float]:
        """
        Return the distance [m] from its plan of each UAV whose state is known, by name.

        It is the distance at the measurement. For a UAV that its relay stops, it is the distance
        `ahead` s from now, between where the UAV stands or brakes and where its plan is then.
        """
        flight, distances = self.followed.flight(now), self.distances(settings, now)
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
        flight = self.followed.flight(now)
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
        flight = self.followed.flight(now)
        is_under_way = flight is not None and flight.is_under_way
        problems = self.followed.find_problems(flight, now) + [
            problem for name in settings.uavs
            if (problem := self.relays.problem(name, is_under_way))]
        if flight is None or flight.state != 'ended' or (
                flight.playback is not self.followed.newest):
            problems += self._poses.left_discs
        if flight is None:
            return problems, TrackStatus()
        problems += self._promise_problems(flight)
        distances = self.distances(settings, now)
        if flight.state != 'waiting':
            problems += self._distance_problems(flight, distances, settings)
        rates = self._achieved.rates or (math.nan, math.nan)
        return problems, TrackStatus(
            flight.playback.plan.identity, flight.time,
            flight.state if flight.is_reported else f'{flight.state}, silent',
            {name: distances.get(name, math.nan) for name in settings.uavs}, *rates,
            self._achieved.measured)


def _promise_end(plan: Plan) -> float:
    """Return the end of the promise [s] from point 0; infinite if it lasts to the plan's end."""
    until, last = plan.promised_until, float(plan.times[-1])
    return math.inf if until is None or until >= last - _ROUNDING else until


def _predictions_end(plan: Plan) -> float:
    """Return the time [s] from point 0 at which the first track of a receiver ends."""
    receivers = *plan.scenario.ground_nodes, *plan.scenario.eavesdroppers
    return min((receiver.track[-1][0] for receiver in receivers if receiver.track),
               default=-math.inf)
