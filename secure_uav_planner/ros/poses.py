"""The last valid pose of every topic, on which the planner bases its scenarios."""

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
    The last valid pose of a topic.

    :param frame_id: the frame of the position.
    :param position: (x, y) in m.
    :param height: z in m.
    :param covariance: the covariance of x and y, (2, 2) in m^2, or None.
    :param stamp: the time of the measurement in s, or of reception if the pose has no stamp.
    :param received: the time of reception in s.
    """

    frame_id: str
    position: Point
    height: float
    covariance: Array | None
    stamp: float
    received: float

    def age(self, now: float) -> float:
        """Return the age in s at a time in s, or 0 if the clock has jumped back."""
        return max(0.0, now - min(self.stamp, self.received))


class PoseBook:
    """The last valid pose of every topic, and the wrong frame of any later pose."""

    def __init__(self) -> None:
        self._poses: dict[str, KnownPose] = {}
        self._foreign: dict[str, str] = {}
        self._lock = threading.Lock()

    def take(self, topic: str, message: PoseStamped | PoseWithCovarianceStamped, frame_id: str,
             now: float) -> None:
        """
        Check a pose and keep it.

        :param message: a PoseStamped or PoseWithCovarianceStamped.
        :param frame_id: the frame in which it must be.
        :param now: the node's time in s.
        :raises PoseError: if the pose cannot be used; the last valid pose is then kept.
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
        # Without rclpy's Time, which raises an error for times before 1970.
        stamp = header.stamp.sec + header.stamp.nanosec * 1e-9 or now
        known = KnownPose(
            frame_id, (pose.position.x, pose.position.y), pose.position.z, covariance, stamp,
            now)
        with self._lock:
            self._poses[topic] = known
            self._foreign.pop(topic, None)

    def get(self, topic: str) -> KnownPose | None:
        """Return the last valid pose of the topic, or None."""
        with self._lock:
            return self._poses.get(topic)

    def problem(self, topic: str, frame_id: str, now: float, timeout: float,
                height_tolerance: float | None = None, optional: bool = False
                ) -> PoseError | None:
        """
        Return why the pose of a topic cannot be used for planning, or None if it can.

        :param frame_id: the frame in which it must be.
        :param now: the node's time in s.
        :param timeout: the age in s beyond which it is not used, or 0 for no limit.
        :param height_tolerance: its largest distance from z = 0 in m, or None for no limit.
        :param optional: whether the pose may be missing.
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
    Return the radius in m that contains a normally distributed error with a given probability.

    The largest axis of the covariance is used. The radius is exact if the covariance is the same
    in all directions, and on the safe side otherwise.

    :param covariance: the covariance of x and y, (2, 2) in m^2.
    :param confidence: the probability, above 0 and below 1.
    """
    scale = float(np.abs(covariance).max())
    if scale == 0.0:
        return 0.0
    # Scaled by the largest element, so that no square overflows.
    largest = max(0.0, float(np.linalg.eigvalsh(covariance / scale)[-1]))
    # The squared distance, divided by the variance, has a chi-squared distribution with two
    # degrees of freedom.
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
