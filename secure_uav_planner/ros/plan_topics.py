"""The transient-local topics of the last plan."""

from collections.abc import Sequence
from typing import Any, NamedTuple

from nav_msgs.msg import Path
from rclpy.node import Node
from rclpy.publisher import Publisher
from std_msgs.msg import Float64MultiArray
from trajectory_msgs.msg import MultiDOFJointTrajectory
from visualization_msgs.msg import MarkerArray

from . import cdr, messages
from .qos import LATCHED, OVERRIDABLE
from ..plan.plan import Plan


class Outgoing(NamedTuple):
    """A message, as an object or serialised in CDR, and its publisher."""

    publisher: Publisher
    message: Any


class PlanTopics:
    """
    The publishers of a plan.

    :param node: the Node that publishes.
    :param uavs: the names of the UAVs.
    """

    def __init__(self, node: Node, uavs: Sequence[str]) -> None:
        def latched(kind: type, topic: str) -> Publisher:
            return node.create_publisher(kind, topic, LATCHED, qos_overriding_options=OVERRIDABLE)

        self._paths = [latched(Path, f'{name}/path') for name in uavs]
        self._powers = [latched(Float64MultiArray, f'{name}/power') for name in uavs]
        self._trajectories = [
            latched(MultiDOFJointTrajectory, f'{name}/trajectory') for name in uavs]
        self._markers = latched(MarkerArray, '~/markers')

    def is_followed(self) -> bool:
        """Return whether anybody receives paths or trajectories, and so may fly by them."""
        return any(publisher.get_subscription_count()
                   for publisher in (*self._paths, *self._trajectories))

    def made(self, plan: Plan, frame_id: str) -> list[Outgoing]:
        """Return all messages of a plan; publish() then sends all of them."""
        found = [Outgoing(publisher, cdr.path(plan, index, frame_id))
                 for index, publisher in enumerate(self._paths)]
        found += [Outgoing(publisher, messages.power(plan, index))
                  for index, publisher in enumerate(self._powers)]
        found += [Outgoing(publisher, cdr.trajectory(plan, index, frame_id))
                  for index, publisher in enumerate(self._trajectories)]
        return [*found, Outgoing(self._markers, messages.markers(plan, frame_id))]


def publish(outgoing: Sequence[Outgoing]) -> None:
    """Publish the messages of a plan."""
    for publisher, message in outgoing:
        publisher.publish(message)
