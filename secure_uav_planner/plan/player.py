"""
Setpoints of plans in real time, each plan by its time of point 0, without jumps.

A flight is waiting at its start, flying, held on the way, or ended. The time of the plan advances
at a rate: 1 is real time, 0 is a hold. `start`, `pause` and another speed change the rate no
faster than the acceleration limits of all UAVs allow, along the same curve, so that all clearances
of the plan hold. A new plan replaces one whose setpoints are not sent; otherwise it is spliced in
at its time, which supersedes the old one. It is refused, with the reason, if its setpoints would
jump.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
import math

import numpy as np
from numpy.typing import ArrayLike

from .plan import Plan
from .playback import Moment, Playback
from ..errors import OptionError, quote
from ..mission.scenario import Array
from ..model.curve import GAUSS_LEGENDRE

Place = tuple[float, float, float]

POSITION_JUMP = 0.01
"""Tolerance of the distance between setpoints in m, beyond max_speed times the time between."""

VELOCITY_JUMP = 1e-3
"""Tolerance of the change of velocity in m/s, beyond the acceleration limit; for rounding."""

_BRAKING_STEP = 0.05  # s
_MOST_BRAKING_STEPS = 200  # About 15 ms.
_END_TOLERANCE = 1e-3  # s


class Player:
    """
    Plays plans one after another.

    :param refuse: called with the reason when a plan is refused.
    :ivar playback: the Playback that flies or waits at its start, or None before any plan.
    :ivar time: in s from point 0 of that plan.
    :ivar rate: the present rate of that time.
    :ivar playing: whether the time is to advance: from a start until a pause, a reset or the end.
    :ivar streaming: whether there are setpoints to send: from the first one until a reset.
    :ivar delivered: secret information so far, bit/Hz.
    :ivar largest_jump: largest distance in m between consecutive setpoints, beyond max_speed times
        the plan's time between them.
    """

    def __init__(self, refuse: Callable[[str], None] = lambda reason: None) -> None:
        self.playback: Playback | None = None
        self.time = self.rate = self.delivered = self.largest_jump = 0.0
        self.playing = self.streaming = False
        self._on_refusal, self._refusal = refuse, ''  # Of the last plan, if it was refused.
        self._latest: Playback | None = None  # The plan to which a reset returns.
        self._pending: tuple[Playback, float] | None = None  # With the time of its splice in s.
        self._flown_ns = -1  # Point 0 of the last plan that has begun; no older one is played.
        self._last_tick_ns: int | None = None
        self._last_setpoint: Moment | None = None
        self._seconds_since_stream_end = 0.0
        self._braking_rates: tuple[Playback, float, Array, Array] | None = None

    # Plans

    def load(self, plan: Plan) -> bool:
        """
        Adopt a plan, or refuse it; return True if it is adopted.

        A plan with the same point 0 as the present one is a revision of its flight and replaces
        it at once. Any other plan is spliced in at once if the setpoints rest. Otherwise it is
        pending until the present plan reaches the time at which the new one begins, or its end.
        A pause and another speed delay both flights alike.
        """
        new, current = Playback(plan), self.playback
        if current is not None and plan.identity == current.plan.identity:
            return False  # Published again, for example by a planner that has been restarted.
        if current is not None and (problem := _explain_team(plan, current.plan)):
            self.refuse(problem)
            return False
        is_revision = current is not None and plan.start_ns == current.plan.start_ns
        if plan.start_ns is not None and plan.start_ns <= self._flown_ns and not is_revision:
            self.refuse('it begins no later than a plan that has been flown')
            return False
        self._latest, self._refusal = new, ''
        if current is None or not self.streaming:
            self._wait_at_start(new)
        elif is_revision:
            jump = 'that plan has ended' if self.ended else self._explain_jump(new, self.time, 0.0)
            if jump:
                self.refuse(f'it comes too late for the flight that it changes: {jump}')
            else:
                self.playback = new
        else:
            ahead = ((new.begin_ns or 0) - (self._last_tick_ns or 0)) * 1e-9
            self._pending = new, self.time + self.rate * max(0.0, ahead)
            self._splice(0.0, f'it came {-ahead:.2f} s too late: ' if ahead < 0 else '')
        return not self._refusal

    def refuse(self, reason: str) -> None:
        """Report the reason for which a plan is not played."""
        self._refusal = reason
        self._on_refusal(reason)

    def _wait_at_start(self, playback: Playback) -> None:
        self.playback, self._pending = playback, None
        self.time, self.rate, self.delivered, self.largest_jump = playback.begin, 0.0, 0.0, 0.0

    def _splice(self, elapsed: float, lateness: str = '') -> bool:
        """Supersede the plan by the pending one if its time has come and nothing jumps."""
        if self._pending is None:
            return False
        (new, splice_time), rate = self._pending, self.rate
        since = self.time + rate * elapsed - splice_time
        if since < 0.0 and not self.ended:
            return False
        self._pending, time = None, new.begin + (rate and since)
        jump = self._explain_jump(new, time, rate and elapsed)
        if jump:
            self.playing = self.playing and not self.ended
            self.refuse(f'{lateness}{jump}; ~/plan makes another one')
            return False
        self._wait_at_start(new)
        self.time, self.rate = time, rate
        return True

    def _explain_jump(self, new: Playback, time: float, elapsed: float) -> str:
        """Describe the jump of setpoints to a plan at a time; empty if there is none."""
        last, moment = self._last_setpoint, _to_clock_time(new, time, self.rate)
        if last is None or self.playback is None:
            return ''
        altitudes, scale = self.playback.plan.scenario.altitudes, max(1.0, self.rate)
        for index, uav in enumerate(new.plan.scenario.uavs):
            distance = math.dist((*moment.positions[index], uav.altitude),
                                 (*last.positions[index], altitudes[index]))
            most = uav.max_speed * scale * elapsed + POSITION_JUMP
            if distance > most or abs(uav.altitude - altitudes[index]) > POSITION_JUMP:
                return (f'its setpoint of {uav.name} would be {distance:.3g} m from the last one, '
                        f'and at most {most:.3g} m is no jump')
            change = math.dist(moment.velocities[index], last.velocities[index])
            most = (uav.max_acceleration or math.inf) * scale**2 * elapsed + VELOCITY_JUMP
            if uav.max_acceleration is not None and change > most:
                return (f'its velocity of {uav.name} would differ by {change:.3g} m/s from the '
                        f'last one, and at most {most:.3g} m/s is no jump')
        return ''

    # Commands

    @property
    def ended(self) -> bool:
        """Whether the end of the plan has been reached."""
        return self.playback is not None and self.time >= self.playback.duration

    def start(self) -> None:
        """
        Release the plan: it begins at its own time, or now if that has passed, or resumes.

        :raises OptionError: if there is no plan, or it has ended.
        """
        if self.playback is None:
            raise OptionError('there is no plan yet')
        if self.ended:
            newer = (f'the one that came then is not played: {self._refusal}' if self._refusal
                     else 'no newer one has come')
            raise OptionError(f'the plan {self.playback.plan.identity} has ended, and {newer}')
        self.playing = True

    def pause(self) -> bool:
        """Come to rest on the curve and hold; return True if a plan was playing."""
        was_playing, self.playing = self.playing and not self.ended, False
        return was_playing

    def reset(self) -> None:
        """End the stream of setpoints; the latest plan waits at its start."""
        self.playing = False
        if self.streaming:
            self.streaming, self._seconds_since_stream_end = False, 0.0
        if self._latest is not None:
            self._wait_at_start(self._latest)

    def not_at_start(self, places: Sequence[Place | None], tolerance: float, speed: float
                     ) -> list[str]:
        """
        Describe the UAVs that cannot be at the start of the plan, and their distances or times.

        :param places: the measured (x, y, z) of each UAV in m, or None for an unknown one: such a
            UAV is taken to be at its last setpoint, and is given the time to fly from there.
        :param tolerance: largest distance in m of a UAV that is at its start.
        """
        assert self.playback is not None
        starts, scale = self.playback.at(self.playback.begin).positions, max(1.0, speed)
        last, waits = self._last_setpoint, []
        for index, (uav, place) in enumerate(
                zip(self.playback.plan.scenario.uavs, places, strict=True)):
            if place is not None:
                distance = math.dist(place, (*starts[index], uav.altitude))
                if not distance <= tolerance:
                    waits.append(f'{uav.name} to be at its start, {distance:.1f} m away')
            elif last is not None and not self.streaming:
                needed = math.dist(last.positions[index], starts[index]) / uav.max_speed
                needed += math.hypot(*last.velocities[index]) / scale / (
                    uav.max_acceleration or math.inf)
                left = needed / scale - self._seconds_since_stream_end
                if left > 0:
                    waits.append(f'{uav.name} to reach its start, another {left:.1f} s')
        return waits

    # Time

    def tick(self, now_ns: int, speed: float = 1.0, eavesdropper: ArrayLike | None = None,
             is_ready: bool = True, longest: float = 0.5) -> Moment | None:
        """
        Advance to a time and return the setpoints, or None if there are none.

        :param now_ns: the time of the clock; if it jumps, the flight is delayed instead.
        :param speed: the rate at which to play.
        :param eavesdropper: its true position, (x, y) in m, or None.
        :param is_ready: whether the setpoints may begin.
        :param longest: upper bound on the time since the last call in s; a clock that has advanced
            by more has jumped.
        :return: setpoints with velocities and accelerations in the clock's time.
        """
        elapsed = 0.0 if self._last_tick_ns is None else (now_ns - self._last_tick_ns) * 1e-9
        if elapsed < 0.0:
            self._flown_ns = -1  # After a jump back, new plans have older stamps.
        elapsed, self._last_tick_ns = min(max(0.0, elapsed), longest), now_ns
        if not self.streaming:
            # The first setpoint is the start itself.
            self._seconds_since_stream_end, elapsed = self._seconds_since_stream_end + elapsed, 0.0
            if self.playback is None or not (self.playing and is_ready):
                return None
            self.streaming, self._last_setpoint = True, None
        last_rate, advance, last = self.rate, self.rate * elapsed, self._last_setpoint
        if not self._splice(elapsed):
            begin = self.time
            self._advance(now_ns, elapsed, speed)
            advance = self.time - begin
            assert self.playback is not None
            self.delivered += _integrate_rates(self.playback, begin, self.time, eavesdropper)
        assert self.playback is not None
        moment = self._last_setpoint = _to_clock_time(self.playback, self.time, self.rate)
        if last is not None:
            scenario = self.playback.plan.scenario
            if self.rate != last_rate and scenario.limits_acceleration:
                # A change of the rate accelerates UAVs beyond the plan's own acceleration.
                moment.accelerations[:] = (moment.velocities - last.velocities) / elapsed
            distances = np.linalg.norm(moment.positions - last.positions, axis=-1)
            self.largest_jump = max(
                self.largest_jump, float((distances - scenario.max_speeds * advance).max()))
        return moment

    def _advance(self, now_ns: int, elapsed: float, speed: float) -> None:
        """Advance the plan's time; it does not begin before its stamp, and stops at its end."""
        playback = self.playback
        assert playback is not None
        due = playback.begin_ns
        if not self.rate and self.time <= playback.begin and due is not None:
            elapsed = min(elapsed, max(0, now_ns - due) * 1e-9)
        if elapsed == 0.0:
            return
        self.rate = self._limit_rate(playback, speed if self.playing else 0.0, elapsed)
        self.time += self.rate * elapsed
        self._flown_ns = -1 if playback.plan.start_ns is None else playback.plan.start_ns
        if self.time > playback.duration - _END_TOLERANCE:
            self.time = playback.duration
            # A pending plan begins without another start.
            self.rate, self.playing = 0.0, self.playing and self._pending is not None

    def _limit_rate(self, playback: Playback, target: float, elapsed: float) -> float:
        """Return the rate nearest to a target that keeps all acceleration limits."""
        scenario = playback.plan.scenario
        if not scenario.limits_acceleration or self._last_setpoint is None:
            return target
        most = max(target, self.rate)
        braking = self._braking_rates
        if braking is None or braking[0] is not playback or braking[1] < most:
            braking = self._braking_rates = (
                playback, most, *_compute_braking_rates(playback, most))
        times, rates = braking[2:]
        if len(times):
            target = min(target, float(np.interp(
                self.time + self.rate * elapsed, times, rates, left=target)))
        most_change = 1e-9 + (
            scenario.max_accelerations * max(1.0, target, self.rate)**2 * elapsed * (1 + 1e-9))
        last = self._last_setpoint.velocities

        def is_allowed(rate: float) -> bool:
            velocities = playback.at(self.time + rate * elapsed).velocities * rate
            change = np.linalg.norm(velocities - last, axis=-1)
            return bool((change <= most_change).all())

        if is_allowed(target):
            return target
        # The present rate keeps them, since the plan does.
        allowed, rejected = self.rate, target
        for _ in range(20):
            middle = (allowed + rejected) / 2
            allowed, rejected = (
                (middle, rejected) if is_allowed(middle) else (allowed, middle))
        return allowed


def _explain_team(plan: Plan, current: Plan) -> str:
    """Describe how the UAVs of a plan differ from those of another one; empty if they do not."""
    names, team = ([uav.name for uav in flown.scenario.uavs] for flown in (plan, current))
    return '' if names == team else f'it is for {quote(names)}, and {quote(team)} fly'


def _to_clock_time(playback: Playback, time: float, rate: float) -> Moment:
    """
    Scale the velocities at a time of the plan by its rate, and accelerations by its square.

    At a rate of 0 no UAV transmits or jams: the plan's powers are for receivers at its own time.
    """
    moment = playback.at(time)
    return replace(moment, velocities=moment.velocities * rate,
                   accelerations=moment.accelerations * rate**2,
                   powers=moment.powers if rate else np.zeros_like(moment.powers))


def _compute_braking_rates(playback: Playback, most: float) -> tuple[Array, Array]:
    """
    Return the largest rates from which the flight can stop at a goal that it passes at speed.

    They are integrated backwards from the end, where the rate is 0.

    :return: increasing times in s and the rates; empty where all UAVs arrive at rest.
    """
    limits = playback.plan.scenario.max_accelerations
    speeds = np.linalg.norm(playback.at(playback.duration).velocities, axis=-1)
    if (speeds < VELOCITY_JUMP).all():
        return np.empty(0), np.empty(0)
    step = max(min(_BRAKING_STEP, playback.plan.scenario.slot_duration / 10),
               float((speeds / limits).max()) / _MOST_BRAKING_STEPS)
    times, squares, slowing = [playback.duration], [0.0], 1.0
    while squares[-1] < most**2 and slowing > 0 and times[-1] > playback.begin:
        moment, square = playback.at(times[-1]), squares[-1]
        velocity, bend = moment.velocities, square * moment.accelerations
        allowed = limits * max(1.0, square) * (0.4 if square < 0.2 else 0.9)
        # The largest d with |bend - d velocity| <= allowed for every UAV.
        along, speed = (velocity * bend).sum(axis=1), (velocity**2).sum(axis=1) + 1e-12
        root = along**2 - speed * ((bend**2).sum(axis=1) - allowed**2)
        slowing = float(((along + np.sqrt(np.maximum(root, 0.0))) / speed).min())
        times.append(times[-1] - step)
        squares.append(square + 2 * step * max(0.0, slowing))
    return np.array(times[::-1]), np.sqrt(squares[::-1])


def _integrate_rates(playback: Playback, begin: float, end: float,
                     eavesdropper: ArrayLike | None) -> float:
    """Return the integral of the secrecy rate between two times, slot by slot, in bit/Hz."""
    step = playback.plan.scenario.slot_duration
    inside = np.arange(np.floor(begin / step) + 1, np.ceil(end / step)) * step
    edges = np.array([begin, *inside, end])
    places, weights = np.transpose(GAUSS_LEGENDRE)
    lengths = np.diff(edges)
    times = edges[:-1, None] + (0.5 + places) * lengths[:, None]
    rates = playback.secrecy_rates(times.ravel(), eavesdropper).reshape(times.shape)
    return float(lengths @ rates @ weights)
