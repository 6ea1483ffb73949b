"""Subscriptions to all poses, of which the valid ones are kept."""

from collections.abc import Callable, Sequence

from geometry_msgs.msg import PoseStamped, PoseWithCovarianceStamped
from nav_msgs.msg import Odometry
from rclpy.callback_groups import MutuallyExclusiveCallbackGroup
from rclpy.node import Node

from .node_parameters import Parameters
from .poses import PoseBook
from .qos import OVERRIDABLE, SENSOR
from .scenarios import GROUND_NODE_TOPIC, odometry_topic, pose_topic, uav_topics
from .text import brief
from ..errors import PoseError

_NO_SHIFT = (0.0, 0.0, 0.0)
_MOST_WARNINGS = 5  # For each topic, until a valid pose arrives on it.


class Intake:
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
        for topic, kind in _kinds(settings['uavs'], settings['eavesdroppers']).items():
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


def _kinds(uavs: Sequence[str], eavesdroppers: Sequence[str]) -> dict[str, type]:
    """Return the type of every topic by name."""
    return {GROUND_NODE_TOPIC: PoseStamped,
            **{pose_topic(name): PoseWithCovarianceStamped for name in eavesdroppers},
            **{pose_topic(name): PoseStamped for name in uavs},
            **{odometry_topic(name): Odometry for name in uavs}}
