"""
The reference of topics, services and parameters, as read from running nodes.

`python -m secure_uav_planner.ros.reference docs` puts it into the page of each node.
"""

import argparse
from pathlib import Path

from typing import NamedTuple

import rclpy
from rclpy.context import Context
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy

from .parameters import (
    eavesdropper_parameters, PLANNER, RELAY, relay_parameters, REPLAY, uav_parameters,
    zone_parameters)
from .planner_node import Planner
from .replay_node import Replay
from .spec import Spec
from .topics import SENSOR, STREAM
from ..output.autopilots import STACKS

_NAMESPACE = '/reference'
_NAMES = {'uav1': '<uav>', 'uav2': '<uav>', 'eavesdropper': '<eavesdropper>'}
_BUILT_IN = ('/rosout', '/parameter_events', '/clock')
_MEANINGS = {
    ('planner', 'ground_node/pose'): 'the position of the ground node',
    ('planner', '<eavesdropper>/pose'):
        'the estimated position; its covariance gives the error radius',
    ('planner', '<uav>/odom'): 'optional: where the UAV is and how fast; used before its pose',
    ('planner', '<uav>/pose'): 'optional: where the UAV is',
    ('planner', 'plan_time'): 'to what time of which plan the flight has come, from a follower',
    ('planner', '<uav>/path'): 'every point of the plan with its time',
    ('planner', '<uav>/power'): 'the power of every slot in W',
    ('planner', '<uav>/trajectory'):
        'position, velocity and acceleration of the flown curve at the times of the points',
    ('planner', '~/markers'): 'the plan for RViz and Foxglove',
    ('planner', '~/status'): 'state, rates and ages; also while solving',
    ('planner', '/diagnostics'): 'the same once a second',
    ('planner', '~/plan'): 'plan now; the answer is a summary, or the reason for a refusal',
    ('planner', '~/cancel'): 'stop the solve that is under way',
    ('replay', '<uav>/path'): 'what to replay, unless `plan_file` is set',
    ('replay', '<uav>/power'): 'what to replay, unless `plan_file` is set',
    ('replay', '<uav>/trajectory'):
        'the curve through the path; without it, the UAV flies straight from point to point',
    ('replay', '<uav>/setpoint/pose'): 'the pose that the UAV should have now',
    ('replay', '<uav>/setpoint/trajectory'):
        'position, velocity, acceleration and yaw of the UAV now, for autopilots',
    ('replay', '<uav>/setpoint/power'): 'the power of the current slot in W',
    ('replay', '<uav>/odom'):
        'a UAV that follows the plan exactly; with `vehicle_odometry` where the real UAV is',
    ('replay', 'plan_time'): 'to what time of which plan the flight has come',
    ('replay', '~/secrecy_rate'): 'the present rate in bit/s/Hz, if `true_eavesdropper` is set',
    ('replay', '~/markers'): 'the present positions of the UAVs',
    ('replay', '~/start'): 'fly the plan at its time, or go on after a pause',
    ('replay', '~/pause'): 'slow down, hold the setpoint and continue to stream it',
    ('replay', '~/reset'): 'end the setpoints; the newest plan waits at its start',
    ('relay', '<uav>/setpoint/trajectory'):
        'one point: position, yaw and, where known, velocity and acceleration',
    ('relay', '<uav>/odom'): 'what the autopilot reports, in the frame of the plan',
}


class Interface(NamedTuple):
    """One topic or service of a node."""

    node: str
    direction: str
    name: str
    kind: str
    qos: str


def interfaces() -> list[Interface]:
    """Return every Interface of the nodes; the relay's depend on its parameter `stack`."""
    context = Context()
    rclpy.init(context=context, args=[])
    try:
        found = []
        for kind in (Planner, Replay):
            node = kind(context=context, namespace=_NAMESPACE)
            try:
                found += _interfaces_of(node)
            finally:
                node.close()
                node.destroy_node()
        return list(dict.fromkeys([*found, *_of_relay()]))
    finally:
        rclpy.try_shutdown(context=context)


def _of_relay() -> list[Interface]:
    """Return the relay's: it runs only where the messages of a stack are installed."""
    stream, sensor = _in_words(STREAM), _in_words(SENSOR)
    found = [Interface('relay', 'sub', '<uav>/setpoint/trajectory',
                       'trajectory_msgs/msg/MultiDOFJointTrajectory', stream),
             Interface('relay', 'pub', '<uav>/odom', 'nav_msgs/msg/Odometry', stream)]
    for stack in STACKS.values():
        found += [Interface('relay', 'pub', f'<vehicle>/{topic}', f'{stack.package}/msg/{kind}',
                            stream) for kind, topic in stack.topics.items()]
        found += [Interface('relay', 'sub', f'<vehicle>/{topic}', kind.replace('/', '/msg/'),
                            sensor) for kind, topic in stack.reports.items()]
    return found


def specs() -> dict[str, dict[str, Spec]]:
    """Return the Spec of every parameter of each node by name; `<uav>` stands for any UAV."""
    of_one = {**uav_parameters('<uav>', 0), **eavesdropper_parameters('<eavesdropper>'),
              **zone_parameters('<zone>')}
    return {'planner': {**PLANNER, **of_one}, 'replay': REPLAY,
            'relay': {**RELAY, **relay_parameters('<uav>', 0)}}


def markdown() -> dict[str, str]:
    """Return the reference of each node by its name, as Markdown."""
    pages = {}
    found = interfaces()
    for node, of_node in specs().items():
        lines = ['## Topics and services', '',
                 '| | name | type | QoS | meaning |', '| --- | --- | --- | --- | --- |']
        lines += [f'| {one.direction} | `{one.name}` | {one.kind} | {one.qos} | '
                  f'{_meaning(one)} |' for one in found if one.node == node]
        lines += ['', '## Parameters', '',
                  '| name | default | allowed | meaning |', '| --- | --- | --- | --- |']
        lines += [f'| `{name}` | {_default(name, spec)} | {spec.allowed} | {spec.description}'
                  f'{" Set at start only." if spec.read_only else ""} |'
                  for name, spec in of_node.items()]
        pages[node] = '\n'.join(lines)
    return pages


def generated(text: str) -> tuple[str, str, str]:
    """Return what is before, inside and behind the part of a page that is generated."""
    before, begin, rest = text.partition('<!-- generated -->\n')
    inside, end, behind = rest.partition('<!-- end of generated -->')
    return before + begin, inside, end + behind


def _meaning(one: Interface) -> str:
    for name, stack in STACKS.items():
        topic = one.name.removeprefix('<vehicle>/')
        if topic in stack.topics.values():
            return f'with `stack` {name}'
        if topic in stack.reports.values():
            return f'with `stack` {name}: where the vehicle is'
    return _MEANINGS[one.node, one.name]


def _interfaces_of(node: Node) -> list[Interface]:
    name = node.get_name()
    entities = (
        [('sub', one.topic_name, one.msg_type, 'msg', one.qos_profile)
         for one in node.subscriptions]
        + [('pub', one.topic_name, one.msg_type, 'msg', one.qos_profile)
           for one in node.publishers]
        + [('srv', one.service_name, one.srv_type, 'srv', None) for one in node.services])
    return [
        Interface(name, direction, _general(topic, name),
                  f'{kind.__module__.split(".")[0]}/{folder}/{kind.__name__}', _in_words(qos))
        for direction, topic, kind, folder, qos in entities
        if topic not in _BUILT_IN and kind.__module__.split('.')[0] not in (
            'rcl_interfaces', 'type_description_interfaces')]


def _general(topic: str, node: str) -> str:
    """Return the name in the code for a resolved name, with `<uav>` for the name of any UAV."""
    if not topic.startswith(_NAMESPACE + '/'):
        return topic
    first, *rest = topic[len(_NAMESPACE) + 1:].split('/', 1)
    return '/'.join(['~' if first == node else _NAMES.get(first, first), *rest])


def _in_words(qos: QoSProfile | None) -> str:
    if qos is None:
        return ''
    reliable = qos.reliability == ReliabilityPolicy.RELIABLE
    latched = qos.durability == DurabilityPolicy.TRANSIENT_LOCAL
    return (f'{"reliable" if reliable else "best effort"}, '
            f'{"transient local" if latched else "volatile"}, depth {qos.depth}')


def _default(name: str, spec: Spec) -> str:
    text = f'`{spec.default!r}`'
    field = name.partition('<uav>.')[2]
    other = uav_parameters('<uav>', 1).get(name) if field else None
    if other is not None and other.default != spec.default:
        text += f', of the others `{other.default!r}`'
    return text


def main() -> None:
    """Bring the pages of the nodes up to date."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('folder', type=Path, help='with a page for each node, such as planner.md')
    folder = parser.parse_args().folder
    for node, text in markdown().items():
        page = folder / f'{node}.md'
        before, _, behind = generated(page.read_text())
        page.write_text(f'{before}{text}\n\n{behind}')


if __name__ == '__main__':
    main()
