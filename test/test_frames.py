"""Poses of other frames: moved by the transform that tf2 knows, or refused with a way out."""

from importlib.util import find_spec
import math
import sys
from unittest.mock import DEFAULT, Mock

from geometry_msgs.msg import PoseStamped, PoseWithCovarianceStamped, Transform, TransformStamped
from hypothesis import given
from hypothesis import strategies as st
from nav_msgs.msg import Odometry, Path
import numpy as np
import pytest
from ros_client import Client, node_here, wait_for
from scipy.spatial.transform import Rotation
from secure_uav_planner.errors import PoseError, WrongFrameError
from secure_uav_planner.ros.frames import Frames, moved
from secure_uav_planner.ros.poses import PoseBook
from secure_uav_planner.ros.topics import LATCHED

SEEDS = st.integers(0, 2**32 - 1)


def filled(target, values, names='xyz'):
    for name, value in zip(names, values, strict=True):
        setattr(target, name, float(value))


def random_transform(rng):
    """Return a transform, its Rotation and its shift (3,) in m."""
    turn, shift, transform = Rotation.random(random_state=rng), rng.normal(0, 300, 3), Transform()
    filled(transform.translation, shift)
    filled(transform.rotation, turn.as_quat(), 'xyzw')
    return transform, turn, shift


def random_message(kind, rng, frame_id='odom'):
    """Return a message of a kind, its position (3,), orientation and covariance (6, 6)."""
    message, place, facing = kind(), rng.normal(0, 300, 3), Rotation.random(random_state=rng)
    message.header.frame_id = frame_id
    pose = message.pose if kind is PoseStamped else message.pose.pose
    filled(pose.position, place)
    filled(pose.orientation, facing.as_quat(), 'xyzw')
    samples = rng.normal(size=(9, 6)) @ rng.normal(size=(6, 6))
    if kind is not PoseStamped:
        message.pose.covariance = (samples.T @ samples).ravel()
    return message, place, facing, samples


def values(of, names='xyz'):
    return np.array([getattr(of, name) for name in names])


@pytest.mark.parametrize('kind', [PoseStamped, PoseWithCovarianceStamped, Odometry])
@given(seed=SEEDS)
def test_a_pose_is_turned_and_shifted_and_its_covariance_turned(kind, seed):
    rng = np.random.default_rng(seed)
    transform, turn, shift = random_transform(rng)
    message, place, facing, samples = random_message(kind, rng)
    found = moved(message, transform, 'map')
    assert (found.header.frame_id, message.header.frame_id) == ('map', 'odom')
    pose = found.pose if kind is PoseStamped else found.pose.pose
    np.testing.assert_allclose(values(pose.position), turn.apply(place) + shift, atol=1e-9)
    there = Rotation.from_quat(values(pose.orientation, 'xyzw'))
    assert (there * (turn * facing).inv()).magnitude() < 1e-6
    if kind is not PoseStamped:
        # The same samples of the error, each of them turned.
        turned = np.hstack([turn.apply(samples[:, :3]), turn.apply(samples[:, 3:])])
        np.testing.assert_allclose(np.reshape(found.pose.covariance, (6, 6)), turned.T @ turned,
                                   atol=1e-9 * np.abs(samples).max()**2)


@pytest.mark.parametrize('child', ['base_link', 'odom', 'map'])
def test_the_velocity_of_a_uav_is_the_same_seen_from_either_frame(child):
    rng = np.random.default_rng(3)
    transform, turn, _ = random_transform(rng)
    message, _, facing, _ = random_message(Odometry, rng)
    velocity = rng.normal(0, 3, 3)  # m/s, in the frame of the child
    message.child_frame_id = child
    filled(message.twist.twist.linear, velocity)
    book = PoseBook(lambda one, frame_id: moved(one, transform, frame_id))
    book.take('uav1/odom', message, 'map', 1.0)
    expected = {'base_link': (turn * facing).apply(velocity), 'odom': turn.apply(velocity),
                'map': velocity}[child]
    np.testing.assert_allclose(book.get('uav1/odom').velocity, expected[:2], atol=1e-9)


def test_a_moved_pose_is_one_of_the_frame_that_it_has_been_moved_to():
    transform, turn, shift = random_transform(np.random.default_rng(1))
    book = PoseBook(lambda one, frame_id: moved(one, transform, frame_id))
    message, place, _, _ = random_message(PoseStamped, np.random.default_rng(2))
    book.take('uav1/pose', message, 'map', 5.0)
    known = book.get('uav1/pose')
    np.testing.assert_allclose((*known.position, known.height), turn.apply(place) + shift)
    for frame_id, problem in (('map', type(None)), ('odom', WrongFrameError)):
        settings = {'frame_id': frame_id, 'pose_timeout': 10.0}
        assert isinstance(book.problem('uav1/pose', settings, 5.0, of_ground=False), problem)


@pytest.mark.parametrize('broken', [0.0, 1.1, math.nan, math.inf])
def test_what_is_no_transform_or_leads_nowhere_is_refused(broken):
    message, _, _, _ = random_message(PoseWithCovarianceStamped, np.random.default_rng(1))
    transform = Transform()
    transform.rotation.w = broken
    with pytest.raises(PoseError, match='the rotation of the transform has length'):
        moved(message, transform, 'map')
    transform = Transform()
    transform.translation.x = math.inf
    book = PoseBook(lambda one, frame_id: moved(one, transform, frame_id))
    with pytest.raises(PoseError, match='position.x is inf'):
        book.take('eavesdropper/pose', message, 'map', 1.0)


def test_a_listener_that_failed_is_begun_again_at_the_next_pose(monkeypatch):
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
            frames.moved(message, 'map')
    assert tf2.TransformListener.call_count == 3 and tf2.Buffer.call_count == 1


def refused(client, process):
    """Send a pose of another frame until the planner refuses it; return what it says."""
    def line():
        client.send_pose('uav1/pose', 450.0, 40.0, frame_id='odom', until_known=False)
        return next((line for line in list(process.lines)
                     if "the pose is in frame 'odom'" in line), None)
    return wait_for(line, what='the refusal')


def test_without_tf2_the_refusal_names_what_to_install():
    if find_spec('tf2_ros') is not None:
        pytest.skip('tf2_ros is installed')
    with node_here('planner', duration=120.0, slots=20) as process, Client() as client:
        line = refused(client, process)
        assert "it must be in frame 'map', as the parameter frame_id says" in line
        assert 'or tf2_ros must be installed to transform it; it is not used' in line


def test_with_tf2_a_pose_of_another_frame_is_planned_from():
    if find_spec('tf2_ros') is None:
        pytest.skip('needs tf2_ros, which an installed ROS has')
    from tf2_msgs.msg import TFMessage
    transform = TransformStamped(child_frame_id='odom')
    transform.header.frame_id = 'map'
    filled(transform.transform.translation, (100.0, 0.0, 0.0))
    half = math.sqrt(0.5)  # A quarter turn to the left.
    filled(transform.transform.rotation, (0.0, 0.0, half, half), 'xyzw')
    with node_here('planner', duration=120.0, slots=20) as process, Client() as client:
        path = client.listen(Path, 'uav1/path')
        client.send_paper()
        assert 'or tf2 must know how to transform it' in refused(client, process)
        client.publisher(TFMessage, '/tf_static', LATCHED).publish(
            TFMessage(transforms=[transform]))

        def planned_from_it():
            client.send_pose('uav1/pose', 450.0, 40.0, frame_id='odom', until_known=False)
            return client.call('planner/plan').success and path and (
                path[-1].poses[0].pose.position.x == pytest.approx(60.0))
        wait_for(planned_from_it, what='a plan from the pose')
        assert path[-1].poses[0].pose.position.y == pytest.approx(450.0)
