"""A plan and its replay as an MCAP file, which Foxglove and `ros2 bag` open."""

from contextlib import suppress
from dataclasses import replace
import os
from pathlib import Path
import re
import sys
from typing import Any, IO

from ament_index_python.packages import get_package_share_directory
from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import PoseWithCovarianceStamped
from mcap.writer import Writer
import numpy as np
from rclpy.serialization import serialize_message
from std_msgs.msg import Float64

from . import messages
from .planner.status import plan_status
from .planner_status import PlannerStatus
from ..errors import OptionError, quote
from ..mission.files import atomic_file
from ..model import channel
from ..plan.plan import Plan
from ..plan.playback import Playback

# The format of rosbag2, from which a player offers the plan to late subscribers.
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


def record(plan: Plan, path: str | os.PathLike[str], frame_id: str = 'map',
           frequency: float = 5.0) -> None:
    """
    Write an MCAP file of what planner and replay publish for a plan at playback speed 1.

    :param plan: a Plan; without a start time its flight begins at 0.
    :param frequency: frequency of the setpoints [Hz] in the plan's time.
    :raises OptionError: for a frequency that is not positive.
    :raises OSError: if the file cannot be written; an existing file is then unchanged.
    """
    if not frequency > 0:
        raise OptionError(f'frequency is {quote(frequency)}; it must be above 0 Hz')
    if plan.start_ns is None:
        plan = replace(plan, start_ns=round(-plan.curve.begin * 1e9))
    with atomic_file(path, binary=True) as file:
        bag = _Bag(file, plan)
        _record_plan(bag, plan, frame_id)
        _record_replay(bag, plan, frame_id, frequency)
        bag.finish()


def _record_plan(bag: '_Bag', plan: Plan, frame_id: str) -> None:
    """Write the receivers' poses, at every point if they have tracks, the plan and its status."""
    scenario = plan.scenario
    times = [plan.curve.begin, *(plan.times.tolist()[1:] if scenario.has_tracks else [])]
    grounds, centres, _ = scenario.receivers_at(times)
    for number, time in enumerate(times):
        stamp = messages.stamp_at(plan, time)
        for name, (x, y) in zip(
                scenario.ground_node_names, grounds[:, number].tolist(), strict=True):
            bag.write(f'/{name}/pose', messages.pose_stamped(
                frame_id, stamp, x, y, 0.0, 0.0), time)
        for name, (x, y) in zip(
                scenario.eavesdropper_names, centres[:, number].tolist(), strict=True):
            estimate = PoseWithCovarianceStamped()
            estimate.header.frame_id, estimate.header.stamp = frame_id, stamp
            estimate.pose.pose = messages.pose(x, y, 0.0, 0.0)
            bag.write(f'/{name}/pose', estimate, time)
    for topic, message in messages.plan_messages(plan, frame_id):
        bag.write(_resolved(topic, 'planner'), message, plan.curve.begin, latched=True)
    bag.write('/planner/status', PlannerStatus(
        DiagnosticStatus.OK, f'{plan.method} plan of {scenario.slots} slots', 'idle',
        plan=plan_status(plan.evaluate(), None, (plan.start_ns or 0) * 1e-9)).to_message(
            'planner: plan'), plan.curve.begin, latched=True)


def _record_replay(bag: '_Bag', plan: Plan, frame_id: str, frequency: float) -> None:
    """Write setpoints, times, and the rate for each slot's worst-case place, at `frequency`."""
    scenario, playback = plan.scenario, Playback(plan)
    worst = channel.worst_case_places(scenario, plan.positions, plan.powers)  # (N, 2) in m
    times = np.arange(playback.begin, playback.duration, 1.0 / frequency)
    for time in (*times.tolist(), playback.duration):
        moment, stamp = playback.at(time), messages.stamp_at(plan, time)
        for topic, message in messages.setpoint_messages(scenario, moment, frame_id, stamp):
            bag.write(_resolved(topic, 'replay'), message, time)
        bag.write('/plan_time', messages.plan_time(plan, time, stamp, 'replay'), time)
        # Slot n = 1..N begins at point n; before point 1 the rate is for the place of slot 1.
        slot = min(max(int(time / scenario.slot_duration + 1e-9), 1), scenario.slots) - 1
        bag.write('/replay/secrecy_rate', Float64(
            data=playback.secrecy_rate(time, worst[slot])), time)


def _resolved(topic: str, node: str) -> str:
    return topic.replace('~', f'/{node}') if topic.startswith('~') else f'/{topic}'


class _Bag:
    """Writer of an MCAP file; it registers schemas and channels when they are first used."""

    def __init__(self, file: IO[bytes], plan: Plan) -> None:
        self._start_ns = plan.start_ns or 0
        self._schemas: dict[str, int] = {}  # Number of a schema in the file by message type.
        self._channels: dict[str, int] = {}  # Number of a channel in the file by topic.
        self._writer = Writer(file)
        self._writer.start(profile='ros2', library='secure_uav_planner')

    def write(self, topic: str, message: Any, time: float, latched: bool = False) -> None:
        """Write a message at a time [s] from point 0; a latched topic keeps its last message."""
        if topic not in self._channels:
            qos = _QOS.format(depth=1 if latched else 10,
                              durability='transient_local' if latched else 'volatile')
            self._channels[topic] = self._writer.register_channel(
                topic, 'cdr', self._schema(type(message)), {'offered_qos_profiles': qos})
        time_ns = max(0, self._start_ns + round(time * 1e9))
        self._writer.add_message(self._channels[topic], log_time=time_ns, publish_time=time_ns,
                                 data=serialize_message(message))

    def finish(self) -> None:
        """Write the index, without which the file is not complete."""
        self._writer.finish()

    def _schema(self, kind: type) -> int:
        """Return the number of the schema of a message class, registered at first use."""
        name = f'{kind.__module__.split(".")[0]}/msg/{kind.__name__}'
        if name not in self._schemas:
            self._schemas[name] = self._writer.register_schema(
                name, 'ros2msg', _definition(name).encode())
        return self._schemas[name]


def _definition(name: str) -> str:
    """Return the .msg text of a type such as nav_msgs/msg/Path, with each nested type's text."""
    texts: dict[str, str] = {}
    queue = [name.replace('/msg/', '/')]
    while queue:
        kind = queue.pop(0)
        if kind in texts:
            continue
        package, message = kind.split('/')
        texts[kind] = (_find_share(package) / 'msg' / f'{message}.msg').read_text()
        fields = messages.message_class(kind).get_fields_and_field_types()
        queue += re.findall(r'\w+/\w+', ' '.join(fields.values()))
    (_, first), *nested = texts.items()
    return '\n'.join([first, *(f'{"=" * 80}\nMSG: {kind}\n{text}' for kind, text in nested)])


def _find_share(package: str) -> Path:
    """Return the folder of a ROS package; ROS from pip has it where Python is installed."""
    with suppress(OSError, LookupError):  # AMENT_PREFIX_PATH is not set, or leads elsewhere.
        return Path(get_package_share_directory(package))
    return Path(sys.prefix) / 'share' / package
