"""The nodes' topics and services: their names, types, quality of service and meanings."""

from collections.abc import Awaitable, Callable, Iterator, Mapping, Sequence
from copy import copy
from functools import partial
from inspect import isawaitable
from typing import Any, NamedTuple, TypeAlias

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from geometry_msgs.msg import PoseStamped, PoseWithCovarianceStamped
from nav_msgs.msg import Odometry, Path
from rclpy.callback_groups import CallbackGroup
from rclpy.clock import Clock, ClockType, ROSClock
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import DurabilityPolicy, QoSPolicyKind, QoSProfile, ReliabilityPolicy
from rclpy.qos_overriding_options import QoSOverridingOptions
from rclpy.service_introspection import ServiceIntrospectionState
from sensor_msgs.msg import TimeReference
from std_msgs.msg import Float64, Float64MultiArray, String
from std_srvs.srv import SetBool, Trigger
from trajectory_msgs.msg import MultiDOFJointTrajectory
from visualization_msgs.msg import MarkerArray

from ..errors import describe_error

SENSOR = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT,
                    durability=DurabilityPolicy.VOLATILE)
"""For subscriptions to poses: it matches every publisher, and only the last pose matters."""

LATCHED = QoSProfile(depth=1, reliability=ReliabilityPolicy.RELIABLE,
                     durability=DurabilityPolicy.TRANSIENT_LOCAL)
"""For plans and the status: a late subscriber receives the last message."""

STREAM = QoSProfile(depth=10)
"""For setpoints."""

REQUESTS = QoSProfile(depth=1000)
"""For services: simultaneous requests are queued, and none is lost."""

# Policies that parameters `qos_overrides.<topic>.<publisher|subscription>.<policy>` may set.
_OVERRIDABLE = QoSOverridingOptions([
    QoSPolicyKind.HISTORY, QoSPolicyKind.DEPTH, QoSPolicyKind.RELIABILITY,
    QoSPolicyKind.DURABILITY])


class Topic(NamedTuple):
    """The message type, the quality of service and the meaning of a topic."""

    kind: type
    qos: QoSProfile
    meaning: str


TOPICS = {
    ('planner', 'sub'): {
        'plan_time': Topic(TimeReference, SENSOR,
                           'which plan a follower flies, and its progress in plan time'),
        '<ground_node>/pose': Topic(PoseStamped, SENSOR, 'the position of a ground node'),
        '<ground_node>/odom': Topic(
            Odometry, SENSOR, 'optional: where a ground node that moves is and how fast; used '
            'before its pose, unless that is fresher by a second'),
        '<eavesdropper>/pose': Topic(
            PoseWithCovarianceStamped, SENSOR,
            'the estimated position; its covariance gives the error radius'),
        '<eavesdropper>/odom': Topic(
            Odometry, SENSOR, 'optional: the estimate of an eavesdropper that moves, with its '
            'velocity; both covariances give the error radius over time; used before its pose, '
            'unless that is fresher by a second'),
        '<uav>/pose': Topic(PoseStamped, SENSOR, 'optional: where the UAV is'),
        '<uav>/odom': Topic(Odometry, SENSOR,
                            'optional: where the UAV is and how fast; used before its pose, '
                            'unless that is fresher by a second'),
        '<uav>/relay': Topic(DiagnosticStatus, SENSOR, 'optional: what becomes of the setpoints '
                             'of the UAV')},
    ('planner', 'pub'): {
        'plan': Topic(String, LATCHED, 'the whole plan: JSON of a plan file, with `frame_id`'),
        '<uav>/path': Topic(Path, LATCHED, 'every point of the plan with its time'),
        '<uav>/power': Topic(Float64MultiArray, LATCHED, 'the power of every slot in W'),
        '<uav>/trajectory': Topic(
            MultiDOFJointTrajectory, LATCHED, 'position, velocity and acceleration of the flown '
            'curve at the times of the points'),
        '~/schedule': Topic(Float64MultiArray, LATCHED,
                            'the share of every slot for each ground node'),
        '~/markers': Topic(MarkerArray, LATCHED, 'the plan for RViz and Foxglove'),
        '~/status': Topic(DiagnosticStatus, LATCHED,
                          'state, rates and ages, once a second and while solving'),
        '/diagnostics': Topic(DiagnosticArray, STREAM, 'the same once a second')},
    ('replay', 'sub'): {
        'plan': Topic(String, LATCHED, 'what to replay, unless `plan_file` is set'),
        '<uav>/relay': Topic(DiagnosticStatus, SENSOR, 'optional: what becomes of the setpoints '
                             'of the UAV')},
    ('replay', 'pub'): {
        '<uav>/setpoint/pose': Topic(PoseStamped, STREAM,
                                     'the pose that the UAV should have now'),
        '<uav>/setpoint/trajectory': Topic(
            MultiDOFJointTrajectory, STREAM,
            'position, velocity, acceleration and yaw of the UAV now, for autopilots'),
        '<uav>/setpoint/power': Topic(Float64, STREAM, 'the power of the current slot in W'),
        '<uav>/odom': Topic(Odometry, STREAM, 'a UAV that follows the plan exactly; with '
                            '`vehicle_odometry` where the real UAV is'),
        'setpoint/served': Topic(String, STREAM, 'the ground node with the largest share of the '
                                 'current slot; empty while nothing is transmitted'),
        '~/markers': Topic(MarkerArray, STREAM, 'the present positions of the UAVs'),
        'plan_time': Topic(TimeReference, STREAM,
                           'which plan is flown, and its progress in plan time'),
        '~/secrecy_rate': Topic(Float64, STREAM, 'the present rate in bit/s/Hz, if '
                                '`true_eavesdropper` is set')},
    ('relay', 'sub'): {
        '<uav>/setpoint/trajectory': Topic(
            MultiDOFJointTrajectory, STREAM,
            'one point: position, yaw and, where known, velocity and acceleration')},
    ('relay', 'pub'): {
        '<uav>/odom': Topic(Odometry, STREAM,
                            'what the autopilot reports, in the frame of the plan'),
        '<uav>/relay': Topic(DiagnosticStatus, STREAM, 'what becomes of the setpoints of the UAV, '
                             'and why, five times a second'),
        '/diagnostics': Topic(DiagnosticArray, STREAM, 'the same, and whether the local frames of '
                              'the vehicles are known, and have moved, once a second')},
}
"""Every Topic by node and direction, except the topics of autopilots' stacks."""


class Service(NamedTuple):
    """The type and the meaning of a service."""

    kind: type
    meaning: str


SERVICES = {
    ('planner', '~/plan'): Service(
        Trigger, 'plan now; the answer is a summary, or the reason for a refusal'),
    ('planner', '~/cancel'): Service(Trigger, 'stop the solve that is under way'),
    ('replay', '~/start'): Service(Trigger, 'fly the plan at its time, or go on after a pause'),
    ('replay', '~/pause'): Service(
        Trigger, 'slow down, hold the setpoint and continue to stream it, with powers of zero'),
    ('replay', '~/reset'): Service(
        Trigger, 'end the setpoints; the newest plan waits at its start'),
    ('relay', '~/enable'): Service(
        SetBool, 'whether setpoints are passed on; after false nothing is sent, until true'),
}
"""Every Service by node and name; each answers with success and a message."""

Answer: TypeAlias = tuple[bool, str]
"""Success and message of a service's answer."""


def overridable(qos: QoSProfile) -> dict[str, Any]:
    """
    Return arguments that give a publisher or subscription a profile with overrides by parameters.

    They hold a copy, because rclpy writes the overrides of one topic into the profile itself.
    """
    return {'qos_profile': copy(qos), 'qos_overriding_options': _OVERRIDABLE}


def publishers(node: Node, topics: Mapping[str, Topic], uavs: Sequence[str]
               ) -> dict[str, Publisher]:
    """Create the publishers, by topic name; a topic of `<uav>` has one for each UAV."""
    return {name: node.create_publisher(
        topic.kind, name, **overridable(topic.qos))
        for name, topic in _named(topics, {'<uav>': uavs})}


def subscribe(node: Node, topics: Mapping[str, Topic], callback: Callable[[str, Any], None],
              group: CallbackGroup, uavs: Sequence[str],
              receivers: Mapping[str, Sequence[str]] = {}) -> None:
    """
    Subscribe to each topic, and for a topic of `<uav>` to one topic for each UAV.

    :param callback: called with the name of the topic, such as 'bob/odom', and a message.
    :param receivers: names of the receivers by placeholder in the topics' names, such as
        '<eavesdropper>'.
    """
    for name, topic in _named(topics, {'<uav>': uavs, **receivers}):
        node.create_subscription(
            topic.kind, name, partial(callback, name), callback_group=group,
            **overridable(topic.qos))


def serve(node: Node, actions: Mapping[str, Callable[..., Answer | Awaitable[Answer]]],
          group: CallbackGroup) -> None:
    """
    Offer services of SERVICES, with introspection as the parameter service_introspection says.

    :param actions: the function of each service by name. It is called with the fields of a
        request, and returns success and message, or a coroutine that does. If it raises an error,
        the answer is no success and the text of the error.
    """
    kinds = {name: kind for (_, name), (kind, _) in SERVICES.items()}
    introspection = node.get_parameter('service_introspection').value.upper()
    for name, action in actions.items():
        service = node.create_service(
            kinds[name], name, partial(_answer, node, action), qos_profile=REQUESTS,
            callback_group=group)
        service.configure_introspection(
            node.get_clock(), STREAM, ServiceIntrospectionState.__members__[introspection])


async def _answer(node: Node, action: Callable[..., Answer | Awaitable[Answer]], request: Any,
                  response: Any) -> Any:
    """Return the response of a service, filled from an action or from the error it raises."""
    try:
        result = action(*(getattr(request, field)
                          for field in request.get_fields_and_field_types()))
        response.success, response.message = await result if isawaitable(result) else result
    except Exception as error:
        response.success, response.message = False, describe_error(error)
        node.get_logger().error(f'a request failed: {response.message}')
    return response


def _named(topics: Mapping[str, Topic], members: Mapping[str, Sequence[str]]
           ) -> Iterator[tuple[str, Topic]]:
    """Yield (name, topic); a placeholder before the first '/' gives one name for each member."""
    for name, topic in topics.items():
        first, _, rest = name.partition('/')
        yield from ([(f'{member}/{rest}', topic) for member in members[first]]
                    if first in members else [(name, topic)])


def member_topics(name: str) -> tuple[str, str]:
    """Return the topics of a member's position in order of preference: odometry, then pose."""
    return f'{name}/odom', f'{name}/pose'


def timer_clock(node: Node) -> Clock:
    """Return a clock for setpoints: simulated time if that is set, otherwise a steady clock."""
    return node.get_clock() if is_simulated(node) else Clock(clock_type=ClockType.STEADY_TIME)


def is_simulated(node: Node) -> bool:
    """Return True if the clock of a node is simulated."""
    clock = node.get_clock()
    return isinstance(clock, ROSClock) and clock.ros_time_is_active
