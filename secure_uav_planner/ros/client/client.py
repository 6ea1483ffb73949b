"""
A client of the planner and the replay, for programs that plan and fly from Python.

It uses their topics and services like any other program. `node_process` starts a node as a process
of its own.
"""

from collections import deque
from collections.abc import Callable
from contextlib import suppress
import threading
import time
from typing import Any

from builtin_interfaces.msg import Time as Stamp
from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import PoseStamped, PoseWithCovarianceStamped
from nav_msgs.msg import Odometry
from rcl_interfaces.srv import GetParameters
import rclpy
from rclpy.client import Client
from rclpy.context import Context
from rclpy.exceptions import InvalidHandle
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import DurabilityPolicy, QoSProfile
from rclpy.task import Future
from sensor_msgs.msg import TimeReference
from std_msgs.msg import String
from std_srvs.srv import Trigger

from .. import messages
from ..parameters import PLANNER
from ..planner_status import PlannerStatus
from ..topics import LATCHED, member_topics, STREAM
from ...errors import brief, describe_error, OptionError, PlanningError, quote
from ...mission.scenario import Point, Scenario
from ...plan.file import parse_text
from ...plan.plan import Plan

# Latched, and deep: an answer may name any of several plans that arrive together.
_PLANS = QoSProfile(depth=100, durability=DurabilityPolicy.TRANSIENT_LOCAL)

_REPEAT = 0.2  # Period [s] of calls of `repeat` while a call waits.
_TIMEOUT = 120.0  # Default timeout of calls [s].
_MOST_PLANS = 8  # Number of last plans that are kept for answers that arrive later.
_MOST_FAILURES = 20  # Number of last errors of callbacks that are kept for waiting calls.


class ClientError(PlanningError, RuntimeError, code='client'):
    """The nodes refuse, or do not answer; the text gives the reason."""


class SecurePlanner:
    """
    Asks the planner for plans and has the replay fly them.

    It is a context manager and is part of the ROS graph inside its block. Its messages arrive in a
    thread of its own, the client's thread. Calls wait for messages, so they must be made from
    another thread. A call raises a ClientError if a callback, such as `on_status`, fails while it
    waits, and if the block is left meanwhile.

    :param scenario: the mission of the nodes, by default the paper's. The client uses the names of
        its members, and the positions of its receivers for send_poses.
    :param namespace: namespace of the nodes.
    :param on_status: called with each PlannerStatus, in the client's thread.
    :raises ParameterError: for names in the scenario that the nodes refuse.
    :ivar status: the last PlannerStatus; before the first one, its `state` is empty.
    :ivar last_plan: the last Plan of the planner, or None.
    :ivar plan_time: the replay's last report of its plan and the time of that plan, or None.
    """

    def __init__(self, scenario: Scenario | None = None, namespace: str = '',
                 on_status: Callable[[PlannerStatus], object] = lambda status: None) -> None:
        self.scenario = scenario or Scenario.paper()
        self.names = [uav.name for uav in self.scenario.uavs]
        self.status = PlannerStatus()
        self.last_plan: Plan | None = None
        self.plan_time: TimeReference | None = None
        self._receivers = (
            *self.scenario.ground_node_names, *self.scenario.eavesdropper_names)
        # Names that the planner's parameters would refuse are refused here.
        for kind, names in (('uavs', self.names), (
                'ground_nodes', self.scenario.ground_node_names), (
                    'eavesdroppers', self.scenario.eavesdropper_names)):
            PLANNER[kind].convert(kind, [*names])
        self._namespace, self._on_status = namespace, on_status
        self._node: Node | None = None
        self._thread: threading.Thread | None = None
        self._arrived = threading.Condition()  # Notified when messages may have arrived.
        self._stop = threading.Event()  # Set when the block is left.

    def __enter__(self) -> 'SecurePlanner':
        """Join the ROS graph, and receive messages in the client's thread."""
        self._services: dict[str, tuple[Client, Client]] = {}
        self._publishers: dict[str, Publisher] = {}
        self._failures: deque[tuple[float, Exception]] = deque(maxlen=_MOST_FAILURES)
        self._plans: dict[str, Plan] = {}  # The last plans by identity.
        self._plan_problem = ''  # Why the last message on `plan` is not a plan.
        self._stop.clear()
        self._context = Context()
        rclpy.init(context=self._context, args=[])
        self._node = rclpy.create_node(
            'client', context=self._context, namespace=self._namespace)
        self._executor = SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self._node)
        for name in self._receivers:  # Publishers are made early, because discovery takes time.
            for kind in (Odometry, self._pose_kind(name)):
                self._publisher(name, kind)
        self.receive(String, 'plan', self._take_plan, _PLANS)
        self.receive(DiagnosticStatus, 'planner/status', self._take_status, LATCHED)
        self.receive(TimeReference, 'plan_time', self._take_plan_time)
        self._thread = threading.Thread(target=self._spin, daemon=True)
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        """End the client's thread, and leave the ROS graph."""
        node, self._node = self.node, None
        self._stop.set()
        if self._thread is not None:
            self._thread.join()
        self._executor.shutdown()
        node.destroy_node()
        rclpy.try_shutdown(context=self._context)

    @property
    def node(self) -> Node:
        """Return the client's own node, or raise a ClientError outside of the block."""
        if self._node is None:
            raise ClientError('the client is connected only within its block, '
                              '`with SecurePlanner() as planner:`')
        return self._node

    # Services

    def plan(self, timeout: float = _TIMEOUT) -> Plan:
        """
        Ask for a plan now, and return the Plan that answers the request.

        A replan that is published meanwhile is not returned.

        :param timeout: time [s] after which the solve is cancelled.
        :raises ClientError: with the planner's reason for a refusal, or if the planner plans for
            other UAVs than the scenario.
        :raises TimeoutError: without a plan within the timeout.
        """
        until = time.monotonic() + timeout
        cancel, _ = self._clients('planner/cancel')  # Made early, because discovery takes time.
        service = self._find('planner/plan', timeout)
        self._check_names(until)
        answer = service.call_async(Trigger.Request())
        try:
            self._wait(answer.done, until,
                       lambda: f'planner/plan did not answer within {timeout:g} s')
        finally:
            if not answer.done() and not self._stop.is_set():
                cancel.call_async(Trigger.Request())
        identity = self._message('planner/plan', answer).split()[1].rstrip(':')
        self._wait(lambda: identity in self._plans, until,
                   lambda: f'the plan did not come within {timeout:g} s{self._plan_problem}')
        return self._plans[identity]

    def cancel(self) -> None:
        """Stop the present solve, for which plan() waits in another thread."""
        self.call('planner/cancel')

    def start(self) -> str:
        """Release the plan, or resume after a pause; return the next state in words."""
        if self.last_plan is not None:
            self.wait_until(lambda: self.plan_time, 'the plan in the replay')
        return self.call('replay/start')

    def pause(self) -> str:
        """Brake to rest on the path and hold; return the answer in words."""
        return self.call('replay/pause')

    def reset(self) -> str:
        """End the setpoints; the newest plan waits at its start. Return the answer in words."""
        return self.call('replay/reset')

    # Poses

    def send_poses(self, stamp: Stamp | None = None) -> None:
        """Publish the positions of all receivers in the scenario, by default stamped now."""
        for name, receiver in zip(
                self._receivers, (*self.scenario.ground_nodes, *self.scenario.eavesdroppers),
                strict=True):
            self.send_pose(name, receiver.position, stamp)

    def send_ground_node(self, position: Point, stamp: Stamp | None = None) -> None:
        """Publish the position of the first ground node, (x, y) in m."""
        self.send_pose(self._receivers[0], position, stamp)

    def send_pose(self, name: str, position: Point, stamp: Stamp | None = None) -> None:
        """Publish the position (x, y) [m] of a member; an eavesdropper's by send_estimate."""
        if self._pose_kind(name) is PoseStamped:
            self._publisher(name, PoseStamped).publish(messages.pose_stamped(
                'map', stamp or self._stamp(), *position, 0.0, 0.0))
        else:
            self.send_estimate(name, position, stamp=stamp)

    def send_estimate(self, name: str, position: Point, deviation: float = 0.0,
                      stamp: Stamp | None = None) -> None:
        """
        Publish the estimated position (x, y) [m] of an eavesdropper in the frame 'map'.

        :param deviation: standard deviation along each axis [m]. With 0, the planner takes the
            error radius from its parameter.
        """
        estimate = PoseWithCovarianceStamped()
        estimate.header.frame_id, estimate.header.stamp = 'map', stamp or self._stamp()
        estimate.pose.pose = messages.pose(*position, 0.0, 0.0)
        _set_deviation(estimate.pose.covariance, deviation)
        self._publisher(name, PoseWithCovarianceStamped).publish(estimate)

    def send_odometry(self, name: str, position: Point, velocity: Point, deviation: float = 0.0,
                      velocity_deviation: float = 0.0, stamp: Stamp | None = None) -> None:
        """
        Publish position (x, y) [m] and velocity (x, y) [m/s] of a member in the frame 'map'.

        :param deviation: standard deviation of the position along each axis [m]; see
            send_estimate.
        :param velocity_deviation: standard deviation of the velocity along each axis [m/s].
        """
        message = messages.odometry(
            'map', 'map', stamp or self._stamp(), (*position, 0.0), 0.0, velocity)
        _set_deviation(message.pose.covariance, deviation)
        _set_deviation(message.twist.covariance, velocity_deviation)
        self._publisher(name, Odometry).publish(message)

    def knows_poses(self, *topics: str) -> bool:
        """Return True if the planner has a pose or odometry of all receivers and on `topics`."""
        return all(any(map(self.status.has_pose, either)) for either in (
            *map(member_topics, self._receivers), *([topic] for topic in topics)))

    # Waiting and receiving

    def wait_until(self, condition: Callable[[], object], what: str = 'the condition',
                   repeat: Callable[[], object] = lambda: None, timeout: float = _TIMEOUT
                   ) -> None:
        """
        Wait until a condition is true; it is evaluated after each message and every 0.05 s.

        :param what: what is waited for, for the error's text.
        :param repeat: called at the beginning and every 0.2 s.
        :raises TimeoutError: when the condition is not true within the `timeout` [s].
        """
        self._wait(condition, time.monotonic() + timeout,
                   lambda: f'{what} did not come within {timeout:g} s', repeat)

    def call(self, service: str, timeout: float = _TIMEOUT) -> str:
        """
        Wait for a service of the nodes, call it, and return the message of its answer.

        :param service: name of a Trigger service, such as 'replay/start'.
        :raises ClientError: with the message of the answer, if the service refuses.
        :raises TimeoutError: when the service does not answer within the `timeout` [s].
        """
        until = time.monotonic() + timeout
        answer = self._find(service, timeout).call_async(Trigger.Request())
        self._wait(answer.done, until, lambda: f'{service} did not answer within {timeout:g} s')
        return self._message(service, answer)

    def receive(self, kind: Any, topic: str, call: Callable[[Any], None],
                qos: QoSProfile = STREAM) -> None:
        """Call a function with each message of a topic, in the client's thread."""
        self.node.create_subscription(kind, topic, call, qos)

    def _clients(self, service: str) -> tuple[Client, Client]:
        node = self.node
        if service not in self._services:
            self._services[service] = make_clients(node, Trigger, service)
        return self._services[service]

    def _check_names(self, until: float) -> None:
        """Wait for the planner's status; raise a ClientError if it lacks a UAV of the scenario."""
        self._wait(lambda: self.status.state, until,
                   lambda: 'the status of the planner did not come')
        members = {topic.partition('/')[0] for topic in self.status.pose_age}
        others = sorted(members - {*self._receivers, *self.names})
        if not members.issuperset(self.names):
            raise ClientError(
                f'the scenario of this client has the UAVs {", ".join(self.names)}, and the '
                f'planner has {", ".join(others) or "not all"}; give both the same mission')

    def _find(self, service: str, timeout: float) -> Client:
        """Return the client of a service, once the service has discovered it; see make_clients."""
        until, answers = time.monotonic() + timeout, list[Future]()
        client, second_client = self._clients(service)
        # The service is awaited at each call, because the node may have been started again.
        self._wait(
            lambda: any(answer.done() for answer in answers), until, lambda: (
                f'the service {service} did not come within {timeout:g} s; is the node '
                f'{service.rpartition("/")[0]} running, with the namespace and the ROS_DOMAIN_ID '
                'of this program?'),
            lambda: answers.append(second_client.call_async(GetParameters.Request())))
        return client

    @staticmethod
    def _message(service: str, answer: Future) -> str:
        """Return the message of an answer, or raise it as a ClientError if it is a refusal."""
        message: str = answer.result().message
        if not answer.result().success:
            raise ClientError(f'{service}: {message}')
        return message

    def _wait(self, condition: Callable[[], object], until: float, late: Callable[[], str],
              repeat: Callable[[], object] = lambda: None) -> None:
        """
        Wait for a condition until a time `until` [s] of time.monotonic.

        :param late: returns the text of the TimeoutError.
        :param repeat: called at the beginning and every _REPEAT [s].
        :raises ClientError: in the client's thread, after a failed callback, or if the block ends.
        """
        if threading.current_thread() is self._thread:
            raise ClientError("this call waits for messages, which arrive in the client's thread, "
                              'that of on_status; it must be in another thread')
        began, repeated = time.monotonic(), 0.0
        while self.node and not condition():
            failure = next((error for at, error in [*self._failures] if at >= began), None)
            if failure is not None:
                raise ClientError(
                    f'a callback failed: {describe_error(failure)}') from failure
            now = time.monotonic()
            if now > until:
                raise TimeoutError(late())
            if now - repeated > _REPEAT:
                repeated = now
                with suppress(InvalidHandle):  # The block has just been left.
                    repeat()
            with self._arrived:
                self._arrived.wait(0.05)

    def _pose_kind(self, name: str) -> type[PoseStamped] | type[PoseWithCovarianceStamped]:
        """Return the pose class of a member; raise a ClientError for an unknown name."""
        members = *self._receivers, *self.names
        if name not in members:
            raise ClientError(f'there is no member {quote(name)}; there are {", ".join(members)}')
        return (PoseWithCovarianceStamped if name in self.scenario.eavesdropper_names
                else PoseStamped)

    def _publisher(self, name: str, kind: Any) -> Publisher:
        """Return a member's publisher of Odometry or of its pose class; refuse another class."""
        node, topic = self.node, f'{name}/{"odom" if kind is Odometry else "pose"}'
        if kind not in (Odometry, self._pose_kind(name)):
            raise ClientError(f'{name} is no eavesdropper')
        if topic not in self._publishers:
            self._publishers[topic] = node.create_publisher(kind, topic, STREAM)
        return self._publishers[topic]

    def _stamp(self) -> Stamp:
        return self.node.get_clock().now().to_msg()

    def _take_plan(self, message: String) -> None:
        """Keep a message's plan among the last _MOST_PLANS; note why, if it is not a plan."""
        try:
            (plan, _), self._plan_problem = parse_text(message.data, Plan), ''
        except PlanningError as error:
            self._plan_problem = f'; {brief(error)}'
            return
        self._plans[plan.identity] = self.last_plan = plan
        while len(self._plans) > _MOST_PLANS:
            del self._plans[next(iter(self._plans))]

    def _take_plan_time(self, message: TimeReference) -> None:
        self.plan_time = message

    def _take_status(self, message: DiagnosticStatus) -> None:
        """Keep the status in a message, and call on_status; ignore any other message."""
        try:
            self.status = PlannerStatus.from_message(message)
        except OptionError:
            return
        self._on_status(self.status)

    def _spin(self) -> None:
        """Run callbacks until the client stops, keep their errors, and wake waiting methods up."""
        node = self.node
        while not self._stop.is_set():
            try:
                self._executor.spin_once(timeout_sec=0.05)
            except Exception as error:
                self._failures.append((time.monotonic(), error))
                node.get_logger().error(f'a callback failed: {describe_error(error)}')
            with self._arrived:
                self._arrived.notify_all()


def _set_deviation(covariance: Any, deviation: float) -> None:
    """Set the variances of x and y in the 36 values of a covariance."""
    covariance[0] = covariance[7] = float(deviation)**2


def make_clients(node: Node, kind: Any, service: str) -> tuple[Client, Client]:
    """
    Return the client of a service, and a client of its node's get_parameters.

    A server drops its answer to a client that it has not discovered. It discovers clients in the
    order of their creation. So once it answers the second client, the first one can be used.
    """
    return node.create_client(kind, service), node.create_client(
        GetParameters, f'{service.rpartition("/")[0]}/get_parameters')
