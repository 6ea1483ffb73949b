"""The nodes' topics: their names, quality of service, those of a plan and of poses; timers."""

from collections.abc import Callable, Sequence
from typing import Any

from geometry_msgs.msg import PoseStamped, PoseWithCovarianceStamped
from nav_msgs.msg import Odometry, Path
from rclpy.callback_groups import MutuallyExclusiveCallbackGroup
from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import DurabilityPolicy, QoSPolicyKind, QoSProfile, ReliabilityPolicy
from rclpy.qos_overriding_options import QoSOverridingOptions
from std_msgs.msg import Float64MultiArray
from trajectory_msgs.msg import MultiDOFJointTrajectory
from visualization_msgs.msg import MarkerArray

from . import messages
from .node_parameters import Parameters
from .poses import PoseBook
from ..errors import brief, PoseError
from ..plan.plan import Plan

SENSOR = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT,
                    durability=DurabilityPolicy.VOLATILE)
"""For subscriptions to poses: it matches every publisher, and only the last pose matters."""

LATCHED = QoSProfile(depth=1, reliability=ReliabilityPolicy.RELIABLE,
                     durability=DurabilityPolicy.TRANSIENT_LOCAL)
"""For plans and the status: a late subscriber receives the last message."""

STREAM = QoSProfile(depth=10)
"""For setpoints."""

OVERRIDABLE = QoSOverridingOptions([
    QoSPolicyKind.HISTORY, QoSPolicyKind.DEPTH, QoSPolicyKind.RELIABILITY,
    QoSPolicyKind.DURABILITY])
"""Set at the start by parameters `qos_overrides.<topic>.<publisher|subscription>.<policy>`."""

GROUND_NODE_TOPIC = 'ground_node/pose'

_NO_SHIFT = (0.0, 0.0, 0.0)
_MOST_WARNINGS = 5  # For each topic, until a valid pose arrives on it.


def pose_topic(name: str) -> str:
    """Return the topic of a UAV's or an eavesdropper's pose."""
    return f'{name}/pose'


def odometry_topic(name: str) -> str:
    """Return the topic of a UAV's odometry."""
    return f'{name}/odom'


def uav_topics(name: str) -> tuple[str, str]:
    """Return the topics that say where a UAV is; the first counts before the second."""
    return odometry_topic(name), pose_topic(name)


def timer_clock(node: Node) -> Clock:
    """Return the clock for the timers of setpoints: simulated, or one that is never set back."""
    clock = node.get_clock()
    return clock if clock.ros_time_is_active else Clock(clock_type=ClockType.STEADY_TIME)


class PlanTopics:
    """
    The publishers of a plan.

    :param node: the Node that publishes.
    :param uavs: the names of the UAVs.
    """

    def __init__(self, node: Node, uavs: Sequence[str]) -> None:
        kinds = {f'{name}/{topic}': kind for name in uavs for topic, kind in (
            ('path', Path), ('power', Float64MultiArray), ('trajectory', MultiDOFJointTrajectory))}
        self._publishers = {
            topic: node.create_publisher(kind, topic, LATCHED, qos_overriding_options=OVERRIDABLE)
            for topic, kind in {**kinds, '~/markers': MarkerArray}.items()}

    def is_followed(self) -> bool:
        """Return whether anybody receives paths or trajectories, and so may fly by them."""
        return any(publisher.get_subscription_count()
                   for topic, publisher in self._publishers.items()
                   if topic.endswith(('/path', '/trajectory')))

    def made(self, plan: Plan, frame_id: str) -> list[tuple[Publisher, Any]]:
        """Return all messages of a plan, each behind its publisher."""
        return [(self._publishers[topic], message)
                for topic, message in messages.of_plan(plan, frame_id)]


class PoseSubscriptions:
    """
    Subscribes to the poses of all members, keeps valid ones and warns once of each other kind.

    :param node: the Node that subscribes.
    :param settings: its Parameters.
    :param poses: the PoseBook that keeps them.
    :param on_first: called after the first valid pose of a topic.
    """

    def __init__(self, node: Node, settings: Parameters, poses: PoseBook,
                 on_first: Callable[[], None]) -> None:
        self._node, self._settings, self._poses = node, settings, poses
        self._on_first = on_first
        self._origins = {topic: f'{name}.origin'
                         for name in settings['uavs'] for topic in uav_topics(name)}
        self._warned: set[tuple[str, str]] = set()
        group = MutuallyExclusiveCallbackGroup()
        kinds = {GROUND_NODE_TOPIC: PoseStamped,
                 **{pose_topic(name): PoseWithCovarianceStamped
                    for name in settings['eavesdroppers']},
                 **{pose_topic(name): PoseStamped for name in settings['uavs']},
                 **{odometry_topic(name): Odometry for name in settings['uavs']}}
        for topic, kind in kinds.items():
            node.create_subscription(
                kind, topic, lambda message, topic=topic: self._take(topic, message), SENSOR,
                callback_group=group, qos_overriding_options=OVERRIDABLE)

    def _take(self, topic: str, message: PoseStamped | PoseWithCovarianceStamped | Odometry
              ) -> None:
        first = self._poses.get(topic) is None
        now = self._node.get_clock().now().nanoseconds * 1e-9
        origin = self._settings[self._origins[topic]] if topic in self._origins else _NO_SHIFT
        try:
            self._poses.take(topic, message, self._settings['frame_id'], now, origin)
        except PoseError as error:
            reason = brief(error)
            if (topic, reason) not in self._warned and (
                    sum(known[0] == topic for known in self._warned) < _MOST_WARNINGS):
                self._warned.add((topic, reason))
                self._node.get_logger().warning(f'{topic}: {reason}; it is not used')
        else:
            self._warned -= {known for known in self._warned if known[0] == topic}
            if first:
                self._on_first()
