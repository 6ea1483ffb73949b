"""Guard of the setpoints for an autopilot: refuses setpoints that jump."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from enum import Enum
import math
from typing import NamedTuple

from ...errors import OptionError
from ...output.autopilots import Setpoint, Vector

_HOLD_DELAY = 0.25
"""
Time [s] without a setpoint after which the last position is held.

Setpoints at 20 to 30 Hz came at most 0.16 s late on a machine with ten times its load; PX4 needs
them at more than 2 Hz.
"""

_ROUNDING = 0.01  # Tolerance of an acceleration [m/s^2], a speed [m/s] and a distance [m].


@dataclass(frozen=True)
class Limits:
    """
    The limits of a stream of setpoints.

    :param max_speed: largest speed of the UAV [m/s].
    :param max_acceleration: largest acceleration of the UAV [m/s^2]; 0 to derive it from max_jump.
    :param max_jump: distance [m] between setpoints that is allowed beyond max_speed times the
        elapsed time. A setpoint's velocity and acceleration may not lead farther than max_jump
        beyond the same limit until its position is held.
    :param start_tolerance: largest distance [m] from the vehicle to the first setpoint of a
        stream; 0 for no check.
    :param timeout: largest age [s] of a setpoint, and time [s] without a setpoint after which the
        stream has ended.
    """

    max_speed: float
    max_acceleration: float
    max_jump: float
    start_tolerance: float
    timeout: float


class StreamState(Enum):
    """The stream of setpoints that a guard follows."""

    NONE = 'no setpoint has passed'
    NEW = 'the frame has moved, so that the next setpoint must begin at the vehicle'
    FOLLOWING = 'setpoints pass that continue each other'
    HELD = 'no setpoint has passed for a moment, so that the last place is held'
    ENDED = 'no setpoint has come for the timeout, so that the next one begins a stream'


class Stream(NamedTuple):
    """
    What the guard does with the setpoints of a UAV.

    :param state: 'passing'; 'holding' the last position; 'refused' before any setpoint has passed;
        or 'silent', without setpoints.
    :param reason: why the stream is held or refused, with numbers and limits.
    """

    state: str
    reason: str = ''


class Guard:
    """
    Passes the setpoints of one UAV unless they jump, and holds the last position.

    Its times are in ns of the node's clock.
    """

    def __init__(self) -> None:
        self._last: Setpoint | None = None  # The last setpoint that has passed.
        self._last_passed = 0  # Arrival [ns] of the last setpoint that has passed.
        self._last_arrived = 0  # Arrival [ns] of the last setpoint with a fresh stamp.
        self._latest = 0  # Latest time [ns] of the clock at an arrival in the stream.
        self._refusal = '', 0  # Reason and arrival [ns] of the last refused setpoint.
        self._vehicle: tuple[Vector, int] | None = None  # Measured position; its time [ns].
        self._has_moved = False  # Whether the frame has moved since the last setpoint passed.

    def note_position(self, place: Vector, time_ns: int) -> None:
        """Note where the vehicle was at a time [ns], in the frame of the setpoints."""
        self._vehicle = place, time_ns

    def change_frame(self, convert: Callable[[Vector], Vector]) -> None:
        """
        Continue in another frame of the vehicle: convert the last setpoint, forget the position.

        With a start_tolerance, the next setpoint must be near the vehicle, as at a start.

        :param convert: converts a position from the old frame to the new one.
        """
        self._vehicle, self._has_moved = None, True
        if self._last is not None:
            self._last = replace(self._last, position=convert(self._last.position))

    def note_arrival(self, now: int, limits: Limits) -> None:
        """Note that a setpoint came at a time [ns], which keeps a stream that has not ended."""
        if self.state(now, limits) is StreamState.ENDED:
            self.forget_stream()
        self._last_arrived = now

    def note_refusal(self, reason: str, now: int) -> None:
        """Note why a setpoint was refused, by this guard or before it."""
        self._refusal = reason, now

    def state(self, now: int, limits: Limits) -> StreamState:
        """Return the StreamState at a time `now` [ns]: NONE, ENDED, NEW, FOLLOWING or HELD."""
        if self._last is None:
            return StreamState.NONE
        if not _within(self._last_arrived, now, limits.timeout):
            return StreamState.ENDED
        if self._has_moved:
            return StreamState.NEW
        return StreamState.FOLLOWING if self.hold(now) is None else StreamState.HELD

    def stream(self, now: int, limits: Limits) -> Stream:
        """Return the Stream; its reason is the last refusal, if recent and after the last pass."""
        reason, refusal_ns = self._refusal
        is_refused = reason and _within(refusal_ns, now, limits.timeout)
        if self._last is None:
            return Stream('refused', reason) if is_refused else Stream('silent')
        if self.hold(now) is None:
            return Stream('passing')
        return Stream('holding', reason if is_refused and refusal_ns >= self._last_passed else
                      'no setpoint comes')

    def take(self, setpoint: Setpoint, now: int, limits: Limits) -> None:
        """
        Keep a setpoint as the last one that has passed, or raise an OptionError with the reason.

        It must be fresh, keep the limits of motion, and be no jump from the last one of the
        stream. Its stamp may be older than the last one's only while a clock, which jumped back,
        repeats times. No time counts as passed between these two. With a start_tolerance, a
        setpoint near the vehicle may jump, and the first setpoint of a stream, or after a change
        of the frame, must be near the vehicle.
        """
        age = (now - setpoint.time_ns) * 1e-9
        if abs(age) > limits.timeout:
            raise OptionError(f'its stamp is {abs(age):.1f} s {"old" if age > 0 else "ahead"} '
                              f'and setpoint_timeout is {limits.timeout:g} s')
        self.note_arrival(now, limits)
        state = self.state(now, limits)
        _check_motion(setpoint, limits)
        is_first = state is StreamState.NONE
        must_begin = is_first or state is StreamState.NEW
        self._latest = now if is_first else max(self._latest, now)
        problem = '' if is_first else _explain_jump(
            self._last, setpoint, limits, may_be_older=now < self._latest)
        if limits.start_tolerance and (problem or must_begin):
            distant = self._explain_start(setpoint, now, limits)
            # A setpoint near the vehicle may start a new stream.
            problem = distant and (distant if must_begin else problem)
        if problem:
            raise OptionError(problem)
        self._last, self._last_passed, self._has_moved = setpoint, now, False

    def _explain_start(self, setpoint: Setpoint, now: int, limits: Limits) -> str:
        """Return the reason why a stream cannot begin with a setpoint, or an empty string."""
        if self._vehicle is None or not _within(self._vehicle[1], now, limits.timeout):
            return ('the position of the vehicle is not known, or its stamp is old, so '
                    'start_tolerance cannot be checked')
        distance = math.dist(setpoint.position, self._vehicle[0])
        return '' if distance <= limits.start_tolerance else (
            f'it is {distance:.1f} m from the vehicle and start_tolerance is '
            f'{limits.start_tolerance:g} m')

    def hold(self, now: int) -> Setpoint | None:
        """Return the last setpoint at rest if none has passed for _HOLD_DELAY, or None."""
        if self._last is None or _within(self._last_passed, now, _HOLD_DELAY):
            return None
        return self._last.hold()

    def forget_stream(self) -> None:
        """Let the next setpoint begin a stream, and forget why one was refused before."""
        self._last, self._refusal = None, ('', 0)

    def has_ended(self, now: int, limits: Limits) -> bool:
        """Return True once when setpoints have ceased to come; the stream is then forgotten."""
        if self.state(now, limits) is not StreamState.ENDED:
            return False
        self.forget_stream()
        return True


def _within(then: int, now: int, seconds: float) -> bool:
    return abs(now - then) * 1e-9 <= seconds


def _check_motion(setpoint: Setpoint, limits: Limits) -> None:
    """Raise an OptionError for a velocity or an acceleration beyond the limits."""
    # An autopilot follows both until the position is held after T = _HOLD_DELAY. Each alone may
    # lead at most max_jump farther than max_speed does: v T <= max_speed T + max_jump, and without
    # max_acceleration a T^2 / 2 <= max_jump.
    speed = math.hypot(*setpoint.velocity or ())
    most = limits.max_speed + limits.max_jump / _HOLD_DELAY
    if speed > most + _ROUNDING:
        raise OptionError(f'it has {speed:.1f} m/s, and max_jump and max_speed allow '
                          f'{most:.1f} m/s')
    acceleration = math.hypot(*setpoint.acceleration or ())
    if limits.max_acceleration:
        name, most = 'max_acceleration allows', limits.max_acceleration + _ROUNDING
    else:
        name, most = 'max_jump allows', 2 * limits.max_jump / _HOLD_DELAY**2
    if acceleration > most:
        raise OptionError(f'it has {acceleration:.3g} m/s^2, and {name} {most:.3g} m/s^2')


def _explain_jump(last: Setpoint | None, setpoint: Setpoint, limits: Limits,
                  may_be_older: bool) -> str:
    """Return why a setpoint is older than the last one or too far from it, or an empty string."""
    assert last is not None
    step = (setpoint.time_ns - last.time_ns) * 1e-9
    if step < 0 and not may_be_older:
        return f'it is {-step:.3g} s older than the last one'
    distance = math.dist(setpoint.position, last.position)
    most = limits.max_jump + limits.max_speed * min(max(0.0, step), limits.timeout)
    return '' if distance <= most + _ROUNDING else (
        f'it is {distance:.1f} m from the last one, and max_jump and max_speed allow '
        f'{most:.1f} m')
