"""The last valid pose of each topic, in the frame of the planner."""

from collections.abc import Callable
from dataclasses import dataclass, replace
import math
from typing import Any

from geometry_msgs.msg import PoseStamped, PoseWithCovarianceStamped
from nav_msgs.msg import Odometry
import numpy as np

from .frames import Message, refuse_frame, turn_covariance
from .settings import PlannerSettings
from ..topics import member_topics
from ...errors import PoseError, PoseMissingError, PoseStaleError, quote
from ...mission.fields import COORDINATE, find_range, Number, Point, RADIUS
from ...mission.participants import Uav
from ...mission.scenario import Scenario
from ...mission.tracks import MAX_SPEED
from ...mission.validation import Array
from ...output.autopilots import rotation, Vector

_SHORTEST_BASE = 0.2  # Shortest time [s] between two positions that give the velocity of a UAV.
_LONGEST_BASE = 1.0  # Longest time [s] between two positions that give the velocity of a UAV.
_LEAST_SPACING = 0.02  # Least time [s] between kept positions, which limits their number.

# Largest time [s] by which odometry, which has a velocity, may be older than a pose and still be
# preferred. With less, the planner would alternate between the two if both arrive steadily.
_ODOMETRY_LAG = 1.0

# Time [s] after a pose in which an older pose does not replace it. After this time an older stamp
# means that the publisher's clock was set back.
_KEPT_BEFORE_OLDER = 10.0

_LEAST_JUMP = 0.1  # Least time [s] by which a clock goes back when it has been set back.

# Number of successive poses outside its disc after which a stationary eavesdropper has left it. Of
# stationary ones, measured with noise at 5 Hz for 300 s, 41% were outside once and 0.5% three
# times in a row.
_OUTSIDE = 3
_LEAST_COMPARED = 0.1  # Least time [s] between two poses that are compared with a disc.
_STANDS = 1e-6  # Largest change [m] of the disc of an eavesdropper that stands.


@dataclass(frozen=True)
class KnownPose:
    """The last valid pose of a topic."""

    position: Point  # (x, y) in m
    height: float  # z in m
    covariance: Array | None  # Covariance of x and y, (2, 2) in m^2.
    stamp: float  # Time of the measurement [s], or of the reception if the pose has no stamp.
    received: float  # Time of the reception [s]; see PoseBook.take.
    velocity: Point | None = None  # Velocity [m/s] by odometry, or by poses of the last second.
    velocity_covariance: Array | None = None  # By a receiver's odometry, (2, 2) in m^2/s^2.

    @property
    def time(self) -> float:
        """Time of the measurement [s], or of the reception if this is earlier."""
        return min(self.stamp, self.received)

    def age(self, now: float) -> float:
        """Age [s] at a time [s], at least 0."""
        return max(0.0, now - self.time)

    def radius(self, name: str, settings: PlannerSettings) -> float:
        """Error radius [m] of an eavesdropper; without a covariance above 0, the parameter."""
        if self.covariance is None or not self.covariance.any():
            return settings.eavesdroppers[name].error_radius
        return error_radius(self.covariance, settings.confidence)


@dataclass
class _Disc:
    """The disc in which the last plan expects an eavesdropper that stands."""

    position: Point
    radius: float  # m
    outside: int = 0  # Number of successive poses whose discs do not meet this disc.
    compared: float = -math.inf  # Time [s] at which the last pose was compared with this disc.
    warning: str = ''  # That the eavesdropper has left this disc, once it has.


class PoseBook:
    """
    The last valid pose of each topic, and why newer ones were refused.

    It is cleared when the clock jumps back, because no age is known then. When the clock jumps
    ahead, poses that were measured before the jump are not used. `now` is the node's time in s.

    :param transform: returns a message in another frame, or raises a PoseError.
    :param to_mission: converts a position in the local frame of a UAV, given by its name, to the
        mission's frame, or raises a PoseError.
    :ivar on_jump: called when the clock has jumped, with the time before and after it.
    """

    def __init__(self, transform: Callable[[Message, str], Message] = refuse_frame,
                 to_mission: Callable[[str, Vector], Vector] = lambda name, place: place) -> None:
        self._transform, self._to_mission = transform, to_mission
        self.on_jump: Callable[[float, float], None] = lambda before, now: None
        self._poses: dict[str, KnownPose] = {}
        self._refusals: dict[str, PoseError] = {}  # Last refusal of each topic since a valid pose.
        # Times [s] and positions [m] of the last second by topic, which give a velocity.
        self._recent: dict[str, list[tuple[float, Point]]] = {}
        self._discs: dict[str, _Disc] = {}  # Discs by the name of the eavesdropper.
        self._latest = -math.inf  # Latest time of the clock [s].
        self._was_set_back = False  # Whether the clock has ever jumped back.
        self._valid_from = -math.inf  # Poses measured before this time [s] are not used.

    def take(self, topic: str, message: Message, settings: PlannerSettings, now: float,
             most_lag: float = 0.0) -> str:
        """
        Keep the pose in a message, unless a newer pose arrived in the last 10 s.

        It is transformed to settings.frame_id, and a UAV's pose also from the UAV's local frame.

        :param most_lag: largest lag [s] of the node's clock. A stamp that is less than most_lag
            ahead of `now` also becomes the time of the reception.
        :return: a warning, once, that an eavesdropper has left the disc that the last plan expects
            it in; otherwise ''.
        :raises PoseError: if the pose cannot be used. The last valid pose is then kept, and the
            error is noted as the topic's refusal.
        """
        self.follow_clock(now)
        name = topic.partition('/')[0]
        try:
            if message.header.frame_id != settings.frame_id:
                message = self._transform(message, settings.frame_id)
            pose = read_pose(message, settings, now, is_receiver=name not in settings.uavs)
            if now < pose.stamp < now + most_lag:
                pose = replace(pose, received=pose.stamp)
            if name in settings.uavs:
                x, y, height = self._to_mission(name, (*pose.position, pose.height))
                pose = replace(pose, position=(x, y), height=height)
        except PoseError as error:
            self._refusals[topic] = error
            raise
        self._refusals.pop(topic, None)
        self._keep(topic, pose)
        return self._note_motion(topic, name, settings, now)

    def follow_clock(self, now: float, longest: float = math.inf) -> None:
        """
        Note the clock's time [s]; after a jump, put earlier poses out of use and call on_jump.

        A clock more than _LEAST_JUMP behind its latest time was set back: all poses and refusals
        are deleted. A clock more than `longest` ahead of its latest time jumped ahead: poses
        measured before now - longest are kept and not used.

        :param longest: longest step [s] since the last call that is not a jump ahead.
        """
        before, self._latest = self._latest, max(now, self._latest)
        if now < before - _LEAST_JUMP:
            for content in (self._poses, self._refusals, self._recent):
                content.clear()
            self._latest, self._was_set_back, self._valid_from = now, True, -math.inf
        elif before > 0.0 and now > before + longest:  # Simulated time is 0 until it is known.
            self._valid_from = now - longest
            self._recent.clear()  # Positions from before and after give no velocity.
        else:
            return
        self.on_jump(before, now)

    def _keep(self, topic: str, pose: KnownPose) -> None:
        """
        Keep a topic's pose, unless a newer one came less than _KEPT_BEFORE_OLDER [s] before.

        A pose without velocity and covariance gets a velocity by _estimate_velocity.
        """
        last = self._poses.get(topic)
        if last is not None and pose.time < last.time and (
                pose.received - last.received < _KEPT_BEFORE_OLDER):
            return
        if pose.velocity is None and pose.covariance is None:
            pose = replace(
                pose, velocity=self._estimate_velocity(topic, pose.stamp, pose.position))
        self._poses[topic] = pose

    def _estimate_velocity(self, topic: str, stamp: float, place: Point) -> Point | None:
        """
        Return the mean velocity (x, y) [m/s] from the oldest kept position to `place`, or None.

        Positions are kept for _LONGEST_BASE [s], at least _LEAST_SPACING [s] apart, `place` too.
        The velocity is None if no kept position is at least _SHORTEST_BASE [s] older than `stamp`.
        """
        recent = [(time, before) for time, before in self._recent.get(topic, ())
                  if 0 < stamp - time <= _LONGEST_BASE]
        if not recent or stamp - recent[-1][0] >= _LEAST_SPACING:
            self._recent[topic] = [*recent, (stamp, place)]
        if not recent or (base := stamp - recent[0][0]) < _SHORTEST_BASE:
            return None
        before = recent[0][1]
        return ((place[0] - before[0]) / base, (place[1] - before[1]) / base)

    def expect(self, scenario: Scenario, time: float) -> None:
        """
        Compare poses from now on with the discs in which a plan has standing eavesdroppers.

        :param scenario: the scenario of the plan.
        :param time: time of the plan [s]; an eavesdropper stands if its disc stays from then on.
        """
        times = scenario.times
        _, centres, radii = scenario.receivers_at([min(max(time, 0.0), times[-2]), times[-1]])
        self._discs = {
            name: _Disc((float(x), float(y)), float(radius))
            for name, ((x, y), last), (radius, last_radius) in zip(
                scenario.eavesdropper_names, centres, radii, strict=True)
            if math.dist((x, y), last) + abs(radius - last_radius) < _STANDS}

    @property
    def left_discs(self) -> list[str]:
        """Warnings of the eavesdroppers that have left their discs in the last plan."""
        return [disc.warning for disc in self._discs.values() if disc.warning]

    def _note_motion(self, topic: str, name: str, settings: PlannerSettings, now: float) -> str:
        """
        Return a warning, once, that an eavesdropper has left its disc in `_discs`; otherwise ''.

        It has left if the error discs of _OUTSIDE usable poses in a row do not meet its disc. A
        pose that comes less than _LEAST_COMPARED [s] after a compared one is not compared.
        """
        disc, pose = self._discs.get(name), self._poses[topic]
        if disc is None or disc.warning or abs(now - disc.compared) < _LEAST_COMPARED or (
                self.usable_pose(name, settings, now) is not pose):
            return ''
        radius = pose.radius(name, settings)
        distance, disc.compared = math.dist(pose.position, disc.position), now
        disc.outside = disc.outside + 1 if distance > disc.radius + radius else 0
        if disc.outside >= _OUTSIDE:
            disc.warning = (
                f'{name} has left its disc: it is {distance:.0f} m from its place in the plan, in '
                'which it is modelled as stationary, and rates are promised for a receiver that '
                f'stays; plan again, with its odometry on {member_topics(name)[0]} or with '
                f'{name}.max_speed if it moves on')
        return disc.warning

    def get(self, topic: str) -> KnownPose | None:
        """Return the last valid pose of the topic, or None."""
        return self._poses.get(topic)

    def ages(self, settings: PlannerSettings, now: float) -> dict[str, float]:
        """Return the age [s] of the last pose by topic of receivers and UAVs; NaN without one."""
        poses = {topic: self._poses.get(topic) for name in (*settings.receivers, *settings.uavs)
                 for topic in member_topics(name)}
        return {topic: math.nan if pose is None else pose.age(now)
                for topic, pose in poses.items()}

    def usable_pose(self, name: str, settings: PlannerSettings, now: float
                    ) -> KnownPose | None:
        """
        Return the usable pose of a UAV or receiver by its odometry or its pose topic, or None.

        Odometry is preferred unless it is more than _ODOMETRY_LAG [s] older than the other pose.
        """
        self.follow_clock(now)
        odometry, pose = (
            None if self.problem(topic, settings, now) else self._poses.get(topic)
            for topic in member_topics(name))
        if odometry is None or pose is None:
            return odometry or pose
        return odometry if pose.time <= odometry.time + _ODOMETRY_LAG else pose

    def check(self, settings: PlannerSettings, now: float, with_uavs: bool = True) -> None:
        """Raise an error with the texts of all problems and the class of the first, if any."""
        if problems := self.problems(settings, now, with_uavs):
            raise type(problems[0])('; '.join(map(str, problems)))

    def problems(self, settings: PlannerSettings, now: float, with_uavs: bool = True
                 ) -> list[PoseError]:
        """
        Return why receivers, and UAVs if `with_uavs`, have no usable pose: errors of their topics.

        A receiver with a track in the mission file has no error. A UAV has at most one error, and
        none without use_pose or before its first pose has come.
        """
        problems = []
        for name in settings.receivers:
            if name not in settings.tracks and self.usable_pose(name, settings, now) is None:
                problems += self._reasons(name, settings, now)
        for name, uav in settings.uavs.items() if with_uavs else ():
            if uav.use_pose and self.usable_pose(name, settings, now) is None:
                problems += [type(problem)(
                    f'{problem}; send a new one, or set {name}.use_pose to false to plan from '
                    f'{name}.start')
                    for problem in self._reasons(name, settings, now)[:1]]
        return problems

    def _reasons(self, name: str, settings: PlannerSettings, now: float) -> list[PoseError]:
        """Return errors of a receiver's or UAV's topics with messages; if none, of its pose's."""
        topics = member_topics(name)
        heard = [topic for topic in topics if topic in self._poses or topic in self._refusals]
        problems = (self.problem(topic, settings, now) for topic in heard or topics[1:])
        return [problem for problem in problems if problem is not None]

    def problem(self, topic: str, settings: PlannerSettings, now: float) -> PoseError | None:
        """
        Return the reason why the pose of a topic cannot be used for planning, or None.

        A receiver must have a pose, with |z| at most height_tolerance. A topic of a UAV on which
        no pose has come has no problem. A refused pose is a problem only if no valid one came
        before it.
        """
        is_receiver = topic.partition('/')[0] not in settings.uavs
        timeout = settings.pose_timeout
        pose, refusal = self._poses.get(topic), self._refusals.get(topic)
        if refusal is not None and pose is None:
            return type(refusal)(f'the last pose on {topic} was refused: {refusal}')
        if pose is None:
            since = ' since the clock was set back' if self._was_set_back else ''
            return PoseMissingError(f'no pose has come on {topic}{since}') if is_receiver else None
        if pose.time < self._valid_from:
            return PoseStaleError(f'the pose on {topic} is from before the clock jumped ahead')
        if timeout and pose.age(now) > timeout:
            newer = '' if refusal is None else f'; newer ones were refused: {refusal}'
            return PoseStaleError(f'the pose on {topic} is {pose.age(now):.1f} s old and '
                                  f'pose_timeout is {timeout:g} s{newer}')
        if not is_receiver:
            return None
        if abs(pose.height) > settings.height_tolerance:
            return PoseError(
                f'the pose on {topic} has z = {pose.height:g} m and height_tolerance is '
                f'{settings.height_tolerance:g} m; ground nodes and eavesdroppers must '
                'be at z = 0 of the frame, above which altitudes count')
        try:
            _check_sizes(pose, settings)  # The confidence may have changed.
        except PoseError as error:
            return PoseError(f'on {topic}, {error}')
        return None


def read_pose(message: Message, settings: PlannerSettings, now: float, is_receiver: bool
              ) -> KnownPose:
    """
    Return the pose in a message that arrives at the clock's time `now` [s].

    A pose without a stamp is measured when it arrives. Odometry has a velocity and, only of a
    receiver, covariances of position and velocity.

    :raises PoseError: if it cannot be used.
    """
    header = message.header
    pose = message.pose if isinstance(message, PoseStamped) else message.pose.pose
    _check_range(pose.position, 'position', COORDINATE)
    for axis in 'xyzw':
        value = getattr(pose.orientation, axis)
        if not math.isfinite(value):
            raise PoseError(f'orientation.{axis} is {quote(value)}; it must be finite')
    covariance = velocity = velocity_covariance = None
    if isinstance(message, Odometry):
        velocity, velocity_covariance = _read_velocity(message, is_receiver)
    if isinstance(message, PoseWithCovarianceStamped) or velocity_covariance is not None:
        covariance = _horizontal_covariance(message.pose.covariance, 'x and y')
    # rclpy's Time is not used, because it raises an error for times before 1970.
    stamp = header.stamp.sec + header.stamp.nanosec * 1e-9 or now
    place = pose.position
    read = KnownPose((place.x, place.y), place.z, covariance, stamp, now, velocity,
                     velocity_covariance)
    _check_sizes(read, settings)
    return read


def error_radius(covariance: Array, confidence: float) -> float:
    """
    Return the radius [m] that contains a normally distributed error with a given probability.

    It is sqrt(-2 ln(1 - confidence) * largest eigenvalue of the covariance, (2, 2) in m^2). That
    is exact if the error is the same in all directions, and too large otherwise.
    """
    scale = float(np.abs(covariance).max())
    if scale == 0.0:
        return 0.0
    # Scaled by the largest element, so that no square overflows.
    largest = max(0.0, float(np.linalg.eigvalsh(covariance / scale)[-1]))
    # The squared distance, divided by the variance, has a chi-squared distribution with two
    # degrees of freedom.
    return math.sqrt(-2.0 * math.log1p(-confidence) * largest) * math.sqrt(scale)


def _check_sizes(pose: KnownPose, settings: PlannerSettings) -> None:
    """Raise a PoseError if the error radius of the position or of the velocity is too large."""
    for covariance, name, most, unit in (
            (pose.covariance, 'x and y', RADIUS.high, 'm'),
            (pose.velocity_covariance, 'the velocity', MAX_SPEED, 'm/s')):
        if covariance is None:
            continue
        radius = error_radius(covariance, settings.confidence)
        if not radius <= most:
            raise PoseError(
                f'the covariance of {name} gives an error radius of {radius:g} {unit} at the '
                f'confidence {settings.confidence:g}; it must be at most {most:g} {unit}')


def _check_range(vector: Any, name: str, allowed: Number) -> None:
    """Raise a PoseError that names the vector unless |x|, |y| and |z| are <= allowed.high."""
    most, unit = allowed.high, allowed.unit
    for axis in 'xyz':
        value = getattr(vector, axis)
        if not abs(value) <= most:
            raise PoseError(f'{name}.{axis} is {quote(value)}; it must be from {-most:g} to '
                            f'{most:g} {unit}')


def _read_velocity(message: Odometry, is_receiver: bool) -> tuple[Point, Array | None]:
    """Return velocity (x, y) [m/s] in the header's frame; covariance (2, 2), None for a UAV."""
    speed, covariance = message.twist.twist.linear, message.twist.covariance
    _check_range(speed, 'twist.linear', find_range(Uav, 'max_speed'))
    velocity, facing, turn = (speed.x, speed.y), message.pose.pose.orientation, None
    # REP-105 and nav_msgs: a twist is in the child frame, whatever that is.
    if message.child_frame_id != message.header.frame_id:
        turn = rotation((facing.x, facing.y, facing.z, facing.w))
        x, y, _ = turn.apply((speed.x, speed.y, speed.z)).tolist()
        velocity = (x, y)
    if not is_receiver:
        return velocity, None
    if math.hypot(*velocity) > MAX_SPEED:
        raise PoseError(f'twist.linear is {math.hypot(*velocity):g} m/s; it must be at most '
                        f'{MAX_SPEED:g} m/s')
    if turn is not None:
        with np.errstate(all='ignore'):  # What is not finite is refused.
            covariance = turn_covariance(covariance, turn)
    return velocity, _horizontal_covariance(covariance, 'the velocity')


def _horizontal_covariance(values: Any, name: str) -> Array:
    """
    Return the covariance of x and y, (2, 2), from the 36 values of a message.

    The other 32 values are not read, so they may be -1 where nothing is measured.

    :raises PoseError: unless the four are finite, symmetric and positive semidefinite.
    """
    matrix = np.array(values, dtype=float).reshape(6, 6)[:2, :2]
    is_valid = bool(np.isfinite(matrix).all() and (np.diag(matrix) >= 0).all())
    if is_valid and matrix.any():
        unit = matrix / np.abs(matrix).max()
        # Simulators and autopilots round to 24 bits.
        is_valid = bool(abs(unit[0, 1] - unit[1, 0]) <= 1e-6
                        and np.linalg.eigvalsh((unit + unit.T) / 2)[0] >= -1e-6)
    if not is_valid:
        rows = quote(matrix.tolist())
        raise PoseError(f'the covariance of {name} is {rows}; it must be finite, symmetric and '
                        'positive semidefinite')
    return matrix
