"""
The last plans of this planner, and how a follower flies them by its reports on `plan_time`.

Only these reports say that a plan is flown.
"""

import math

from sensor_msgs.msg import TimeReference

from ..messages import nanoseconds, read_plan_time
from ...errors import LateError, quote, SupersededError
from ...plan.flight import Flight
from ...plan.plan import Plan
from ...plan.playback import Playback
from ...plan.tracking import FollowerReports, SILENCE

_MOST_PLANS = 8  # Number of last plans that are kept for the reports of a follower.
# Largest time [s] between the expected and the present time of a plan. Reports jitter by less.
_SAME_TIME = 0.03
_ROUNDING = 1e-6  # Tolerance of a time [s].
_LEAST_AHEAD = 3.0  # Least time [s] before the effect of a plan at which another can replace it.
ADOPTION_GRACE = 2.0  # Time [s] that a follower has to adopt a plan after it comes or begins.


class FollowedPlans:
    """
    The last plans of the planner, the one that a follower flies, and its present plan time.

    The follower that flies first is followed until its flight ends or it is silent. `now` is the
    node's time in s.
    """

    def __init__(self) -> None:
        self._plans: dict[str, Playback] = {}  # The last plans by identity.
        self._published_ns = 0  # Time of the newest plan's publication [ns].
        # Time [s] of the plan in flight at which the newest plan is to replace it.
        self._takeover = -math.inf
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
        if not self._plans or plan.identity != self.newest.plan.identity:
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
        self.reports.add(clock_ns, plan_ns)

    @property
    def reports(self) -> FollowerReports:
        """Last reports on the plan in flight, once a follower has reported."""
        assert self._reports is not None
        return self._reports

    def replace_plan(self, plan: Plan) -> None:
        """Replace a tracked plan by one of the same identity."""
        self._plans[plan.identity] = Playback(plan)

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
        is_newest = self.newest.plan.start_ns == reported.plan.start_ns and (
            reports.last_ns - self._published_ns <= ADOPTION_GRACE * 1e9)
        time, time_scale = reports.at(now_ns, start_of(reported.plan))
        return Flight(self.newest if is_newest else reported, time, time_scale,
                      reports.is_current(now_ns))

    def is_waiting(self, plan: Plan, now: float) -> bool:
        """Return True if the flight of a plan is not reported, or waits at its start."""
        flight = self.flight(now)
        return flight is None or flight.state == 'waiting' or (
            flight.playback.plan.start_ns != plan.start_ns)

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
        ahead = (self.newest.begin_ns or 0) * 1e-9 - now if self._plans else -math.inf
        return '' if ahead < -ADOPTION_GRACE else (
            f'plan {self.newest.plan.identity} takes effect in {max(0.0, ahead):.1f} s')

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
            raise LateError(f'plan {self.newest.plan.identity} takes effect in {ahead:.1f} s; '
                            'ask again when it is flown')
        return ahead

    @property
    def newest(self) -> Playback:
        """Newest plan, once there is one."""
        return next(reversed(self._plans.values()))

    def awaits_newest(self, flight: Flight, now: float) -> bool:
        """
        Return True if the newest plan, with another start time, is to replace the plan in flight.

        It is False if the newest plan was due more than ADOPTION_GRACE ago, since the follower has
        then refused it.
        """
        return self.newest.plan.start_ns != flight.playback.plan.start_ns and (
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
        return late if math.isfinite(late) else now - (self.newest.begin_ns or 0) * 1e-9

    def find_problems(self, flight: Flight | None, now: float) -> list[str]:
        """Return in words what is wrong with the reports on plan_time, and with the follower."""
        problems, unknown = [], self.unknown_plan(now)
        if unknown is not None:
            problems.append(
                f'the follower plays plan {unknown}, which this planner does not have: ' + (
                    self._describe_takeover(now)
                    or 'it adopts a new plan only after its ~/pause and ~/reset'))
        ignored, time = self._ignored or ('', -math.inf)
        if 0 <= now - time <= SILENCE:
            problems.append(
                f'two followers report on plan_time: following {quote(self.reports.follower)}, '
                f'ignoring {quote(ignored)}; stop one')
        received, age = self._last_arrival
        silence = now - received
        if silence <= SILENCE < abs(age):
            problems.append(
                f'the reports on plan_time are stamped {abs(age):.1f} s in the '
                f'{"past" if age > 0 else "future"} and do not count: the clocks of the hosts '
                'differ; synchronise them (NTP or PTP)')
        if flight is not None and flight.is_under_way and silence > SILENCE:
            problems.append(
                f'the follower {quote(self.reports.follower)} is silent for {silence:.0f} s')
        if flight is not None and self.newest is not flight.playback and (
                self._lateness_of_newest(flight, now) > ADOPTION_GRACE):
            problems.append(f'plan {self.newest.plan.identity} is not flown: the follower has '
                            f'not adopted it and flies {flight.playback.plan.identity}')
        return problems


def start_of(plan: Plan) -> int:
    """Return the time of point 0 [ns] of a plan that has one, as any plan of the planner."""
    assert plan.start_ns is not None
    return plan.start_ns


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
