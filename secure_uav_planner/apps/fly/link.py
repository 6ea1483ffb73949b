"""
The simulated time of a flight, and what the nodes send in it over DDS.

This process publishes /clock, and goes on by a step when the setpoints of the step before have
come. So a flight is the same however fast the machine is, and no setpoint comes earlier or later
than it would in real time; the transport itself takes no time.
"""

from collections import Counter
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager
import math
import time

from builtin_interfaces.msg import Time as Stamp
from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import PoseStamped, PoseWithCovarianceStamped
from nav_msgs.msg import Odometry, Path
import rclpy
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.time import Time
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import TimeReference
from std_srvs.srv import Trigger
from trajectory_msgs.msg import MultiDOFJointTrajectory

from ...errors import PlanningError
from ...output.autopilots import Setpoint
from ...ros import messages
from ...ros.graph import node_process
from ...ros.topics import LATCHED, STREAM

RATE = 25.0
"""Setpoints per second."""

STEP_NS = round(1e9 / RATE)
"""The clock goes on by so many ns at a time."""

BEGIN_NS = 10**9
"""The first time of the clock."""

_ASK_AGAIN = 0.2  # s after which the clock is published again; its QoS is best effort
_PATIENCE = 120.0
_COUNTS = ('plans', 'replans', 'refusals')


class FlightError(PlanningError, RuntimeError):
    """A flight cannot go on; the text gives the reason."""

    code = 'flight'


def node(name: str, **parameters: object) -> AbstractContextManager[object]:
    """Return the context of a node's process in simulated time; dots are __ in parameters."""
    return node_process(name, ['-p', 'use_sim_time:=true', *(
        word for key, value in parameters.items()
        for word in ('-p', f'{key.replace("__", ".")}:={value}'))])


class Link:
    """
    Publishes /clock and receives the setpoints of every UAV, within a with block.

    :param names: of the UAVs.
    """

    def __init__(self, names: Sequence[str]) -> None:
        self._names = names
        self.received: dict[str, Setpoint] = {}

    def __enter__(self) -> 'Link':
        self._context = Context()
        rclpy.init(context=self._context, args=[])
        self._node = rclpy.create_node('fly', context=self._context)
        self._executor = SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self._node)
        self._connect()
        self.wait(self._is_connected, 'the replay node')
        return self

    def __exit__(self, *_: object) -> None:
        self._executor.shutdown()
        self._node.destroy_node()
        rclpy.try_shutdown(context=self._context)

    def _connect(self) -> None:
        self._clock = self._node.create_publisher(Clock, '/clock', STREAM)
        for name in self._names:
            self._node.create_subscription(
                MultiDOFJointTrajectory, f'{name}/setpoint/trajectory',
                lambda message, name=name: self.received.update(
                    {name: messages.setpoint_of(message)}),
                STREAM)

    def _is_connected(self) -> bool:
        counts = [self._node.count_publishers(f'{name}/setpoint/trajectory')
                  for name in self._names]
        if max(counts) > 1:
            raise FlightError(f'{max(counts)} nodes of this ROS domain publish setpoints; set '
                              'ROS_DOMAIN_ID to another one')
        return all(counts) and self._clock.get_subscription_count() > 0

    def setpoints(self, now_ns: int) -> list[Setpoint]:
        """Return the setpoint of every UAV at a time, which this process makes the present."""
        self.go_on(now_ns, lambda: self._has_setpoints(now_ns))
        return [self.received[name] for name in self._names]

    def _has_setpoints(self, now_ns: int) -> bool:
        return all(name in self.received and self.received[name].time_ns == now_ns
                   for name in self._names)

    def go_on(self, now_ns: int, have_come: Callable[[], bool]) -> None:
        """Make a time in ns the present, and wait for what comes of that."""
        self.wait(have_come, f'the setpoints at {now_ns * 1e-9:g} s',
                  lambda: self.publish_clock(now_ns))

    def publish_clock(self, now_ns: int) -> None:
        """Make a time in ns the present."""
        self._clock.publish(Clock(clock=Stamp(sec=now_ns // 10**9, nanosec=now_ns % 10**9)))

    def wait(self, condition: Callable[[], object], what: str,
             ask: Callable[[], object] = lambda: None) -> None:
        """
        Receive messages until a condition is true.

        :param ask: called at the beginning, and again and again until then.
        :raises FlightError: if that takes too long.
        """
        until, asked = time.monotonic() + _PATIENCE, -math.inf
        while not condition():
            if time.monotonic() > until:
                raise FlightError(f'{what} did not come within {_PATIENCE:g} s')
            if time.monotonic() - asked > _ASK_AGAIN:
                asked = time.monotonic()
                ask()
            self._executor.spin_once(timeout_sec=0.05)


class NodesLink(Link):
    """
    What the two nodes publish, and what a user and the vehicles send.

    :param scenario: the mission; of its one eavesdropper the node knows the error radius.
    :ivar paths: all nav_msgs/Path of each UAV.
    :ivar plan_time: the last sensor_msgs/TimeReference of the replay, or None.
    :ivar status: the values of the planner's status, by key.
    :ivar warnings: how many times that was not OK, by its text.
    :ivar is_solving: whether the planner solves, or has not said yet what has come of it.
    """

    def __init__(self, scenario):
        super().__init__([uav.name for uav in scenario.uavs])
        self.paths = [[] for _ in self._names]
        self.plan_time, self.status, self.warnings = None, {}, Counter()
        self.is_solving, self._settled = False, None
        self._scenario = scenario

    def _connect(self):
        super()._connect()
        make = self._node.create_publisher
        self._odometry = [make(Odometry, f'{name}/odom', STREAM) for name in self._names]
        self._ground_node = make(PoseStamped, 'ground_node/pose', STREAM)
        self._estimate = make(PoseWithCovarianceStamped, 'eavesdropper/pose', STREAM)
        self._services = {name: self._node.create_client(Trigger, name) for name in (
            'planner/plan', 'replay/start', 'replay/pause')}
        receive = self._node.create_subscription
        for name, paths in zip(self._names, self.paths, strict=True):
            receive(Path, f'{name}/path', paths.append, LATCHED)
        receive(DiagnosticStatus, 'planner/status', self._take_status, LATCHED)
        receive(TimeReference, 'plan_time',
                lambda message: setattr(self, 'plan_time', message), STREAM)

    def _is_connected(self):
        return super()._is_connected() and self._clock.get_subscription_count() > 1 and all(
            service.service_is_ready() for service in self._services.values())

    def _take_status(self, message):
        self.status = {entry.key: entry.value for entry in message.values}
        if message.level != DiagnosticStatus.OK:
            self.warnings[message.message] += 1
        counts = [self.status[key] for key in _COUNTS]
        if self.status['state'] == 'solving':
            self.is_solving = True
        elif not self.is_solving or counts != self._settled:
            self.is_solving, self._settled = False, counts

    def knows_poses(self):
        """Return whether the planner knows where everybody is."""
        return all(self.status.get(f'pose_age.{topic}', 'none') != 'none' for topic in (
            'ground_node/pose', 'eavesdropper/pose', *(f'{name}/odom' for name in self._names)))

    def has_come_to(self, now_ns):
        """Return whether the replay has come to a time in ns with all that it sends."""
        return messages.nanoseconds(self.plan_time.header.stamp) == now_ns and (
            not self.received or self._has_setpoints(now_ns))

    def call(self, service):
        """
        Call a service.

        :raises FlightError: if it fails, with its message.
        """
        future = self._services[service].call_async(Trigger.Request())
        self.wait(future.done, f'the answer of {service}')
        if not future.result().success:
            raise FlightError(f'{service}: {future.result().message}')

    def report(self, now_ns, vehicles):
        """Publish where everybody is at a time in ns."""
        stamp = Time(nanoseconds=now_ns).to_msg()
        self._ground_node.publish(
            messages.pose_stamped('map', stamp, *self._scenario.ground_node, 0.0, 0.0))
        estimate = PoseWithCovarianceStamped()
        estimate.header.frame_id, estimate.header.stamp = 'map', stamp
        eavesdropper, = self._scenario.eavesdroppers
        estimate.pose.pose = messages.pose(*eavesdropper.position, 0.0, 0.0)
        self._estimate.publish(estimate)
        for name, publisher, vehicle in zip(self._names, self._odometry, vehicles, strict=True):
            publisher.publish(messages.odometry(
                'map', f'{name}/base_link', stamp, vehicle.place, 0.0, vehicle.velocity[:2]))
