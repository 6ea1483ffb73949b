"""UAVs that report where they are: odometry, distances from the plan, and plans from there."""

from dataclasses import replace
import math
import time

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from geometry_msgs.msg import PoseStamped, PoseWithCovarianceStamped
from nav_msgs.msg import Odometry, Path
import numpy as np
import pytest
from rclpy.time import Time as RosTime
from ros_client import (
    DEFAULTS, node_here, places_of, pose_message, seconds, stamp_at, values_of, wait_for)
from secure_uav_planner import fly_hover_fly, Iteration, Scenario
from secure_uav_planner.errors import LateError, PoseError, SupersededError, WrongFrameError
from secure_uav_planner.plan.playback import Playback
from secure_uav_planner.ros import messages
from secure_uav_planner.ros.plan_tracking import PlanTracking
from secure_uav_planner.ros.poses import Arrival, PoseBook
from secure_uav_planner.ros.scenarios import make_request, StartTime
from secure_uav_planner.ros.status import level_and_text, RequestOutcome, State
from sensor_msgs.msg import TimeReference
from studies.flown.missions import limit_acceleration


def odometry(x, y, velocity=(0.0, 0.0), frame_id='map', stamp=None, orientation=()):
    """Return an Odometry with a velocity in its own frame; orientation has fields by name."""
    message = pose_message(Odometry, x, y, 100, frame_id, stamp and stamp_at(stamp))
    message.child_frame_id = 'base_link'
    for field, value in dict(orientation).items():
        setattr(message.pose.pose.orientation, field, value)
    message.twist.twist.linear.x, message.twist.twist.linear.y = velocity
    return message


def kept_pose(*sent, now=50.0):
    """Return the pose that is kept of messages, each perhaps with its time of arrival."""
    book = PoseBook()
    for message in sent:
        message, arrival = message if isinstance(message, tuple) else (message, now)
        book.take(Arrival('uav1/odom', message, arrival), DEFAULTS, arrival)
    return book.get('uav1/odom')


@pytest.mark.parametrize('duration', [120.0, 120.1, 123.7, 1e3 / 7])
def test_the_state_of_a_flight_does_not_depend_on_the_rounding_of_its_times(duration):
    plan = fly_hover_fly(limit_acceleration(Scenario.paper(duration, slots=50), 3.0))
    plan = replace(plan, start_ns=1_795_347_543_727_675_843)
    playback, tracking = Playback(plan), PlanTracking(PoseBook())
    tracking.add_plan(plan, plan.start_ns * 1e-9)
    for moment, expected in ((playback.begin, 'waiting'), (playback.duration, 'ended'),
                             (playback.begin + 1e-3, 'held'), (playback.duration - 1e-3, 'held')):
        for after in (0, 40_000_000, 77_777_777):
            clock_ns = plan.start_ns + 200_000_000_000 + after
            tracking.add_report(messages.plan_time(
                plan, moment, RosTime(nanoseconds=clock_ns).to_msg()), clock_ns * 1e-9)
            assert tracking.flight(clock_ns * 1e-9).state == expected


def pose(stamp, x, frame_id='map'):
    return pose_message(PoseStamped, x, 0, 0, frame_id, stamp_at(stamp))


def test_the_velocity_of_poses_is_that_of_the_last_second():
    assert kept_pose(pose(40.0, 0.0)).velocity is None
    assert kept_pose(pose(40.0, 0.0), pose(40.1, 0.5)).velocity is None  # too short to tell
    steady = [pose(40 + 0.1 * step, 0.4 * step) for step in range(30)]
    assert kept_pose(*steady).velocity == pytest.approx((4.0, 0.0))
    assert kept_pose(pose(10.0, 0.0), pose(40.0, 9.0)).velocity is None
    # The clock has jumped back.
    assert kept_pose(*steady, (pose(20.0, 0.0), 20.1)).velocity is None


def test_places_in_two_frames_give_no_velocity():
    book = PoseBook()
    for stamp, frame_id, velocity in (
            (10.0, 'map', None), (10.25, 'map', (4.0, 0.0)), (10.5, 'odom', None)):
        book.take(Arrival('uav1/pose', pose(stamp, 4.0 * stamp, frame_id), stamp),
                  {**DEFAULTS, 'frame_id': frame_id}, stamp)
        assert book.get('uav1/pose').velocity == velocity


@pytest.mark.parametrize('change, text', [
    ({'velocity': (math.nan, 0.0)}, r'twist.linear.x is nan; it must be from -1e\+06 to 1e\+06'),
    ({'x': math.nan}, 'position.x is nan'),
    ({'orientation': {'w': math.nan}}, 'orientation.w is nan'),
    ({'orientation': {'z': 5.0, 'w': 5.0}}, 'orientation has length 7.07107; it must be')])
def test_odometry_that_is_not_finite_is_refused_and_the_last_pose_kept(change, text):
    book = PoseBook()
    book.take(Arrival('uav1/odom', odometry(1.0, 2.0), 5.0), DEFAULTS, 5.0)
    with pytest.raises(PoseError, match=text):
        wrong = odometry(**{'x': 7.0, 'y': 7.0, **change})
        book.take(Arrival('uav1/odom', wrong, 6.0), DEFAULTS, 6.0)
    assert book.get('uav1/odom').position == (1.0, 2.0)
    with pytest.raises(WrongFrameError, match="is in frame 'odom'; it must be in frame 'map'"):
        book.take(Arrival('uav1/odom', odometry(7.0, 7.0, frame_id='odom'), 6.0), DEFAULTS, 6.0)
    assert book.get('uav1/odom').position == (1.0, 2.0)


class Uav:
    """Sends odometry again and again, as a localisation does."""

    def __init__(self, client, name):
        self.client, self.publisher = client, client.publisher(Odometry, f'{name}/odom')

    def send(self, x, y, velocity=(0.0, 0.0), age=0.0, **options):
        self.publisher.publish(odometry(x, y, velocity, stamp=time.time() - age, **options))


def timed(path):
    """Return the times in s and the points of a path."""
    return np.array([seconds(at.header.stamp) for at in path.poses]), places_of(path)


def status_with(status, publish, condition, what):
    """Publish until the values of a status fulfil a condition; return the message."""
    def fulfilled():
        publish()
        time.sleep(0.05)
        return status and condition(values_of(status[-1])) and status[-1]
    return wait_for(fulfilled, what=what)


def test_of_odometry_and_pose_the_fresher_counts_however_old_both_may_be(client, planner):
    path = client.listen(Path, 'uav1/path')
    uav = Uav(client, 'uav1')
    client.set_parameters('planner', pose_timeout=0.0)
    client.send_paper()
    client.send_pose('uav1/pose', 70.0, 470.0)

    def start(x, age):
        def planned():
            uav.send(60.0, 460.0, age=age)
            return client.call('planner/plan').success and path and (
                path[-1].poses[0].pose.position.x == x)
        wait_for(planned, what=f'a plan from x = {x:g} m')
    start(60.0, 0.0)
    start(70.0, 7.4)  # The client sends the pose again.


def test_stale_odometry_and_odometry_of_another_frame_are_refused_as_poses_are(client, planner):
    uav = Uav(client, 'uav1')
    client.send_paper()

    def refusal(text, **options):
        def refused():
            uav.send(60.0, 460.0, **options)
            answer = client.call('planner/plan')
            return not answer.success and text in answer.message and answer.message
        return wait_for(refused, what=f'a refusal with {text!r}')
    refusal("uav1/odom was refused: the pose is in frame 'odom'", frame_id='odom')
    message = refusal('the pose on uav1/odom is', age=60.0)
    assert 'set uav1.use_pose to false to plan from uav1.start' in message
    before = len(planner.lines)

    def warned(text):
        return sum(text in line for line in planner.lines[before:])
    wrong = {'position.x is nan': {'x': math.nan},
             "is in frame 'odom'; it must be": {'x': 60.0, 'frame_id': 'odom'}}
    for text, options in wrong.items():
        wait_for(lambda: uav.send(y=460.0, **options) or warned(text), what=text)
    for options in [*wrong.values()] * 3:
        uav.send(y=460.0, **options)
    client.call('planner/cancel')
    assert [warned(text) for text in wrong] == [1, 1]
    assert client.set_parameters('planner', uav1__use_pose=False)[0].successful
    assert client.call('planner/plan').success


def test_the_status_has_the_distance_of_each_uav_and_warns_beyond_the_tolerance(client, planner):
    paths = [client.listen(Path, f'{name}/path') for name in ('uav1', 'uav2')]
    status = client.listen(DiagnosticStatus, 'planner/status')
    diagnostics = client.listen(DiagnosticArray, '/diagnostics', 10)
    uavs = [Uav(client, name) for name in ('uav1', 'uav2')]
    reports = client.publisher(TimeReference, 'plan_time')
    client.plan_paper()
    wait_for(lambda: all(paths) and status and 'plan.identity' in values_of(status[-1]))
    assert 'track.time' not in values_of(status[-1])  # Nobody flies.
    identity = values_of(status[-1])['plan.identity']

    def report_now():
        """Report that the plan is flown by its stamps; return the time."""
        now = time.time()
        message = TimeReference(source=f'{identity} /follower', time_ref=stamp_at(now))
        message.header.stamp = stamp_at(now)
        reports.publish(message)
        return now
    values = values_of(status_with(
        status, report_now, lambda values: 'track.distance.uav1' in values, 'a flight'))
    assert [values[f'track.{key}'] for key in ('distance.uav1', 'rate', 'planned_rate')] == [
        'none'] * 3

    def beside(x, y):
        """Send odometry of both UAVs, the first one beside its plan."""
        now = report_now()
        for uav, path, offset in zip(uavs, paths, ((x, y), (0.0, 0.0))):
            times, points = timed(path[-1])
            place = [np.interp(now, times, column) for column in points.T]
            uav.publisher.publish(odometry(*np.add(place, offset), stamp=now))
    client.set_parameters('planner', pose_timeout=0.0)

    def status_beside(x, y, distance, level):
        """Return the first status with the distances of both UAVs and a level."""
        def fulfilled():
            beside(x, y)
            time.sleep(0.05)
            values = values_of(status[-1])
            told = [values.get(f'track.distance.{name}', 'none') for name in ('uav1', 'uav2')]
            return 'none' not in told and np.allclose(
                np.array(told, float), [distance, 0.0], atol=0.01) and (
                    status[-1].level == level) and status[-1]
        return wait_for(fulfilled, what=f'a distance of {distance} m')
    status_beside(0.3, 0.4, 0.5, DiagnosticStatus.OK)
    far = status_beside(30.0, 40.0, 50.0, DiagnosticStatus.WARN)
    assert 'uav1 is 50.0 m from its plan, beyond' in far.message
    # The summary of the plan is told as well, and diagnostics tell the same.
    assert 'guaranteed rate' in far.message
    wait_for(lambda: any(far.message == message.status[0].message for message in diagnostics))
    assert client.set_parameters('planner', track_tolerance=51.0)[0].successful
    status_beside(30.0, 40.0, 50.0, DiagnosticStatus.OK)

    def rated():
        beside(0.0, 0.0)
        time.sleep(0.05)
        return values_of(status[-1]).get('track.rate', 'none') != 'none'
    wait_for(rated, what='the rate')
    assert np.isfinite(float(values_of(status[-1])['track.planned_rate']))


@pytest.mark.parametrize('acceleration', [0.0, 2.0])
def test_a_plan_in_flight_starts_from_where_the_uav_will_be(client, acceleration):
    """It flies with 5 m/s towards -y, on no plan, so that it brakes and stands."""
    with node_here('planner', duration=180.0, slots=90, start_delay=30.0,
                   uav1__max_acceleration=acceleration, uav2__max_acceleration=acceleration):
        path = client.listen(Path, 'uav1/path')
        uav = Uav(client, 'uav1')
        client.send_paper()
        began = time.time()

        def place(moment):
            return 100.0, 500.0 - 5.0 * (moment - began)

        def planned():
            uav.send(*place(time.time()), (0.0, -5.0))
            return client.call('planner/plan').success
        asked = time.time()
        while not planned():
            asked = time.time()
        wait_for(lambda: path)
        times, points = timed(path[-1])
        assert times[0] > asked + 30.0 - 1e-3
        assert times[-2] - times[0] == pytest.approx(180.0)
        braking = 5.0**2 / (2 * acceleration) if acceleration else 0.0
        asked_at, answered_at = place(asked), place(time.time())
        assert points[0, 0] == pytest.approx(100.0)
        assert answered_at[1] <= points[0, 1] + braking <= asked_at[1]
        if acceleration:
            assert np.linalg.norm(points[1] - points[0]) / 2.0 <= 2.0 * 2.0 + 1e-6


def requested_uav(message, now, plan=None, **changes):
    """Return the first UAV of a mission that is requested at a time in s, after its odometry."""
    settings, book = {**DEFAULTS, 'start_delay': 30.0, **changes}, PoseBook()
    for topic, sent in (
            ('ground_node/pose', pose(now, 0.0)), ('uav1/odom', message),
            ('eavesdropper/pose', pose_message(PoseWithCovarianceStamped, 200, 0))):
        book.take(Arrival(topic, sent, now), DEFAULTS, now)
    tracking = PlanTracking(book)
    if plan is not None:
        tracking.add_plan(plan, now)
        report(tracking, plan, *((clock, clock - 1000.0) for clock in (now - 0.1, now)))
    flight, start = tracking.flight(now), StartTime.from_settings(settings, round(now * 1e9), None)
    return make_request(settings, book, start, tracking.states(flight, settings, now),
                        flight).scenario.uavs[0]


@pytest.mark.parametrize('noise', [0.02, 0.3, 0.5])
def test_a_uav_that_hovers_with_noisy_odometry_starts_where_it_hovers(noise):
    rng = np.random.default_rng(5)
    for _ in range(100):
        speed = rng.normal(scale=noise, size=2).tolist()
        uav = requested_uav(odometry(100.0, 500.0, speed, stamp=999.9), 1000.0, **{
            'uav1.max_acceleration': 2.0, 'uav2.max_acceleration': 2.0})
        assert math.dist(uav.start, (100.0, 500.0)) < 1.0 and uav.start_velocity == (0.0, 0.0)


def test_a_plan_in_flight_continues_the_last_one_for_a_uav_that_follows_it(two_plans):
    curve = Playback(two_plans[1])
    x, y = curve.at(20.0).positions[0]
    uav = requested_uav(odometry(x + 1.0, y, stamp=1020.0), 1020.0, two_plans[1])
    assert uav.start == pytest.approx(curve.at(50.0).positions[0])


def test_a_plan_that_is_solved_too_late_for_its_start_is_refused(client):
    with node_here('planner', duration=150.0, slots=10, start_delay=0.001):
        status = client.listen(DiagnosticStatus, 'planner/status')
        path = client.listen(Path, 'uav1/path')
        client.send_paper()
        answer = client.call('planner/plan')
        assert not answer.success and 'a longer start_delay gives it more time' in answer.message
        wait_for(lambda: status and values_of(status[-1])['outcome.code'] == 'late')
        assert not path


def test_a_problem_with_a_uav_is_in_the_status_during_a_solve():
    outcome, problems = RequestOutcome(DiagnosticStatus.OK, 'ok', 'a plan'), ['uav1 is 9 m off']
    failed = outcome._replace(level=DiagnosticStatus.ERROR, text='it failed')
    solving = 'solving: iteration 3, 1.5000 bit/s/Hz'
    progress = Iteration(3, 'joint', 1.5, 0.1, 0.1)
    for last, wrong, iteration, level, text in (
            (outcome, problems, progress, DiagnosticStatus.WARN, f'uav1 is 9 m off; {solving}'),
            (outcome, [], progress, DiagnosticStatus.OK, solving),
            (outcome, problems, None, DiagnosticStatus.WARN, 'uav1 is 9 m off; a plan'),
            (outcome, [], None, DiagnosticStatus.OK, 'a plan'),
            (failed, problems, None, DiagnosticStatus.ERROR, 'uav1 is 9 m off; it failed')):
        assert level_and_text(last, wrong, iteration) == (level, text)


def test_the_end_of_the_flight_clears_the_refusal_of_a_replan_only():
    state = State(plan=fly_hover_fly(Scenario.paper(120.0, slots=10)))
    for is_replan in (False, True):
        state.refuse(LateError('it comes too late'), is_replan)
        state.end_flight()
        assert (state.outcome.code == 'ok') is is_replan


def tracking_of(*plans, now=1000.0):
    """Return a PlanTracking of plans that are published at a time in s."""
    tracking = PlanTracking(PoseBook())
    for plan in plans:
        tracking.add_plan(plan, now)
    return tracking


def report(tracking, plan, *reports):
    """Add reports about a plan: (time of the clock, time of the plan) in s."""
    for clock, time_of_plan in reports:
        tracking.add_report(messages.plan_time(plan, time_of_plan, stamp_at(clock)), clock)


@pytest.fixture(scope='module')
def two_plans():
    """Return a plan that begins at 1000 s, and another one of the same flight."""
    scenario = Scenario.paper(120.0, slots=40)
    return [replace(fly_hover_fly(scenario, power), start_ns=1000 * 10**9)
            for power in ('constant', 'optimised')]


def test_a_replan_that_its_follower_does_not_adopt_is_not_in_flight(two_plans):
    first, second = two_plans
    tracking = tracking_of(first)
    report(tracking, first, (1010.0, 10.0), (1010.1, 10.1))
    tracking.add_plan(second, 1010.2)
    report(tracking, first, (1011.0, 11.0))  # It may not have it yet.
    assert tracking.flight(1011.0).playback.plan is second
    report(tracking, first, (1013.0, 13.0))
    assert tracking.flight(1013.0).playback.plan is first
    problems, values = tracking.status(
        {'uavs': ['uav1', 'uav2'], 'track_tolerance': 5.0, 'frame_id': 'map', 'pose_timeout': 0.0,
         'uav1.use_pose': True, 'uav2.use_pose': True}, 1013.0)
    assert (values['track.plan'], values['track.state']) == (first.identity, 'flying')
    assert f'plan {second.identity} is not flown: the follower has not adopted it and flies ' \
           f'{first.identity}' in problems
    report(tracking, second, (1013.5, 13.5))
    assert tracking.flight(1013.5).playback.plan is second


def test_a_follower_of_an_unknown_plan_is_named(two_plans):
    plan, unknown = two_plans
    tracking = PlanTracking(PoseBook())
    report(tracking, unknown, (1010.0, 10.0))
    problem, = tracking.status({'uavs': [], 'track_tolerance': 5.0}, 1010.5)[0]
    assert f'plays plan {unknown.identity}, which this planner does not have' in problem
    tracking.check_known(1010.5)  # It may wait.
    report(tracking, unknown, (1010.6, 10.1))
    with pytest.raises(SupersededError, match='which this planner does not have; end that'):
        tracking.check_known(1010.6)
    tracking.add_plan(plan, 1010.6)
    assert tracking.unknown_plan(1010.6) == unknown.identity
    assert tracking.unknown_plan(1012.0) is None  # Silent since.


def test_a_flight_whose_rate_changes_is_not_steady(two_plans):
    plan, _ = two_plans
    tracking = tracking_of(plan)
    clocks = 1010.0 + np.arange(40) * 0.05
    report(tracking, plan, *((clock, clock - 1000.0) for clock in clocks))
    report(tracking, plan, (1012.0, 11.98), (1012.05, 12.05))  # A stamp that was taken late.
    tracking.check_steady(1012.05)
    report(tracking, plan, *((1012.05 + since, 12.05 + since - 0.1 * since**2)
                             for since in np.arange(1, 11) * 0.05))
    with pytest.raises(LateError, match='slowing down or speeding up'):
        tracking.check_steady(1012.55)
    report(tracking, plan, (1012.6, 12.574), (1012.65, 12.574))
    assert tracking.flight(1012.65).state == 'held'
    tracking.check_steady(1012.65)
    tracking.check_steady(1014.0)  # After a silence it stands.


def test_a_flight_that_has_just_been_released_is_not_steady(two_plans):
    plan, _ = two_plans
    tracking = tracking_of(plan)
    for clock in 1010.0 + np.arange(30) * 0.05:
        report(tracking, plan, (clock, 10.0))
        tracking.check_steady(clock)
    report(tracking, plan, (1011.5, 10.001))
    with pytest.raises(LateError):
        tracking.check_steady(1011.5)


@pytest.mark.parametrize('age, word', [(1.5, 'past'), (-3.0, 'future')])
def test_reports_by_another_clock_are_named_with_the_difference(two_plans, age, word):
    plan, _ = two_plans
    tracking = tracking_of(plan)
    settings = {'uavs': [], 'track_tolerance': 5.0}
    tracking.add_report(messages.plan_time(plan, 10.0, stamp_at(1010.0 - age)), 1010.0)
    problem, = tracking.status(settings, 1010.2)[0]
    assert f'{abs(age):.1f} s in the {word}' in problem and 'NTP' in problem
    problem, = tracking.status(settings, 1012.0)[0]
    assert 'is silent for 2 s' in problem


def test_after_a_silence_older_odometry_has_the_time_of_the_reports(two_plans):
    """Also where the clock has just come to the time of the plan at which the flight stands."""
    plan, _ = two_plans
    book = PoseBook()
    tracking = PlanTracking(book)
    tracking.add_plan(plan, 1000.0)
    report(tracking, plan, (1009.0, 18.0), (1010.0, 20.0))  # At double speed.
    place = Playback(plan).at(19.0).positions[0].tolist()
    book.take(Arrival('uav1/odom', odometry(*place, stamp=1009.5), 1009.5), DEFAULTS, 1009.5)
    settings = {'uavs': ['uav1'], 'frame_id': 'map', 'pose_timeout': 0.0}
    for now in (1015.0, 22.0 + plan.start_ns * 1e-9, 1030.0):
        assert tracking.flight(now).time == 22.0
        assert tracking.distances(settings, now)['uav1'] < 1e-3


def test_of_two_followers_the_first_under_way_counts_until_it_is_silent(two_plans):
    plan, _ = two_plans
    tracking = tracking_of(plan)

    def add(follower, clock, time_of_plan):
        tracking.add_report(messages.plan_time(
            plan, time_of_plan, stamp_at(clock), follower), clock)
        return tracking.flight(clock).time, tracking.status(
            {'uavs': [], 'track_tolerance': 5.0}, clock)[0]

    waiting = Playback(plan).begin
    assert add('idle', 1010.0, waiting) == (waiting, [])
    assert add('real', 1010.1, 3.0) == (3.0, [])  # The first one has not begun.
    for follower, time_of_plan in (('idle', waiting), ('late', 1.0)):
        time, (problem,) = add(follower, 1010.2, time_of_plan)
        assert time == pytest.approx(3.0, abs=0.2)
        assert f"following 'real', ignoring '{follower}'" in problem
    assert add('real', 1011.0, 3.9) == (pytest.approx(3.9), [problem])
    assert add('late', 1012.1, 2.9) == (pytest.approx(2.9), [])
