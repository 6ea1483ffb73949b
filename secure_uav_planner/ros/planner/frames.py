"""Poses in other frames, which tf2 transforms to the planner's frame."""

from contextlib import suppress
from copy import deepcopy
from importlib import import_module
from typing import Any, TypeAlias

from geometry_msgs.msg import PoseStamped, PoseWithCovarianceStamped, Transform
from nav_msgs.msg import Odometry
import numpy as np
from rclpy.node import Node
from rclpy.time import Time

from ..messages import nanoseconds
from ...errors import brief, describe_error, PoseError, quote, WrongFrameError
from ...mission.scenario import Array
from ...output.autopilots import rotation

_LONGEST_LAG = 1.0  # Largest time [s] between a pose and the last transform, which is then used.

Message: TypeAlias = PoseStamped | PoseWithCovarianceStamped | Odometry


def refuse_frame(message: Message, frame_id: str) -> Message:
    """Raise a WrongFrameError; it replaces Frames.transform where poses are not transformed."""
    raise WrongFrameError(_frame_refusal(message, frame_id))


def _frame_refusal(message: Message, frame_id: str) -> str:
    return (f'the pose is in frame {quote(message.header.frame_id)}; it must be in frame '
            f'{quote(frame_id)}, as the parameter frame_id says')


class Frames:
    """
    Transforms poses with the tf2 of a node.

    It subscribes to /tf at the first pose in another frame, so that others pay nothing for it.
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
        except Exception as error:  # For example, an SROS2 enclave may not allow the subscription.
            raise WrongFrameError(f'{reason}, or tf2 must listen to transforms, which it cannot: '
                                  f'{describe_error(error)}') from None
        try:
            transform = self._lookup(message, frame_id)
        except (self._tf2.TransformException, ValueError) as error:
            raise WrongFrameError(f'{reason}, or tf2 must know how to transform it: '
                                  f'{brief(error, 200)}') from None
        return transform_message(message, transform, frame_id)

    def _listen(self) -> None:
        """Import tf2_ros, and make its buffer and its listener, unless there is a listener."""
        if self._listener is not None:
            return
        self._tf2 = import_module('tf2_ros')
        if self._buffer is None:  # It is there if only the listener failed at an earlier pose.
            # A buffer with the node is cleared when the node's clock jumps back.
            self._buffer = self._tf2.Buffer(node=self._node)
        self._listener = self._tf2.TransformListener(self._buffer, self._node)

    def _lookup(self, message: Message, frame_id: str) -> Transform:
        """Return the transform at a message's stamp, or the last one if _LONGEST_LAG allows."""
        header, latest = message.header, Time()  # Time 0 asks tf2 for the last one.
        try:
            return self._buffer.lookup_transform(
                frame_id, header.frame_id, Time.from_msg(header.stamp)).transform
        except (self._tf2.ExtrapolationException, ValueError):
            # A transform may arrive a little later than a pose of the same time. Stamps before
            # 1970 raise a ValueError.
            transform = self._buffer.lookup_transform(frame_id, header.frame_id, latest)
            lag = nanoseconds(header.stamp) - nanoseconds(transform.header.stamp)
            if abs(lag) > _LONGEST_LAG * 1e9:
                raise
            return transform.transform


def transform_message(message: Message, transform: Transform, frame_id: str) -> Message:
    """Return a pose after a transform: R p + t, with covariances R C R^T."""
    turn = rotation(_vector(transform.rotation, 'xyzw').tolist(), 'the rotation of the transform')
    new = deepcopy(message)
    new.header.frame_id = frame_id
    pose = new.pose if isinstance(new, PoseStamped) else new.pose.pose
    # PoseBook refuses numbers that overflow or are not finite.
    with np.errstate(all='ignore'):
        _set(pose.position, turn.apply(_vector(pose.position)) + _vector(transform.translation))
        if not isinstance(new, PoseStamped):
            new.pose.covariance = turn_covariance(new.pose.covariance, turn).ravel()
        # A velocity is in the child frame, and is transformed if that is the frame of the pose.
        if isinstance(new, Odometry) and message.child_frame_id == message.header.frame_id:
            new.child_frame_id = frame_id
            for vector in (new.twist.twist.linear, new.twist.twist.angular):
                _set(vector, turn.apply(_vector(vector)))
            new.twist.covariance = turn_covariance(new.twist.covariance, turn).ravel()
    with suppress(PoseError):  # An invalid orientation is refused where it is used.
        facing = turn * rotation(_vector(pose.orientation, 'xyzw').tolist())
        _set(pose.orientation, facing.as_quat(), 'xyzw')
    return new


def turn_covariance(values: Any, turn: Any) -> Array:
    """Return a covariance (6, 6) of two vectors turned by R: R C R^T for each block C (3, 3)."""
    # Block by block, so that an unused block that is not finite does not spoil used ones.
    blocks = np.reshape(values, (2, 3, 2, 3)).transpose(0, 2, 1, 3)
    turned = turn.as_matrix() @ blocks @ turn.as_matrix().T
    return np.asarray(turned.transpose(0, 2, 1, 3).reshape(6, 6))


def _vector(source: Any, axes: str = 'xyz') -> Array:
    return np.array([getattr(source, axis) for axis in axes])


def _set(target: Any, values: Array, axes: str = 'xyz') -> None:
    for axis, value in zip(axes, values.tolist(), strict=True):
        setattr(target, axis, value)
