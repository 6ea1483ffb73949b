"""The last valid pose of each topic, in the frame of the planner; tf2 transforms the others."""

from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from copy import deepcopy
from dataclasses import dataclass, replace
from importlib import import_module
import math
from typing import Any, TypeAlias

from geometry_msgs.msg import PoseStamped, PoseWithCovarianceStamped, Transform
from nav_msgs.msg import Odometry
import numpy as np
from rclpy.node import Node
from rclpy.time import Time

from .messages import nanoseconds
from .topics import member_topics
from ..errors import (
    brief, describe_error, PoseError, PoseMissingError, PoseStaleError, quote, WrongFrameError)
from ..mission.scenario import Array, Point, RANGES
from ..mission.tracks import MAX_SPEED
from ..output.autopilots import rotation

# s between the positions that give the velocity of a UAV without odometry.
_SHORTEST_BASE, _LONGEST_BASE = 0.2, 1.0
_LEAST_SPACING = 0.02  # s between the positions that are kept, so that they are few at any rate.
_LONGEST_LAG = 1.0  # s by which the last transform may be older than a pose.

# s after a pose in which no older one replaces it; later, a publisher's clock may have been set
# back.
_KEPT_BEFORE_OLDER = 10.0

Message: TypeAlias = PoseStamped | PoseWithCovarianceStamped | Odometry


@dataclass(frozen=True)
class KnownPose:
    """The last valid pose of a topic."""

    frame_id: str
    position: Point  # (x, y) in m
    height: float  # z in m
    covariance: Array | None  # Of x and y, (2, 2) in m^2.
    stamp: float  # When it was measured in s, or received if the pose has no stamp.
    received: float  # s
    velocity: Point | None = None  # From odometry or the poses of the last second, in m/s.
    velocity_covariance: Array | None = None  # From a receiver's odometry, (2, 2) in m^2/s^2.

    @property
    def time(self) -> float:
        """Time of the measurement in s, but not after the reception."""
        return min(self.stamp, self.received)

    def age(self, now: float) -> float:
        """Return the age in s at a time in s, or 0 if the clock has jumped back."""
        return max(0.0, now - self.time)

    def is_overtaken_by(self, last: 'KnownPose') -> bool:
        """Return True if a pose that came before, by the same clock, was measured later."""
        return self.time < last.time and (
            0.0 <= self.received - last.received < _KEPT_BEFORE_OLDER)


def _frame_refusal(message: Message, frame_id: str) -> str:
    return (f'the pose is in frame {quote(message.header.frame_id)}; it must be in frame '
            f'{quote(frame_id)}, as the parameter frame_id says')


def _refuse_frame(message: Message, frame_id: str) -> Message:
    raise WrongFrameError(_frame_refusal(message, frame_id))


class PoseBook:
    """
    The last valid pose of each topic.

    :param transform: returns a message in another frame, or raises a PoseError.
    """

    def __init__(self, transform: Callable[[Message, str], Message] = _refuse_frame) -> None:
        self._transform = transform
        self._poses: dict[str, KnownPose] = {}
        self._foreign_frames: dict[str, str] = {}
        self._recent: dict[str, list[tuple[float, Point]]] = {}

    def take(self, topic: str, message: Message, frame_id: str, now: float,
             origin: Sequence[float] = (0.0, 0.0, 0.0), arrived: float | None = None,
             is_receiver: bool = False) -> None:
        """
        Check a pose and keep it, unless a newer one has just come.

        :param frame_id: the frame that it has or is transformed to.
        :param origin: offset that is added to its position, (x, y, z) in m.
        :param arrived: time of arrival in s, for a pose without a stamp; by default now.
        :param is_receiver: whether the covariances of an odometry count.
        :raises PoseError: if the pose cannot be used; the last valid pose is then kept.
        """
        header = message.header
        if header.frame_id != frame_id:
            try:
                message = self._transform(message, frame_id)
            except WrongFrameError:
                self._foreign_frames[topic] = quote(header.frame_id)
                raise
        pose = message.pose if isinstance(message, PoseStamped) else message.pose.pose
        _check_range(pose.position, 'position', RANGES['coordinate'][1], 'm')
        for axis in 'xyzw':
            value = getattr(pose.orientation, axis)
            if not math.isfinite(value):
                raise PoseError(f'orientation.{axis} is {quote(value)}; it must be finite')
        covariance = velocity = velocity_covariance = None
        if isinstance(message, PoseWithCovarianceStamped):
            covariance = _horizontal_covariance(message.pose.covariance)
        elif isinstance(message, Odometry):
            velocity = _velocity(message)
            if is_receiver:
                covariance = _horizontal_covariance(message.pose.covariance)
                velocity_covariance = _velocity_covariance(message)
                if math.hypot(*velocity) > MAX_SPEED:
                    raise PoseError(f'twist.linear is {math.hypot(*velocity):g} m/s; it must be '
                                    f'at most {MAX_SPEED:g} m/s')
        # Without rclpy's Time, which raises an error for times before 1970.
        stamp = header.stamp.sec + header.stamp.nanosec * 1e-9 or (
            now if arrived is None else arrived)
        x, y, height = (getattr(pose.position, axis) + shift
                        for axis, shift in zip('xyz', origin, strict=True))
        new = KnownPose(frame_id, (x, y), height, covariance, stamp, now, velocity,
                        velocity_covariance)
        self._foreign_frames.pop(topic, None)
        last = self._poses.get(topic)
        if last is not None and last.frame_id != frame_id:
            self._recent.pop(topic, None)  # Places in another frame.
        elif last is not None and new.is_overtaken_by(last):
            return
        if isinstance(message, PoseStamped):
            new = replace(new, velocity=self._estimate_velocity(topic, stamp, new.position))
        self._poses[topic] = new

    def _estimate_velocity(self, topic: str, stamp: float, place: Point) -> Point | None:
        """Note a position; return the mean velocity of the last second in m/s, or None."""
        recent = [(time, before) for time, before in self._recent.get(topic, ())
                  if 0 < stamp - time <= _LONGEST_BASE]
        if not recent or stamp - recent[-1][0] >= _LEAST_SPACING:
            self._recent[topic] = [*recent, (stamp, place)]
        if not recent or (base := stamp - recent[0][0]) < _SHORTEST_BASE:
            return None
        before = recent[0][1]
        return ((place[0] - before[0]) / base, (place[1] - before[1]) / base)

    def get(self, topic: str) -> KnownPose | None:
        """Return the last valid pose of the topic, or None."""
        return self._poses.get(topic)

    def usable_pose(self, name: str, settings: Mapping[str, Any], now: float,
                    is_receiver: bool = False) -> KnownPose | None:
        """Return the last usable odometry of a member, or else its last usable pose, or None."""
        for topic in member_topics(name):
            pose = self.get(topic)
            if pose is not None and self.problem(topic, settings, now, is_receiver) is None:
                return pose
        return None

    def check(self, settings: Mapping[str, Any], now: float, with_uavs: bool = True) -> None:
        """Raise an error of the class of the first problem, with the text of all, if any."""
        problems = self.problems(settings, now, with_uavs)
        if problems:
            raise type(problems[0])('; '.join(map(str, problems)))

    def problems(self, settings: Mapping[str, Any], now: float, with_uavs: bool = True
                 ) -> list[PoseError]:
        """Return an error for each topic whose pose cannot be used for planning."""
        problems = []
        for name in ('ground_node', *settings['eavesdroppers']):
            if self.usable_pose(name, settings, now, True) is None:
                odometry, pose = member_topics(name)
                is_heard = odometry in self._poses or odometry in self._foreign_frames
                problems.append(self.problem(odometry if is_heard else pose, settings, now, True))
        for name in settings['uavs'] if with_uavs else ():
            if settings[f'{name}.use_pose'] and self.usable_pose(name, settings, now) is None:
                refusals = [self.problem(topic, settings, now, False)
                            for topic in member_topics(name)]
                problems += [type(problem)(
                    f'{problem}; send a new one, or set {name}.use_pose to false to plan from '
                    f'{name}.start') for problem in refusals if problem is not None][:1]
        return [problem for problem in problems if problem is not None]

    def problem(self, topic: str, settings: Mapping[str, Any], now: float, is_receiver: bool
                ) -> PoseError | None:
        """
        Return the reason why the pose of a topic cannot be used for planning, or None.

        :param is_receiver: a receiver needs a pose, on the ground; a UAV does not.
        """
        frame_id, timeout = settings['frame_id'], settings['pose_timeout']
        pose, foreign = self._poses.get(topic), self._foreign_frames.get(topic)
        if pose is not None and pose.frame_id != frame_id:
            pose, foreign = None, quote(pose.frame_id)
        if pose is None and foreign is not None:
            return WrongFrameError(
                f'{topic} is in frame {foreign} and the parameter frame_id is {quote(frame_id)}')
        if pose is None:
            return PoseMissingError(f'no pose has come on {topic}') if is_receiver else None
        if timeout and pose.age(now) > timeout:
            return PoseStaleError(f'the pose on {topic} is {pose.age(now):.1f} s old and '
                                  f'pose_timeout is {timeout:g} s')
        if is_receiver and abs(pose.height) > settings['height_tolerance']:
            return PoseError(
                f'the pose on {topic} has z = {pose.height:g} m and height_tolerance is '
                f'{settings["height_tolerance"]:g} m; the ground node and the eavesdroppers must '
                'be at z = 0 of the frame, above which altitudes count')
        return None


class Frames:
    """
    Transforms poses with the tf2 of a node.

    It subscribes to /tf at the first pose of another frame, which saves the time otherwise.
    """

    def __init__(self, node: Node) -> None:
        self._node = node
        self._tf2: Any = None
        self._buffer: Any = None
        self._listener: Any = None

    def transform(self, message: Message, frame_id: str) -> Message:
        """
        Return a pose in another frame, with its covariance and velocity.

        :raises WrongFrameError: where tf2_ros is missing, cannot listen, or knows no transform.
        :raises PoseError: if the transform cannot be used.
        """
        reason = _frame_refusal(message, frame_id)
        try:
            self._listen()
        except ImportError:
            raise WrongFrameError(
                f'{reason}, or tf2_ros must be installed to transform it') from None
        except Exception as error:  # Such as one of an enclave that does not allow it.
            raise WrongFrameError(f'{reason}, or tf2 must listen to transforms, which it cannot: '
                                  f'{describe_error(error)}') from None
        try:
            transform = self._lookup(message, frame_id)
        except (self._tf2.TransformException, ValueError) as error:
            raise WrongFrameError(f'{reason}, or tf2 must know how to transform it: '
                                  f'{brief(error, 200)}') from None
        return transform_message(message, transform, frame_id)

    def _listen(self) -> None:
        if self._listener is not None:
            return
        self._tf2 = import_module('tf2_ros')
        if self._buffer is None:  # Or an earlier listener failed after it was made.
            # With the clock of the node, which may jump back.
            self._buffer = self._tf2.Buffer(node=self._node)
        self._listener = self._tf2.TransformListener(self._buffer, self._node)

    def _lookup(self, message: Message, frame_id: str) -> Transform:
        header, latest = message.header, Time()
        try:
            return self._buffer.lookup_transform(
                frame_id, header.frame_id, Time.from_msg(header.stamp)).transform
        except (self._tf2.ExtrapolationException, ValueError):
            # Poses come as soon as they are measured and transforms a little later; ValueErrors
            # are about stamps before 1970.
            transform = self._buffer.lookup_transform(frame_id, header.frame_id, latest)
            lag = nanoseconds(header.stamp) - nanoseconds(transform.header.stamp)
            if abs(lag) > _LONGEST_LAG * 1e9:
                raise
            return transform.transform


def transform_message(message: Message, transform: Transform, frame_id: str) -> Message:
    """Return a pose after a transform: R p + t, with the covariance R C R^T of both its parts."""
    turn = rotation(_vector(transform.rotation, 'xyzw'), 'the rotation of the transform')
    new = deepcopy(message)
    new.header.frame_id = frame_id
    pose = new.pose if isinstance(new, PoseStamped) else new.pose.pose
    # PoseBook refuses numbers that overflow or are not finite.
    with np.errstate(all='ignore'):
        _set(pose.position, turn.apply(_vector(pose.position)) + _vector(transform.translation))
        if not isinstance(new, PoseStamped):
            new.pose.covariance = _turn_covariance(new.pose.covariance, turn).ravel()
        # A velocity is in the frame of the child, which is transformed if it is the pose's own.
        if isinstance(new, Odometry) and message.child_frame_id == message.header.frame_id:
            new.child_frame_id = frame_id
            for vector in (new.twist.twist.linear, new.twist.twist.angular):
                _set(vector, turn.apply(_vector(vector)))
            new.twist.covariance = _turn_covariance(new.twist.covariance, turn).ravel()
    with suppress(PoseError):  # An invalid orientation is refused where it is used.
        facing = turn * rotation(_vector(pose.orientation, 'xyzw'))
        _set(pose.orientation, facing.as_quat(), 'xyzw')
    return new


def _turn_covariance(values: Any, turn: Any) -> Array:
    """Return a covariance of two vectors in the axes after a rotation, (6, 6)."""
    both = np.kron(np.eye(2), turn.as_matrix())
    return np.asarray(both @ np.reshape(values, (6, 6)) @ both.T)


def _vector(source: Any, axes: str = 'xyz') -> Array:
    return np.array([getattr(source, axis) for axis in axes])


def _set(target: Any, values: Array, axes: str = 'xyz') -> None:
    for axis, value in zip(axes, values.tolist(), strict=True):
        setattr(target, axis, value)


def error_radius(covariance: Array, confidence: float) -> float:
    """
    Return the radius in m that contains a normally distributed error with a given probability.

    It is that of the largest axis of the covariance, (2, 2) in m^2: exact if the error is the
    same in all directions, and too large otherwise.
    """
    scale = float(np.abs(covariance).max())
    if scale == 0.0:
        return 0.0
    # Scaled by the largest element, so that no square overflows.
    largest = max(0.0, float(np.linalg.eigvalsh(covariance / scale)[-1]))
    # The squared distance, divided by the variance, has a chi-squared distribution with two
    # degrees of freedom.
    return math.sqrt(-2.0 * math.log1p(-confidence) * largest) * math.sqrt(scale)


def _check_range(vector: Any, name: str, most: float, unit: str) -> None:
    for axis in 'xyz':
        value = getattr(vector, axis)
        if not abs(value) <= most:
            raise PoseError(f'{name}.{axis} is {quote(value)}; it must be from {-most:g} to '
                            f'{most:g} {unit}')


def _velocity(message: Odometry) -> Point:
    """Return the horizontal velocity of an Odometry in the frame of its header, in m/s."""
    speed = message.twist.twist.linear
    _check_range(speed, 'twist.linear', RANGES['max_speed'][1], 'm/s')
    # REP-105 and nav_msgs: a twist is in the child frame, whatever that is.
    if message.child_frame_id == message.header.frame_id:
        return (speed.x, speed.y)
    turn = message.pose.pose.orientation
    x, y, _ = rotation((turn.x, turn.y, turn.z, turn.w)).apply((speed.x, speed.y, speed.z))
    return (float(x), float(y))


def _velocity_covariance(message: Odometry) -> Array:
    """Return the covariance of the horizontal velocity in the frame of the header, (2, 2)."""
    covariance = message.twist.covariance
    if message.child_frame_id == message.header.frame_id:
        return _horizontal_covariance(covariance)
    turn = message.pose.pose.orientation
    return _horizontal_covariance(
        _turn_covariance(covariance, rotation((turn.x, turn.y, turn.z, turn.w))))


def _horizontal_covariance(values: Any) -> Array:
    """Return the covariance of x and y, (2, 2) in m^2, from the 36 values of a message."""
    matrix = np.array(values, dtype=float).reshape(6, 6)
    if not np.isfinite(matrix).all():
        raise PoseError('the covariance has values that are not finite')
    scale = np.abs(matrix).max()
    if scale > 0:
        unit = matrix / scale
        if (np.abs(unit - unit.T).max() > 1e-6
                or np.linalg.eigvalsh((unit + unit.T) / 2)[0] < -1e-6):
            raise PoseError('the covariance must be symmetric and positive semidefinite')
    return matrix[:2, :2]
