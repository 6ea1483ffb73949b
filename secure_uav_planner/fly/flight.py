"""
A flight of quadrotors after the setpoints that the replay node streams over DDS.

Time is simulated: this process publishes /clock, and goes on by a step when the setpoints of the
step before have come. So the flight is the same however fast the machine is, and no setpoint comes
earlier or later than it would in real time; the transport itself takes no time.
"""

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
import math
import pathlib
import tempfile
import time

from builtin_interfaces.msg import Time as Stamp
import numpy as np
import rclpy
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rosgraph_msgs.msg import Clock
from trajectory_msgs.msg import MultiDOFJointTrajectory

from .gusts import Gusts
from .quadrotor import Quadrotor, STEP
from ..autopilots import Setpoint
from ..errors import PlanningError
from ..playback import Playback
from ..ros.graph import process
from ..ros.messages import setpoint_of
from ..ros.qos import STREAM

RATE = 25.0
"""Setpoints per second."""

_BEGIN_NS = 10**9
_SETTLING = 10.0  # s of hovering in the wind before the flight
_ASK_AGAIN = 0.2  # s after which the clock is published again; its QoS is best effort
_PATIENCE = 120.0
_SAME_PLACE = 1e-3  # m


class FlightError(PlanningError, RuntimeError):
    """A flight cannot go on; the text gives the reason."""

    code = 'flight'


@dataclass(frozen=True)
class Flight:
    """
    What was flown.

    :param plan: the Plan.
    :param times: from point 0 of the plan, (K,) in s.
    :param places: where the UAVs were, (U, K, 3) in m.
    :param setpoints: where they should have been by the setpoint that they had, (U, K, 3) in m.
    """

    plan: object
    times: np.ndarray
    places: np.ndarray
    setpoints: np.ndarray

    @property
    def planned(self):
        """Return where the planned curve is at the times, (U, K, 3) in m."""
        level = Playback(self.plan).curve.at(self.times).positions
        heights = self.plan.scenario.altitudes[:, None, None]
        return np.concatenate(
            [level, np.broadcast_to(heights, (*level.shape[:2], 1))], axis=-1)


def fly(plan, steady=(5.0, 0.0), deviation=5 / 3, seed=0):
    """
    Return the Flight of a plan, from start to goal.

    :param plan: a Plan whose UAVs start at rest.
    :param steady: the steady wind, (x, y) in m/s.
    :param deviation: the standard deviation of the gusts in m/s, a third of their peaks.
    :param seed: of the gusts.
    """
    with tempfile.TemporaryDirectory() as folder:
        file = pathlib.Path(folder) / 'plan.json'
        plan.save(file, evaluate=False)
        parameters = {'plan_file': file, 'use_sim_time': 'true', 'autostart': 'true',
                      'rate': RATE}
        arguments = [word for name, value in parameters.items()
                     for word in ('-p', f'{name}:={value}')]
        with process('replay', arguments), _Link([uav.name for uav in plan.scenario.uavs]) as link:
            return _fly(plan, link, _vehicles(plan, steady, deviation, seed))


def _vehicles(plan, steady, deviation, seed):
    """Return the quadrotors, which have hovered at their starts for a while."""
    first = Playback(plan)
    moment = first.at(first.begin)
    found = []
    for index, uav in enumerate(plan.scenario.uavs):
        place = (*moment.positions[index].tolist(), uav.altitude)
        yaw = float(moment.headings[index])
        gusts = Gusts(steady, deviation, uav.altitude, STEP, (seed, index))
        vehicle = Quadrotor(place, yaw, gusts)
        vehicle.follow(Setpoint('map', 0, place, yaw, (0.0,) * 3, (0.0,) * 3), _SETTLING)
        found.append(vehicle)
    return found


def _fly(plan, link, vehicles):
    playback = Playback(plan)
    step_ns = round(1e9 / RATE)
    steps = math.ceil((playback.duration - playback.begin) * RATE)
    now = _BEGIN_NS
    setpoints = link.setpoints(now)
    times, places, wanted = [], [], []
    with ThreadPoolExecutor(1) as pool:
        for number in range(steps + 1):
            times.append(playback.begin + number / RATE)
            places.append([vehicle.place for vehicle in vehicles])
            wanted.append([setpoint.position for setpoint in setpoints])
            # The replay computes the next setpoints while the vehicles follow these.
            now += step_ns
            coming = pool.submit(link.setpoints, now)
            for vehicle, setpoint in zip(vehicles, setpoints, strict=True):
                vehicle.follow(setpoint, 1 / RATE)
            setpoints = coming.result()
    flight = Flight(plan, np.array(times), np.moveaxis(np.array(places), 0, 1),
                    np.moveaxis(np.array(wanted), 0, 1))
    off = np.linalg.norm(flight.setpoints - flight.planned, axis=-1).max()
    if not off <= _SAME_PLACE:
        raise FlightError(f'setpoints were up to {off:.3g} m beside the plan; is there another '
                          'node that publishes them?')
    return flight


class _Link:
    """Publishes /clock and receives the setpoints of every UAV."""

    def __init__(self, names: Sequence[str]) -> None:
        self._names = names
        self._received: dict[str, Setpoint] = {}

    def __enter__(self) -> '_Link':
        self._context = Context()
        rclpy.init(context=self._context, args=[])
        self._node = rclpy.create_node('fly', context=self._context)
        self._executor = SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self._node)
        self._clock = self._node.create_publisher(Clock, '/clock', STREAM)
        for name in self._names:
            self._node.create_subscription(
                MultiDOFJointTrajectory, f'{name}/setpoint/trajectory',
                lambda message, name=name: self._received.update({name: setpoint_of(message)}),
                STREAM)
        self._wait(self._is_connected, 'the replay node')
        return self

    def __exit__(self, *_: object) -> None:
        self._executor.shutdown()
        self._node.destroy_node()
        rclpy.try_shutdown(context=self._context)

    def _is_connected(self) -> bool:
        counts = [self._node.count_publishers(f'{name}/setpoint/trajectory')
                  for name in self._names]
        if max(counts) > 1:
            raise FlightError(f'{max(counts)} nodes of this ROS domain publish setpoints; set '
                              'ROS_DOMAIN_ID to another one')
        return all(counts) and self._clock.get_subscription_count() > 0

    def setpoints(self, now_ns: int) -> list[Setpoint]:
        """Return the setpoint of every UAV at a time, which this process makes the present."""
        sent = -math.inf

        def have_come() -> bool:
            nonlocal sent
            if time.monotonic() - sent > _ASK_AGAIN:
                sent = time.monotonic()
                self._clock.publish(Clock(clock=Stamp(
                    sec=now_ns // 10**9, nanosec=now_ns % 10**9)))
            return all(name in self._received and self._received[name].time_ns == now_ns
                       for name in self._names)

        self._wait(have_come, f'the setpoints at {now_ns * 1e-9:g} s')
        return [self._received[name] for name in self._names]

    def _wait(self, condition, what: str) -> None:
        until = time.monotonic() + _PATIENCE
        while not condition():
            if time.monotonic() > until:
                raise FlightError(f'{what} did not come within {_PATIENCE:g} s')
            self._executor.spin_once(timeout_sec=0.05)
