"""
The simulated time of a flight, and what the nodes send in it over DDS.

This process publishes /clock, and advances it by a step after the setpoints of the step before.
So a flight is the same however fast the machine is, no setpoint is earlier or later than in real
time, and the transport itself takes no time.
"""

from collections import Counter
from contextlib import AbstractContextManager

from diagnostic_msgs.msg import DiagnosticStatus
from nav_msgs.msg import Odometry
from rclpy.time import Time
from rosgraph_msgs.msg import Clock
from secure_uav_planner.ros import messages
from secure_uav_planner.ros.client import ClientError, node_process, SecurePlanner
from secure_uav_planner.ros.topics import STREAM
from trajectory_msgs.msg import MultiDOFJointTrajectory

RATE = 25.0
"""Setpoints per second."""

STEP_NS = round(1e9 / RATE)
"""The step of the clock in ns."""

BEGIN_NS = 10**9
"""The first time of the clock."""


def node(name: str, **parameters: object) -> AbstractContextManager[object]:
    """Return the context of a node's process in simulated time."""
    return node_process(name, ['-p', 'use_sim_time:=true', *(
        word for key, value in parameters.items() for word in ('-p', f'{key}:={value}'))])


class Link(SecurePlanner):
    """
    Publishes /clock and the state of the vehicles, and receives the setpoints of each UAV.

    :param nodes: the number of nodes with this clock.
    :ivar setpoints: the last Setpoint of each UAV by its name.
    :ivar warnings: counts of the planner's status that was not OK, by its text.
    :ivar is_solving: True while the planner solves.
    """

    def __init__(self, scenario, nodes):
        super().__init__(scenario, on_status=self._note_status)
        self.setpoints, self.warnings = {}, Counter()
        self.is_solving, self._nodes = False, nodes

    def __enter__(self):
        super().__enter__()
        make = self.node.create_publisher
        self._clock = make(Clock, '/clock', STREAM)
        self._odometry = {name: make(Odometry, f'{name}/odom', STREAM) for name in self.names}
        for name in self.names:
            self.receive(MultiDOFJointTrajectory, f'{name}/setpoint/trajectory',
                         lambda message, name=name: self.setpoints.update(
                             {name: messages.read_setpoint(message)}))
        self.wait_until(self._is_connected, 'a node')
        return self

    def _is_connected(self):
        counts = [self.node.count_publishers(f'{name}/setpoint/trajectory')
                  for name in self.names]
        if max(counts) > 1:
            raise ClientError(f'{max(counts)} nodes of this ROS domain publish setpoints; set '
                              'ROS_DOMAIN_ID to another one')
        return all(counts) and self._clock.get_subscription_count() >= self._nodes

    def _note_status(self, status):
        """Count warnings, and update is_solving."""
        if status.level != DiagnosticStatus.OK:
            self.warnings[status.text] += 1
        self.is_solving = status.state == 'solving'

    def has_come_to(self, now_ns):
        """Return True if the replay has sent all messages of a time in ns."""
        return self.plan_time and messages.nanoseconds(
            self.plan_time.header.stamp) == now_ns and len(self.setpoints) in (
            0, len(self.names)) and all(
                setpoint.time_ns == now_ns for setpoint in [*self.setpoints.values()])

    def publish_clock(self, now_ns):
        """Set the clock to a time in ns."""
        self._clock.publish(Clock(clock=Time(nanoseconds=now_ns).to_msg()))

    def report(self, now_ns, vehicles):
        """Publish poses and odometry at a time in ns."""
        stamp = Time(nanoseconds=now_ns).to_msg()
        self.send_poses(stamp)
        for (name, publisher), vehicle in zip(self._odometry.items(), vehicles, strict=True):
            publisher.publish(messages.odometry(
                'map', f'{name}/base_link', stamp, vehicle.place, 0.0, vehicle.velocity[:2]))
