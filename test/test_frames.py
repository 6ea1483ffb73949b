"""Poses of other frames, which tf2 transforms."""

from importlib.util import find_spec
import math
import sys
from unittest.mock import DEFAULT, Mock

from geometry_msgs.msg import PoseStamped, PoseWithCovarianceStamped, Transform, TransformStamped
from hypothesis import given
from nav_msgs.msg import Odometry, Path
import numpy as np
import pytest
from ros_client import numbers, SETTINGS
from ros_nodes import has_said, wait_for
from scipy.spatial.transform import Rotation
from secure_uav_planner.errors import PoseError, WrongFrameError
from secure_uav_planner.ros.planner.frames import Frames, transform_message
from secure_uav_planner.ros.planner.poses import PoseBook
from secure_uav_planner.ros.topics import LATCHED
from strategies import SEEDS
from test_poses import pose, take


def set_fields(target, values, names='xyz'):
    for name, value in zip(names, values, strict=True):
        setattr(target, name, float(value))


def random_transform(rng):
    """Return a transform, its Rotation and its shift (3,) in m."""
    turn, shift, transform = Rotation.random(random_state=rng), rng.normal(0, 300, 3), Transform()
    set_fields(transform.translation, shift)
    set_fields(transform.rotation, turn.as_quat(), 'xyzw')
    return transform, turn, shift


def random_message(kind, rng, frame_id='odom'):
    """Return a message of a kind, its position (3,), orientation and covariance (6, 6)."""
    message, place, facing = kind(), rng.normal(0, 300, 3), Rotation.random(random_state=rng)
    message.header.frame_id = frame_id
    pose = message.pose if kind is PoseStamped else message.pose.pose
    set_fields(pose.position, place)
    set_fields(pose.orientation, facing.as_quat(), 'xyzw')
    samples = rng.normal(size=(9, 6)) @ rng.normal(size=(6, 6))
    if kind is not PoseStamped:
        message.pose.covariance = (samples.T @ samples).ravel()
    return message, place, facing, samples


@pytest.mark.parametrize('kind', [PoseStamped, PoseWithCovarianceStamped, Odometry])
@given(seed=SEEDS)
def test_a_transform_turns_and_shifts_a_pose_and_turns_its_covariance(kind, seed):
    rng = np.random.default_rng(seed)
    transform, turn, shift = random_transform(rng)
    message, place, facing, samples = random_message(kind, rng)
    moved = transform_message(message, transform, 'map')
    assert (moved.header.frame_id, message.header.frame_id) == ('map', 'odom')
    pose = moved.pose if kind is PoseStamped else moved.pose.pose
    np.testing.assert_allclose(numbers(pose.position), turn.apply(place) + shift, atol=1e-9)
    there = Rotation.from_quat(numbers(pose.orientation, 'xyzw'))
    assert (there * (turn * facing).inv()).magnitude() < 1e-6
    if kind is not PoseStamped:
        # The same samples of the error, each of them turned.
        turned = np.hstack([turn.apply(samples[:, :3]), turn.apply(samples[:, 3:])])
        np.testing.assert_allclose(np.reshape(moved.pose.covariance, (6, 6)), turned.T @ turned,
                                   atol=1e-9 * np.abs(samples).max()**2)


@pytest.mark.parametrize('child', ['base_link', 'odom', 'map'])
def test_transformed_odometry_counts_in_its_new_frame_with_the_same_velocity(child):
    rng = np.random.default_rng(3)
    transform, turn, shift = random_transform(rng)
    message, place, facing, _ = random_message(Odometry, rng)
    velocity = rng.normal(0, 3, 3)  # m/s, in the frame of the child
    message.child_frame_id = child
    set_fields(message.twist.twist.linear, velocity)
    book = PoseBook(lambda message, frame_id: transform_message(message, transform, frame_id))
    take(book, 'uav1/odom', message, 1.0)
    kept = book.get('uav1/odom')
    np.testing.assert_allclose((*kept.position, kept.height), turn.apply(place) + shift)
    expected = {'base_link': (turn * facing).apply(velocity), 'odom': turn.apply(velocity),
                'map': velocity}[child]
    np.testing.assert_allclose(kept.velocity, expected[:2], atol=1e-9)
    assert book.problem('uav1/odom', SETTINGS, 5.0) is None


@pytest.mark.parametrize('broken', [0.0, 1.1, math.nan, math.inf])
def test_a_transform_that_is_no_rotation_or_not_finite_is_refused(broken):
    message, _, _, _ = random_message(PoseWithCovarianceStamped, np.random.default_rng(1))
    transform = Transform()
    transform.rotation.w = broken
    with pytest.raises(PoseError, match='the rotation of the transform has length'):
        transform_message(message, transform, 'map')
    transform = Transform()
    transform.translation.x = math.inf
    book = PoseBook(lambda message, frame_id: transform_message(message, transform, frame_id))
    with pytest.raises(PoseError, match='position.x is inf'):
        take(book, 'eavesdropper/pose', message, 1.0)


def test_a_listener_that_failed_is_made_again_at_the_next_pose(monkeypatch):
    """tf2_ros fails here as where an enclave forbids it, so a stand-in takes its place."""
    message = random_message(PoseStamped, np.random.default_rng(1))[0]
    tf2 = Mock(TransformException=LookupError, ExtrapolationException=ArithmeticError)
    tf2.TransformListener.side_effect = [RuntimeError('not allowed')] * 2 + [DEFAULT]
    tf2.Buffer.return_value.lookup_transform.side_effect = LookupError('no such frame')
    monkeypatch.setitem(sys.modules, 'tf2_ros', tf2)
    frames = Frames(None)
    for reason in 2 * ['cannot: RuntimeError: not allowed'] + 2 * [
            'how to transform it: no such frame']:
        with pytest.raises(WrongFrameError, match=reason):
            frames.transform(message, 'map')
    assert tf2.TransformListener.call_count == 3 and tf2.Buffer.call_count == 1


@pytest.mark.skipif(find_spec('tf2_ros') is not None, reason='tf2_ros is installed')
def test_without_tf2_a_pose_of_another_frame_is_refused_with_what_to_install_and_the_last_kept():
    book = PoseBook(Frames(None).transform)
    take(book, 'uav1/pose', pose(1.0, 99.0))
    with pytest.raises(WrongFrameError, match="it must be in frame 'map', as the parameter "
                       'frame_id says, or tf2_ros must be installed to transform it'):
        take(book, 'uav1/pose', pose(2.0, 100.0, frame_id='odom'))
    assert book.usable_pose('uav1', SETTINGS, 100.0).position[0] == 1.0
    with pytest.raises(WrongFrameError):
        take(book, 'ground_node/pose', pose(2.0, 100.0, frame_id='odom'))
    with pytest.raises(WrongFrameError, match='the last pose on ground_node/pose was refused'):
        book.check(SETTINGS, 100.0)


@pytest.mark.skipif(find_spec('tf2_ros') is None, reason='an installed ROS has tf2_ros')
def test_with_tf2_a_pose_of_another_frame_is_planned_from(client, planner):
    from tf2_msgs.msg import TFMessage
    transform = TransformStamped(child_frame_id='odom')
    transform.header.frame_id = 'map'
    set_fields(transform.transform.translation, (100.0, 0.0, 0.0))
    half = math.sqrt(0.5)  # A quarter turn to the left.
    set_fields(transform.transform.rotation, (0.0, 0.0, half, half), 'xyzw')
    path = client.listen(Path, 'uav1/path')
    client.send_paper()
    wait_for(lambda: client.send_pose('uav1/pose', 450.0, 40.0, frame_id='odom', until_known=False)
             or has_said(planner, 'or tf2 must know how to transform it'))
    client.publisher(TFMessage, '/tf_static', LATCHED).publish(TFMessage(transforms=[transform]))

    def planned_from_it():
        client.send_pose('uav1/pose', 450.0, 40.0, frame_id='odom', until_known=False)
        return client.call('planner/plan').success and path and (
            path[-1].poses[0].pose.position.x == pytest.approx(60.0))
    wait_for(planned_from_it, what='a plan from the pose')
    assert path[-1].poses[0].pose.position.y == pytest.approx(450.0)
