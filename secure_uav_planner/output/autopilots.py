"""
Setpoints and odometry of autopilots' stacks, as plain values, and the limits that a plan needs.

Setpoints are in an east-north-up frame with yaw counter-clockwise from east (REP-103). MAVROS and
Aerostack2 take setpoints in this frame; MAVROS converts them to the autopilot's frame. PX4's own
messages are in north-east-down with yaw clockwise from north, and in forward-right-down for the
body.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
import math
from typing import Any, NamedTuple, TypeAlias

import numpy as np
import scipy

from ..errors import OptionError, PoseError, quote
from ..mission.fields import COORDINATE

Vector: TypeAlias = tuple[float, float, float]
Fields: TypeAlias = dict[str, Any]

_FRAME_LOCAL_NED = 1
_IGNORE_VELOCITY = 8 + 16 + 32
_IGNORE_ACCELERATION = 64 + 128 + 256
_IGNORE_YAW_RATE = 2048
_ZERO = (0.0, 0.0, 0.0)
_NAN = (math.nan,) * 3
# Norm above which a place is earth-centred in m: more than degrees and an altitude can have, less
# than the radius of the Earth.
_EARTH_CENTRED = 1e6
_POSE_NED = 1
_VELOCITY_NED, _VELOCITY_BODY = 1, 3
_GRAVITY = 9.81  # Gravitational acceleration [m/s^2].
# Deceleration of a multicopter by drag, divided by speed^2 [1/m]. In ArduPilot's simulator, a lean
# of 30 degrees carried 2 but not 3 m/s^2 at 10 m/s, which gives 0.027 to 0.037.
_DRAG = 0.036
_RESERVE = 4 / 3  # Least ratio of a limit to the plan's limit with which a delay is made up.
# Ratio of a recommended limit to the plan's limit, as flown with 3 m/s^2, and the step in m/s,
# m/s^2 or degrees to which the recommended limit is rounded up.
_RECOMMENDED = {'speed': (1.5, 0.5), 'acceleration': (1.6, 0.5), 'lean': (_RESERVE, 5.0)}


@dataclass(frozen=True)
class Setpoint:
    """
    The desired position and motion of a UAV at a time.

    :param frame_id: name of the east-north-up frame.
    :param time_ns: time of the setpoint in ns.
    :param position: (x, y, z) in m.
    :param yaw: in rad, counter-clockwise from x.
    :param velocity: (x, y, z) in m/s, or None if unknown.
    :param acceleration: (x, y, z) in m/s^2, or None if unknown.
    :param yaw_rate: in rad/s, or None if unknown.
    :raises OptionError: for a value that is not finite, or beyond the range of coordinates.
    """

    frame_id: str
    time_ns: int
    position: Vector
    yaw: float
    velocity: Vector | None = None
    acceleration: Vector | None = None
    yaw_rate: float | None = None

    def __post_init__(self) -> None:
        """Refuse numbers beyond COORDINATE."""
        for name in ('position', 'yaw', 'velocity', 'acceleration', 'yaw_rate'):
            value = getattr(self, name)
            low, high = COORDINATE.low, COORDINATE.high
            if value is not None and not all(
                    low <= number <= high for number in np.atleast_1d(value).tolist()):
                raise OptionError(
                    f'{name} is {quote(value)}; it must be from {low:g} to {high:g}', (name,))

    def hold(self) -> 'Setpoint':
        """Return the setpoint at rest; its old stamp cannot be after the next setpoint's stamp."""
        return replace(self, velocity=_ZERO, acceleration=_ZERO, yaw_rate=None)


@dataclass(frozen=True)
class Stack:
    """
    The messages of an autopilot's stack.

    :param package: its ROS message package.
    :param source: the repository of that package.
    :param topics: topics of the setpoint messages, below the vehicle's name, by type.
    :param fields: function of a Setpoint and the present time in ns. It returns the fields of each
        setpoint message by type. A field that is a message is a dict, or a list of dicts.
    :param states: topics of the vehicle's state, by package and type.
    :param odometry: function of the last message of each topic in `states`. It returns the fields
        of nav_msgs/Odometry in the vehicle's local frame, east-north-up, without names of frames.
        The stamp is left out if the stack may have another clock.
    :param debian: name of the Debian package if ROS distributes one, otherwise ''.
    """

    package: str
    source: str
    topics: Mapping[str, str]
    fields: Callable[[Setpoint, int], dict[str, Fields]]
    states: Mapping[str, str]
    odometry: Callable[..., Fields]
    debian: str = ''


def ned(vector: Vector) -> Vector:
    """Convert a vector from east-north-up to north-east-down, or back."""
    x, y, z = vector
    return (y, x, -z)


def yaw_ned(yaw: float) -> float:
    """Convert yaw from east to yaw clockwise from north, from -pi to pi, in rad."""
    return math.remainder(math.pi / 2 - yaw, 2 * math.pi)


def rotation(quaternion: Sequence[float], name: str = 'orientation') -> Any:
    """
    Return the scipy.spatial.transform.Rotation of a quaternion (x, y, z, w).

    :param name: name of the quaternion in the error.
    :raises PoseError: if its length is not within 0.001 of 1.
    """
    length = math.hypot(*quaternion)
    if not abs(length - 1.0) < 1e-3:
        raise PoseError(f'{name} has length {length:g}; it must be a quaternion of length 1')
    return scipy.spatial.transform.Rotation.from_quat(quaternion)


def mavros_setpoint(setpoint: Setpoint, now_ns: int) -> dict[str, Fields]:
    """Return mavros_msgs/PositionTarget; type_mask has the bits of all values that are None."""
    mask = sum(bits for value, bits in (
        (setpoint.velocity, _IGNORE_VELOCITY), (setpoint.acceleration, _IGNORE_ACCELERATION),
        (setpoint.yaw_rate, _IGNORE_YAW_RATE)) if value is None)
    return {'PositionTarget': {
        'header': _header(setpoint),
        'coordinate_frame': _FRAME_LOCAL_NED,  # MAVROS takes east-north-up in this frame.
        'type_mask': mask,
        'position': _xyz(setpoint.position),
        'velocity': _xyz(setpoint.velocity or _ZERO),
        'acceleration_or_force': _xyz(setpoint.acceleration or _ZERO),
        'yaw': setpoint.yaw,
        'yaw_rate': setpoint.yaw_rate or 0.0,
    }}


def px4_setpoint(setpoint: Setpoint, now_ns: int) -> dict[str, Fields]:
    """Return TrajectorySetpoint in north-east-down, NaN for None, and OffboardControlMode."""
    now_us = now_ns // 1000
    return {
        'OffboardControlMode': {
            'timestamp': now_us,
            'position': True,
            'velocity': setpoint.velocity is not None,
            'acceleration': setpoint.acceleration is not None,
        },
        'TrajectorySetpoint': {
            'timestamp': now_us,
            'position': ned(setpoint.position),
            'velocity': _NAN if setpoint.velocity is None else ned(setpoint.velocity),
            'acceleration': (
                _NAN if setpoint.acceleration is None else ned(setpoint.acceleration)),
            'jerk': _NAN,
            'yaw': yaw_ned(setpoint.yaw),
            'yawspeed': math.nan if setpoint.yaw_rate is None else -setpoint.yaw_rate,
        },
    }


def aerostack2_setpoint(setpoint: Setpoint, now_ns: int) -> dict[str, Fields]:
    """
    Return as2_msgs/TrajectorySetpoints with one point, without a yaw rate.

    :raises OptionError: without a velocity or an acceleration, which the message cannot omit.
    """
    if setpoint.velocity is None or setpoint.acceleration is None:
        raise OptionError('Aerostack2 takes setpoints with velocity and acceleration only')
    return {'TrajectorySetpoints': {
        'header': _header(setpoint),
        'setpoints': [{
            'position': _xyz(setpoint.position),
            'twist': _xyz(setpoint.velocity),
            'acceleration': _xyz(setpoint.acceleration),
            'yaw_angle': setpoint.yaw,
        }],
    }}


def ros_odometry(message: Any) -> Fields:
    """Return stamp, pose and twist of a nav_msgs/Odometry as fields of nav_msgs/Odometry."""
    return {'header': {'stamp': message.header.stamp}, 'pose': message.pose,
            'twist': message.twist}


def px4_odometry(message: Any) -> Fields:
    """
    Convert px4_msgs/VehicleOdometry to fields of nav_msgs/Odometry: pose ENU, twist FLU.

    :raises PoseError: for a frame without north, or an invalid orientation.
    """
    if message.pose_frame != _POSE_NED or message.velocity_frame not in (
            _VELOCITY_NED, _VELOCITY_BODY):
        raise PoseError(
            f'pose_frame is {message.pose_frame} and velocity_frame is {message.velocity_frame}; '
            f'they must be {_POSE_NED}, and {_VELOCITY_NED} or {_VELOCITY_BODY}')
    w, x, y, z = map(float, message.q)
    body = rotation((x, y, z, w), 'q')
    velocity = _vector(message.velocity)
    if message.velocity_frame == _VELOCITY_NED:
        velocity = _vector(body.inv().apply(velocity))
    x, y, z, w = (math.sqrt(0.5) * body.as_quat()).tolist()
    # q(NED to ENU) * q(body: FRD to NED) * q(FLU to FRD), where both outer ones are constant.
    orientation = {'x': x + y, 'y': x - y, 'z': w - z, 'w': w + z}
    return {'pose': {'pose': {'position': _xyz(ned(_vector(message.position))),
                              'orientation': orientation}},
            'twist': {'twist': {'linear': _xyz(_flu(velocity)),
                                'angular': _xyz(_flu(_vector(message.angular_velocity)))}}}


def aerostack2_odometry(pose: Any, twist: Any) -> Fields:
    """Return the fields of nav_msgs/Odometry of a PoseStamped and a TwistStamped in body axes."""
    return {'header': {'stamp': pose.header.stamp}, 'pose': {'pose': pose.pose},
            'twist': {'twist': twist.twist}}


STACKS = {
    'mavros': Stack(
        'mavros_msgs', 'https://github.com/mavlink/mavros',
        {'PositionTarget': 'mavros/setpoint_raw/local'}, mavros_setpoint,
        {'nav_msgs/Odometry': 'mavros/local_position/odom'}, ros_odometry,
        debian='ros-jazzy-mavros-msgs'),
    'px4': Stack(
        'px4_msgs', 'https://github.com/PX4/px4_msgs (the branch of your PX4 release)',
        {'OffboardControlMode': 'fmu/in/offboard_control_mode',
         'TrajectorySetpoint': 'fmu/in/trajectory_setpoint'}, px4_setpoint,
        {'px4_msgs/VehicleOdometry': 'fmu/out/vehicle_odometry'}, px4_odometry),
    'aerostack2': Stack(
        'as2_msgs', 'https://github.com/aerostack2/aerostack2',
        {'TrajectorySetpoints': 'motion_reference/trajectory'}, aerostack2_setpoint,
        {'geometry_msgs/PoseStamped': 'self_localization/pose',
         'geometry_msgs/TwistStamped': 'self_localization/twist'}, aerostack2_odometry),
}
"""Each Stack by its name."""


class Reference(NamedTuple):
    """
    The place on Earth of the origin of a vehicle's local frame.

    :param latitude: in degrees.
    :param longitude: in degrees.
    :param resets: numbers that change when the estimator is reset.
    """

    latitude: float
    longitude: float
    resets: tuple[int, ...] = ()


class ReferenceSource(NamedTuple):
    """A message that has a Reference: package, source and debian as in Stack, topics, reader."""

    package: str
    source: str
    kind: str
    topics: tuple[str, ...]
    read: Callable[[Any], Reference]
    debian: str = ''


def px4_reference(message: Any) -> Reference:
    """Read the Reference of px4_msgs/VehicleLocalPosition; raise PoseError if flagged invalid."""
    if not (message.xy_valid and message.xy_global):
        raise PoseError(f'xy_valid is {message.xy_valid} and xy_global is {message.xy_global}; '
                        'both must be true')
    return Reference(message.ref_lat, message.ref_lon, (
        message.ref_timestamp, message.xy_reset_counter, message.z_reset_counter))


def mavros_reference(message: Any) -> Reference:
    """Read the Reference of geographic_msgs/GeoPointStamped; raise PoseError if it is in m."""
    place = message.position
    if math.hypot(place.latitude, place.longitude, place.altitude) > _EARTH_CENTRED:
        raise PoseError('its position is earth-centred (ECEF) in m, as MAVROS before 2024 sends '
                        'it, and must be in degrees; use a newer MAVROS, or <uav>.origin')
    return Reference(place.latitude, place.longitude)


REFERENCES = {
    'px4': ReferenceSource(
        'px4_msgs', STACKS['px4'].source, 'px4_msgs/VehicleLocalPosition',
        # PX4 appends the version of a message to the name of its topic, if that is not 0.
        ('fmu/out/vehicle_local_position', 'fmu/out/vehicle_local_position_v1'), px4_reference),
    'mavros': ReferenceSource(
        'geographic_msgs', 'https://github.com/ros-geographic-info/geographic_info',
        'geographic_msgs/GeoPointStamped', ('mavros/global_position/gp_origin',), mavros_reference,
        debian='ros-jazzy-geographic-msgs')}
"""Each ReferenceSource by its name."""

TRIED_VERSIONS = {
    'px4_msgs/TrajectorySetpoint': (0,), 'px4_msgs/VehicleOdometry': (0,),
    'px4_msgs/VehicleLocalPosition': (0, 1)}
"""The values of MESSAGE_VERSION that the conversions are for: px4_msgs of PX4 1.16 to 1.18."""


def _header(setpoint: Setpoint) -> Fields:
    return {'frame_id': setpoint.frame_id, 'stamp': {
        'sec': setpoint.time_ns // 10**9, 'nanosec': setpoint.time_ns % 10**9}}


def _xyz(vector: Vector) -> Fields:
    return dict(zip('xyz', vector, strict=True))


def _vector(values: Any) -> Vector:
    """Return three numbers of a message or an array as floats."""
    x, y, z = map(float, values)
    return (x, y, z)


def _flu(vector: Vector) -> Vector:
    """Convert a vector from forward-right-down to forward-left-up."""
    x, y, z = vector
    return (x, -y, -z)


def lean(speed: float, acceleration: float, reserve: float = 1.0) -> float:
    """Return the lean [degrees], atan(reserve (a + _DRAG v^2) / g), at v [m/s] and a [m/s^2]."""
    return math.degrees(math.atan2(reserve * (acceleration + _DRAG * speed**2), _GRAVITY))


@dataclass(frozen=True)
class Parameter:
    """A parameter of an autopilot that limits how it follows setpoints."""

    name: str  # Name in the autopilot's documentation.
    limits: str  # Limited quantity: 'speed', 'acceleration' or 'lean'.
    unit: str  # Unit of the parameter's values.
    factor: float  # Value that means 1 m/s, 1 m/s^2 or 1 degree.
    default: float
    most: float  # The largest value that the documentation allows.

    def least(self, speed: float, acceleration: float) -> float:
        """Return the least value with _RESERVE for a plan's limits of speed and acceleration."""
        return self.factor * self._scale(speed, acceleration, _RESERVE)

    def recommended(self, speed: float, acceleration: float) -> float:
        """Return the value by _RECOMMENDED, at most `most`, to make up for a delay."""
        ratio, step = _RECOMMENDED[self.limits]
        value = self._scale(speed, acceleration, ratio)
        return min(self.most, self.factor * step * math.ceil(value / step))

    def _scale(self, speed: float, acceleration: float, ratio: float) -> float:
        return {'speed': ratio * speed, 'acceleration': ratio * acceleration,
                'lean': lean(speed, acceleration, ratio)}[self.limits]


AUTOPILOTS: Mapping[str, tuple[Parameter, ...]] = {
    # WPNAV_SPEED and WPNAV_ACCEL limit in GUIDED only the correction of an error, which is added
    # to the plan's velocity and acceleration.
    'ardupilot': (Parameter('WPNAV_SPEED', 'speed', 'cm/s', 100, 1000, 2000),
                  Parameter('WPNAV_ACCEL', 'acceleration', 'cm/s^2', 100, 250, 500),
                  Parameter('ANGLE_MAX', 'lean', 'cdeg', 100, 3000, 8000)),
    # MPC_XY_VEL_MAX limits in OFFBOARD the sum of the plan's velocity and its correction.
    'px4': (Parameter('MPC_XY_VEL_MAX', 'speed', 'm/s', 1, 12, 20),
            Parameter('MPC_TILTMAX_AIR', 'lean', 'deg', 1, 45, 89)),
}
"""Parameters that limit a flight along setpoints, by the name of the autopilot."""


def changes(autopilot: str, speed: float,
            acceleration: float) -> tuple[tuple[Parameter, float], ...]:
    """
    Return (parameter, recommended value) of each parameter that is to be raised for a plan.

    The tuple is empty if every default is at least the parameter's `least`. A recommended value
    is at most the largest allowed one. If it is below `least`, the autopilot cannot follow the
    plan.

    :param autopilot: a name in AUTOPILOTS.
    :param speed: the plan's limit of speed in m/s.
    :param acceleration: the plan's limit of acceleration in m/s^2.
    """
    limits, parameters = (speed, acceleration), AUTOPILOTS[autopilot]
    if all(parameter.default >= parameter.least(*limits) for parameter in parameters):
        return ()
    return tuple((parameter, parameter.recommended(*limits)) for parameter in parameters
                 if parameter.default < parameter.recommended(*limits))
