"""Poses of other frames, moved into the planner's own frame by tf2 where that is installed."""

from contextlib import suppress
from copy import deepcopy
from importlib import import_module
from typing import Any

from geometry_msgs.msg import PoseStamped, Transform
from nav_msgs.msg import Odometry
import numpy as np
from rclpy.node import Node
from rclpy.time import Time

from .messages import nanoseconds
from .poses import frame_refusal, Message
from ..errors import brief, describe_error, PoseError, WrongFrameError
from ..mission.scenario import Array
from ..output.autopilots import rotation

_LONGEST_LAG = 1.0  # s, by which the last transform may be older than a pose.


class Frames:
    """
    Moves poses from frame to frame with the transforms that a node hears.

    It listens from the first pose of another frame on, so a planner whose poses are all in its own
    frame does not spend time on /tf.
    """

    def __init__(self, node: Node) -> None:
        self._node = node
        self._tf2: Any = None
        self._buffer: Any = None
        self._listener: Any = None

    def moved(self, message: Message, frame_id: str) -> Message:
        """
        Return a pose in another frame, with its covariance and velocity.

        :raises WrongFrameError: where tf2_ros is missing, cannot listen, or knows no transform.
        :raises PoseError: if the transform cannot be used.
        """
        reason = frame_refusal(message, frame_id)
        try:
            self._listen()
        except ImportError:
            raise WrongFrameError(
                f'{reason}, or tf2_ros must be installed to transform it') from None
        except Exception as error:  # Such as one of an enclave that does not allow it.
            raise WrongFrameError(f'{reason}, or tf2 must listen to transforms, which it cannot: '
                                  f'{describe_error(error)}') from None
        try:
            transform = self._transform(message, frame_id)
        except (self._tf2.TransformException, ValueError) as error:
            raise WrongFrameError(f'{reason}, or tf2 must know how to transform it: '
                                  f'{brief(error, 200)}') from None
        return moved(message, transform, frame_id)

    def _listen(self) -> None:
        """Begin to listen, unless that has been done."""
        if self._listener is not None:
            return
        self._tf2 = import_module('tf2_ros')
        if self._buffer is None:  # One that was made before it failed to listen is kept.
            # With the clock of the node, which may jump back.
            self._buffer = self._tf2.Buffer(node=self._node)
        self._listener = self._tf2.TransformListener(self._buffer, self._node)

    def _transform(self, message: Message, frame_id: str) -> Transform:
        header, latest = message.header, Time()
        try:
            return self._buffer.lookup_transform(
                frame_id, header.frame_id, Time.from_msg(header.stamp)).transform
        except (self._tf2.ExtrapolationException, ValueError):
            # Poses come as soon as they are measured and transforms a little later; ValueErrors
            # are about stamps before 1970.
            found = self._buffer.lookup_transform(frame_id, header.frame_id, latest)
            lag = nanoseconds(header.stamp) - nanoseconds(found.header.stamp)
            if abs(lag) > _LONGEST_LAG * 1e9:
                raise
            return found.transform


def moved(message: Message, transform: Transform, frame_id: str) -> Message:
    """Return a pose after a transform: R p + t, with the covariance R C R^T of both its parts."""
    turn = rotation(_vector(transform.rotation, 'xyzw'), 'the rotation of the transform')
    new = deepcopy(message)
    new.header.frame_id = frame_id
    pose = new.pose if isinstance(new, PoseStamped) else new.pose.pose
    # What overflows or is not a number is refused by those who check poses.
    with np.errstate(all='ignore'):
        _set(pose.position, turn.apply(_vector(pose.position)) + _vector(transform.translation))
        if not isinstance(new, PoseStamped):
            both = np.kron(np.eye(2), turn.as_matrix())
            new.pose.covariance = (
                both @ np.reshape(new.pose.covariance, (6, 6)) @ both.T).ravel()
        # A velocity is in the frame of the child, which moves along with the pose, but for this.
        if isinstance(new, Odometry) and message.child_frame_id == message.header.frame_id:
            new.child_frame_id = frame_id
            for vector in (new.twist.twist.linear, new.twist.twist.angular):
                _set(vector, turn.apply(_vector(vector)))
    with suppress(PoseError):  # An orientation that is none is refused by those who need it.
        facing = turn * rotation(_vector(pose.orientation, 'xyzw'))
        _set(pose.orientation, facing.as_quat(), 'xyzw')
    return new


def _vector(of: Any, axes: str = 'xyz') -> Array:
    return np.array([getattr(of, axis) for axis in axes])


def _set(target: Any, values: Array, axes: str = 'xyz') -> None:
    for axis, value in zip(axes, values.tolist(), strict=True):
        setattr(target, axis, value)
