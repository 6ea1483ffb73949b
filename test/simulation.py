"""Simulated time for the nodes, faster than real, and what happens in it."""

import threading

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from nav_msgs.msg import Path
from rclpy.qos import DurabilityPolicy, QoSProfile
from ros_client import values_of
from rosgraph_msgs.msg import Clock
from secure_uav_planner import Plan
from std_msgs.msg import Float64MultiArray

DEEP = QoSProfile(depth=1000, durability=DurabilityPolicy.TRANSIENT_LOCAL)


class Simulation:
    """
    Simulated time, faster than real, and the estimate of an eavesdropper who walks.

    It stands while the planner solves, which takes real time, however much of it.

    :param where: returns the position of the eavesdropper at a time.
    :param advance: called with the time whenever that has gone on.
    """

    def __init__(self, client, where, speedup, advance=lambda now: None):
        self.now = 1000.0
        self._client, self._where, self._speedup = client, where, speedup
        self._advance = advance
        self._clock = client.node.create_publisher(Clock, '/clock', 10)
        # The diagnostics, too: a replan that has been superseded says nothing in the status.
        self._received = client.listen(DiagnosticStatus, 'planner/status')
        client.node.create_subscription(
            DiagnosticArray, '/diagnostics',
            lambda message: self._received.extend(message.status), 10)
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def _run(self):
        while not self._stop.wait(0.02):
            if not self._received or values_of(self._received[-1])['state'] == 'idle':
                self.now += 0.02 * self._speedup
                self._advance(self.now)
            self._clock.publish(Clock(clock=self.stamp()))

    def send_estimate(self):
        x, y = self._where(self.now)
        self._client.send_estimate(
            'eavesdropper/pose', x, y, stamp=self.stamp(), until_known=False)

    def stamp(self):
        message = Clock()
        message.clock.sec, message.clock.nanosec = int(self.now), int(self.now % 1 * 1e9)
        return message.clock

    def close(self):
        self._stop.set()
        self._thread.join()


def received(client):
    return ([client.listen(Path, f'{name}/path', DEEP) for name in ('uav1', 'uav2')],
            [client.listen(Float64MultiArray, f'{name}/power', DEEP)
             for name in ('uav1', 'uav2')])


def plan_of(scenario, paths, powers, index):
    return Plan(scenario, [[(at.pose.position.x, at.pose.position.y)
                            for at in path[index].poses] for path in paths],
                [power[index].data for power in powers])
