"""
The simulated time of a flight, and what the nodes send in it over DDS.

This process publishes /clock, and goes on by a step when the setpoints of the step before have
come. So a flight is the same however fast the machine is, and no setpoint comes earlier or later
than it would in real time; the transport itself takes no time.
"""

from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager
import math
import time

from builtin_interfaces.msg import Time as Stamp
import rclpy
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rosgraph_msgs.msg import Clock
from trajectory_msgs.msg import MultiDOFJointTrajectory

from ...errors import PlanningError
from ...output.autopilots import Setpoint
from ...ros.graph import node_process
from ...ros.messages import setpoint_of
from ...ros.topics import STREAM

RATE = 25.0
"""Setpoints per second."""

STEP_NS = round(1e9 / RATE)
"""The clock goes on by so many ns at a time."""

BEGIN_NS = 10**9
"""The first time of the clock."""

_ASK_AGAIN = 0.2  # s after which the clock is published again; its QoS is best effort
_PATIENCE = 120.0


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
                lambda message, name=name: self.received.update({name: setpoint_of(message)}),
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
        self.go_on(now_ns, lambda: all(
            name in self.received and self.received[name].time_ns == now_ns
            for name in self._names))
        return [self.received[name] for name in self._names]

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
