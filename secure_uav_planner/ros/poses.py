"""What the planner knows of the world: the last good pose of every topic."""

from dataclasses import dataclass
import math
import threading
from typing import Any

from geometry_msgs.msg import Pose, PoseStamped, PoseWithCovarianceStamped
import numpy as np

from ..errors import PoseError, PoseMissingError, PoseStaleError, shown, WrongFrameError
from ..scenario import Array, LIMITS, Point


@dataclass(frozen=True)
class KnownPose:
    """
    The last good pose of a topic.

    :param frame_id: the frame of the position.
    :param position: (x, y) in m.
    :param height: z in m.
    :param covariance: of x and y, (2, 2) in m^2, or None.
    :param stamp: when it was measured, or when it came if it was not stamped, in s.
    :param received: when it came, in s.
    """

    frame_id: str
    position: Point
    height: float
    covariance: Array | None
    stamp: float
    received: float

    def age(self, now: float) -> float:
        """Return the age in s at a time in s; a clock that jumped back makes it 0."""
        return max(0.0, now - min(self.stamp, self.received))


class PoseBook:
    """The last good pose of every topic, and the wrong frames in which others came."""

    def __init__(self) -> None:
        self._poses: dict[str, KnownPose] = {}
        self._foreign: dict[str, str] = {}
        self._lock = threading.Lock()

    def take(self, topic: str, message: PoseStamped | PoseWithCovarianceStamped, frame_id: str,
             now: float) -> None:
        """
        Keep a pose.

        :param message: a PoseStamped or PoseWithCovarianceStamped.
        :param frame_id: the frame it must be in.
        :param now: the node's time in s.
        :raises PoseError: when it is not used; the last good pose stands.
        """
        header = message.header
        if header.frame_id != frame_id:
            foreign = shown(header.frame_id)
            with self._lock:
                self._foreign[topic] = foreign
            raise WrongFrameError(
                f'the pose is in frame {foreign}; it must be in frame {shown(frame_id)}, '
                f'as the parameter frame_id says')
        covariance = getattr(message.pose, 'covariance', None)
        pose = message.pose if covariance is None else message.pose.pose
        _check_values(pose)
        if covariance is not None:
            covariance = _horizontal_covariance(covariance)
        # Not by rclpy's Time, which raises for what was before 1970.
        stamp = header.stamp.sec + header.stamp.nanosec * 1e-9 or now
        known = KnownPose(
            frame_id, (pose.position.x, pose.position.y), pose.position.z, covariance, stamp,
            now)
        with self._lock:
            self._poses[topic] = known
            self._foreign.pop(topic, None)

    def get(self, topic: str) -> KnownPose | None:
        """Return the last good pose of the topic, or None."""
        with self._lock:
            return self._poses.get(topic)

    def problem(self, topic: str, frame_id: str, now: float, timeout: float,
                height_tolerance: float | None = None, optional: bool = False
                ) -> PoseError | None:
        """
        Return why the pose of a topic cannot be planned with, or None when it can.

        :param frame_id: the frame it must be in.
        :param now: the node's time in s.
        :param timeout: age in s beyond which it cannot be planned with, 0 for none.
        :param height_tolerance: how far from z = 0 it may be, in m, or None for anywhere.
        :param optional: whether it may be missing.
        """
        with self._lock:
            known, foreign = self._poses.get(topic), self._foreign.get(topic)
        if known is not None and known.frame_id != frame_id:
            known, foreign = None, shown(known.frame_id)
        if known is None and foreign is not None:
            return WrongFrameError(
                f'{topic} is in frame {foreign} and the parameter frame_id is {shown(frame_id)}')
        if known is None:
            return None if optional else PoseMissingError(f'no pose has come on {topic}')
        if timeout and known.age(now) > timeout:
            return PoseStaleError(f'the pose on {topic} is {known.age(now):.1f} s old and '
                                  f'pose_timeout is {timeout:g} s')
        if height_tolerance is not None and abs(known.height) > height_tolerance:
            return PoseError(
                f'the pose on {topic} has z = {known.height:g} m and height_tolerance is '
                f'{height_tolerance:g} m; the ground node and the eavesdroppers must be at '
                f'z = 0 of the frame, above which altitudes count')
        return None


def error_radius(covariance: Array, confidence: float) -> float:
    """
    Return the radius in m around the mean that holds a normal error with a probability.

    Exact for a round covariance, on the safe side for any other: its largest axis counts.

    :param covariance: of x and y, (2, 2) in m^2.
    :param confidence: the probability, above 0 and below 1.
    """
    scale = float(np.abs(covariance).max())
    if scale == 0.0:
        return 0.0
    # In units of its largest element, so that no square overflows.
    largest = max(0.0, float(np.linalg.eigvalsh(covariance / scale)[-1]))
    # The squared distance over the variance has the chi-squared law of two degrees of freedom.
    return math.sqrt(-2.0 * math.log1p(-confidence) * largest) * math.sqrt(scale)


def _check_values(pose: Pose) -> None:
    low, high = LIMITS['coordinate']
    for field in 'xyz':
        value = getattr(pose.position, field)
        if not low <= value <= high:
            raise PoseError(
                f'position.{field} is {shown(value)}; it must be from {low:g} to {high:g} m')
    for field in 'xyzw':
        value = getattr(pose.orientation, field)
        if not math.isfinite(value):
            raise PoseError(f'orientation.{field} is {shown(value)}; it must be finite')


def _horizontal_covariance(values: Any) -> Array:
    """Return the covariance of x and y, (2, 2) in m^2, of the 36 values of a message."""
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
