"""
A client of the planner and the replay, for programs that plan and fly from Python.

It uses their topics and services like any other program. `node_process` starts a node as a process
of its own, and `isolated` keeps them from other ROS programs.
"""

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import partial
import os
from pathlib import Path
import signal
import socket
import subprocess
import sys
import threading
import time
from typing import Any

from builtin_interfaces.msg import Time as Stamp
from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import PoseStamped, PoseWithCovarianceStamped
from rcl_interfaces.srv import GetParameters
import rclpy
from rclpy.client import Client
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import QoSProfile
from rclpy.task import Future
from sensor_msgs.msg import TimeReference
from std_srvs.srv import Trigger

from . import messages
from .assembly import Assembly
from .topics import LATCHED, STREAM, TOPICS
from ..errors import PlanningError
from ..mission.scenario import Point, Scenario
from ..plan.plan import Plan

_RECEPTION = ('ground_node', 'eavesdroppers', 'reference_snr_db', 'channel', 'colluding')
_REPEAT = 0.2  # s
_PATIENCE = 120.0  # s

# Linux assigns the ports of these domains to no program. Tests and users have lower domains.
_DOMAINS = range(215, 233)


class ClientError(PlanningError, RuntimeError, code='client'):
    """The nodes refuse, or do not answer; the text gives the reason."""


class SecurePlanner:
    """
    Asks the planner for plans and has the replay fly them.

    It is a context manager, within which it is part of the ROS graph; its messages arrive in a
    thread of its own.

    :param scenario: the mission of the nodes, by default the paper's: the names of its members,
        and the positions of the receivers for send_poses.
    :param namespace: of the nodes.
    :param on_status: called with each status of the planner, in the client's thread.
    :ivar status: the values of the last status, by key.
    :ivar last_plan: the last Plan, or None; its receivers are those of the scenario, and its UAVs
        have the smallest limits that the plan keeps.
    :ivar plan_time: the last report of the replay on its plan and the time in it, or None.
    """

    def __init__(self, scenario: Scenario | None = None, namespace: str = '',
                 on_status: Callable[[DiagnosticStatus], object] = lambda message: None) -> None:
        self.scenario = scenario or Scenario.paper()
        self.names = [uav.name for uav in self.scenario.uavs]
        self.status: dict[str, str] = {}
        self.last_plan: Plan | None = None
        self.plan_time: TimeReference | None = None
        self._namespace, self._on_status = namespace, on_status
        self._services: dict[str, Client] = {}
        self._arrived = threading.Condition()
        self._stop = threading.Event()
        self._callback_error: Exception | None = None

    def __enter__(self) -> 'SecurePlanner':
        self._context = Context()
        rclpy.init(context=self._context, args=[])
        self.node = rclpy.create_node(
            'client', context=self._context, namespace=self._namespace)
        self._executor = SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self.node)
        self._ground_node = self.node.create_publisher(PoseStamped, 'ground_node/pose', STREAM)
        self._estimates = {
            name: self.node.create_publisher(PoseWithCovarianceStamped, f'{name}/pose', STREAM)
            for name in self.scenario.eavesdropper_names}
        self._assembly = Assembly(self.names, lambda topic: True)
        for topic, (kind, *_) in TOPICS['replay', 'sub'].items():
            for name in self.names:
                member_topic = topic.replace('<uav>', name)
                self.node.create_subscription(
                    kind, member_topic, partial(self._take, member_topic), LATCHED, raw=True)
        self.receive(DiagnosticStatus, 'planner/status', self._take_status, LATCHED)
        self.receive(TimeReference, 'plan_time', self._take_plan_time)
        self._thread = threading.Thread(target=self._spin, daemon=True)
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._stop.set()
        self._thread.join()
        self._executor.shutdown()
        self.node.destroy_node()
        rclpy.try_shutdown(context=self._context)

    # Services

    def plan(self, timeout: float = _PATIENCE) -> Plan:
        """
        Ask for a plan now, and return the Plan that the planner publishes.

        :param timeout: s after which the solve is cancelled.
        :raises ClientError: with the planner's reason for a refusal.
        """
        before = self.last_plan
        try:
            self.call('planner/plan', timeout)
        except TimeoutError:
            self.cancel()
            raise
        self.wait_until(lambda: self.last_plan is not before, 'the plan')
        assert self.last_plan is not None
        return self.last_plan

    def cancel(self) -> None:
        """Stop the solve under way, which plan() waits for in another thread."""
        self.call('planner/cancel')

    def start(self) -> str:
        """Release the plan, or go on after a pause; return the next state in words."""
        if self.last_plan is not None:
            self.wait_until(lambda: self.plan_time, 'the plan in the replay')
        return self.call('replay/start')

    def pause(self) -> str:
        """Slow down to a rest on the path."""
        return self.call('replay/pause')

    def reset(self) -> str:
        """End the setpoints; the newest plan waits at its start."""
        return self.call('replay/reset')

    def send_poses(self, stamp: Stamp | None = None) -> None:
        """Publish the scenario's positions of the receivers, by default stamped now."""
        self.send_ground_node(self.scenario.ground_node, stamp)
        for name, eavesdropper in zip(
                self._estimates, self.scenario.eavesdroppers, strict=True):
            self.send_estimate(name, eavesdropper.position, stamp=stamp)

    def send_ground_node(self, position: Point, stamp: Stamp | None = None) -> None:
        """Publish the position of the ground node, (x, y) in m."""
        self._ground_node.publish(
            messages.pose_stamped('map', stamp or self._stamp(), *position, 0.0, 0.0))

    def send_estimate(self, name: str, position: Point, deviation: float = 0.0,
                      stamp: Stamp | None = None) -> None:
        """
        Publish the estimate of an eavesdropper, (x, y) in m.

        :param deviation: its standard deviation along each axis in m; 0 leaves the error radius to
            the planner's parameter.
        """
        estimate = PoseWithCovarianceStamped()
        estimate.header.frame_id, estimate.header.stamp = 'map', stamp or self._stamp()
        estimate.pose.pose = messages.pose(*position, 0.0, 0.0)
        estimate.pose.covariance[0] = estimate.pose.covariance[7] = float(deviation)**2
        self._estimates[name].publish(estimate)

    def knows_poses(self, *topics: str) -> bool:
        """Return True if the planner has the poses of all receivers, and of topics."""
        return all(self.status.get(f'pose_age.{topic}', 'none') != 'none' for topic in (
            'ground_node/pose', *(f'{name}/pose' for name in self._estimates), *topics))

    # Waiting and receiving

    def wait_until(self, condition: Callable[[], object], what: str = 'the condition',
                   repeat: Callable[[], object] = lambda: None, timeout: float = _PATIENCE
                   ) -> None:
        """
        Wait until a condition is true, which is asked after each message.

        :param repeat: called at the beginning and every 0.2 s.
        :raises TimeoutError: after the timeout in s.
        """
        until, repeated = time.monotonic() + timeout, 0.0
        while not condition():
            if self._callback_error is not None:
                raise ClientError('a message cannot be used') from self._callback_error
            now = time.monotonic()
            if now > until:
                raise TimeoutError(f'{what} did not come within {timeout:g} s')
            if now - repeated > _REPEAT:
                repeated = now
                repeat()
            with self._arrived:
                self._arrived.wait(0.05)

    def call(self, service: str, timeout: float = _PATIENCE) -> str:
        """
        Call a service of the nodes, once it is there; return its message.

        :raises ClientError: if it fails, with its message.
        :raises TimeoutError: without an answer within the timeout in s.
        """
        if service not in self._services:
            self._services[service] = connect(self.node, Trigger, service, self._ask)
        future = self._services[service].call_async(Trigger.Request())
        self.wait_until(future.done, f'the answer of {service}', timeout=timeout)
        if not future.result().success:
            raise ClientError(f'{service}: {future.result().message}')
        message: str = future.result().message
        return message

    def receive(self, kind: Any, topic: str, call: Callable[..., object],
                qos: QoSProfile = STREAM) -> None:
        """Call a function with each message of a topic, in the client's thread."""
        self.node.create_subscription(kind, topic, call, qos)

    def _ask(self, request: Callable[[], Future], what: str) -> None:
        answers: list[Future] = []
        self.wait_until(lambda: any(answer.done() for answer in answers), what,
                        lambda: answers.append(request()))

    def _stamp(self) -> Stamp:
        return self.node.get_clock().now().to_msg()

    def _take(self, topic: str, message: bytes) -> None:
        self._assembly.take(topic, message, time.monotonic_ns())
        if self._assembly.is_whole():
            self.last_plan, _ = self._assembly.plan(**{
                field: getattr(self.scenario, field) for field in _RECEPTION})

    def _take_plan_time(self, message: TimeReference) -> None:
        self.plan_time = message

    def _take_status(self, message: DiagnosticStatus) -> None:
        self.status = {entry.key: entry.value for entry in message.values}
        self._on_status(message)

    def _spin(self) -> None:
        while not self._stop.is_set():
            try:
                self._executor.spin_once(timeout_sec=0.05)
            except Exception as error:
                self._callback_error = error
            with self._arrived:
                self._arrived.notify_all()


def connect(node: Node, kind: Any, service: str,
            ask: Callable[[Callable[[], Future], str], object]) -> Client:
    """
    Return the client of a service, once the server has discovered it.

    A server drops its answer to an undiscovered client. It discovers clients in their order, so
    that its answer to a later one tells that it has discovered this one.

    :param ask: called with a request and its name; repeats the request until there is an answer.
    """
    client = node.create_client(kind, service)
    later = node.create_client(GetParameters, f'{service.rpartition("/")[0]}/get_parameters')
    ask(lambda: later.call_async(GetParameters.Request()), f'the service {service}')
    return client


@contextmanager
def isolated(out: Path) -> Iterator[None]:
    """Keep the ROS graph on this host and logs in the folder, unless variables are set."""
    os.environ.setdefault('ROS_AUTOMATIC_DISCOVERY_RANGE', 'LOCALHOST')
    os.environ.setdefault('ROS_LOG_DIR', str((out / 'log').resolve()))
    if 'ROS_DOMAIN_ID' in os.environ:
        yield
        return
    with free_domain() as domain:
        os.environ['ROS_DOMAIN_ID'] = str(domain)
        yield


@contextmanager
def free_domain() -> Iterator[int]:
    """Reserve a domain that has no participant, or raise an OSError if all are in use."""
    first = os.getpid() % len(_DOMAINS)
    for domain in (*_DOMAINS[first:], *_DOMAINS[:first]):
        port = 7400 + 250 * domain
        with socket.socket(type=socket.SOCK_STREAM) as reserved, \
                socket.socket(type=socket.SOCK_DGRAM) as probe:
            try:
                # DDS uses UDP only. Demos reserve a domain by binding the TCP port of this number.
                reserved.bind(('127.0.0.1', port))
                # The first participant of a domain binds this UDP port.
                probe.bind(('', port + 10))
            except OSError:
                continue
            probe.close()
            yield domain
            return
    raise OSError(f'the domains {_DOMAINS[0]} to {_DOMAINS[-1]} are taken; '
                  'set ROS_DOMAIN_ID to another one')


@contextmanager
def node_process(name: str, parameters: Sequence[str]) -> Iterator['subprocess.Popen[bytes]']:
    """Run a node in its own process, and stop it with SIGINT, like Ctrl-C."""
    started = subprocess.Popen(
        [sys.executable, '-m', f'secure_uav_planner.ros.{name}', '--ros-args', *parameters],
        start_new_session=True)
    try:
        yield started
    finally:
        started.send_signal(signal.SIGINT)
        try:
            started.wait(timeout=5)
        except subprocess.TimeoutExpired:
            started.kill()
            started.wait()
