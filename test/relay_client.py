"""What tests of the relay need besides a client: a source of setpoints, vehicles, references."""

import time

from nav_msgs.msg import Odometry
import numpy as np
from ros_client import numbers, pose_message
from ros_nodes import wait_for
from secure_uav_planner import Origin
from secure_uav_planner.ros import messages
from simulation import follow
from trajectory_msgs.msg import MultiDOFJointTrajectory


class Source:
    """A program that streams the setpoints of a UAV, like the replay."""

    def __init__(self, client, uav, velocity=(3.0, 4.0), acceleration=(0.5, -0.25)):
        self._clock = client.node.get_clock()
        self.message = messages.trajectory_setpoint(
            uav, 'map', self._clock.now().to_msg(),
            ((10.0, 20.0, 30.0), 0.3, velocity, acceleration))
        self.place = self.message.points[0].transforms[0].translation
        self._publisher = client.publisher(
            MultiDOFJointTrajectory, f'{uav}/setpoint/trajectory', 10)
        self.stamps = []

    def send(self):
        """Send the setpoint of now."""
        self.message.header.stamp = self._clock.now().to_msg()
        self.stamps.append(self.message.header.stamp)
        self._publisher.publish(self.message)
        time.sleep(0.02)

    def until(self, condition):
        """Send until a condition holds."""
        return wait_for(lambda: self.send() or condition())


def rests(received, send=lambda: time.sleep(0.02)):
    """Return whether no message comes for a second, in which others are sent."""
    count, until = len(received), time.monotonic() + 1.0
    while time.monotonic() < until:
        send()
    return len(received) == count


def listen_to_mavros(packages, client, uav='uav1'):
    return client.listen(packages('mavros_msgs', 'PositionTarget'),
                         f'{uav}/mavros/setpoint_raw/local', 1000)


class Autopilot:
    """A vehicle that follows the setpoints of MAVROS, and stays where it is without them."""

    step = 0.05

    def __init__(self, packages, client, name, place):
        self.place, self.velocity, self._target = np.array(place), np.zeros(2), None
        client.node.create_subscription(
            packages('mavros_msgs', 'PositionTarget'), f'{name}/mavros/setpoint_raw/local',
            lambda message: setattr(self, '_target', (time.monotonic(), message)), 10)
        self._publisher = client.node.create_publisher(
            Odometry, f'{name}/mavros/local_position/odom', 10)
        self._now = client.now
        client.node.create_timer(self.step, self._fly)

    def _fly(self):
        """Follow the last setpoint, or brake without a fresh one, and report."""
        target, velocity = self.place, (0.0, 0.0)
        if self._target is not None and time.monotonic() - self._target[0] < 1.0:
            target, velocity = (numbers(part, 'xy') for part in (
                self._target[1].position, self._target[1].velocity))
        self.place, self.velocity = follow(
            self.place, self.velocity, target, velocity, 4.0, self.step, most_speed=12.0)
        message = pose_message(Odometry, *self.place, 100.0, stamp=self._now())
        message.twist.twist.linear.x, message.twist.twist.linear.y = self.velocity.tolist()
        self._publisher.publish(message)


# References of local frames

ZURICH = Origin(47.3977, 8.5456)
MISSION = {'origin.projection': 'px4', 'origin.latitude': ZURICH.latitude,
           'origin.longitude': ZURICH.longitude}


def reference_at(kind, east, resets=0, is_valid=True):
    """Return the report of a px4 whose frame begins some m east of the mission's origin."""
    latitude, longitude = map(float, ZURICH.to_geographic(east, 0.0))
    return kind(xy_valid=True, xy_global=is_valid, ref_lat=latitude, ref_lon=longitude,
                xy_reset_counter=resets, ref_timestamp=1000 + resets)


def local_place(reference, place):
    """Return where a vehicle with a reference takes a place of the mission, (x, y), to be."""
    frame = Origin(reference.ref_lat, reference.ref_lon)
    return [float(value) for value in frame.to_local(*ZURICH.to_geographic(*place))]
