"""
Setpoints in the forms that autopilots' stacks take, as plain values by the names of their fields.

Setpoints are in an east-north-up frame with yaw counter-clockwise from east (REP-103). MAVROS and
Aerostack2 take that; MAVROS turns it into the autopilot's frame itself. PX4's own messages are in
north-east-down with yaw clockwise from north.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
import math
from typing import Any, TypeAlias

import numpy as np

from .errors import OptionError, shown
from .scenario import LIMITS

Vector: TypeAlias = tuple[float, float, float]
Fields: TypeAlias = dict[str, Any]

_FRAME_LOCAL_NED = 1
_IGNORE_VELOCITY = 8 + 16 + 32
_IGNORE_ACCELERATION = 64 + 128 + 256
_IGNORE_YAW_RATE = 2048
_UNUSED = (math.nan,) * 3


@dataclass(frozen=True)
class Setpoint:
    """
    Where a UAV should be at a time, and how it should move.

    :param frame_id: the name of the frame, east-north-up.
    :param time_ns: when, in ns.
    :param position: (x, y, z) in m.
    :param yaw: in rad, counter-clockwise from x.
    :param velocity: (x, y, z) in m/s, or None if it is not known.
    :param acceleration: (x, y, z) in m/s^2, or None if it is not known.
    :param yaw_rate: in rad/s, or None if it is not known.
    :raises OptionError: for a value that is not finite, or beyond those of a scenario.
    """

    frame_id: str
    time_ns: int
    position: Vector
    yaw: float
    velocity: Vector | None = None
    acceleration: Vector | None = None
    yaw_rate: float | None = None

    def __post_init__(self) -> None:
        for name in ('position', 'yaw', 'velocity', 'acceleration', 'yaw_rate'):
            value = getattr(self, name)
            low, high = LIMITS['coordinate']
            if value is not None and not all(
                    low <= one <= high for one in np.atleast_1d(value).tolist()):
                raise OptionError(
                    f'{name} is {shown(value)}; it must be from {low:g} to {high:g}')

    def seen_from(self, origin: Sequence[float]) -> 'Setpoint':
        """Return the setpoint in a frame with another origin, (x, y, z) in m, and equal axes."""
        x, y, z = (here - there for here, there in zip(self.position, origin, strict=True))
        return replace(self, position=(x, y, z))


@dataclass(frozen=True)
class Stack:
    """
    What an autopilot's stack takes.

    :param package: its ROS message package.
    :param source: how to get that package, for people.
    :param topics: the topic of each message by the name of its type, below the vehicle's name.
    :param fields: returns the fields of each message, by the name of its type, for a Setpoint and
        the present time in ns. A field that is a message is a dict, or a list of dicts.
    :param heartbeat: the types that the stack must receive at a minimum rate.
    """

    package: str
    source: str
    topics: Mapping[str, str]
    fields: Callable[[Setpoint, int], dict[str, Fields]]
    heartbeat: tuple[str, ...] = ()


def ned(vector: Vector) -> Vector:
    """Return a vector of east-north-up in north-east-down, or the other way round."""
    x, y, z = vector
    return (y, x, -z)


def yaw_ned(yaw: float) -> float:
    """Return the heading clockwise from north, from -pi to pi, for one from east, in rad."""
    return math.remainder(math.pi / 2 - yaw, 2 * math.pi)


def yaw_of(x: float, y: float, z: float, w: float) -> float:
    """Return the yaw of an orientation given as a quaternion, in rad."""
    return math.atan2(2 * (w * z + x * y), w * w + x * x - y * y - z * z)


def mavros(setpoint: Setpoint, now_ns: int) -> dict[str, Fields]:
    """Return mavros_msgs/PositionTarget; MAVROS takes east-north-up in FRAME_LOCAL_NED."""
    mask = 0
    for value, bits in ((setpoint.velocity, _IGNORE_VELOCITY),
                        (setpoint.acceleration, _IGNORE_ACCELERATION),
                        (setpoint.yaw_rate, _IGNORE_YAW_RATE)):
        mask |= bits if value is None else 0
    return {'PositionTarget': {
        'header': _header(setpoint),
        'coordinate_frame': _FRAME_LOCAL_NED,
        'type_mask': mask,
        'position': _xyz(setpoint.position),
        'velocity': _xyz(setpoint.velocity or (0.0, 0.0, 0.0)),
        'acceleration_or_force': _xyz(setpoint.acceleration or (0.0, 0.0, 0.0)),
        'yaw': setpoint.yaw,
        'yaw_rate': setpoint.yaw_rate or 0.0,
    }}


def px4(setpoint: Setpoint, now_ns: int) -> dict[str, Fields]:
    """Return px4_msgs/TrajectorySetpoint, NaN where nothing is known, and OffboardControlMode."""
    timestamp = now_ns // 1000
    return {
        'OffboardControlMode': {
            'timestamp': timestamp,
            'position': True,
            'velocity': setpoint.velocity is not None,
            'acceleration': setpoint.acceleration is not None,
        },
        'TrajectorySetpoint': {
            'timestamp': timestamp,
            'position': ned(setpoint.position),
            'velocity': _UNUSED if setpoint.velocity is None else ned(setpoint.velocity),
            'acceleration': (
                _UNUSED if setpoint.acceleration is None else ned(setpoint.acceleration)),
            'jerk': _UNUSED,
            'yaw': yaw_ned(setpoint.yaw),
            'yawspeed': math.nan if setpoint.yaw_rate is None else -setpoint.yaw_rate,
        },
    }


def aerostack2(setpoint: Setpoint, now_ns: int) -> dict[str, Fields]:
    """
    Return as2_msgs/TrajectorySetpoints with one point.

    :raises OptionError: without a velocity and an acceleration, as the message has no way to
        leave them out.
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


STACKS = {
    'mavros': Stack('mavros_msgs', 'apt install ros-jazzy-mavros-msgs',
                    {'PositionTarget': 'mavros/setpoint_raw/local'}, mavros),
    'px4': Stack('px4_msgs', 'build https://github.com/PX4/px4_msgs in your workspace, of the '
                 'branch of your PX4 release',
                 {'OffboardControlMode': 'fmu/in/offboard_control_mode',
                  'TrajectorySetpoint': 'fmu/in/trajectory_setpoint'}, px4,
                 heartbeat=('OffboardControlMode',)),
    'aerostack2': Stack('as2_msgs', 'build https://github.com/aerostack2/aerostack2 in your '
                        'workspace',
                        {'TrajectorySetpoints': 'motion_reference/trajectory'}, aerostack2),
}
"""Every Stack by its name."""


def _header(setpoint: Setpoint) -> Fields:
    return {'frame_id': setpoint.frame_id, 'stamp': {
        'sec': setpoint.time_ns // 10**9, 'nanosec': setpoint.time_ns % 10**9}}


def _xyz(vector: Vector) -> Fields:
    return dict(zip('xyz', vector, strict=True))
