"""
Plays plans in time, each by its time of point 0, so that no setpoint ever jumps.

The time of the plan goes on with a rate: 1 is real time, 0 stands still. A pause, a start and
another speed change the rate no faster than every UAV's limit of acceleration allows, along the
same curve, so that all clearances of the plan hold. A new plan is joined only where its setpoints
continue those that are being sent; else it is refused, with the reason.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
import math

import numpy as np
from numpy.typing import ArrayLike

from .plan import Plan
from .playback import Moment, Playback
from ..errors import OptionError
from ..mission.scenario import Array
from ..model.curve import GAUSS_LEGENDRE

Place = tuple[float, float, float]

POSITION_JUMP = 0.01
"""How far setpoints may be apart, in m, beyond what the speed makes of the time in between."""

VELOCITY_JUMP = 1e-3
"""How far velocities may be apart, in m/s, beyond what the acceleration makes; for rounding."""

_BRAKING_STEP = 0.05  # s
_AT_THE_END = 1e-3  # s


class Player:
    """
    Plays plans one after another.

    :param refuse: called with the reason when a plan is not played.
    :ivar playback: the Playback that is played or waits at its start, or None before any plan.
    :ivar time: in s from point 0 of that plan.
    :ivar rate: how fast that time goes on now.
    :ivar playing: whether it is to go on: from the start until a pause, a reset or the end.
    :ivar streaming: whether there is a setpoint to send: from the start until a reset.
    :ivar delivered: secret information so far, bit/Hz.
    :ivar largest_jump: the largest distance between one setpoint and the next in m, beyond what
        the speed limit allows in the time of the plan in between.
    """

    def __init__(self, refuse: Callable[[str], None] = lambda reason: None) -> None:
        self.playback: Playback | None = None
        self.time = self.rate = self.delivered = self.largest_jump = 0.0
        self.playing = self.streaming = False
        self._on_refusal, self._refusal = refuse, ''  # Of the last plan, if that is not played.
        self._latest: Playback | None = None  # What a reset returns to.
        self._next: tuple[Playback, float] | None = None  # It takes over at this time, in s.
        self._flown_ns = -1  # Point 0 of the last plan that has begun; no older one does.
        self._ticked_ns: int | None = None
        self._last_setpoint: Moment | None = None
        self._seconds_since_stream_end = 0.0
        self._braking: tuple[Playback, float, Array, Array] | None = None

    # Plans

    def load(self, plan: Plan) -> bool:
        """
        Adopt a plan, or refuse it; return whether it will be played.

        A plan with the same point 0 as the one that is played is a revision of the same flight
        and takes over at once. Any other one takes over at once where the setpoints rest, and
        otherwise at the time of this flight that is due when the new one begins, or at its end.
        A pause and another speed delay both flights alike.
        """
        new, current = Playback(plan), self.playback
        if current is not None and plan.identity == current.plan.identity:
            return False  # Published again, for example by a planner that has been restarted.
        is_revision = current is not None and plan.start_ns == current.plan.start_ns
        if plan.start_ns is not None and plan.start_ns <= self._flown_ns and not is_revision:
            self.refuse('it begins no later than a plan that has been flown')
            return False
        self._latest, self._refusal = new, ''
        if current is None or not self.streaming:
            self._wait_at_start(new)
        elif is_revision:
            problem = 'that plan has ended' if self.ended else self._problem(new, self.time, 0.0)
            if problem:
                self.refuse(f'it comes too late for the flight that it changes: {problem}')
            else:
                self.playback = new
        else:
            ahead = max(0, (due_ns(new) or 0) - (self._ticked_ns or 0)) * 1e-9
            self._next = new, self.time + self.rate * ahead
            self._take_over(0.0)
        return not self._refusal

    def refuse(self, reason: str) -> None:
        """Report why a plan is not played."""
        self._refusal = reason
        self._on_refusal(reason)

    def _wait_at_start(self, playback: Playback) -> None:
        self.playback, self._next = playback, None
        self.time, self.rate, self.delivered, self.largest_jump = playback.begin, 0.0, 0.0, 0.0

    def _take_over(self, elapsed: float) -> bool:
        """Go over to the next plan when its time has come, unless that is a jump."""
        if self._next is None:
            return False
        (new, begin), rate = self._next, self.rate
        since = self.time + rate * elapsed - begin
        if since < 0.0 and not self.ended:
            return False
        self._next, time = None, new.begin + (rate and since)
        problem = self._problem(new, time, rate and elapsed)
        if problem:
            self.playing = self.playing and not self.ended
            self.refuse(f'{problem}; ~/plan makes another one')
            return False
        self._wait_at_start(new)
        self.time, self.rate = time, rate
        return True

    def _problem(self, new: Playback, time: float, elapsed: float) -> str:
        """Explain why the setpoints cannot continue with a plan at a time; empty if they can."""
        last, moment = self._last_setpoint, _to_clock_time(new, time, self.rate)
        if last is None or self.playback is None:
            return ''
        altitudes, quick = self.playback.plan.scenario.altitudes, max(1.0, self.rate)
        for index, uav in enumerate(new.plan.scenario.uavs):
            distance = math.dist((*moment.positions[index], uav.altitude),
                                 (*last.positions[index], altitudes[index]))
            most = uav.max_speed * quick * elapsed + POSITION_JUMP
            if distance > most or abs(uav.altitude - altitudes[index]) > POSITION_JUMP:
                return (f'its setpoint of {uav.name} would be {distance:.3g} m from the last one, '
                        f'and at most {most:.3g} m is no jump')
            change = math.dist(moment.velocities[index], last.velocities[index])
            most = (uav.max_acceleration or math.inf) * quick**2 * elapsed + VELOCITY_JUMP
            if uav.max_acceleration is not None and change > most:
                return (f'its velocity of {uav.name} would differ by {change:.3g} m/s from the '
                        f'last one, and at most {most:.3g} m/s is no jump')
        return ''

    # What a user asks for

    @property
    def ended(self) -> bool:
        """Whether the end of the plan has been reached."""
        return self.playback is not None and self.time >= self.playback.duration

    def start(self) -> None:
        """
        Release the plan: it begins at its own time, or now if that has passed, or goes on.

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
        """Come to rest on the curve and hold; return whether anything was playing."""
        was, self.playing = self.playing and not self.ended, False
        return was

    def reset(self) -> None:
        """End the setpoints; the newest plan waits at its start."""
        self.playing = False
        if self.streaming:
            self.streaming, self._seconds_since_stream_end = False, 0.0
        if self._latest is not None:
            self._wait_at_start(self._latest)

    def not_at_start(self, places: Sequence[Place | None], tolerance: float, speed: float
                     ) -> list[str]:
        """
        Name the UAVs that cannot be at the start of the plan, and how far they are from it.

        :param places: the measured (x, y, z) of each UAV in m, None where it is not known. Such a
            UAV counts as where its last setpoint was, and is given the time to fly from there.
        :param tolerance: distance from the start in m that counts as being there.
        """
        assert self.playback is not None
        starts, quick = self.playback.at(self.playback.begin).positions, max(1.0, speed)
        last, waits = self._last_setpoint, []
        for index, (uav, place) in enumerate(
                zip(self.playback.plan.scenario.uavs, places, strict=True)):
            if place is not None:
                distance = math.dist(place, (*starts[index], uav.altitude))
                if not distance <= tolerance:
                    waits.append(f'{uav.name} to be at its start, {distance:.1f} m away')
            elif last is not None and not self.streaming:
                needed = math.dist(last.positions[index], starts[index]) / uav.max_speed
                needed += math.hypot(*last.velocities[index]) / quick / (
                    uav.max_acceleration or math.inf)
                left = needed / quick - self._seconds_since_stream_end
                if left > 0:
                    waits.append(f'{uav.name} to reach its start, another {left:.1f} s')
        return waits

    # Time

    def tick(self, now_ns: int, speed: float = 1.0, eavesdropper: ArrayLike | None = None,
             is_ready: bool = True, longest: float = 0.5) -> Moment | None:
        """
        Go on to a time and return the setpoints, or None while there are none.

        :param now_ns: the time of the clock; where it jumps, the flight is delayed instead.
        :param speed: how fast to play.
        :param eavesdropper: where it really is, (x, y) in m, or None.
        :param is_ready: whether the setpoints may begin.
        :param longest: what can have passed since the last call, in s; if more has by the clock,
            that has jumped.
        :return: velocities and accelerations are those of the clock's time.
        """
        elapsed = 0.0 if self._ticked_ns is None else (now_ns - self._ticked_ns) * 1e-9
        if elapsed < 0.0:
            self._flown_ns = -1  # Plans of the time that begins anew are older by their stamps.
        elapsed, self._ticked_ns = min(max(0.0, elapsed), longest), now_ns
        if not self.streaming:
            # The first setpoint is the start itself.
            self._seconds_since_stream_end, elapsed = self._seconds_since_stream_end + elapsed, 0.0
            if self.playback is None or not (self.playing and is_ready):
                return None
            self.streaming, self._last_setpoint = True, None
        last_rate, moved, last = self.rate, self.rate * elapsed, self._last_setpoint
        if not self._take_over(elapsed):
            begin = self.time
            self._advance(now_ns, elapsed, speed)
            moved = self.time - begin
            assert self.playback is not None
            self.delivered += _delivered(self.playback, begin, self.time, eavesdropper)
        assert self.playback is not None
        moment = self._last_setpoint = _to_clock_time(self.playback, self.time, self.rate)
        if last is not None:
            scenario = self.playback.plan.scenario
            if self.rate != last_rate:
                # The time of the plan goes on at another rate, which moves UAVs with a limit.
                limited = np.isfinite(scenario.max_accelerations)
                moment.accelerations[limited] = (
                    moment.velocities - last.velocities)[limited] / elapsed
            distances = np.linalg.norm(moment.positions - last.positions, axis=-1)
            self.largest_jump = max(
                self.largest_jump, float((distances - scenario.max_speeds * moved).max()))
        return moment

    def _advance(self, now_ns: int, elapsed: float, speed: float) -> None:
        playback, due = self.playback, due_ns(self.playback)
        assert playback is not None
        if not self.rate and self.time <= playback.begin and due is not None:
            elapsed = min(elapsed, max(0, now_ns - due) * 1e-9)  # It does not begin before.
        if elapsed == 0.0:
            return
        self.rate = self._next_rate(playback, speed if self.playing else 0.0, elapsed)
        self.time += self.rate * elapsed
        self._flown_ns = -1 if playback.plan.start_ns is None else playback.plan.start_ns
        if self.time > playback.duration - _AT_THE_END:
            self.time = playback.duration
            # A plan that came during the flight begins without another word.
            self.rate, self.playing = 0.0, self.playing and self._next is not None

    def _next_rate(self, playback: Playback, target: float, elapsed: float) -> float:
        """Return the rate nearest to a target that keeps all limits of acceleration."""
        limits = playback.plan.scenario.max_accelerations
        limited = np.isfinite(limits)
        if not limited.any() or self._last_setpoint is None:
            return target
        most = max(target, self.rate)
        if self._braking is None or self._braking[0] is not playback or self._braking[1] < most:
            self._braking = (playback, most, *_braking(playback, most))
        times, rates = self._braking[2:]
        if len(times):
            target = min(target, float(np.interp(
                self.time + self.rate * elapsed, times, rates, left=target)))
        most_change = limits * max(1.0, target, self.rate)**2 * elapsed * (1 + 1e-9) + 1e-9
        last = self._last_setpoint.velocities

        def is_allowed(rate: float) -> bool:
            velocities = playback.at(self.time + rate * elapsed).velocities * rate
            change = np.linalg.norm(velocities - last, axis=-1)
            return bool((change <= most_change)[limited].all())

        if is_allowed(target):
            return target
        # The present rate keeps them, since the plan does.
        kept, refused = self.rate, target
        for _ in range(20):
            middle = (kept + refused) / 2
            kept, refused = (middle, refused) if is_allowed(middle) else (kept, middle)
        return kept


def due_ns(playback: Playback | None) -> int | None:
    """Return the time at which the first UAV leaves its start, in ns, or None without one."""
    if playback is None or playback.plan.start_ns is None:
        return None
    return playback.plan.start_ns + round(playback.begin * 1e9)


def _to_clock_time(playback: Playback, time: float, rate: float) -> Moment:
    """Scale the velocities of a time of the plan by its rate, and accelerations by the square."""
    moment = playback.at(time)
    return replace(moment, velocities=moment.velocities * rate,
                   accelerations=moment.accelerations * rate**2)


def _braking(playback: Playback, most: float) -> tuple[Array, Array]:
    """
    Return the largest rates with which a goal that is passed at speed is still a stop.

    They are integrated backward from the end, where the rate is 0.

    :return: increasing times in s and the rates; empty where all UAVs arrive at rest.
    """
    limits = playback.plan.scenario.max_accelerations
    limited = np.isfinite(limits)
    if (np.abs(playback.at(playback.duration).velocities[limited]) < VELOCITY_JUMP).all():
        return np.empty(0), np.empty(0)
    step = min(_BRAKING_STEP, playback.plan.scenario.slot_duration / 10)
    times, squares, slowing = [playback.duration], [0.0], 1.0
    while squares[-1] < most**2 and slowing > 0 and times[-1] > playback.begin:
        moment, square = playback.at(times[-1]), squares[-1]
        velocity, bend = moment.velocities[limited], square * moment.accelerations[limited]
        allowed = limits[limited] * max(1.0, square) * (0.4 if square < 0.2 else 0.9)
        # The largest d with |bend - d velocity| <= allowed for every UAV.
        along, speed = (velocity * bend).sum(axis=1), (velocity**2).sum(axis=1) + 1e-12
        root = along**2 - speed * ((bend**2).sum(axis=1) - allowed**2)
        slowing = float(((along + np.sqrt(np.maximum(root, 0.0))) / speed).min())
        times.append(times[-1] - step)
        squares.append(square + 2 * step * max(0.0, slowing))
    return np.array(times[::-1]), np.sqrt(squares[::-1])


def _delivered(playback: Playback, begin: float, end: float,
               eavesdropper: ArrayLike | None) -> float:
    """Return the secrecy rate integrated from one time to another, slot by slot, in bit/Hz."""
    step = playback.plan.scenario.slot_duration
    inside = np.arange(np.floor(begin / step) + 1, np.ceil(end / step)) * step
    edges = np.array([begin, *inside, end])
    places, weights = np.transpose(GAUSS_LEGENDRE)
    lengths = np.diff(edges)
    times = edges[:-1, None] + (0.5 + places) * lengths[:, None]
    rates = playback.secrecy_rates(times.ravel(), eavesdropper).reshape(times.shape)
    return float(lengths @ rates @ weights)
