"""
Setpoints of plans in real time, without jumps; each plan begins at its own start time.

A flight is waiting at its start, flying, held on the way, or ended. The time of the plan advances
at a playback speed, `time_scale`: 1 is real time, 0 is a hold. `start`, `pause` and a new speed
change it no faster than the acceleration limits of all UAVs allow. The UAVs stay on the
same curve, so that all clearances of the plan hold. A new plan replaces one whose setpoints are
not sent. While setpoints are sent, the new plan is spliced in at its start time and supersedes
the old one. A new plan is refused, with the reason, if its setpoints would jump.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace
import math

import numpy as np
from numpy.typing import ArrayLike

from .flight import Flight, TimeScaleLimit, VELOCITY_JUMP
from .plan import Plan
from .playback import Moment, Playback
from .tracking import PUNCTUAL
from ..errors import OptionError, quote
from ..mission.participants import Uav
from ..model.curve import GAUSS_LEGENDRE

Point3 = tuple[float, float, float]
"""(x, y, z) in m."""

POSITION_JUMP = 0.01
"""Distance between setpoints [m] that is allowed beyond max_speed times the time between them."""

_END_TOLERANCE = 1e-3  # Time [s] before the end of a plan from which its flight has ended.


def _make_flight(playback: Playback, time: float, scale: float) -> Flight:
    """Return a flight at a time [s], clipped to begin and end; at the end its time_scale is 0."""
    if time > playback.duration - _END_TOLERANCE:
        return Flight(playback, playback.duration, 0.0)
    return Flight(playback, max(time, playback.begin), scale)


class Player:
    """
    Plays plans one after another.

    :param refuse: called with the reason when a plan is refused.
    :param mutes_unpromised: whether no power is sent in slots that are not promised.
    :ivar flight: present flight, or None before the first plan.
    :ivar playing: whether the plan's time shall advance: from `start` until `pause`, `reset` or
        the end.
    :ivar delivered: secret information that the flight has delivered [bit/Hz].
    :ivar largest_jump: largest distance [m] between consecutive setpoints, beyond max_speed times
        the plan's time between them.
    """

    def __init__(self, refuse: Callable[[str], None] = lambda reason: None,
                 mutes_unpromised: bool = False) -> None:
        self._mutes_unpromised = mutes_unpromised
        self.flight: Flight | None = None
        self._limit: TimeScaleLimit | None = None  # Limits the playback speed of `flight`.
        self.playing, self.delivered, self.largest_jump = False, 0.0, 0.0  # In bit/Hz and m.
        self._last: Moment | None = None  # The last setpoints.
        self._silence: float | None = 0.0  # Time [s] without a stream; None while streaming.
        # A plan that waits to be spliced in, and the present plan's time [s] at the splice.
        self._pending: tuple[Playback, float] | None = None
        self._latest: Playback | None = None  # The plan to which a reset returns.
        self._elsewhere: Playback | None = None  # A plan that begins away from the ended flight.
        self._on_refusal = refuse
        self._refusal = ''  # The reason for which the latest plan was refused.
        self._flown_ns = -1  # Start of the last plan that has begun; older plans are refused.
        self._last_tick_ns: int | None = None

    @property
    def playback(self) -> Playback | None:
        """Playback of the plan that flies or waits at its start, or None before any plan."""
        return None if self.flight is None else self.flight.playback

    @property
    def ended(self) -> bool:
        """Whether the end of the plan has been reached."""
        return self.flight is not None and self.flight.state == 'ended'

    @property
    def streaming(self) -> bool:
        """Whether there are setpoints to send: from the first one until a reset."""
        return self._silence is None

    # Plans

    def load(self, plan: Plan) -> bool:
        """
        Adopt a plan now or later, or refuse it; return False if it is refused or not new.

        A plan with the identity of the present or the pending one is not new: only its promise is
        taken over. A revision has the same start as the present plan. A plan for other UAVs is
        refused. A plan that starts no later than the last flown plan is refused, unless it is a
        revision. Without a stream of setpoints, a new plan replaces the present one at once. In a
        stream, only a revision does. Any other plan is pending until the splice, at which the
        present plan ends or reaches the start of the new one. A pause or a lower speed before the
        splice delays the new plan, too. In a stream, a plan whose setpoints would jump is refused.
        """
        new, flight = Playback(plan, self._mutes_unpromised), self.flight
        current = None if flight is None else flight.playback.plan
        if current is not None and plan.identity == current.identity:
            self._renew(new)  # The same flight; its promise may now last longer.
            return False
        if self._pending is not None and plan.identity == self._pending[0].plan.identity:
            self._latest, self._pending = new, (new, self._pending[1])  # Its splice stays.
            return False
        if current is not None and (problem := _explain_team(plan, current)):
            self.refuse(problem)
            return False
        is_revision = current is not None and plan.start_ns == current.start_ns
        if plan.start_ns is not None and plan.start_ns <= self._flown_ns and not is_revision:
            self.refuse('it begins no later than a plan that has been flown')
            return False
        self._latest, self._elsewhere, self._refusal = new, None, ''
        if flight is None or not self.streaming:
            self._adopt(Flight(new, new.begin, 0.0))
        elif is_revision:
            self._revise(_make_flight(new, flight.time, flight.time_scale))
        else:
            ahead = ((new.begin_ns or 0) - (self._last_tick_ns or 0)) * 1e-9
            waiting, splice_time = self._pending, flight.time + flight.time_scale * max(0.0, ahead)
            self._pending = new, splice_time
            self._splice(0.0, f'it came {-ahead:.2f} s too late: ' if ahead < 0 else '')
            if self._refusal and not self.ended:  # A refused plan leaves the pending one.
                self._pending = waiting
        return not self._refusal

    def refuse(self, reason: str) -> None:
        """Report the reason for which a plan is not played."""
        self._refusal = reason
        self._on_refusal(reason)

    def _renew(self, playback: Playback) -> None:
        """Replace the plan of the flight by the same plan with another promise."""
        assert self.flight is not None
        self.flight = self.flight._replace(playback=playback)
        if self._latest is not None and self._latest.plan.identity == playback.plan.identity:
            self._latest = playback

    def _check_promise(self, now_ns: int) -> None:
        """
        End the promise for good if the flight is over PUNCTUAL s early or late for it.

        A promise of the whole flight, with promised_until None, does not end.
        """
        assert self.flight is not None
        plan, state = self.flight.playback.plan, self.flight.state
        if plan.promised_until is not None and state != 'ended' and (
                abs(self.flight.lateness(now_ns * 1e-9)) > PUNCTUAL):
            ended = plan.end_promise(self.flight.time)
            if ended is not plan:
                self._renew(Playback(ended, self._mutes_unpromised))

    def _adopt(self, flight: Flight) -> None:
        """Replace the flight, drop a waiting plan, and count delivery and jumps from zero."""
        self.flight, self._limit, self._pending = flight, TimeScaleLimit(flight.playback), None
        self._elsewhere = None
        self.delivered = self.largest_jump = 0.0

    def _revise(self, revised: Flight) -> None:
        """Replace the flight by a revision, or refuse the revision if setpoints would jump."""
        jump = 'that plan has ended' if self.ended else self._explain_jump(revised, 0.0)
        if jump:
            self.refuse(f'it comes too late for the flight that it changes: {jump}')
        else:
            self.flight, self._limit = revised, TimeScaleLimit(revised.playback)

    def _splice(self, elapsed: float, lateness: str = '') -> bool:
        """
        Supersede the plan by the pending one if its time has come; return True if that is done.

        The time has also come if the present plan has ended. A pending plan whose setpoints would
        jump is refused. A refusal after the end of the present plan stops playing, and `start` may
        begin the refused plan later. `elapsed` is the time since the last setpoints [s], and
        `lateness` the first words of a refusal.
        """
        if self._pending is None or self.flight is None:
            return False
        (new, splice_time), scale = self._pending, self.flight.time_scale
        since = self.flight.time + scale * elapsed - splice_time  # Time after the splice [s].
        if since < 0.0 and not self.ended:
            return False
        self._pending = None
        flight = _make_flight(new, new.begin + since if scale else new.begin, scale)
        jump = self._explain_jump(flight, elapsed if scale else 0.0)
        if not jump:
            self._adopt(flight)
        elif self.ended:
            self.playing, self._elsewhere = False, new
            self.refuse(f'{jump}; ~/start begins it where the UAVs are, if that is its start by '
                        'odometry; otherwise call ~/reset')
        else:
            self.refuse(f'{lateness}{jump}; call ~/plan again')
        return not jump

    def _explain_jump(self, new: Flight, elapsed: float) -> str:
        """Describe the jump from the last setpoints, `elapsed` s ago, to a flight; '' if none."""
        last, current = self._last, self.flight
        if last is None or current is None:
            return ''
        moment, altitudes = new.moment, current.playback.plan.scenario.altitudes
        scale = max(1.0, current.time_scale)
        for index, uav in enumerate(new.playback.plan.scenario.uavs):
            distance = math.dist((*moment.positions[index], uav.altitude),
                                 (*last.positions[index], altitudes[index]))
            most = uav.max_speed * scale * elapsed + POSITION_JUMP
            if distance > most or abs(uav.altitude - altitudes[index]) > POSITION_JUMP:
                return (f'its setpoint of {uav.name} would be {distance:.3g} m from the last one; '
                        f'the limit is {most:.3g} m')
            change = math.dist(moment.velocities[index], last.velocities[index])
            most = (uav.max_acceleration or math.inf) * scale**2 * elapsed + VELOCITY_JUMP
            if uav.max_acceleration is not None and change > most:
                return (f'its velocity of {uav.name} would differ by {change:.3g} m/s from the '
                        f'last one; the limit is {most:.3g} m/s')
        return ''

    # Commands

    def start(self, positions: Sequence[Point3 | None] = (), tolerance: float = 0.0) -> None:
        """
        Release the plan: it begins at its own time, or now if that has passed, or resumes.

        After the end of a flight, a plan that was refused because it begins elsewhere is released
        if the UAVs are at its start.

        :param positions: measured position of each UAV, or None for an unknown one. By default
            all are unknown.
        :param tolerance: distance [m] from its start within which a UAV is at its start.
        :raises OptionError: if there is no plan, or if it has ended and no other can begin.
        """
        if self.playback is None:
            raise OptionError('there is no plan yet')
        if self.ended and self._elsewhere is not None:
            self._begin_elsewhere(self._elsewhere, positions, tolerance)
        if self.ended:
            newer = (f'the one that came then is not played: {self._refusal}' if self._refusal
                     else 'no newer one has come')
            raise OptionError(f'the plan {self.playback.plan.identity} has ended, and {newer}')
        self.playing = True

    def _begin_elsewhere(self, new: Playback, positions: Sequence[Point3 | None],
                         tolerance: float) -> None:
        """Adopt a plan if all UAVs are known to be within `tolerance` m of its start, or raise."""
        positions = positions or [None] * len(new.plan.scenario.uavs)
        problems = [f'the position of {uav.name} is not known' if position is None else
                    f'{uav.name} is {distance:.1f} m from its start; the limit is {tolerance:g} m'
                    for uav, position, distance in _list_distances(new, positions)
                    if position is None or not distance <= tolerance]
        if problems:
            raise OptionError(
                f'plan {new.plan.identity} begins elsewhere than where the last flight has ended, '
                f'and {"; ".join(problems)}; call ~/plan again, or ~/reset and ~/start')
        flight = Flight(new, new.begin, 0.0)
        self._adopt(flight)
        self._last = flight.moment  # The next setpoints are compared with the new start.

    def pause(self) -> bool:
        """Brake to rest on the curve and hold; return True if a plan was playing."""
        was_playing, self.playing = self.playing and not self.ended, False
        return was_playing

    def reset(self) -> None:
        """End the stream of setpoints; the latest plan waits at its start, even a pending one."""
        self.playing = False
        if self.streaming:
            self._silence = 0.0
        if self._latest is not None:
            self._adopt(Flight(self._latest, self._latest.begin, 0.0))

    def unmet_conditions(self, positions: Sequence[Point3 | None], tolerance: float, speed: float
                         ) -> list[str]:
        """
        Describe each UAV that is not at its start, with the distance [m] or time left [s].

        :param positions: measured position of each UAV, or None for an unknown one. An unknown
            UAV is given the time to fly from its last setpoint, if any, to the start.
        :param tolerance: distance [m] from its start within which a UAV is at its start.
        :param speed: the playback speed; above 1, UAVs move that much faster than max_speed.
        """
        assert self.playback is not None
        starts, scale = self.playback.at(self.playback.begin).positions, max(1.0, speed)
        last, unmet = self._last, []
        for index, (uav, position, distance) in enumerate(
                _list_distances(self.playback, positions)):
            if position is not None:
                if not distance <= tolerance:
                    unmet.append(f'{uav.name} to be at its start, {distance:.1f} m away')
            elif last is not None and self._silence is not None:
                needed = math.dist(last.positions[index], starts[index]) / uav.max_speed
                needed += math.hypot(*last.velocities[index]) / scale / (
                    uav.max_acceleration or math.inf)
                time_left = needed / scale - self._silence
                if time_left > 0:
                    unmet.append(f'{uav.name} to reach its start, another {time_left:.1f} s')
        return unmet

    # Time

    def tick(self, now_ns: int, speed: float = 1.0, eavesdropper: ArrayLike | None = None,
             is_ready: bool = True, longest: float = 0.5, is_silent: bool = False
             ) -> Moment | None:
        """
        Advance to a time and return the setpoints, or None if there are none.

        :param now_ns: time of the clock [ns]. If it has jumped back, no time has elapsed. If it
            has jumped ahead, `longest` has elapsed.
        :param speed: playback speed to approach while playing.
        :param eavesdropper: true position of the eavesdropper, (x, y) in m, or None.
        :param is_ready: whether the first setpoint may be sent.
        :param longest: largest time [s] since the last call that is not a jump of the clock.
        :param is_silent: whether no power is sent, so that nothing is delivered.
        :return: setpoints, whose velocities and accelerations are per s of the clock.
        """
        elapsed = 0.0 if self._last_tick_ns is None else (now_ns - self._last_tick_ns) * 1e-9
        if elapsed < 0.0:
            self._flown_ns = -1  # After a jump back, new plans have older stamps.
        elapsed, self._last_tick_ns = min(max(0.0, elapsed), longest), now_ns
        if self._silence is not None:
            # The plan does not advance before the first setpoint, which is the start itself.
            self._silence, elapsed = self._silence + elapsed, 0.0
            if self.flight is None or not (self.playing and is_ready):
                return None
            self._silence = self._last = None
        before, last = self.flight, self._last
        assert before is not None
        advance = before.time_scale * elapsed  # Time of the plan since the last setpoints [s].
        if not self._splice(elapsed):
            self.flight = self._advance(now_ns, elapsed, speed if self.playing else 0.0)
            advance = self.flight.time - before.time
            self._note_advance(before, eavesdropper, is_silent)
        assert self.flight is not None
        self._check_promise(now_ns)
        moment = self._last = self.flight.moment
        if last is not None:
            scenario = self.flight.playback.plan.scenario
            if self.flight.time_scale != before.time_scale and scenario.limits_acceleration:
                # A change of the time_scale accelerates UAVs beyond the plan's own acceleration.
                moment.accelerations[:] = (moment.velocities - last.velocities) / elapsed
            distances = np.linalg.norm(moment.positions - last.positions, axis=-1)
            jump = float((distances - scenario.max_speeds * advance).max())
            self.largest_jump = max(self.largest_jump, jump)
        return replace(moment, powers=np.zeros_like(moment.powers)) if is_silent else moment

    def _advance(self, now_ns: int, elapsed: float, target: float) -> Flight:
        """Return the flight `elapsed` s later, at the allowed time_scale nearest to a target."""
        flight, last = self.flight, self._last
        assert flight is not None and self._limit is not None
        due = flight.playback.begin_ns
        if flight.state == 'waiting' and not flight.time_scale and due is not None:
            # A plan does not begin before its start time.
            elapsed = min(elapsed, max(0, now_ns - due) * 1e-9)
        if elapsed == 0.0 or flight.state == 'ended':
            return flight
        scale = target if last is None else self._limit.approach(
            target, flight, last.velocities, elapsed)
        return _make_flight(flight.playback, flight.time + scale * elapsed, scale)

    def _note_advance(self, before: Flight, eavesdropper: ArrayLike | None, is_silent: bool
                      ) -> None:
        """
        Note that the plan is flown, add what it delivered since `before`, stop at its end.

        Silent setpoints deliver nothing. Playing continues after the end if a plan is pending.
        """
        flight = self.flight
        assert flight is not None
        if flight.time > before.time:
            start_ns, now_ns = flight.playback.plan.start_ns, self._last_tick_ns
            # The start is still to come after the clock was set back, but new plans begin earlier.
            self._flown_ns = -1 if start_ns is None or now_ns is None else min(start_ns, now_ns)
        if self.ended and before.state != 'ended':
            # A plan that is still pending begins without another call of start().
            self.playing = self.playing and self._pending is not None
        if not is_silent:
            self.delivered += _integrate_rates(
                flight.playback, before.time, flight.time, eavesdropper)


def _list_distances(playback: Playback, positions: Sequence[Point3 | None]
                    ) -> list[tuple[Uav, Point3 | None, float]]:
    """Return each UAV, its position, and the distance [m] from there to its start, or NaN."""
    starts = playback.at(playback.begin).positions.tolist()
    return [(uav, position, math.nan if position is None else
             math.dist(position, (*start, uav.altitude)))
            for uav, position, start in zip(
                playback.plan.scenario.uavs, positions, starts, strict=True)]


def _explain_team(plan: Plan, current: Plan) -> str:
    """Describe how the names of the UAVs differ between two plans; empty if they are equal."""
    names, team = ([uav.name for uav in flown.scenario.uavs] for flown in (plan, current))
    return '' if names == team else f'it is for {quote(names)}, and {quote(team)} fly'


def _integrate_rates(playback: Playback, begin: float, end: float,
                     eavesdropper: ArrayLike | None) -> float:
    """Return the integral of the secrecy rate from time `begin` to `end` [s] in bit/Hz."""
    # Gauss-Legendre quadrature in each slot, because powers jump between slots.
    step = playback.plan.scenario.slot_duration
    inside = np.arange(np.floor(begin / step) + 1, np.ceil(end / step)) * step
    edges = np.array([begin, *inside, end])
    places, weights = np.transpose(GAUSS_LEGENDRE)
    lengths = np.diff(edges)
    times = edges[:-1, None] + (0.5 + places) * lengths[:, None]
    rates = playback.secrecy_rates(times.ravel(), eavesdropper).reshape(times.shape)
    return float(lengths @ rates @ weights)
