"""Poses: stale, off the ground, extreme, late, or with a covariance that is none."""

from dataclasses import replace
from itertools import count
import math
import time

from geometry_msgs.msg import PoseStamped, PoseWithCovarianceStamped
from hypothesis import given
from hypothesis import strategies as st
import numpy as np
import pytest
from ros_client import odometry_message, pose_message, SETTINGS, settings_with, stamp_at
from ros_nodes import wait_for
from secure_uav_planner import Eavesdropper, Scenario
from secure_uav_planner.errors import PoseError
from secure_uav_planner.mission.fields import RADIUS
from secure_uav_planner.ros.planner.poses import PoseBook
from strategies import SEEDS


def take(book, topic, message, now=100.0, settings=SETTINGS):
    """Give a book a message that arrives at a time in s; return its remark."""
    return book.take(topic, message, settings, now)


def problems(book, now=100.0, **settings):
    """Return what is wrong with poses, in words."""
    return '; '.join(map(str, book.problems(settings_with(**settings), now)))


def odometry(x, stamp, covariance=None, twist_covariance=None, **options):
    message = odometry_message(x, 0, stamp=stamp_at(stamp), **options)
    if covariance is not None:
        message.pose.covariance = covariance
    if twist_covariance is not None:
        message.twist.covariance = twist_covariance
    return message


def estimate(x, stamp=100.0, covariance=None, z=0):
    message = pose_message(PoseWithCovarianceStamped, x, 0, z, stamp=stamp_at(stamp))
    if covariance is not None:
        message.pose.covariance = covariance
    return message


def pose(x, stamp=100.0, z=0, frame_id='map'):
    return pose_message(PoseStamped, x, 0, z, frame_id, stamp_at(stamp))


@pytest.mark.parametrize('topic, make', [('uav1/pose', pose), ('uav1/odom', odometry)])
def test_a_stale_pose_of_a_uav_is_refused_with_a_way_out_that_needs_no_restart(topic, make):
    book = PoseBook()
    take(book, topic, make(50.0, 40.0), 40.0)
    text = problems(book)
    assert f'the pose on {topic} is 60.0 s old and pose_timeout is 10 s' in text
    assert 'set uav1.use_pose to false to plan from uav1.start' in text
    assert 'uav1' not in problems(book, **{'uav1.use_pose': False})
    take(book, topic, make(50.0, 99.0))
    assert 'uav1' not in problems(book)


@pytest.mark.parametrize('topic, message', [
    ('ground_node/pose', pose(0.0, z=-35)), ('eavesdropper/pose', estimate(200.0, z=-35)),
    ('uav1/pose', pose(70.0, z=-35))])
def test_a_receivers_pose_off_the_ground_is_refused_beyond_the_tolerance(topic, message):
    book = PoseBook()
    take(book, topic, message)
    is_refused = f'the pose on {topic} has z = -35 m and height_tolerance is 2 m' in problems(book)
    assert is_refused == (topic != 'uav1/pose')
    assert topic not in problems(book, height_tolerance=40.0)


@pytest.mark.parametrize('poses, kept', [
    ([(100, 100.1), (98, 100.2)], 100), ([(100, 100.1), (98, 100.2), (101, 101.1)], 101),
    # Once a clock was set back: the node's, or that of a publisher, which was ahead.
    ([(100, 100.1), (2, 2.1)], 2), ([(900, 100.1), (101, 101.1)], 101),
    ([(100, 100.1), *((second, 100.0 + second) for second in range(1, 12))], 11),
    ([(100, 100.1), *((97 + second, 100.0 + second) for second in range(1, 5))], 101)])
def test_an_older_pose_replaces_a_newer_one_only_after_a_clock_was_set_back(poses, kept):
    """Poses are (stamp, time of arrival) in s."""
    book = PoseBook()
    for stamp, now in poses:
        take(book, 'uav1/pose', pose(stamp, stamp), now)
    assert book.get('uav1/pose').position[0] == kept


@pytest.mark.parametrize('stamp, most_lag, time', [
    (100.8, 0.0, 100.0), (100.8, 2.0, 100.8), (99.5, 2.0, 99.5), (102.5, 2.0, 100.0)])
def test_a_stamp_ahead_of_a_clock_that_may_lag_is_the_time_of_the_measurement(
        stamp, most_lag, time):
    """Before, a UAV seemed 8 m off its plan where messages of simulated time came late."""
    book = PoseBook()
    book.take('uav1/odom', odometry(1.0, stamp), SETTINGS, 100.0, most_lag)
    assert book.get('uav1/odom').time == pytest.approx(time)


def test_odometry_counts_until_a_pose_is_a_second_fresher():
    settings, book = settings_with(pose_timeout=0.0), PoseBook()
    take(book, 'uav1/odom', odometry(1.0, 100.0))
    for stamp, x in ((100.1, 1.0), (100.9, 1.0), (101.1, 2.0), (107.4, 2.0)):
        take(book, 'uav1/pose', pose(2.0, stamp), stamp)
        assert book.usable_pose('uav1', settings, stamp).position[0] == x, stamp
    take(book, 'uav1/odom', odometry(3.0, 107.0), 107.5)
    assert book.usable_pose('uav1', settings_with(pose_timeout=5.0), 112.2).position[0] == 2.0
    assert book.usable_pose('uav1', settings, 1e6).position[0] == 3.0


@pytest.mark.parametrize('timeout', [0.0, 5.0])
def test_what_came_before_the_clock_was_set_back_is_forgotten(timeout):
    settings, book = settings_with(pose_timeout=timeout), PoseBook()
    take(book, 'uav1/odom', odometry(1.0, 600.0), 600.0)
    take(book, 'eavesdropper/pose', estimate(200.0, 600.0), 600.0)
    with pytest.raises(PoseError):
        take(book, 'ground_node/pose', pose_message(PoseStamped, math.nan, 0), 600.0)
    assert book.usable_pose('uav1', settings, 599.95) is not None  # Rounding, and no jump.
    assert book.usable_pose('uav1', settings, 100.0) is None
    with pytest.raises(PoseError, match='no pose has come on eavesdropper/pose since the clock'):
        book.check(settings, 100.0)
    take(book, 'uav1/odom', odometry(2.0, 100.2), 100.3)
    assert book.usable_pose('uav1', settings, 102.3).age(102.3) == pytest.approx(2.1)


def test_what_was_measured_before_the_clock_jumped_ahead_is_not_used():
    """Before, receivers were predicted too far by their way in the time of the jump."""
    settings, book, jumps = SETTINGS, PoseBook(), []
    book.on_jump = lambda *times: jumps.append(times)
    book.follow_clock(600.0, 0.3)
    for x, stamp in ((0.0, 599.5), (1.0, 600.0)):
        take(book, 'eavesdropper/odom', odometry(x, stamp, variance=1.0), 600.0)
        take(book, 'ground_node/pose', pose(x, stamp), 600.0)
    book.follow_clock(600.3, 0.4)
    book.check(settings, 600.3)
    book.follow_clock(603.4, 0.4)
    assert jumps == [(600.3, 603.4)]
    late = odometry(1.0, 600.1, variance=1.0)  # It was under way.
    for message in (None, late):
        if message is not None:
            take(book, 'eavesdropper/odom', message, 603.4)
        with pytest.raises(PoseError, match='the pose on eavesdropper/odom is from before the '
                                            'clock jumped ahead'):
            book.check(settings, 603.4)
    take(book, 'eavesdropper/odom', odometry(1.0, 603.3, variance=1.0), 603.4)
    take(book, 'ground_node/pose', pose(1.0, 603.3), 603.4)
    book.check(settings, 603.4)
    assert book.get('ground_node/pose').velocity is None
    book.follow_clock(603.5, 0.4)
    assert len(jumps) == 1


def block(xx, yy, xy=0.0, yx=None, rest=0.0):
    """Return the 36 values of a covariance with a block of x and y; the others are the rest."""
    matrix = np.full((6, 6), float(rest))
    matrix[:2, :2] = [[xx, xy], [xy if yx is None else yx, yy]]
    return matrix.ravel()


SMALL = 1e-3
NO_COVARIANCES = [block(-1, -1), block(-1, -1, rest=1e6), block(1, -SMALL, rest=1e9),
                  block(1e6, -0.5), block(1, 1, 2), block(SMALL, SMALL, 0, SMALL, rest=1e9),
                  block(math.nan, 1), block(1, 1, math.inf), block(math.inf, math.inf)]


@pytest.mark.parametrize('covariance', [*NO_COVARIANCES, block(1e16, 1e16), block(1e14, 1)])
def test_a_covariance_that_is_none_or_too_large_is_refused_and_the_last_estimate_ages(covariance):
    book = PoseBook()
    reason = 'must be finite, symmetric and positive semidefinite|error radius of .*; it must be'
    take(book, 'eavesdropper/odom', odometry(1.0, 100.0), 100.0)
    for message in (odometry(2.0, 101.0, covariance),
                    odometry(2.0, 101.0, twist_covariance=covariance)):
        with pytest.raises(PoseError, match=reason):
            take(book, 'eavesdropper/odom', message, 101.0)
        with pytest.raises(PoseError, match=reason):
            take(book, 'eavesdropper/pose', estimate(2.0, 101.0, covariance), 101.0)
    assert book.usable_pose('eavesdropper', SETTINGS, 101.0).position[0] == 1.0
    text = problems(book, 111.0)
    assert 'eavesdropper/odom is 11.0 s old' in text and 'newer ones were refused' in text
    assert 'the last pose on eavesdropper/pose was refused: the covariance of x' in text


def test_why_poses_are_refused_and_that_an_eavesdropper_moves_is_logged_once(client, planner):
    client.plan_paper()
    publisher, places = client.publisher(PoseWithCovarianceStamped, 'eavesdropper/pose'), count()

    def lines_after(reason, covariance):
        """Send an estimate of now, ever farther off; return the lines with a reason."""
        message = estimate(10.0 * next(places), covariance=covariance)
        message.header.stamp = client.now()
        publisher.publish(message)
        time.sleep(0.02)
        return [line for line in planner.lines if reason in line]

    for case in (('eavesdropper/pose: the covariance of x and y is [[-1.0', block(-1, -1)),
                 ('eavesdropper has left its disc', None)):
        wait_for(lambda: lines_after(*case), what=case[0])
        assert len([lines_after(*case) for _ in range(10)][-1]) == 1
    wait_for(lambda: 'eavesdropper has left its disc' in client.status.text)
    assert client.call('planner/plan').success
    wait_for(lambda: 'eavesdropper has left its disc' not in client.status.text)


@pytest.mark.filterwarnings('error::RuntimeWarning')
@given(seed=SEEDS, exponent=st.floats(-300, 300))
def test_only_the_covariance_of_x_and_y_counts_at_any_size_and_rounding_does_not(seed, exponent):
    rng = np.random.default_rng(seed)
    sides = rng.normal(size=(2, rng.integers(1, 3)))
    unit = (sides @ sides.T).astype(np.float32).astype(float)
    covariance = block(0, 0, rest=rng.choice([-1.0, 1e300, math.nan, math.inf]))
    covariance.reshape(6, 6)[:2, :2] = used = unit * 10.0**exponent
    book, message = PoseBook(), estimate(200.0, covariance=covariance)
    radius = math.sqrt(-2 * math.log(0.05) * np.linalg.eigvalsh(unit)[-1]) * 10.0**(exponent / 2)
    if radius > RADIUS.high:
        with pytest.raises(PoseError, match='gives an error radius of') as refused:
            take(book, 'eavesdropper/pose', message)
        assert 'np.' not in str(refused.value)
        return
    take(book, 'eavesdropper/pose', message)
    kept = book.get('eavesdropper/pose')
    assert (kept.covariance == used).all()
    assert kept.radius('eavesdropper', SETTINGS) == pytest.approx(radius)
    take(book, 'eavesdropper/pose', estimate(200.0, covariance=block(0, 0, rest=5.0)))
    assert book.get('eavesdropper/pose').radius('eavesdropper', SETTINGS) == 10.0


def test_an_estimate_that_a_higher_confidence_makes_too_large_is_not_planned_with():
    book = PoseBook()
    take(book, 'eavesdropper/pose', estimate(200.0, covariance=block(1e13, 1e13)))
    assert 'eavesdropper' not in problems(book)
    assert 'on eavesdropper/pose, the covariance of x and y gives an error radius of' in problems(
        book, confidence=0.9999)


STANDING = Eavesdropper((0.0, 0.0), 10.0)


def expecting(eavesdropper, time=0.0):
    """Return a book that expects an eavesdropper as a plan has it."""
    book = PoseBook()
    book.expect(replace(Scenario.paper(), eavesdroppers=(eavesdropper,)), time)
    return book


def remarks(*xs, covariance=None, expected=STANDING, time=0.0):
    """Return what is said about an eavesdropper that was at x, in m, second after second."""
    book = expecting(expected, time)
    return [remark for second, x in enumerate(xs) if (remark := take(
        book, 'eavesdropper/pose', estimate(x, second, covariance), float(second)))]


def test_of_an_eavesdropper_that_sends_poses_and_leaves_its_disc_it_is_said_once_what_to_do():
    remark, = remarks(*range(0, 200, 5))
    assert 'eavesdropper has left its disc' in remark and 'modelled as stationary' in remark
    assert 'its odometry on eavesdropper/odom or with eavesdropper.max_speed' in remark
    moving = Eavesdropper(track=((0.0, 0.0, 0.0, 10.0), (50.0, 250.0, 0.0, 10.0)))
    assert not remarks(*range(0, 200, 5), expected=moving)
    assert not remarks(0, 50, 0, 50, 50, 0)  # Single errors, and no motion.
    # Its estimate wanders in a disc of 24 m, which the covariance gives.
    assert not remarks(*range(0, 45, 3), expected=Eavesdropper((0.0, 0.0), 24.0),
                       covariance=block(100.0, 100.0))


def test_an_eavesdropper_is_expected_where_the_last_plan_has_it_from_its_last_change_on():
    assert len(remarks(200, 200, 200)) == 1  # It is elsewhere from its first pose on.
    changed = Eavesdropper(track=((0.0, 0.0, 0.0, 10.0), (1.0, 200.0, 0.0, 10.0)))
    assert not remarks(200, 200, 200, expected=changed, time=1.0)
    assert len(remarks(0, 0, 0, expected=changed, time=1.0)) == 1
    book = expecting(STANDING)
    for second in range(3):
        take(book, 'eavesdropper/pose', estimate(200, second), second)
    warning, = book.left_discs
    assert 'it is 200 m from its place in the plan' in warning
    book.expect(replace(Scenario.paper(), eavesdroppers=(STANDING,)), 0.0)  # A second plan.
    assert not book.left_discs
    take(book, 'eavesdropper/pose', estimate(0, 500), 500)
    for second in range(100, 103):  # It leaves again, by odometry and with the clock set back.
        take(book, 'eavesdropper/odom', odometry(200, second), second)
    assert len(book.left_discs) == 1


def velocity_of(*poses):
    """Return the velocity that is kept of poses, which arrive when they are measured."""
    book = PoseBook()
    for message in poses:
        take(book, 'uav1/pose', message, message.header.stamp.sec + 0.1)
    return book.get('uav1/pose').velocity


def test_the_velocity_of_poses_is_that_of_the_last_second():
    assert velocity_of(pose(0.0, 40.0)) is None
    assert velocity_of(pose(0.0, 40.0), pose(0.5, 40.1)) is None  # too short to tell
    steady = [pose(0.4 * step, 40 + 0.1 * step) for step in range(30)]
    assert velocity_of(*steady) == pytest.approx((4.0, 0.0))
    assert velocity_of(pose(0.0, 10.0), pose(9.0, 40.0)) is None
    assert velocity_of(*steady, pose(0.0, 20.0)) is None  # The clock has jumped back.


@pytest.mark.parametrize('topic, change, text', [
    ('uav1/odom', {'velocity': (math.nan, 0.0)},
     r'twist.linear.x is nan; it must be from -1e\+06 to 1e\+06'),
    ('uav1/odom', {'x': math.nan}, 'position.x is nan'),
    ('uav1/odom', {'w': math.nan}, 'orientation.w is nan'),
    ('uav1/odom', {'w': 5.0, 'child_frame_id': 'base_link'},
     'orientation has length 5; it must be'),
    ('uav1/odom', {'frame_id': 'odom'}, "is in frame 'odom'; it must be in frame 'map'"),
    ('eavesdropper/odom', {'velocity': (0.0, 2000.0)},
     'twist.linear is 2000 m/s; it must be at most 1000 m/s'),
    ('eavesdropper/odom', {'velocity_variance': math.inf},
     r'the covariance of the velocity is \[\[inf, 0.0\]')])
def test_odometry_that_is_wrong_or_in_another_frame_is_refused_and_the_last_pose_kept(
        topic, change, text):
    book, options = PoseBook(), dict(change)
    take(book, topic, odometry(1.0, 99.0))
    x, w = options.pop('x', 7.0), options.pop('w', 1.0)
    message = odometry(x, 100.0, **options)
    message.pose.pose.orientation.w = w
    with pytest.raises(PoseError, match=text):
        take(book, topic, message)
    assert book.get(topic).position == (1.0, 0.0)
