"""Simulated time for the nodes, faster than real, and what happens in it."""

import threading

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from nav_msgs.msg import Path
from rclpy.qos import DurabilityPolicy, QoSProfile
from ros_client import places_of, stamp_at, values_of
from rosgraph_msgs.msg import Clock
from secure_uav_planner import Plan
from std_msgs.msg import Float64MultiArray

DEEP = QoSProfile(depth=1000, durability=DurabilityPolicy.TRANSIENT_LOCAL)


class SimulatedTime:
    """
    A /clock that can be stopped and set; it runs faster than real time.

    :ivar jumps: what it was and what it was set to, every time.
    """

    _step = 0.01

    def __init__(self, client, start=0.0, speedup=10.0):
        self.now, self.running, self.jumps = start, True, []
        self._publisher = client.node.create_publisher(Clock, '/clock', 10)
        self._speedup = speedup
        self._lock = threading.Lock()
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)

    def __enter__(self):
        self._thread.start()
        return self

    def __exit__(self, *_):
        self._stop.set()
        self._thread.join()

    def _run(self):
        while not self._stop.wait(self._step):
            if self.running:
                with self._lock:
                    self._go_on()
                self._publisher.publish(Clock(clock=self.stamp()))

    def _go_on(self):
        self.now += self._step * self._speedup

    def stamp(self):
        return stamp_at(self.now)

    def jump(self, now):
        with self._lock:
            self.jumps.append((self.now, now))
            self.now = now


class Simulation(SimulatedTime):
    """
    Simulated time, faster than real, and the estimate of an eavesdropper who walks.

    It stands while the planner solves, which takes real time, however much of it.

    :param where: returns the position of the eavesdropper at a time.
    :param advance: called with the time whenever that has gone on.
    """

    _step = 0.02

    def __init__(self, client, where, speedup, advance=lambda now: None):
        super().__init__(client, 1000.0, speedup)
        self._client, self._where, self._advance = client, where, advance
        # The diagnostics, too: a replan that has been superseded says nothing in the status.
        self._received = client.listen(DiagnosticStatus, 'planner/status')
        client.node.create_subscription(
            DiagnosticArray, '/diagnostics',
            lambda message: self._received.extend(message.status), 10)

    def _go_on(self):
        if not self._received or values_of(self._received[-1])['state'] == 'idle':
            super()._go_on()
            self._advance(self.now)

    def send_estimate(self):
        x, y = self._where(self.now)
        self._client.send_estimate(
            'eavesdropper/pose', x, y, stamp=self.stamp(), until_known=False)


def received(client):
    return ([client.listen(Path, f'{name}/path', DEEP) for name in ('uav1', 'uav2')],
            [client.listen(Float64MultiArray, f'{name}/power', DEEP)
             for name in ('uav1', 'uav2')])


def plan_of(scenario, paths, powers, index):
    return Plan(scenario, [places_of(path[index]) for path in paths],
                [power[index].data for power in powers])
