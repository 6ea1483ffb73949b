"""A plan and its replay as an MCAP file, which Foxglove and `ros2 bag` open."""

from dataclasses import replace
import os
from pathlib import Path
import re
from typing import Any, IO

from ament_index_python.packages import get_package_share_directory
from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import PoseWithCovarianceStamped
from mcap.writer import Writer
import numpy as np
from rclpy.serialization import serialize_message

from . import messages
from .status import closest_approach_values
from ..errors import OptionError, shown
from ..mission.files import atomic_file
from ..mission.scenario import Point
from ..model import channel
from ..plan.plan import Plan
from ..plan.playback import Playback

_PRIMITIVES = {
    'bool', 'byte', 'char', 'float32', 'float64', 'int8', 'uint8', 'int16', 'uint16', 'int32',
    'uint32', 'int64', 'uint64', 'string', 'wstring'}

# The format of rosbag2. When the bag is played, late subscribers then receive the plan.
_QOS = """- history: keep_last
  depth: {depth}
  reliability: reliable
  durability: {durability}
  deadline: {{sec: 9223372036, nsec: 854775807}}
  lifespan: {{sec: 9223372036, nsec: 854775807}}
  liveliness: automatic
  liveliness_lease_duration: {{sec: 9223372036, nsec: 854775807}}
  avoid_ros_namespace_conventions: false
"""


def record(plan: Plan, path: str | os.PathLike[str], frame_id: str = 'map', rate: float = 5.0,
           eavesdropper: Point | None = None) -> None:
    """
    Write all messages of the planner and of the replay node for a plan, flown in real time.

    :param plan: a Plan; without a start time it starts at 0.
    :param path: the path of the MCAP file.
    :param frame_id: the frame of all messages that have a header.
    :param rate: the rate of setpoints in Hz of the plan's time.
    :param eavesdropper: its true position, (2,) in m; by default it has the worst position of its
        disc in every slot.
    :raises OptionError: for a rate that is not positive.
    :raises OSError: if the file cannot be written; an existing file is then unchanged.
    """
    if not rate > 0:
        raise OptionError(f'rate is {shown(rate)}; it must be above 0 Hz')
    if plan.start_ns is None:
        plan = replace(plan, start_ns=0)
    with atomic_file(path, binary=True) as file:
        bag = _Bag(file, plan.start_ns)
        _record_plan(bag, plan, frame_id)
        _record_replay(bag, plan, frame_id, rate, eavesdropper)
        bag.finish()


def _record_plan(bag: '_Bag', plan: Plan, frame_id: str) -> None:
    scenario = plan.scenario
    stamp = messages.stamp_at(plan)
    bag.write('/ground_node/pose', messages.pose_stamped(
        frame_id, stamp, *scenario.ground_node, 0.0, 0.0))
    for eve, name in zip(
            scenario.eavesdroppers, scenario.eavesdropper_names, strict=True):
        estimate = PoseWithCovarianceStamped()
        estimate.header.frame_id, estimate.header.stamp = frame_id, stamp
        estimate.pose.pose = messages.pose(*eve.position, 0.0, 0.0)
        bag.write(f'/{name}/pose', estimate)
    for topic, message in messages.of_plan(plan, frame_id):
        bag.write(_resolved(topic, 'planner'), message, latched=True)
    bag.write('/planner/status', messages.diagnostic_status(
        'planner: plan', DiagnosticStatus.OK, f'{plan.method} plan of {scenario.slots} slots', {
            'state': 'idle', 'plan.guaranteed_rate': plan.guaranteed_rate,
            'plan.worst_case_rate': plan.worst_case_rate, 'plan.method': plan.method,
            'plan.status': plan.status, 'plan.solve_time': plan.solve_time,
            'plan.curve_rate': plan.curve_rate, **closest_approach_values(plan)}), latched=True)


def _record_replay(bag: '_Bag', plan: Plan, frame_id: str, rate: float,
                   eavesdropper: Point | None) -> None:
    scenario, playback = plan.scenario, Playback(plan)
    worst = channel.worst_case_places(scenario, plan.positions, plan.powers)
    times = np.arange(0.0, playback.duration, 1.0 / rate)
    for time in (*times.tolist(), playback.duration):
        moment, stamp = playback.at(time), messages.stamp_at(plan, time)
        for topic, message in messages.of_moment(scenario, moment, frame_id, stamp):
            bag.write(_resolved(topic, 'replay'), message, time)
        slot = min(max(int(time / scenario.slot_duration + 1e-9), 1), scenario.slots) - 1
        place = worst[slot] if eavesdropper is None else eavesdropper
        bag.write('/replay/secrecy_rate', messages.float64(
            playback.secrecy_rate(moment, place)), time)


def _resolved(topic: str, node: str) -> str:
    return topic.replace('~', f'/{node}') if topic.startswith('~') else f'/{topic}'


class _Bag:
    """Writer of an MCAP file; it registers schemas and channels when they are first used."""

    def __init__(self, file: IO[bytes], start_ns: int) -> None:
        self._start_ns = start_ns
        self._schemas: dict[str, int] = {}
        self._channels: dict[str, int] = {}
        self._writer = Writer(file)
        self._writer.start(profile='ros2', library='secure_uav_planner')

    def write(self, topic: str, message: Any, time: float = 0.0, latched: bool = False) -> None:
        """Write a message at a time in s from the start of the plan."""
        if topic not in self._channels:
            qos = _QOS.format(depth=1 if latched else 10,
                              durability='transient_local' if latched else 'volatile')
            self._channels[topic] = self._writer.register_channel(
                topic, 'cdr', self._schema(type(message)), {'offered_qos_profiles': qos})
        at = self._start_ns + round(time * 1e9)
        self._writer.add_message(
            self._channels[topic], log_time=at, publish_time=at, data=serialize_message(message))

    def finish(self) -> None:
        """Write the index, without which the file is not complete."""
        self._writer.finish()

    def _schema(self, kind: type) -> int:
        name = f'{kind.__module__.split(".")[0]}/msg/{kind.__name__}'
        if name not in self._schemas:
            self._schemas[name] = self._writer.register_schema(
                name, 'ros2msg', definition(name).encode())
        return self._schemas[name]


def definition(name: str) -> str:
    """
    Return the definition of a message type and of all types that it contains, for MCAP.

    :param name: such as 'nav_msgs/msg/Path'.
    """
    own = _text(name)
    parts, seen, left = [own], {name}, _members(own, name)
    while left:
        member = left.pop(0)
        if member in seen:
            continue
        seen.add(member)
        text = _text(member)
        parts.append(f'{"=" * 80}\nMSG: {member.replace("/msg/", "/")}\n{text}')
        left += _members(text, member)
    return '\n'.join(parts)


def _text(name: str) -> str:
    package, folder, kind = name.split('/')
    return (Path(get_package_share_directory(package)) / folder / f'{kind}.msg').read_text()


def _members(text: str, owner: str) -> list[str]:
    """Return the names of the message types in the fields of a definition."""
    found = []
    for line in text.splitlines():
        words = line.split('#')[0].split()
        kind = re.sub(r'\[.*|<=.*', '', words[0]) if words else ''
        if kind and kind not in _PRIMITIVES:
            package, _, name = kind.rpartition('/')
            found.append(f'{package.split("/")[0] or owner.split("/")[0]}/msg/{name}')
    return found
