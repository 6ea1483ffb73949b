"""Bags of ROS 2 (a folder, .db3 or .mcap), read by rosbags; no ROS is needed."""

from dataclasses import dataclass, field
import os
from pathlib import Path
from typing import Any

import numpy as np

from .log import VehicleLog
from ...errors import LogFileError
from ...plan.file import parse_text
from ...plan.plan import Plan

_ODOMETRY = 'nav_msgs/msg/Odometry'


@dataclass
class FlightBag:
    """
    What a bag says of a flight.

    :ivar logs: the log of each UAV by name.
    :ivar plans: the plans in the order in which they were published.
    :ivar identities: identities of the plans that a follower reported, in order.
    """

    logs: dict[str, VehicleLog]
    plans: list[Plan] = field(default_factory=list)
    identities: list[str] = field(default_factory=list)


def read_bag(path: str | os.PathLike[str], uavs: tuple[str, ...]) -> FlightBag:
    """
    Return the flight of UAVs in a bag with their topics `<uav>/odom`, in any namespace.

    Where there are topics `plan`, `plan_time` and `<uav>/setpoint/power`, these are read, too.
    """
    from rosbags.highlevel import AnyReader  # Here, since few need it.
    from rosbags.typesys import get_typestore, Stores
    path = Path(path)
    states: dict[str, list[tuple[float, ...]]] = {uav: [] for uav in uavs}
    powers: dict[str, list[tuple[float, float]]] = {uav: [] for uav in uavs}
    reports: list[tuple[float, float]] = []
    bag = FlightBag({})
    with AnyReader([path], default_typestore=get_typestore(Stores.ROS2_JAZZY)) as reader:
        for connection, stamp, data in reader.messages(connections=[
                connection for connection in reader.connections
                if _find_role(connection.topic, connection.msgtype, uavs)]):
            role, uav = _find_role(connection.topic, connection.msgtype, uavs) or ('', '')
            message: Any = reader.deserialize(data, connection.msgtype)
            if role == 'odom':
                states[uav].append((_seconds(message.header.stamp), *_list_state(message)))
            elif role == 'power':
                powers[uav].append((stamp * 1e-9, float(message.data)))
            elif role == 'plan':
                bag.plans.append(parse_text(message.data, Plan)[0])
            else:
                identity = message.source.partition(' ')[0]
                if bag.identities[-1:] != [identity]:
                    bag.identities.append(identity)
                reports.append((_seconds(message.header.stamp), _seconds(message.time_ref)))
    for uav, rows in states.items():
        if not rows:
            raise LogFileError(f'it has no odometry of {uav} (a topic {uav}/odom)')
        table, plan_times = np.array(rows), None
        if reports and bag.plans and bag.plans[-1].start_ns is not None:
            clock, plan = np.array(reports).T
            plan_times = clock, plan - bag.plans[-1].start_ns * 1e-9
        bag.logs[uav] = VehicleLog(
            table[:, 0], table[:, 1:4], table[:, 4:7], 0.0, plan_times=plan_times,
            powers=tuple(np.array(powers[uav]).T) if powers[uav] else None)  # type: ignore
    return bag


def _find_role(topic: str, kind: str, uavs: tuple[str, ...]) -> tuple[str, str] | None:
    """Return the role of a topic and its UAV, or None for topics that are not read."""
    parts = topic.strip('/').split('/')
    if kind == _ODOMETRY and parts[-1] == 'odom' and len(parts) > 1 and parts[-2] in uavs:
        return 'odom', parts[-2]
    if parts[-2:] == ['setpoint', 'power'] and len(parts) > 2 and parts[-3] in uavs:
        return 'power', parts[-3]
    if parts[-1] == 'plan' and kind == 'std_msgs/msg/String':
        return 'plan', ''
    if parts[-1] == 'plan_time' and kind == 'sensor_msgs/msg/TimeReference':
        return 'plan_time', ''
    return None


def _seconds(stamp: Any) -> float:
    return float(stamp.sec) + 1e-9 * float(stamp.nanosec)


def _list_state(message: Any) -> tuple[float, ...]:
    """Return position and velocity of odometry; its twist is in the frame of the vehicle."""
    place, turn = message.pose.pose.position, message.pose.pose.orientation
    twist = message.twist.twist.linear
    sine = 2 * (turn.w * turn.z + turn.x * turn.y)
    cosine = 1 - 2 * (turn.y**2 + turn.z**2)
    return (place.x, place.y, place.z, cosine * twist.x - sine * twist.y,
            sine * twist.x + cosine * twist.y, twist.z)
