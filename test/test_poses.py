"""Poses that are stale, off the ground, or whose numbers are extreme."""

import time

from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import PoseStamped, PoseWithCovarianceStamped
from nav_msgs.msg import Path
import numpy as np
import pytest
from ros_client import pose_message, values_of, wait_for
from secure_uav_planner.ros.poses import error_radius, PoseBook


def test_a_stale_pose_of_a_uav_is_refused_with_a_way_out_that_needs_no_restart(client, planner):
    path = client.listen(Path, 'uav1/path')
    old = int(time.time()) - 60
    client.send_pose('uav1/pose', 50.0, 450.0, stamp=Time(sec=old))
    client.send_paper()
    answer = client.call('planner/plan')
    assert not answer.success and 'pose_timeout is 10 s' in answer.message
    age = float(answer.message.split('uav1/pose is ')[1].split(' s old')[0])
    assert 59 < age < time.time() - old + 0.1
    assert 'set uav1.use_pose to false to plan from uav1.start' in answer.message
    assert client.set_parameters('planner', uav1__use_pose=False)[0].successful
    answer = client.call('planner/plan')
    assert answer.success, answer.message
    wait_for(lambda: path)
    assert (path[-1].poses[0].pose.position.x, path[-1].poses[0].pose.position.y) == (100.0, 500.0)
    # A new pose is used as soon as it may be.
    client.set_parameters('planner', uav1__use_pose=True)

    def planned_from_it():
        client.send_pose('uav1/pose', 60.0, 460.0, until_known=False)
        return client.call('planner/plan').success and (
            path[-1].poses[0].pose.position.x == 60.0)
    wait_for(planned_from_it, what='a plan from the new pose')


@pytest.mark.parametrize('topic, kind, x', [
    ('ground_node/pose', PoseStamped, 0.0),
    ('eavesdropper/pose', PoseWithCovarianceStamped, 200.0)])
def test_a_pose_off_the_ground_is_refused_beyond_the_tolerance(client, planner, topic, kind, x):
    path = client.listen(Path, 'uav1/path')
    client.send_paper()
    publisher = client.publisher(kind, topic)

    def refused():
        publisher.publish(pose_message(kind, x, 0, -35))
        answer = client.call('planner/plan')
        return None if answer.success else answer.message
    message = wait_for(refused, what='the refusal')
    assert f'the pose on {topic} has z = -35 m and height_tolerance is 2 m' in message
    assert client.set_parameters('planner', height_tolerance=40.0)[0].successful
    del path[:]
    assert client.call('planner/plan').success
    wait_for(lambda: path)
    # Whatever the tolerance, the altitude counts from z = 0.
    assert {at.pose.position.z for at in path[-1].poses} == {100.0}


def test_the_height_of_a_uavs_pose_does_not_matter(client, planner):
    path = client.listen(Path, 'uav1/path')
    client.send_paper()
    publisher = client.publisher(PoseStamped, 'uav1/pose')

    def planned_from_it():
        publisher.publish(pose_message(PoseStamped, 70, 0, 3))
        return client.call('planner/plan').success and path and (
            path[-1].poses[0].pose.position.x == 70.0)
    wait_for(planned_from_it, what='a plan from the pose')
    assert path[-1].poses[0].pose.position.z == 100.0


def test_frames_of_any_length_are_shown_in_a_few_words(client, planner):
    client.send_paper()
    result, = client.set_parameters('planner', frame_id='f' * 256)
    assert not result.successful and 'a string of at most 255 characters' in result.reason
    client.send_pose('uav1/pose', 0.0, 0.0, frame_id='f' * 5000, until_known=False)
    assert client.set_parameters('planner', frame_id='f' * 255)[0].successful
    answer = client.call('planner/plan')
    assert not answer.success and len(answer.message) < 1000
    result, = client.set_parameters('planner', method='m' * 10**5)
    assert not result.successful and len(result.reason) < 300
    status = client.listen(DiagnosticStatus, 'planner/status')
    wait_for(lambda: status)
    assert len(status[-1].message) < 1000
    assert max(map(len, planner.lines)) < 1000


def test_extreme_poses_leave_no_warning_of_numpy(client, planner, recwarn):
    client.send_paper()
    publisher = client.publisher(PoseWithCovarianceStamped, 'eavesdropper/pose')
    for variance in (5e-324, 1e-300, 1e154, 1e308, 1.7e308):
        message = pose_message(PoseWithCovarianceStamped, 200, 0)
        message.pose.covariance[0] = message.pose.covariance[7] = variance
        message.pose.covariance[1] = message.pose.covariance[6] = -variance
        for _ in range(3):
            publisher.publish(message)
            client.call('planner/plan')
    client.send_estimate('eavesdropper/pose', 200, 0)
    status = client.listen(DiagnosticStatus, 'planner/status')
    wait_for(lambda: client.call('planner/plan') and status and (
        float(values_of(status[-1])['pose_age.eavesdropper/pose']) < 10))
    for text in ('np.float64', 'Traceback'):
        assert not any(text in line for line in planner.lines), planner.lines
    assert not [one for one in recwarn if issubclass(one.category, RuntimeWarning)]


def test_an_error_radius_is_computed_where_squares_overflow():
    factor = error_radius(np.eye(2), 0.95)
    for scale in (1e-300, 1e-9, 1.0, 1e300):
        assert error_radius(scale * np.eye(2), 0.95) == pytest.approx(factor * np.sqrt(scale))
    assert error_radius(np.zeros((2, 2)), 0.95) == 0.0


def taken(*poses):
    """Return x of the pose that is kept of some, each (stamp, time of reception, x), in s."""
    book = PoseBook()
    for stamp, now, x in poses:
        book.take('uav1/pose', pose_message(PoseStamped, x, 0, stamp=Time(sec=stamp)), 'map', now)
    return book.get('uav1/pose').position[0]


def test_an_older_pose_that_comes_later_does_not_replace_a_newer_one():
    assert taken((100, 100.1, 1.0), (98, 100.2, 2.0)) == 1.0
    assert taken((100, 100.1, 1.0), (98, 100.2, 2.0), (101, 101.1, 3.0)) == 3.0


@pytest.mark.parametrize('poses', [
    [(100, 100.1, 1.0), (2, 2.1, 2.0)],  # the node's clock
    [(900, 100.1, 1.0), (101, 101.1, 2.0)],  # a publisher's, which was ahead
    [(100, 100.1, 1.0), *[(second, 100.0 + second, 2.0) for second in range(1, 12)]],
    [(100, 100.1, 1.0), *[(97 + second, 100.0 + second, 2.0) for second in range(1, 5)]]])
def test_after_a_clock_was_set_back_poses_are_taken_again(poses):
    assert taken(*poses) == 2.0
