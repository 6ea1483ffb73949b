"""The last valid pose of every topic, on which the planner bases its scenarios."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
import math
from typing import Any, TypeAlias

from geometry_msgs.msg import PoseStamped, PoseWithCovarianceStamped
from nav_msgs.msg import Odometry
import numpy as np

from .topics import GROUND_NODE_TOPIC, uav_topics
from ..errors import PoseError, PoseMissingError, PoseStaleError, quote, WrongFrameError
from ..mission.scenario import Array, Point, RANGES
from ..output.autopilots import rotation

# Positions over so many seconds give the velocity of a UAV that sends no odometry.
_SHORTEST_BASE, _LONGEST_BASE = 0.2, 1.0
_LEAST_SPACING = 0.02  # Of those that are kept, in s, so that they are few at any rate.

# For so long in s after a pose has come, an older one does not replace it. One that comes later
# may be of a publisher whose clock has been set back.
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

    @property
    def time(self) -> float:
        """Return when it was measured in s; a stamp of the future counts as that of reception."""
        return min(self.stamp, self.received)

    def age(self, now: float) -> float:
        """Return the age in s at a time in s, or 0 if the clock has jumped back."""
        return max(0.0, now - self.time)

    def is_late_after(self, other: 'KnownPose') -> bool:
        """Return whether a pose that came before is newer, and both are of the same clock."""
        return self.time < other.time and (
            0.0 <= self.received - other.received < _KEPT_BEFORE_OLDER)


def frame_refusal(message: Message, frame_id: str) -> str:
    """Return why a pose of another frame is refused."""
    return (f'the pose is in frame {quote(message.header.frame_id)}; it must be in frame '
            f'{quote(frame_id)}, as the parameter frame_id says')


def _refuse(message: Message, frame_id: str) -> Message:
    raise WrongFrameError(frame_refusal(message, frame_id))


class PoseBook:
    """The last valid pose of every topic, after it was moved into the frame of the planner."""

    def __init__(self, moved: Callable[[Message, str], Message] = _refuse) -> None:
        self._moved = moved
        self._poses: dict[str, KnownPose] = {}
        self._foreign: dict[str, str] = {}
        self._recent: dict[str, list[tuple[float, Point]]] = {}

    def take(self, topic: str, message: Message, frame_id: str, now: float,
             origin: Sequence[float] = (0.0, 0.0, 0.0), arrived: float | None = None) -> None:
        """
        Check a pose and keep it, unless a newer one has just come.

        :param frame_id: the frame in which it must be, or into which it can be moved.
        :param origin: what is added to its position, (x, y, z) in m.
        :param arrived: when it came in s, the time of a pose that has no stamp; by default now.
        :raises PoseError: if the pose cannot be used; the last valid pose is then kept.
        """
        header = message.header
        if header.frame_id != frame_id:
            try:
                message = self._moved(message, frame_id)
            except WrongFrameError:
                self._foreign[topic] = quote(header.frame_id)
                raise
        pose = message.pose if isinstance(message, PoseStamped) else message.pose.pose
        _check_range(pose.position, 'position', RANGES['coordinate'][1], 'm')
        for axis in 'xyzw':
            value = getattr(pose.orientation, axis)
            if not math.isfinite(value):
                raise PoseError(f'orientation.{axis} is {quote(value)}; it must be finite')
        covariance = velocity = None
        if isinstance(message, PoseWithCovarianceStamped):
            covariance = _horizontal_covariance(message.pose.covariance)
        elif isinstance(message, Odometry):
            velocity = _velocity(message)
        # Without rclpy's Time, which raises an error for times before 1970.
        stamp = header.stamp.sec + header.stamp.nanosec * 1e-9 or (
            now if arrived is None else arrived)
        x, y, height = (getattr(pose.position, axis) + shift
                        for axis, shift in zip('xyz', origin, strict=True))
        new = KnownPose(frame_id, (x, y), height, covariance, stamp, now, velocity)
        self._foreign.pop(topic, None)
        last = self._poses.get(topic)
        if last is not None and last.frame_id != frame_id:
            self._recent.pop(topic, None)  # Places in another frame.
        elif last is not None and new.is_late_after(last):
            return
        if isinstance(message, PoseStamped):
            new = replace(new, velocity=self._difference(topic, stamp, new.position))
        self._poses[topic] = new

    def _difference(self, topic: str, stamp: float, place: Point) -> Point | None:
        """Note a position; return the mean velocity of the last second in m/s, if it is known."""
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

    def of_uav(self, name: str, settings: Mapping[str, Any], now: float) -> KnownPose | None:
        """Return the last usable odometry of a UAV, or else its last usable pose, or None."""
        for topic in uav_topics(name):
            known = self.get(topic)
            if known is not None and self.problem(topic, settings, now, False) is None:
                return known
        return None

    def check(self, settings: Mapping[str, Any], now: float, of_uavs: bool = True) -> None:
        """Raise an error of the class of the first problem, with the text of all, if any."""
        problems = self.problems(settings, now, of_uavs)
        if problems:
            raise type(problems[0])('; '.join(map(str, problems)))

    def problems(self, settings: Mapping[str, Any], now: float, of_uavs: bool = True
                 ) -> list[PoseError]:
        """Return an error for every topic whose pose cannot be used for planning."""
        found = [self.problem(topic, settings, now, True) for topic in (
            GROUND_NODE_TOPIC, *(f'{name}/pose' for name in settings['eavesdroppers']))]
        for name in settings['uavs'] if of_uavs else ():
            if settings[f'{name}.use_pose'] and self.of_uav(name, settings, now) is None:
                of_uav = [self.problem(topic, settings, now, False) for topic in uav_topics(name)]
                found += [type(problem)(
                    f'{problem}; send a new one, or set {name}.use_pose to false to plan from '
                    f'{name}.start') for problem in of_uav if problem is not None][:1]
        return [problem for problem in found if problem is not None]

    def problem(self, topic: str, settings: Mapping[str, Any], now: float, of_ground: bool
                ) -> PoseError | None:
        """Return why the pose of a topic cannot be used for planning, or None if it can."""
        # Poses of UAVs may be missing, and at any height.
        frame_id, timeout = settings['frame_id'], settings['pose_timeout']
        known, foreign = self._poses.get(topic), self._foreign.get(topic)
        if known is not None and known.frame_id != frame_id:
            known, foreign = None, quote(known.frame_id)
        if known is None and foreign is not None:
            return WrongFrameError(
                f'{topic} is in frame {foreign} and the parameter frame_id is {quote(frame_id)}')
        if known is None:
            return PoseMissingError(f'no pose has come on {topic}') if of_ground else None
        if timeout and known.age(now) > timeout:
            return PoseStaleError(f'the pose on {topic} is {known.age(now):.1f} s old and '
                                  f'pose_timeout is {timeout:g} s')
        if of_ground and abs(known.height) > settings['height_tolerance']:
            return PoseError(
                f'the pose on {topic} has z = {known.height:g} m and height_tolerance is '
                f'{settings["height_tolerance"]:g} m; the ground node and the eavesdroppers must '
                'be at z = 0 of the frame, above which altitudes count')
        return None


def error_radius(covariance: Array, confidence: float) -> float:
    """
    Return the radius in m that contains a normally distributed error with a given probability.

    The largest axis of the covariance, (2, 2) in m^2, is used: the radius is exact if that is the
    same in all directions, and on the safe side otherwise.
    """
    scale = float(np.abs(covariance).max())
    if scale == 0.0:
        return 0.0
    # Scaled by the largest element, so that no square overflows.
    largest = max(0.0, float(np.linalg.eigvalsh(covariance / scale)[-1]))
    # The squared distance, divided by the variance, has a chi-squared distribution with two
    # degrees of freedom.
    return math.sqrt(-2.0 * math.log1p(-confidence) * largest) * math.sqrt(scale)


def _check_range(of: Any, name: str, most: float, unit: str) -> None:
    """Check that the x, y and z of something are at most as large."""
    for axis in 'xyz':
        value = getattr(of, axis)
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
