"""What the relay passes on: setpoints that continue each other, and begin where the vehicle is."""

from dataclasses import replace
from itertools import pairwise
import math

from hypothesis import given
from hypothesis import strategies as st
import pytest
from secure_uav_planner.errors import OptionError
from secure_uav_planner.output.autopilots import Setpoint
from secure_uav_planner.ros.relay.guard import Guard, Limits, StreamState

LIMITS = Limits(max_speed=10.0, max_acceleration=2.0, max_jump=1.0, start_tolerance=0.0,
                timeout=1.0)
CHECKED = replace(LIMITS, start_tolerance=5.0)
SECOND = 10**9
STEP = SECOND // 20


def at(x, now, **motion):
    """Return a setpoint for a time in ns."""
    return Setpoint('map', now, (x, 0.0, 100.0), 0.3, **motion)


def passes(guard, setpoint, now=None, limits=LIMITS):
    """Return whether a setpoint is passed on."""
    try:
        guard.take(setpoint, setpoint.time_ns if now is None else now, limits)
    except OptionError:
        return False
    return True


def streamed(count=20, speed=10.0):
    """Return a Guard that has passed a stream that begins at x = 0 and t = 0, its end and time."""
    guard = Guard()
    for number in range(count + 1):
        now = number * STEP
        assert passes(guard, at(speed * now / SECOND, now))
    return guard, speed * now / SECOND, now


@given(st.lists(st.tuples(st.integers(0, 2 * SECOND), st.integers(0, SECOND),
                          st.floats(-40.0, 40.0)), max_size=40))
def test_whatever_comes_what_is_sent_moves_within_the_limits_and_its_stamps_never_go_back(moves):
    guard, x, now = Guard(), 0.0, SECOND
    sent, ends = [], 0
    for wait, late, move in moves:
        now, x = now + wait, x + move
        ends += guard.has_ended(now, LIMITS)
        if (held := guard.hold(now)) is not None:
            sent.append((ends, held))
            assert held.velocity == held.acceleration == (0.0, 0.0, 0.0)
        if passes(guard, at(x, now - late), now):
            sent.append((ends, at(x, now - late)))
    for (stream, old), (same, new) in pairwise(sent):
        # The time without setpoints counts, up to the one after which a stream has ended.
        if stream == same:
            assert old.time_ns <= new.time_ns
            assert math.dist(old.position, new.position) <= 1.0 + 10.0 * 1.0 + 1e-9


def refuses(guard, setpoint, reason, now=None, limits=LIMITS):
    """Check that a setpoint is refused with a reason."""
    with pytest.raises(OptionError, match=reason):
        guard.take(setpoint, setpoint.time_ns if now is None else now, limits)


def test_a_stream_that_jumps_is_never_followed_is_held_and_may_come_back():
    guard, x, now = streamed()
    for number in range(1, 200):
        later = now + number * STEP
        allowed = min(1.0 + 0.5 * number, 11.0)
        refuses(guard, at(x - 400.0, later), 'it is 400.0 m from the last one, and max_jump and '
                f'max_speed allow {allowed:.1f} m')
        assert not guard.has_ended(later, LIMITS)
        if number == 1:  # The setpoints of another source may still come.
            assert guard.hold(later) is None
    assert guard.hold(later) == at(x, now, velocity=(0.0, 0.0, 0.0), acceleration=(0.0, 0.0, 0.0))
    # As far as the UAV can have moved before a stream counts as ended.
    assert not passes(guard, at(x + 11.1, later))
    assert passes(guard, at(x + 10.9, later))


@pytest.mark.parametrize('motion, limits, reason', [
    ({'velocity': (0.0, -300.0, 400.0)}, LIMITS,
     'it has 500.0 m/s, and max_jump and max_speed allow 14.0 m/s'),
    ({'velocity': (14.1, 0.0, 0.0)}, LIMITS, 'it has 14.1 m/s'),
    ({'velocity': (13.9, 0.0, 0.0)}, LIMITS, None),
    ({'acceleration': (0.0, 2.1, 0.0)}, LIMITS, 'max_acceleration allows 2.01'),
    ({'acceleration': (0.0, 1.9, 0.0)}, LIMITS, None),
    ({'acceleration': (0.0, 16.1, 0.0)}, replace(LIMITS, max_acceleration=0.0, max_jump=0.5),
     'max_jump allows 16'),
    ({'acceleration': (0.0, 15.9, 0.0)}, replace(LIMITS, max_acceleration=0.0, max_jump=0.5),
     None)])
def test_a_motion_beyond_the_limits_or_that_leads_to_a_jump_is_refused_anywhere_in_a_stream(
        motion, limits, reason):
    guard, x, now = streamed()
    for guard, setpoint in ((guard, at(x, now + STEP, **motion)), (Guard(), at(x, now, **motion))):
        if reason is None:
            assert passes(guard, setpoint, limits=limits)
        else:
            refuses(guard, setpoint, reason, limits=limits)


def test_a_straight_flight_at_full_speed_passes_without_any_jump_allowed():
    guard, limits = Guard(), replace(LIMITS, max_jump=0.0)
    for number in range(1, 200):
        assert passes(guard, at(10.0 * number * 0.05, number * 50_000_000,
                                velocity=(10.0, 0.0, 0.0)), limits=limits)


def test_a_stream_that_is_silent_is_held_then_ends_and_another_may_begin_elsewhere():
    guard, x, now = streamed()
    assert guard.hold(now + SECOND // 5) is None
    assert guard.hold(now + SECOND // 2).position == (x, 0.0, 100.0)
    assert not guard.has_ended(now + SECOND, LIMITS)
    assert guard.has_ended(now + SECOND + 1, LIMITS)
    assert not guard.has_ended(now + SECOND + 2, LIMITS)  # It is said once.
    assert guard.hold(now + 2 * SECOND) is None
    assert passes(guard, at(x + 300.0, now + 2 * SECOND))


def test_a_stream_begins_where_the_vehicle_is_and_not_before_that_is_known():
    guard = Guard()

    refuses(guard, at(0.0, SECOND),
            'the position of the vehicle is not known, or its stamp is old', limits=CHECKED)
    guard.note_position((100.0, 0.0, 98.0), SECOND)
    refuses(guard, at(0.0, SECOND), 'it is 100.0 m from the vehicle and start_tolerance is 5 m',
            limits=CHECKED)
    # What a vehicle has reported long ago says nothing.
    refuses(guard, at(104.0, 3 * SECOND), 'the position of the vehicle is not known',
            limits=CHECKED)
    assert guard.hold(4 * SECOND) is None  # No place has passed that could be held.
    assert passes(guard, at(104.0, SECOND), limits=CHECKED)
    # After a jump as well.
    assert not passes(guard, at(300.0, SECOND + STEP), limits=CHECKED)
    guard.note_position((301.0, 0.0, 100.0), SECOND + STEP)
    assert passes(guard, at(300.0, SECOND + 2 * STEP), limits=CHECKED)
    # After it was told to be quiet, too.
    guard.forget_stream()
    assert not passes(guard, at(330.0, SECOND + 3 * STEP), limits=CHECKED)


@pytest.mark.parametrize('age, words', [
    (1.5, '1.5 s old'), (1e6, '1000000.0 s old'), (-1.5, '1.5 s ahead')])
def test_a_setpoint_of_another_time_is_refused_and_keeps_nothing_alive(age, words):
    guard, x, now = streamed()
    for number in range(1, 30):
        later = now + number * STEP
        refuses(guard, at(x, later - round(age * SECOND)), f'its stamp is {words} and ', later)
    assert guard.has_ended(later, LIMITS)


@pytest.mark.parametrize('jump', [-30, 30])
def test_a_clock_that_jumps_ends_the_stream_and_the_next_setpoint_begins_one(jump):
    guard, x, now = streamed()
    now += jump * SECOND
    assert guard.has_ended(now, LIMITS)
    assert passes(guard, at(x, now)) and guard.hold(now) is None


@pytest.mark.parametrize('is_under_way', [False, True])
@pytest.mark.parametrize('back', [0.03, 0.2, 0.5, 0.97, 1.5])
def test_a_stream_goes_on_when_the_clock_is_set_back_and_only_then_its_stamps_may(
        back, is_under_way):
    guard, x, now = streamed()
    if is_under_way:  # It was sent before the clock was set back and comes after it.
        sent, now = at(x + 0.5, now + STEP), now + STEP - round(back * SECOND)
        assert passes(guard, sent, now) == (back <= 1.0)
        x += 0.5
    else:
        now -= round(back * SECOND)
    for number in range(1, 100):
        later = now + number * STEP
        if number == 3 and back <= 1.0:  # No jump is allowed meanwhile.
            refuses(guard, at(x + 0.5 * number + 1.1, later), 'm from the last one')
        assert passes(guard, at(x + 0.5 * number, later))
        assert guard.stream(later, LIMITS) == ('passing', '')
    refuses(guard, at(x + 0.5 * number, later - STEP), 'older than the last one', later)


@given(st.lists(st.tuples(st.integers(0, SECOND), st.integers(0, SECOND // 10),
                          st.integers(0, SECOND), st.integers(0, SECOND),
                          st.floats(-12.0, 12.0)), max_size=40))
def test_a_clock_that_is_set_back_allows_no_larger_moves_than_the_time_that_has_passed(moves):
    guard, time, offset, x, last = Guard(), 10 * SECOND, 0, 0.0, None
    for wait, latency, back, back_under_way, move in moves:
        time, x = time + wait, x + move
        sent, stamp = time, time - (offset := offset + back)
        time += latency
        now = time - (offset := offset + back_under_way)
        if guard.state(now, LIMITS) is StreamState.ENDED:
            last = None  # What jumps back farther than the timeout ends the stream.
        if passes(guard, at(x, stamp), now):
            assert last is None or abs(x - last[1]) <= 1.0 + 10.0 * (sent - last[0]) / SECOND + (
                1e-9)
            last = sent, x


def test_a_stream_passes_beside_one_that_jumps_and_what_becomes_of_it_is_told_with_its_reason():
    guard, x, now = streamed()
    assert guard.stream(now, LIMITS) == ('passing', '')
    for number in range(1, 40):  # Of another source, while this one goes on.
        now += STEP
        assert not passes(guard, at(400.0, now))
        guard.note_refusal('it is far', now)
        assert passes(guard, at(x + 0.5 * number, now))
        assert guard.hold(now) is None
        assert guard.stream(now, LIMITS) == ('passing', '')
    assert guard.stream(now + SECOND // 2, LIMITS) == ('holding', 'it is far')
    assert guard.stream(now + 2 * SECOND, LIMITS) == ('holding', 'no setpoint comes')
    guard.note_refusal('its frame_id is wrong', now + SECOND // 2)
    assert guard.stream(now + SECOND, LIMITS) == ('holding', 'its frame_id is wrong')
    assert guard.has_ended(now + 2 * SECOND, LIMITS)
    assert guard.stream(now + 2 * SECOND, LIMITS) == ('silent', '')
    guard.note_refusal('it is 50.0 m from the vehicle', now + 3 * SECOND)
    assert guard.stream(now + 3 * SECOND, LIMITS) == ('refused', 'it is 50.0 m from the vehicle')
    guard.forget_stream()  # As when the relay is enabled again.
    assert guard.stream(now + 3 * SECOND, LIMITS) == ('silent', '')


def test_a_stream_has_a_state_from_its_first_setpoint_to_its_end():
    guard = Guard()
    assert guard.state(0, CHECKED) is StreamState.NONE
    guard, x, now = streamed()
    assert guard.state(now, CHECKED) is StreamState.FOLLOWING
    assert guard.state(now + SECOND // 2, CHECKED) is StreamState.HELD
    guard.change_frame(lambda place: place)
    assert guard.state(now, CHECKED) is StreamState.NEW
    guard.note_position((x - 6.0, 0.0, 100.0), now + STEP)
    assert not passes(guard, at(x, now + STEP), limits=CHECKED)
    guard.note_position((x - 4.0, 0.0, 100.0), now + STEP)
    assert passes(guard, at(x, now + STEP), limits=CHECKED)
    assert guard.state(now + STEP, CHECKED) is StreamState.FOLLOWING
    assert guard.state(now + 2 * SECOND, CHECKED) is StreamState.ENDED
    assert guard.has_ended(now + 2 * SECOND, CHECKED)
    assert guard.state(now + 2 * SECOND, CHECKED) is StreamState.NONE


def test_in_another_frame_the_last_place_is_held_and_continued_where_it_is_there():
    guard, x, now = streamed()
    guard.change_frame(lambda place: (place[0] + 50.0, *place[1:]))
    assert guard.hold(now + SECOND).position == (x + 50.0, 0.0, 100.0)
    assert not passes(guard, at(x + 0.5, now + STEP))
    assert passes(guard, at(x + 50.5, now + 2 * STEP))
