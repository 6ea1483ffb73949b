"""What the planner knows of the world: the last good pose of every topic."""

from dataclasses import dataclass
import math
import threading
from typing import NamedTuple

import numpy as np

from ..scenario import LIMITS

_SHOWN = 60  # Characters of a frame's name.


class PoseError(ValueError):
    """A pose that cannot be used; the text names the field, its value and what is allowed."""


@dataclass(frozen=True)
class KnownPose:
    """
    The last good pose of a topic.

    :param frame_id: what the position is in.
    :param position: (x, y) in m.
    :param covariance: of x and y, (2, 2) in m^2, or None.
    :param stamp: when it was measured, or when it came if it was not stamped, in s.
    :param received: when it came, in s.
    """

    frame_id: str
    position: tuple
    covariance: object
    stamp: float
    received: float

    def age(self, now):
        """Return the age in s at a time in s; a clock that jumped back makes it 0."""
        return max(0.0, now - min(self.stamp, self.received))


class PoseProblem(NamedTuple):
    """Why a topic's pose cannot be planned with."""

    text: str
    stale: bool = False


class PoseBook:
    """The last good pose of every topic, and in which wrong frames others came."""

    def __init__(self):
        self._poses = {}
        self._foreign = {}
        self._lock = threading.Lock()

    def take(self, topic, message, frame_id, now):
        """
        Keep a pose.

        :param message: a PoseStamped or PoseWithCovarianceStamped.
        :param frame_id: the frame it must be in.
        :param now: the node's time in s.
        :raises PoseError: when it is not used; the last good pose stands.
        """
        header = message.header
        if header.frame_id != frame_id:
            foreign = header.frame_id[:_SHOWN]
            with self._lock:
                self._foreign[topic] = foreign
            raise PoseError(f'the pose is in frame {foreign!r}; '
                            f'it must be in frame {frame_id!r}, as the parameter frame_id says')
        covariance = getattr(message.pose, 'covariance', None)
        pose = message.pose if covariance is None else message.pose.pose
        _check_values(pose)
        if covariance is not None:
            covariance = _horizontal_covariance(covariance)
        # Not by rclpy's Time, which raises for what was before 1970.
        stamp = header.stamp.sec + header.stamp.nanosec * 1e-9 or now
        known = KnownPose(
            frame_id, (pose.position.x, pose.position.y), covariance, stamp, now)
        with self._lock:
            self._poses[topic] = known
            self._foreign.pop(topic, None)

    def get(self, topic):
        """Return the last good pose of the topic, or None."""
        with self._lock:
            return self._poses.get(topic)

    def problem(self, topic, frame_id, now, timeout, optional=False):
        """
        Return the PoseProblem of a topic, or None when its pose can be planned with.

        :param timeout: age in s beyond which it cannot, 0 for none.
        :param optional: whether it may be missing.
        """
        with self._lock:
            known, foreign = self._poses.get(topic), self._foreign.get(topic)
        if known is not None and known.frame_id != frame_id:
            known, foreign = None, known.frame_id
        if known is None and foreign is not None:
            return PoseProblem(
                f'{topic} is in frame {foreign!r} and the parameter frame_id is {frame_id!r}')
        if known is None:
            return None if optional else PoseProblem(f'no pose has come on {topic}')
        if timeout and known.age(now) > timeout:
            return PoseProblem(f'the pose on {topic} is {known.age(now):.1f} s old and '
                               f'pose_timeout is {timeout:g} s', stale=True)
        return None


def error_radius(covariance, confidence):
    """
    Return the radius in m around the mean that holds a normal error with a probability.

    Exact for a round covariance, on the safe side for any other: its largest axis counts.

    :param covariance: of x and y, (2, 2) in m^2.
    :param confidence: the probability, above 0 and below 1.
    """
    largest = max(0.0, float(np.linalg.eigvalsh(covariance)[-1]))
    # The squared distance over the variance has the chi-squared law of two degrees of freedom.
    return math.sqrt(-2.0 * math.log1p(-confidence) * largest)


def _check_values(pose):
    low, high = LIMITS['coordinate']
    for field in 'xyz':
        value = getattr(pose.position, field)
        if not low <= value <= high:
            raise PoseError(
                f'position.{field} is {value}; it must be from {low:g} to {high:g} m')
    for field in 'xyzw':
        value = getattr(pose.orientation, field)
        if not math.isfinite(value):
            raise PoseError(f'orientation.{field} is {value}; it must be finite')


def _horizontal_covariance(values):
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
