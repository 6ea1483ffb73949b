"""The plan in flight: to what time of it the flight has come, and where the UAVs are then."""

from collections import deque
from collections.abc import Mapping
import math
from typing import Any

import numpy as np
from sensor_msgs.msg import TimeReference

from .messages import nanoseconds
from .poses import PoseBook
from ..errors import LateError, quote
from ..mission.scenario import Array
from ..plan.plan import Plan
from ..plan.playback import Playback
from ..plan.tracking import AchievedRates, deviation, Flight, MeasuredState

_MOST_PLANS = 8  # That are kept for the reports of a follower.
_MEMORY = 2.0  # s for which reports are kept, for odometry that comes later.
_SILENCE = 1.0  # s without a report after which the time of the plan stands still.
_SAME_TIME = 0.01  # s
_STEADY = 0.03  # Largest change of a constant rate in half a second.
ADOPTION_GRACE = 2.0  # s after a plan has come, or begins, in which a follower may fly another.


class _Reports:
    """
    The reports of one follower about one plan, as pairs of times.

    :param rate: of the plan's time until the second report.
    """

    def __init__(self, follower: str, identity: str, rate: float) -> None:
        self.follower, self.identity, self._first_rate = follower, identity, rate
        self._pairs: deque[tuple[int, int]] = deque()  # Clock and plan in ns.

    def add(self, clock_ns: int, plan_ns: int) -> None:
        if self._pairs and clock_ns <= self.last_ns:
            self._pairs.clear()  # The clock has jumped back.
        self._pairs.append((clock_ns, plan_ns))
        while clock_ns - self._pairs[0][0] > _MEMORY * 1e9:
            self._pairs.popleft()

    @property
    def last_ns(self) -> int:
        """Time of the last report in ns."""
        return self._pairs[-1][0]

    @property
    def plan_ns(self) -> int:
        """Time of the plan in the last report in ns."""
        return self._pairs[-1][1]

    def is_current(self, clock_ns: int) -> bool:
        """Return False if the follower is silent at a time in ns."""
        return clock_ns - self.last_ns <= _SILENCE * 1e9

    def _since_last(self) -> Array:
        """Return clock and plan relative to the last report, (2, K), for more digits."""
        return np.transpose([(clock - self._pairs[-1][0], plan - self._pairs[-1][1])
                             for clock, plan in self._pairs])

    def is_steady(self) -> bool:
        """Return True if the plan is paused, or its rate has been constant over a second."""
        since, plan = self._since_last() * 1e-9
        rates = np.diff(plan) / np.diff(since)
        if len(rates) == 0 or rates[-1] == 0:
            return True
        # Medians, because a busy machine takes single stamps late.
        halves = [rates[(since[:-1] >= begin) & (since[:-1] < begin + 0.5)]
                  for begin in (-1.0, -0.5)]
        if not all(map(len, halves)):
            return True
        before, after = map(np.median, halves)
        return bool(after > 0 and abs(after - before) < _STEADY)

    def at(self, clock_ns: int, start_ns: int) -> tuple[float, float]:
        """Return the time of the plan in s from its point 0, and its rate, at a time in ns."""
        (last, plan), rate = self._pairs[-1], self._first_rate
        if len(self._pairs) > 1:
            before = self._pairs[-2]
            rate = max(0.0, (plan - before[1]) / (last - before[0]))
        since, time = (clock_ns - last) * 1e-9, (plan - start_ns) * 1e-9
        if since <= 0:
            return time + float(np.interp(clock_ns - last, *self._since_last())) * 1e-9, rate
        return time + rate * min(since, _SILENCE), rate if self.is_current(clock_ns) else 0.0


class PlanTracking:
    """
    Tracks the flight of the last plans.

    A follower reports the time of the plan that it flies; without reports, the last plan is flown
    by its stamps. Of several followers the first one under way counts, until it ends or is silent.
    Settings are the values of the planner's parameters by name, and `now` is the node's time in s.
    """

    def __init__(self, poses: PoseBook) -> None:
        self._poses = poses
        self._plans: dict[str, Playback] = {}
        self._reports: _Reports | None = None
        self._published_ns = 0  # The newest plan.
        self._unknown_plan: tuple[str, float] | None = None  # With the time of its last report.
        self._ignored: tuple[str, float] | None = None  # A further follower, likewise.
        self._last_arrival = -math.inf, 0.0  # Of a report, in s, and its age then.
        self._track = AchievedRates()

    def add_plan(self, plan: Plan, now: float) -> None:
        """Track a plan that is published now; it supersedes those that have not begun."""
        reported = self._reports.identity if self._reports else None
        begun = [identity for identity, playback in self._plans.items() if now > (
            playback.plan.start_ns * 1e-9 + playback.begin) and identity != reported]
        kept = {reported, *begun[1 - _MOST_PLANS:]} - {plan.identity}
        self._plans = {identity: playback for identity, playback in self._plans.items()
                       if identity in kept}
        self._plans[plan.identity] = Playback(plan)
        self._published_ns = round(now * 1e9)

    def add_report(self, message: TimeReference, now: float) -> None:
        """Use the report of a follower that arrived at a time in s."""
        clock, plan = nanoseconds(message.header.stamp), nanoseconds(message.time_ref)
        self._last_arrival = now, now - clock * 1e-9
        follower, last = message.header.frame_id, self._reports
        if message.source not in self._plans:
            self._unknown_plan = message.source, clock * 1e-9
            return
        if last and follower != last.follower and abs(clock - last.last_ns) <= _SILENCE * 1e9 and (
                self._is_under_way(last.identity, last.plan_ns)
                or not self._is_under_way(message.source, plan)):
            self._ignored = follower, clock * 1e-9
            return
        if last is None or (last.follower, last.identity) != (follower, message.source):
            # A follower that passes from one plan to the next does not stop.
            rate = 0.0 if last is None else last.at(clock, 0)[1]
            self._reports = _Reports(follower, message.source, rate)
        self._reports.add(clock, plan)

    def _is_under_way(self, identity: str, plan_ns: int) -> bool:
        playback = self._plans.get(identity)
        return playback is not None and Flight(
            playback, (plan_ns - playback.plan.start_ns) * 1e-9, 0.0, 'reports').is_under_way

    def flight(self, now: float) -> Flight | None:
        """Return the Flight at a time, or None before any plan."""
        if not self._plans:
            return None
        newest, now_ns = next(reversed(self._plans.values())), round(now * 1e9)
        reports = self._reports
        reported = reports and self._plans.get(reports.identity)
        # A new plan of the same flight is flown at the same time, as soon as it is adopted.
        is_same = reported and newest.plan.start_ns == reported.plan.start_ns
        if not reported or not (is_same or reports.is_current(now_ns)):
            return self._flight_by_stamps(now)
        is_adopted = newest is reported or (
            reports.last_ns - self._published_ns <= ADOPTION_GRACE * 1e9)
        return Flight(newest if is_same and is_adopted else reported,
                      *reports.at(now_ns, reported.plan.start_ns),
                      'reports' if reports.is_current(now_ns) else 'silence')

    def _flight_by_stamps(self, now: float) -> Flight:
        """Return the flight of the last plan that has begun, or else of the newest."""
        flights = [Flight(playback, now - playback.plan.start_ns * 1e-9, 1.0, 'stamps')
                   for playback in reversed(self._plans.values())]
        return next((flight for flight in flights if flight.state != 'waiting'), flights[0])

    def _plan_time(self, flight: Flight, then: float) -> float:
        """Return the time of the flight's plan at an earlier time, both in s."""
        start_ns = flight.playback.plan.start_ns
        if flight.source == 'stamps':
            return then - start_ns * 1e-9
        return self._reports.at(round(then * 1e9), start_ns)[0]

    def check_steady(self, now: float) -> None:
        """Raise a LateError while a follower slows down or speeds up."""
        if self._reports and self._reports.is_current(round(now * 1e9)) and (
                not self._reports.is_steady()):
            raise LateError('the flight is slowing down or speeding up at the moment; '
                            'ask again when it goes on evenly, or stands')

    @property
    def has_reports(self) -> bool:
        """Whether a follower has reported about a plan of this planner."""
        return self._reports is not None

    def unknown_plan(self, now: float) -> str | None:
        """Return the identity of a plan in flight that is not of this planner, or None."""
        return _recent(self._unknown_plan, now)

    def states(self, flight: Flight | None, settings: Mapping[str, Any], now: float
               ) -> list[MeasuredState | None]:
        """Return the state of each UAV to plan from; None where it is not known or not used."""
        return [self._state(name, flight, settings, now) if settings[f'{name}.use_pose']
                else None for name in settings['uavs']]

    def _state(self, name: str, flight: Flight | None, settings: Mapping[str, Any], now: float
               ) -> MeasuredState | None:
        """Return the last usable state of a UAV in the time of a flight, or else of the clock."""
        pose = self._poses.usable_pose(name, settings, now)
        if pose is None:
            return None
        time = self._plan_time(flight, pose.time) if flight else pose.time
        if flight is None or pose.velocity is None:
            return MeasuredState(time, pose.position, pose.velocity)
        u, v = pose.velocity
        return MeasuredState(time, pose.position, (
            u / flight.rate, v / flight.rate) if flight.rate else None)

    def _offsets(self, flight: Flight | None, settings: Mapping[str, Any], now: float
                 ) -> dict[str, Array]:
        """Return the offset of each UAV from its plan in m, by name, where it is known."""
        if flight is None:
            return {}
        states = {name: self._state(name, flight, settings, now)
                  for name in settings['uavs']}
        return {name: deviation(flight.playback, index, state)
                for index, (name, state) in enumerate(states.items())
                if state is not None}

    def distances(self, settings: Mapping[str, Any], now: float) -> dict[str, float]:
        """Return the distance of each UAV from its plan in m, by name, where it is known."""
        return {name: math.hypot(*offset)
                for name, offset in self._offsets(self.flight(now), settings, now).items()}

    def observe(self, settings: Mapping[str, Any], now: float) -> None:
        """Add the present positions of the UAVs to the achieved rate."""
        flight = self.flight(now)
        offsets = self._offsets(flight, settings, now)
        if flight is None or len(offsets) < len(settings['uavs']):
            return
        positions = flight.playback.at(flight.time).positions + np.array(list(offsets.values()))
        self._track.add(flight.playback, flight.time, positions)

    def report(self, settings: Mapping[str, Any], now: float) -> tuple[list[str], dict[str, Any]]:
        """Return the problems of the flight in words, and the values of the status by key."""
        flight, most = self.flight(now), settings['track_tolerance']
        problems = self._follower_problems(now)
        if flight is None:
            return problems, {}
        distances = self.distances(settings, now)
        problems += [f'{name} is {distance:.1f} m from its plan, beyond the track_tolerance of '
                     f'{most:g} m' for name, distance in distances.items()
                     if flight.state != 'waiting' and distance > most]
        newest = next(reversed(self._plans.values()))
        rates = self._track.rates or ('none', 'none')
        late = now - newest.plan.start_ns * 1e-9 - newest.begin
        if newest is not flight.playback and late > ADOPTION_GRACE:
            problems.append(f'plan {newest.plan.identity} is not flown: the follower has not '
                            f'taken it up and flies {flight.playback.plan.identity}')
        return problems, {
            'track.plan': flight.playback.plan.identity, 'track.time': flight.time,
            'track.state': flight.state if flight.is_reported else f'{flight.state} by stamps',
            **{f'track.distance.{name}': distances.get(name, 'none')
               for name in settings['uavs']},
            'track.rate': rates[0], 'track.planned_rate': rates[1]}

    def _follower_problems(self, now: float) -> list[str]:
        problems, unknown = [], self.unknown_plan(now)
        if unknown is not None:
            problems.append(f'the follower flies plan {unknown}, which this planner does not '
                            'know: it takes up no other before its ~/pause and ~/reset')
        ignored = _recent(self._ignored, now)
        if ignored is not None:
            problems.append(
                f'two followers report on plan_time: {quote(self._reports.follower)} counts and '
                f'{quote(ignored)} does not; let one of them fly')
        received, age = self._last_arrival
        if now - received <= _SILENCE < abs(age):
            problems.append(
                f'the reports on plan_time are stamped {abs(age):.1f} s in the '
                f'{"past" if age > 0 else "future"} and do not count: the clocks of the hosts '
                'differ; synchronise them (NTP or PTP)')
        return problems


def _recent(noted: tuple[str, float] | None, now: float) -> str | None:
    """Return the name of what was noted at a time in s, unless that is long ago."""
    name, time = noted or ('', -math.inf)
    return name if 0 <= now - time <= _SILENCE else None


def check_continuation(before: Flight | None, now: Flight | None, elapsed: float) -> None:
    """
    Check that a flight has continued at its rate for some s since a plan was asked for.

    :raises LateError: if it was paused, released or replaced since.
    """
    if before is None or not (before.is_reported and before.is_under_way):
        return
    if now is None or now.playback.plan.start_ns != before.playback.plan.start_ns or (
            abs(now.time - before.time - before.rate * elapsed) > _SAME_TIME):
        raise LateError('the flight was paused, or went on otherwise, while the plan was made; '
                        'ask again')
