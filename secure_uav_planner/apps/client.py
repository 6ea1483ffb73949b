"""A client of the planner and the replay node, which uses their topics like any other program."""

from collections.abc import Callable
import math
import time
from typing import Any

from builtin_interfaces.msg import Time as Stamp
from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import PoseStamped, PoseWithCovarianceStamped
from nav_msgs.msg import Path
import rclpy
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.qos import QoSProfile
from std_msgs.msg import Float64MultiArray
from std_srvs.srv import Trigger

from ..errors import PlanningError
from ..mission.scenario import Scenario
from ..ros import messages
from ..ros.topics import LATCHED, STREAM

_ASK_AGAIN = 0.2  # s
_PATIENCE = 120.0


class ClientError(PlanningError, RuntimeError):
    """The nodes do not answer as expected; the text gives the reason."""

    code = 'client'


class Client:
    """
    Sends the poses of those on the ground, and receives plans and the planner's status.

    It is a context, in which it is part of the ROS graph.

    :param scenario: the mission. Poses have no covariance: the node has the error radii.
    :ivar paths: the nav_msgs/Path of each UAV by its name, a list of all that have come.
    :ivar powers: likewise.
    :ivar status: the values of the planner's status, by key.
    """

    def __init__(self, scenario: Scenario) -> None:
        self.scenario = scenario
        self.names = [uav.name for uav in scenario.uavs]
        self.paths: dict[str, list[Path]] = {name: [] for name in self.names}
        self.powers: dict[str, list[Float64MultiArray]] = {name: [] for name in self.names}
        self.status: dict[str, str] = {}

    def __enter__(self) -> 'Client':
        self._context = Context()
        rclpy.init(context=self._context, args=[])
        self.node = rclpy.create_node('client', context=self._context)
        self._executor = SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self.node)
        self._ground_node = self.node.create_publisher(PoseStamped, 'ground_node/pose', STREAM)
        self._estimates = {
            name: self.node.create_publisher(PoseWithCovarianceStamped, f'{name}/pose', STREAM)
            for name in self.scenario.eavesdropper_names}
        for name in self.names:
            self.receive(Path, f'{name}/path', self.paths[name].append, LATCHED)
            self.receive(Float64MultiArray, f'{name}/power', self.powers[name].append, LATCHED)
        self.receive(DiagnosticStatus, 'planner/status', self.take_status, LATCHED)
        return self

    def __exit__(self, *_: object) -> None:
        self._executor.shutdown()
        self.node.destroy_node()
        rclpy.try_shutdown(context=self._context)

    def receive(self, kind: Any, topic: str, call: Callable[[Any], object],
                qos: QoSProfile = STREAM) -> None:
        """Call a function with every message of a topic."""
        self.node.create_subscription(kind, topic, call, qos)

    def take_status(self, message: DiagnosticStatus) -> None:
        """Keep the values of a status."""
        self.status = {entry.key: entry.value for entry in message.values}

    def knows_poses(self, *topics: str) -> bool:
        """Return whether the planner knows who is on the ground, and the poses of topics."""
        return all(self.status.get(f'pose_age.{topic}', 'none') != 'none' for topic in (
            'ground_node/pose', *(f'{name}/pose' for name in self._estimates), *topics))

    def send_poses(self, stamp: Stamp | None = None) -> None:
        """Publish where those on the ground are, by default now."""
        stamp = stamp or self.node.get_clock().now().to_msg()
        self._ground_node.publish(
            messages.pose_stamped('map', stamp, *self.scenario.ground_node, 0.0, 0.0))
        for eve, publisher in zip(
                self.scenario.eavesdroppers, self._estimates.values(), strict=True):
            estimate = PoseWithCovarianceStamped()
            estimate.header.frame_id, estimate.header.stamp = 'map', stamp
            estimate.pose.pose = messages.pose(*eve.position, 0.0, 0.0)
            publisher.publish(estimate)

    def wait(self, condition: Callable[[], object], what: str,
             ask: Callable[[], object] = lambda: None) -> None:
        """
        Receive messages until a condition is true.

        :param ask: called at the beginning, and again and again until then.
        :raises ClientError: if that takes too long.
        """
        until, asked = time.monotonic() + _PATIENCE, -math.inf
        while not condition():
            if time.monotonic() > until:
                raise ClientError(f'{what} did not come within {_PATIENCE:g} s')
            if time.monotonic() - asked > _ASK_AGAIN:
                asked = time.monotonic()
                ask()
            self._executor.spin_once(timeout_sec=0.05)

    def call(self, service: str) -> None:
        """
        Call a service of the nodes, once it is there.

        :raises ClientError: if it fails, with its message.
        """
        client = self.node.create_client(Trigger, service)
        self.wait(client.service_is_ready, f'the service {service}')
        future = client.call_async(Trigger.Request())
        self.wait(future.done, f'the answer of {service}')
        if not future.result().success:
            raise ClientError(f'{service}: {future.result().message}')
