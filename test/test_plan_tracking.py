"""UAVs that report where they are: odometry, distances from the plan, and plans from there."""

from dataclasses import replace
import math

from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import PoseStamped, PoseWithCovarianceStamped
from hypothesis import given, strategies as st
import numpy as np
import pytest
from rclpy.time import Time as RosTime
from ros_client import odometry_message, pose_message, SETTINGS, settings_with, stamp_at
from secure_uav_planner import fly_hover_fly, Scenario
from secure_uav_planner.errors import (
    InfeasibleMissionError, LateError, SupersededError, TimeLimitError)
from secure_uav_planner.plan.flight import Flight
from secure_uav_planner.plan.playback import Playback
from secure_uav_planner.plan.tracking import PUNCTUAL
from secure_uav_planner.ros import messages
from secure_uav_planner.ros.planner.plan_tracking import PlanTracking
from secure_uav_planner.ros.planner.poses import PoseBook
from secure_uav_planner.ros.planner.request import make_request, StartTime
from secure_uav_planner.ros.planner.status import State
from secure_uav_planner.ros.planner_status import TrackStatus
from studies.flown.missions import limit_acceleration
from test_plan import gap_plan


def odometry(x, y, velocity=(0.0, 0.0), stamp=0.0):
    return odometry_message(x, y, velocity, stamp=stamp_at(stamp))


@pytest.mark.parametrize('duration', [120.0, 120.1, 123.7, 1e3 / 7])
def test_the_state_of_a_flight_does_not_depend_on_the_rounding_of_its_times(duration):
    plan = fly_hover_fly(limit_acceleration(Scenario.paper(duration, slots=50), 3.0))
    plan = replace(plan, start_ns=1_795_347_543_727_675_843)
    playback, tracking = Playback(plan), PlanTracking(PoseBook())
    tracking.followed.add_plan(plan, plan.start_ns * 1e-9)
    for moment, expected in ((playback.begin, 'waiting'), (playback.duration, 'ended'),
                             (playback.begin + 1e-3, 'held'), (playback.duration - 1e-3, 'held')):
        for after in (0, 40_000_000, 77_777_777):
            clock_ns = plan.start_ns + 200_000_000_000 + after
            tracking.followed.add_report(messages.plan_time(
                plan, moment, RosTime(nanoseconds=clock_ns).to_msg()), clock_ns * 1e-9)
            assert tracking.followed.flight(clock_ns * 1e-9).state == expected


def take_poses(book, message, now):
    """Give a book the paper's poses and odometry of the first UAV at a time in s."""
    for topic, sent in (
            ('ground_node/pose', pose_message(PoseStamped, 0, 0)), ('uav1/odom', message),
            ('eavesdropper/pose', pose_message(PoseWithCovarianceStamped, 200, 0))):
        book.take(topic, sent, SETTINGS, now)


def request(tracking, book, settings, now):
    """Return the request of a new plan at a time in s."""
    flight = tracking.followed.flight(now)
    start = StartTime.from_settings(settings, round(now * 1e9), flight)
    return make_request(settings, book, start, tracking.states(flight, settings, now), flight)


def requested_uav(message, now, plan=None, **changes):
    """Return the first UAV of a mission that is requested at a time in s, after its odometry."""
    settings, book = settings_with(**{'start_delay': 30.0, **changes}), PoseBook()
    take_poses(book, message, now)
    tracking = PlanTracking(book)
    if plan is not None:
        tracking.followed.add_plan(plan, now)
        report(tracking, plan, *((clock, clock - 1000.0) for clock in (now - 0.1, now)))
    return request(tracking, book, settings, now).scenario.uavs[0]


@given(st.tuples(st.floats(-1.5, 1.5), st.floats(-1.5, 1.5)))
def test_a_uav_that_hovers_with_noisy_odometry_starts_where_it_hovers(speed):
    uav = requested_uav(odometry(100.0, 500.0, speed, stamp=999.9), 1000.0, **{
        'uav1.max_acceleration': 2.0, 'uav2.max_acceleration': 2.0})
    assert math.dist(uav.start, (100.0, 500.0)) < 2.0 and uav.start_velocity == (0.0, 0.0)


@pytest.mark.parametrize('acceleration, braking', [(0.0, 0.0), (2.0, 6.25)])
def test_a_uav_in_flight_on_no_plan_brakes_and_the_plan_starts_where_it_stands(
        acceleration, braking):
    uav = requested_uav(odometry(100.0, 500.0, (0.0, -5.0), stamp=1000.0), 1000.0, **{
        'uav1.max_acceleration': acceleration, 'uav2.max_acceleration': acceleration})
    assert uav.start == pytest.approx((100.0, 500.0 - braking))


def test_a_plan_in_flight_continues_the_last_one_for_a_uav_that_follows_it(other):
    curve = Playback(other)
    x, y = curve.at(20.0).positions[0]
    uav = requested_uav(odometry(x + 1.0, y, stamp=1020.0), 1020.0, other)
    assert uav.start == pytest.approx(curve.at(50.0).positions[0])


@pytest.mark.parametrize('distance, is_refused', [(3.0, False), (40.0, True)])
def test_a_new_plan_is_refused_in_flight_while_a_uav_is_held_off_the_plan(
        plan, distance, is_refused):
    """Before, the new plan began on the plan in flight, where the UAV was not."""
    settings, book = settings_with(start_delay=30.0), PoseBook()
    tracking = tracking_of(plan, book=book)
    place = Playback(plan).at(20.0).positions[0] + (distance, 0.0)
    for clock in np.arange(1017.0, 1020.1, 0.1):
        report(tracking, plan, (clock, clock - 1000.0))
        take_poses(book, odometry(*place, stamp=clock), clock)
        tracking.observe(settings, clock)
    if not is_refused:
        assert request(tracking, book, settings, clock).flight.state == 'flying'
        return
    with pytest.raises(InfeasibleMissionError, match='uav1 is held 40.. m from the plan in '):
        request(tracking, book, settings, clock)
    clock += 0.1
    report(tracking, plan, (clock, Playback(plan).begin))  # Reset.
    uav, _ = request(tracking, book, settings, clock).scenario.uavs
    assert uav.start == pytest.approx(place)


def test_a_plan_with_a_delay_starts_that_long_after_its_request_however_long_it_takes():
    for acceleration in (0.0, 2.0):
        start = StartTime.from_settings(settings_with(**{
            'start_delay': 30.0, 'uav1.max_acceleration': acceleration}), 1000 * 10**9, None)
        assert start.point_0_ns(1020 * 10**9) == 1030 * 10**9


def tracking_of(*plans, now=1000.0, book=None):
    """Return a PlanTracking, by a PoseBook, of plans that are published at a time in s."""
    tracking = PlanTracking(PoseBook() if book is None else book)
    for plan in plans:
        tracking.followed.add_plan(plan, now)
    return tracking


def report(tracking, plan, *reports):
    """Add reports about a plan: (time of the clock, time of the plan) in s."""
    for clock, time_of_plan in reports:
        tracking.followed.add_report(
            messages.plan_time(plan, time_of_plan, stamp_at(clock)), clock)


def plan_with(power):
    """Return a plan that begins at 1000 s."""
    return replace(fly_hover_fly(Scenario.paper(120.0, slots=40), power), start_ns=1000 * 10**9)


@pytest.fixture(scope='module')
def plan():
    return plan_with('constant')


@pytest.fixture(scope='module')
def other():
    """Return another plan of the same flight."""
    return plan_with('optimised')


def test_the_status_has_the_distance_of_each_uav_and_its_rate_and_warns_beyond_the_tolerance(
        plan):
    book, playback = PoseBook(), Playback(plan)
    tracking = tracking_of(plan, book=book)
    assert tracking.status(SETTINGS, 1001.0) == ([], TrackStatus())  # Nobody flies.
    for clock, offset, text in ((1020.0, (0.3, 0.4), None), (1020.2, (0.3, 0.4), None),
                                (1020.4, (30.0, 40.0), 'uav1 is 50.0 m from its plan, beyond')):
        report(tracking, plan, (clock, clock - 1000.0))
        for uav, (name, off) in enumerate((('uav1', offset), ('uav2', (0.0, 0.0)))):
            place = playback.at(clock - 1000.0).positions[uav] + off
            book.take(f'{name}/odom', odometry(*place, stamp=clock), SETTINGS, clock)
        tracking.observe(SETTINGS, clock)
        problems, track = tracking.status(SETTINGS, clock)
        assert track.distance == pytest.approx(
            {'uav1': math.hypot(*offset), 'uav2': 0.0}, abs=1e-6)
        assert len(problems) == bool(text) and (text or '') in ''.join(problems)
    assert tracking.status(settings_with(track_tolerance=51.0), clock)[0] == []
    assert track.rate <= track.planned_rate
    track = tracking.status(settings_with(pose_timeout=1.0), 1030.0)[1]
    assert math.isnan(track.distance['uav1'])


def test_a_replan_that_its_follower_does_not_adopt_is_not_in_flight(plan, other):
    tracking = tracking_of(plan)
    report(tracking, plan, (1010.0, 10.0), (1010.1, 10.1))
    tracking.followed.add_plan(other, 1010.2)
    report(tracking, plan, (1011.0, 11.0))  # It may not have it yet.
    assert tracking.followed.flight(1011.0).playback.plan is other
    report(tracking, plan, (1013.0, 13.0))
    assert tracking.followed.flight(1013.0).playback.plan is plan
    problems, track = tracking.status(SETTINGS, 1013.0)
    assert (track.plan, track.state) == (plan.identity, 'flying')
    assert f'plan {other.identity} is not flown: the follower has not adopted it and flies ' \
           f'{plan.identity}' in problems
    report(tracking, other, (1013.5, 13.5))
    assert tracking.followed.flight(1013.5).playback.plan is other


def test_a_follower_of_an_unknown_plan_is_named(plan, other):
    tracking = PlanTracking(PoseBook())
    report(tracking, other, (1010.0, 10.0))
    problem, = tracking.status(SETTINGS, 1010.5)[0]
    assert f'plays plan {other.identity}, which this planner does not have' in problem
    tracking.followed.check_known(1010.5)  # It may wait.
    report(tracking, other, (1010.6, 10.1))
    with pytest.raises(SupersededError, match='which this planner does not have; end that'):
        tracking.followed.check_known(1010.6)
    tracking.followed.add_plan(plan, 1010.6)
    assert tracking.followed.unknown_plan(1010.6) == other.identity
    assert tracking.followed.unknown_plan(1012.0) is None  # Silent since.


def test_a_planner_restarted_while_its_plan_waits_says_when_that_is_flown(plan, other):
    """Before, it advised to end a flight whose follower was about to adopt the plan."""
    tracking = tracking_of(replace(plan, start_ns=1030 * 10**9), now=1010.0)
    waiting = next(iter(tracking.followed._plans))
    for clock, text in ((1010.0, 'takes effect in 20.0 s'), (1031.0, 'takes effect in 0.0 s'),
                        (1033.0, None)):
        report(tracking, other, (clock - 0.2, clock - 1000.2), (clock - 0.1, clock - 1000.1))
        problem, = tracking.status(SETTINGS, clock)[0]
        with pytest.raises(LateError if text else SupersededError) as error:
            tracking.followed.check_known(clock)
        for told in (problem, str(error.value)):
            assert 'which this planner does not have' in told
            assert ('~/pause and ~/reset' in told) == (text is None)
            assert (f'plan {waiting} {text}' in told) == (text is not None)


def test_a_flight_whose_rate_changes_is_not_steady(plan):
    """A flight that is released after a pause is in test_tracking.py."""
    tracking = tracking_of(plan)
    clocks = 1010.0 + np.arange(40) * 0.05
    report(tracking, plan, *((clock, clock - 1000.0) for clock in clocks))
    report(tracking, plan, (1012.0, 11.98), (1012.05, 12.05))  # A stamp that was taken late.
    tracking.followed.check_steady(1012.05)
    report(tracking, plan, *((1012.05 + since, 12.05 + since - 0.1 * since**2)
                             for since in np.arange(1, 11) * 0.05))
    with pytest.raises(LateError, match='slowing down or speeding up'):
        tracking.followed.check_steady(1012.55)
    report(tracking, plan, (1012.6, 12.574), (1012.65, 12.574))
    assert tracking.followed.flight(1012.65).state == 'held'
    tracking.followed.check_steady(1012.65)
    tracking.followed.check_steady(1014.0)  # After a silence it stands.


def test_a_flight_is_steady_as_soon_as_its_follower_reports_the_begin_again(plan):
    tracking = tracking_of(plan)
    report(tracking, plan, *((1010.0 + since, 10.0 + since - 0.1 * since**2)
                             for since in np.arange(20) * 0.05))
    with pytest.raises(LateError):
        tracking.followed.check_steady(1011.0)
    report(tracking, plan, (1011.02, 0.0))
    tracking.followed.check_steady(1011.1)
    assert tracking.followed.flight(1011.1).state == 'waiting'


@pytest.mark.parametrize('period', [0.02, 0.2, 1.0])
def test_a_flight_is_not_steady_right_after_its_clock_jumped_ahead(plan, period):
    """Before, the receivers were predicted for a playback speed below 1."""
    tracking = tracking_of(plan)
    for count in range(10):
        clock = 1010.0 + (3.0 + 4 * period if count > 5 else 0.0) + count * period
        report(tracking, plan, (clock, 10.0 + count * period))
        if count in (6, 7):
            with pytest.raises(LateError):
                tracking.followed.check_steady(clock)
        elif count != 1:
            tracking.followed.check_steady(clock)
            assert count == 0 or tracking.followed.flight(clock).time_scale == pytest.approx(1.0)


@pytest.mark.parametrize('age, word', [(1.5, 'past'), (-3.0, 'future')])
def test_reports_by_another_clock_are_named_with_the_difference(plan, age, word):
    tracking = tracking_of(plan)
    tracking.followed.add_report(messages.plan_time(plan, 10.0, stamp_at(1010.0 - age)), 1010.0)
    problem, = tracking.status(SETTINGS, 1010.2)[0]
    assert f'{abs(age):.1f} s in the {word}' in problem and 'NTP' in problem
    problem, = tracking.status(SETTINGS, 1012.0)[0]
    assert 'is silent for 2 s' in problem


def test_after_a_silence_older_odometry_has_the_time_of_the_reports(plan):
    """Also where the clock has just come to the time of the plan at which the flight stands."""
    book = PoseBook()
    tracking = tracking_of(plan, book=book)
    report(tracking, plan, (1009.0, 18.0), (1010.0, 20.0))  # At double speed.
    place = Playback(plan).at(19.0).positions[0].tolist()
    book.take('uav1/odom', odometry(*place, stamp=1009.5), SETTINGS, 1009.5)
    settings = settings_with(pose_timeout=0.0)
    for now in (1015.0, 22.0 + plan.start_ns * 1e-9, 1030.0):
        flight = tracking.followed.flight(now)
        assert (flight.time, flight.time_scale, flight.is_reported) == (22.0, 0.0, False)
        assert tracking.distances(settings, now)['uav1'] < 1e-3


@pytest.mark.parametrize('silence', [3.0, 5.0, 9.0])
def test_odometry_that_is_silent_is_compared_with_where_the_plan_was_then(plan, other, silence):
    """Before, 5 s of silence made a UAV on its plan seem 30 m off it, also after a replan."""
    book = PoseBook()
    tracking = tracking_of(plan, book=book)

    def fly(plan, begin, end):
        report(tracking, plan, *((1000.0 + time, time) for time in np.arange(begin, end, 0.05)))

    fly(plan, 0.0, 20.0)
    place = Playback(plan).at(20.0).positions[0]
    book.take('uav1/odom', odometry(*place, stamp=1020.0), SETTINGS, 1020.0)
    fly(plan, 20.0, 20.0 + silence - 1.0)
    tracking.followed.add_plan(replace(plan, powers=plan.powers * 0.9), 1019.0 + silence)
    fly(next(reversed(tracking.followed._plans.values())).plan, 19.0 + silence, 20.0 + silence)
    now = 1020.0 + silence
    assert tracking.distances(SETTINGS, now)['uav1'] < 1e-6
    # Another flight has no time then, so nothing is told.
    tracking.followed.add_plan(replace(other, start_ns=other.start_ns - 10**9), now)
    fly(next(reversed(tracking.followed._plans.values())).plan, 20.0 + silence, 21.0 + silence)
    assert tracking.distances(SETTINGS, now + 1.0) == {}


def test_a_plan_that_is_to_take_over_soon_is_not_planned_anew_and_later_in_the_time_until_then(
        plan):
    """Before, a request that was overtaken was dropped after its whole solve."""
    tracking = tracking_of(plan)
    assert tracking.followed.until_superseded(None, 1010.0) == math.inf
    report(tracking, plan, (1010.0, 10.0), (1010.1, 10.1))
    flight = tracking.followed.flight(1010.1)
    assert tracking.followed.until_superseded(flight, 1010.1) == math.inf
    for begin, left in ((1050, 29.0), (1020, 8.9), (1012, None)):
        tracking.followed.add_plan(replace(plan, start_ns=begin * 10**9), 1010.1)
        if left is None:
            with pytest.raises(LateError, match='takes effect in 1.9 s; ask again when it is'):
                tracking.followed.until_superseded(flight, 1010.1)
        else:
            until = tracking.followed.until_superseded(flight, 1010.1)
            start = StartTime(1_010_100_000_000, 30.0, 0.0, until)
            assert start.time_limit(60.0) == pytest.approx(left)
            told = str(start.explain(TimeLimitError('over'), settings_with(time_limit=60.0)))
            assert ('an earlier plan takes effect in 9.9 s' in told) == (begin == 1020)
    # One that its follower has not adopted is not waited for, nor one of a flight that is held.
    assert tracking.followed.until_superseded(flight._replace(time_scale=0.0), 1010.1) == math.inf
    assert tracking.followed.until_superseded(flight._replace(time=14.1), 1014.1) == math.inf


def test_a_solve_that_a_short_start_delay_ends_is_told_in_its_words():
    error = TimeLimitError('time_limit is 0.25 s; it was over')
    for delay, limit, is_told in ((0.5, 60.0, True), (0.5, 0.0, True), (0.5, 0.1, False),
                                  (0.0, 60.0, False)):
        told = StartTime(0, delay, 0.0).explain(
            error, settings_with(time_limit=limit))
        assert (told is not error) == is_told
        assert not is_told or 'which leaves 0.25 s to solve it' in str(told)


def test_of_two_followers_the_first_under_way_counts_until_it_is_silent(plan):
    tracking = tracking_of(plan)

    def add(follower, clock, time_of_plan):
        tracking.followed.add_report(messages.plan_time(
            plan, time_of_plan, stamp_at(clock), follower), clock)
        return tracking.followed.flight(clock).time, tracking.status(
            SETTINGS, clock)[0]

    waiting = Playback(plan).begin
    assert add('idle', 1010.0, waiting) == (waiting, [])
    assert add('real', 1010.1, 3.0) == (3.0, [])  # The first one has not begun.
    for follower, time_of_plan in (('idle', waiting), ('late', 1.0)):
        time, (problem,) = add(follower, 1010.2, time_of_plan)
        assert time == pytest.approx(3.0, abs=0.2)
        assert f"following 'real', ignoring '{follower}'" in problem
    assert add('real', 1011.0, 3.9) == (pytest.approx(3.9), [problem])
    assert add('late', 1012.1, 2.9) == (pytest.approx(2.9), [])


def test_each_slot_of_a_gap_is_told_also_by_a_planner_that_was_restarted_inside_it():
    """Before, the last slot of a gap had no word, and a restart forgot the gap."""
    first, plan = gap_plan()
    for known in ((first, plan), (plan,)):
        tracking = tracking_of(*known, now=10**9)
        for time in np.arange(0.5, 105.0, 2.5):
            report(tracking, plan, (10**9 + time, time))
            assert [text for text in tracking.status(SETTINGS, 10**9 + time)[0]
                    if 'promise' in text] == ([
                        'the promise ended at 20.0 s; the next begins at 50.0 s']
                        if 20.0 <= time < 50.0 else []), time
    state = State(plan=plan)
    assert '8 of 10 slots promised; all slots: ' in state.outcome.text
    assert state.outcome.level == DiagnosticStatus.OK


@given(st.floats(5.0, 100.0), st.floats(0.05, 4.0), st.floats(0.1, 1.5))
def test_a_planner_ends_a_promise_in_the_slot_in_which_its_follower_does(
        pause, braking, period):
    """
    Before, a slot that the replay flew unpromised stayed in the numbers of its plan.

    :param braking: time in s until the flight is held.
    :param period: time in s between two checks of the planner.
    """
    plan = replace(fly_hover_fly(Scenario.paper(120.0, slots=120)), start_ns=10**18,
                   promised_until=120.0)
    followed, tracking, checked = plan, tracking_of(plan, now=10**9), 0.0
    for clock in np.arange(0.0, pause + braking + 3.0, 0.04):
        after = max(0.0, clock - pause)
        time = min(clock, pause) + (after - after**2 / (2 * braking) if after < braking else
                                    braking / 2)
        report(tracking, plan, (10**9 + clock, time))
        flight = Flight(Playback(followed), time, 1.0)
        if abs(flight.lateness(10**9 + clock)) > PUNCTUAL:
            followed = followed.end_promise(time)
        if clock - checked > period:
            checked = clock
            kept = tracking.check_promise(10**9 + clock) or tracking.followed.flight(
                10**9 + clock).playback.plan
    assert kept.promised_slots.tolist() == followed.promised_slots.tolist()
