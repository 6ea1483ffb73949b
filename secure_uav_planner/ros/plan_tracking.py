"""Which plan is flown, to what time of it the flight has come, and where the UAVs are then."""

from collections import deque
from collections.abc import Mapping
import math
import threading
from typing import Any

import numpy as np
from sensor_msgs.msg import TimeReference

from .messages import nanoseconds
from .poses import PoseBook
from .scenarios import sighting_of
from ..errors import LateError
from ..mission.scenario import Array
from ..plan.plan import Plan
from ..plan.playback import Playback
from ..plan.tracking import deviation, Flight, Sighting, Track

_MOST_PLANS = 8  # Of which a follower may report.
_MEMORY = 2.0  # Reports of so many s are kept, for odometry that comes later.
_SILENCE = 1.0  # s without a report, after which the time of the plan stands still.
_SAME_TIME = 0.01  # s
_STEADY = 0.03  # Change of the rate of a plan's time, in half a second, that is none.
_UNTAKEN = 2.0  # s after a plan has come, or begins, when a follower flies another one.


class _Reports:
    """
    What a follower has said of the time of one plan.

    :param rate: how fast that time goes on until the second report.
    """

    def __init__(self, identity: str, rate: float) -> None:
        self.identity, self._first_rate = identity, rate
        self._clock: deque[int] = deque()  # ns
        self._plan: deque[int] = deque()  # ns

    def add(self, clock_ns: int, plan_ns: int) -> None:
        if self._clock and clock_ns <= self._clock[-1]:
            self._clock.clear()  # The clock has jumped back.
            self._plan.clear()
        self._clock.append(clock_ns)
        self._plan.append(plan_ns)
        while clock_ns - self._clock[0] > _MEMORY * 1e9:
            self._clock.popleft()
            self._plan.popleft()

    @property
    def last_ns(self) -> int:
        """Return the time of the last report in ns."""
        return self._clock[-1]

    def is_heard(self, clock_ns: int) -> bool:
        """Return whether there was a report not long before a time in ns."""
        return clock_ns - self._clock[-1] <= _SILENCE * 1e9

    def is_steady(self) -> bool:
        """Return whether the time of the plan went on equally fast in both halves of a second."""
        since = np.array([time - self._clock[-1] for time in self._clock]) * 1e-9
        rates = np.diff(np.array(self._plan) - self._plan[-1]) * 1e-9 / np.diff(since)
        # Medians, for a stamp that is taken late on a busy machine tells nothing of the pace.
        halves = [rates[(since[:-1] >= begin) & (since[:-1] < begin + 0.5)]
                  for begin in (-1.0, -0.5)]
        return not all(map(len, halves)) or bool(
            abs(np.median(halves[0]) - np.median(halves[1])) < _STEADY)

    def at(self, clock_ns: int, start_ns: int) -> tuple[float, float]:
        """Return the time of the plan in s from its point 0, and its rate, at a time in ns."""
        last, since = self._clock[-1], (clock_ns - self._clock[-1]) * 1e-9
        time = (self._plan[-1] - start_ns) * 1e-9
        rate = self._first_rate
        if len(self._clock) > 1:
            rate = max(0.0, (self._plan[-1] - self._plan[-2]) / (last - self._clock[-2]))
        if since <= 0:
            # Relative to the last one, for more digits.
            before = np.interp(clock_ns - last, np.array(self._clock) - last,
                               np.array(self._plan) - self._plan[-1])
            return time + float(before) * 1e-9, rate
        return time + rate * min(since, _SILENCE), rate if self.is_heard(clock_ns) else 0.0


class PlanTracking:
    """
    Follows the flight of the last plans.

    A follower reports the time of the plan that it flies. Without reports of the last plan, that
    is flown by its stamps.

    :param poses: the PoseBook.
    """

    def __init__(self, poses: PoseBook) -> None:
        self._poses = poses
        self._plans: dict[str, Playback] = {}
        self._reports: _Reports | None = None
        self._followed = 0  # The time of the newest plan in ns.
        self._stranger: tuple[str, float] | None = None
        self._track = Track()
        self._lock = threading.Lock()

    def follow(self, plan: Plan, now: float) -> None:
        """Take up a plan that is published at a time in s; it replaces what has not begun."""
        with self._lock:
            reported = self._reports.identity if self._reports else None
            begun = [identity for identity, playback in self._plans.items() if now > (
                playback.plan.start_ns * 1e-9 + playback.begin) and identity != reported]
            kept = {reported, *begun[1 - _MOST_PLANS:]} - {plan.identity}
            self._plans = {identity: playback for identity, playback in self._plans.items()
                           if identity in kept}
            self._plans[plan.identity] = Playback(plan)
            self._followed = round(now * 1e9)

    def hear(self, message: TimeReference) -> None:
        """Take up what a follower says of the time of its plan."""
        clock, plan = nanoseconds(message.header.stamp), nanoseconds(message.time_ref)
        with self._lock:
            if message.source not in self._plans:
                self._stranger = message.source, clock * 1e-9
                return
            if self._reports is None or self._reports.identity != message.source:
                # A follower that goes over from one plan to the next does not stop.
                rate = 0.0 if self._reports is None else self._reports.at(clock, 0)[1]
                self._reports = _Reports(message.source, rate)
            self._reports.add(clock, plan)

    def flight(self, now: float) -> Flight | None:
        """Return what is flown at a time in s, or None before any plan."""
        with self._lock:
            if not self._plans:
                return None
            newest = next(reversed(self._plans.values()))
            reported = self._reports and self._plans.get(self._reports.identity)
            if self._reports is None or reported is None:
                return self._by_stamps(now)
            now_ns = round(now * 1e9)
            is_heard = self._reports.is_heard(now_ns)
            # A new plan of the same flight is flown at the same time, as soon as it is known.
            same = newest.plan.start_ns == reported.plan.start_ns
            if not is_heard and not same:
                return self._by_stamps(now)
            untaken = newest is not reported and (
                self._reports.last_ns - self._followed > _UNTAKEN * 1e9)
            return Flight(newest if same and not untaken else reported,
                          *self._reports.at(now_ns, reported.plan.start_ns), is_heard)

    def check_steady(self, now: float) -> None:
        """
        Check that the time of the plan that is flown goes on evenly.

        :raises LateError: while a follower slows down or speeds up; nobody knows where it will be.
        """
        with self._lock:
            if self._reports and self._reports.is_heard(round(now * 1e9)) and (
                    not self._reports.is_steady()):
                raise LateError('the flight is slowing down or speeding up at the moment; '
                                'ask again when it goes on evenly, or stands')

    @property
    def has_reports(self) -> bool:
        """Return whether a follower has said anything of a plan that is known."""
        with self._lock:
            return self._reports is not None

    def stranger(self, now: float) -> str | None:
        """Return the identity of a plan that a follower flies and nobody here knows, or None."""
        with self._lock:
            found = self._stranger
            heard = found is not None and 0 <= now - found[1] <= _SILENCE
            return found[0] if found and heard else None

    def _by_stamps(self, now: float) -> Flight:
        """Return the flight of the last plan that has begun, or else of the newest."""
        flights = [Flight(playback, now - playback.plan.start_ns * 1e-9, 1.0, False)
                   for playback in reversed(self._plans.values())]
        return next((flight for flight in flights if flight.state != 'waiting'), flights[0])

    def sightings(self, flight: Flight | None, settings: Mapping[str, Any], now: float
                  ) -> list[Sighting | None]:
        """
        Return the state of every UAV from which to plan, None where it is not known or not used.

        :param flight: in whose time the sightings are; None for that of the clock.
        :param settings: values of the planner's parameters by name.
        :param now: the node's time in s.
        """
        return [self.sighting(name, flight, settings, now) if settings[f'{name}.use_pose']
                else None for name in settings['uavs']]

    def sighting(self, name: str, flight: Flight | None, settings: Mapping[str, Any], now: float
                 ) -> Sighting | None:
        """Return the last usable state of a UAV in the time of a flight, or None."""
        seen = sighting_of(name, settings, self._poses, now)
        if seen is None or flight is None:
            return seen
        measured = self.flight(seen.time)
        time = seen.time if measured is None else measured.time
        if seen.velocity is None or flight.rate == 0.0:
            return Sighting(time, seen.position)
        u, v = seen.velocity
        return Sighting(time, seen.position, (u / flight.rate, v / flight.rate))

    def distances(self, settings: Mapping[str, Any], now: float) -> dict[str, float]:
        """Return the distance of each UAV from its plan in m, by name, where it is known."""
        flight = self.flight(now)
        return {name: math.hypot(*offset)
                for name, offset in self._offsets(flight, settings, now).items()}

    def observe(self, settings: Mapping[str, Any], now: float) -> None:
        """Note where the UAVs are now, for the rate that they achieve."""
        flight = self.flight(now)
        offsets = self._offsets(flight, settings, now)
        if flight is None or len(offsets) < len(settings['uavs']):
            return
        positions = flight.playback.at(flight.time).positions + np.array(list(offsets.values()))
        with self._lock:
            self._track.add(flight.playback, flight.time, positions)

    def report(self, settings: Mapping[str, Any], now: float) -> tuple[list[str], dict[str, Any]]:
        """
        Return what the status says of the flight.

        :return: a text about every UAV that flies farther from its plan than it should and about
            a plan that is not taken up, and the values of the status by key.
        """
        flight, most = self.flight(now), settings['track_tolerance']
        stranger = self.stranger(now)
        problems = [] if stranger is None else [
            f'the follower flies plan {stranger}, which this planner does not know: it takes up '
            'no other before its ~/pause and ~/reset']
        if flight is None:
            return problems, {}
        distances = self.distances(settings, now)
        problems += [f'{name} is {distance:.1f} m from its plan and track_tolerance is {most:g} m'
                     for name, distance in distances.items()
                     if flight.state != 'waiting' and distance > most]
        with self._lock:
            newest = next(reversed(self._plans.values()))
            rates = self._track.rates or ('none', 'none')
        late = now - newest.plan.start_ns * 1e-9 - newest.begin
        if newest is not flight.playback and late > _UNTAKEN:
            problems.append(f'plan {newest.plan.identity} is not flown: the follower has not '
                            f'taken it up and flies {flight.playback.plan.identity}')
        return problems, {
            'track.plan': flight.playback.plan.identity, 'track.time': flight.time,
            'track.state': flight.state if flight.is_reported else f'{flight.state} by stamps',
            **{f'track.distance.{name}': distances.get(name, 'none')
               for name in settings['uavs']},
            **dict(zip(('track.rate', 'track.planned_rate'), rates, strict=True))}

    def _offsets(self, flight: Flight | None, settings: Mapping[str, Any], now: float
                 ) -> dict[str, Array]:
        """Return the offset of each UAV from its plan in m, by name, where it is known."""
        if flight is None:
            return {}
        found = {}
        for index, name in enumerate(settings['uavs']):
            sighting = self.sighting(name, flight, settings, now)
            if sighting is not None:
                found[name] = deviation(flight.playback, index, sighting)
        return found


def check_goes_on(before: Flight | None, now: Flight | None, elapsed: float) -> None:
    """
    Check that a flight has gone on as a new plan expects.

    :param before: when the plan was asked for.
    :param now: after some time.
    :param elapsed: that time in s.
    :raises LateError: if it was paused, released or replaced since.
    """
    if before is None or not before.is_reported or before.state not in ('flying', 'held'):
        return
    if now is None or now.playback.plan.start_ns != before.playback.plan.start_ns or (
            abs(now.time - before.time - before.rate * elapsed) > _SAME_TIME):
        raise LateError('the flight was paused, or went on otherwise, while the plan was made; '
                        'ask again')
