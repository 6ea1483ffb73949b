"""Simulated time for the nodes, faster than real, what happens in it, and jumps of setpoints."""

import math
from random import Random
import threading

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from nav_msgs.msg import Odometry, Path
import numpy as np
from rclpy.qos import DurabilityPolicy, QoSProfile
from ros_client import places_of, seconds, stamp_at
from rosgraph_msgs.msg import Clock
from secure_uav_planner import Plan
from secure_uav_planner.plan.tracking import GAIN
from secure_uav_planner.ros import messages
from secure_uav_planner.ros.planner_status import PlannerStatus
from std_msgs.msg import Float64MultiArray
from trajectory_msgs.msg import MultiDOFJointTrajectory

SPEED, ACCELERATION = 10.0, 2.0  # Largest ones of setpoints that do not jump [m/s, m/s^2].
ALLOWANCE, VELOCITY_ALLOWANCE = 0.011, 0.02  # What they may exceed those by [m, m/s].
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
    Simulated time, faster than real, which stands while the planner solves in real time.

    :param advance: called with the time whenever that has gone on.
    """

    _step = 0.02

    def __init__(self, client, advance, speedup):
        super().__init__(client, 1000.0, speedup)
        self._advance = advance
        # The diagnostics, too: a replan that has been superseded says nothing in the status.
        self._received = client.listen(DiagnosticStatus, 'planner/status')
        client.node.create_subscription(
            DiagnosticArray, '/diagnostics',
            lambda message: self._received.extend(message.status), 10)

    def forget_solve(self):
        """Go on though the planner has ended during a solve."""
        self._received.clear()

    def _go_on(self):
        if not self._received or PlannerStatus.from_message(
                self._received[-1]).state == 'idle':
            super()._go_on()
            self._advance(self.now)


def follow(place, velocity, target, target_velocity, acceleration, step, most_speed=math.inf):
    """
    Return place and velocity of a vehicle that follows a setpoint by the law of common autopilots.

    :param acceleration: the vehicle's limit in m/s^2.
    :param step: time in s.
    :param most_speed: the vehicle's limit in m/s.
    """
    offset = target - place
    distance = math.hypot(*offset)
    closing = min(GAIN * distance, math.sqrt(2 * acceleration * distance)) / max(distance, 1e-9)
    wanted = target_velocity + closing * offset
    wanted *= min(1.0, most_speed / max(math.hypot(*wanted), 1e-9))
    change = wanted - velocity
    velocity = velocity + change * min(
        1.0, acceleration * step / max(math.hypot(*change), 1e-9))
    return place + step * velocity, velocity


class Receiver:
    """A receiver that drives, and whose odometry need not be true: it lies in one of `lies`."""

    lies = ('none', 'none', 'none', 'silence', 'standing', 'jumps', 'covariance')

    def __init__(self, client, name, place):
        self._name, self._place, self._rng = name, np.array(place), Random(name)
        self._publisher = client.node.create_publisher(Odometry, f'{name}/odom', 10)
        self.drive()

    def drive(self, speed=0.0, heading=0.0, turn=0.0, lie='none'):
        """Drive in m/s, rad and rad/s, and lie from now on."""
        self._speed, self._heading, self._turn, self._lie = speed, heading, turn, lie

    def go_on(self, stamp, step):
        """Let a step in s go by, and report."""
        self._heading += step * self._turn
        velocity = self._speed * np.array([math.cos(self._heading), math.sin(self._heading)])
        self._place = place = self._place + step * velocity
        variances = [1.0, 0.01]  # Of position and velocity.
        if self._lie == 'silence':
            return
        if self._lie == 'standing':
            velocity = np.zeros(2)
        elif self._lie == 'jumps':
            place = place + [self._rng.uniform(-300, 300), self._rng.uniform(-300, 300)]
        elif self._lie == 'covariance':
            variances = self._rng.choices([-1.0, 0.0, 1e14, 1e16, math.inf, math.nan], k=2)
        message = messages.odometry('map', self._name, stamp, (*place, 0.0), 0.0, velocity)
        for part, variance in zip((message.pose, message.twist), variances):
            part.covariance[0] = part.covariance[7] = variance
        self._publisher.publish(message)


class Setpoints:
    """
    The setpoints that UAVs get.

    :ivar rows: of each UAV: epoch, time [s], position (x, y, z) [m] and velocity (x, y) [m/s].
    :ivar epoch: number that a test changes where the stream may begin elsewhere.
    """

    def __init__(self, client, names):
        self.epoch, self.rows = 0, {name: [] for name in names}
        for name in names:
            client.node.create_subscription(
                MultiDOFJointTrajectory, f'{name}/setpoint/trajectory',
                lambda message, name=name: self._take(name, message), 1000)

    def _take(self, name, message):
        at, = message.points
        place, velocity = at.transforms[0].translation, at.velocities[0].linear
        self.rows[name].append((self.epoch, seconds(message.header.stamp), place.x, place.y,
                                place.z, velocity.x, velocity.y))

    def have_begun(self):
        return all(self.rows.values())

    def last_place(self, name):
        return np.array(self.rows[name][-1][2:4])


def explain_jump(before, after, is_smooth=True):
    """Return how far a setpoint jumps from the one before, in words; empty if it does not."""
    step = max(0.0, after[1] - before[1])
    jump = math.dist(before[2:5], after[2:5]) - SPEED * step
    change = math.dist(before[5:], after[5:]) - ACCELERATION * step
    jumps = before[0] == after[0] and (
        jump > ALLOWANCE or is_smooth and change > VELOCITY_ALLOWANCE)
    return f'at {after[1]:.3f} s: {jump:.3f} m, {change:.3f} m/s' if jumps else ''


def received(client):
    return ([client.listen(Path, f'{name}/path', DEEP) for name in ('uav1', 'uav2')],
            [client.listen(Float64MultiArray, f'{name}/power', DEEP)
             for name in ('uav1', 'uav2')])


def plan_of(scenario, paths, powers, index):
    return Plan(scenario, [places_of(path[index]) for path in paths],
                [power[index].data for power in powers])
