"""
Flights of quadrotors that follow the setpoints of the replay node over DDS.

A plan is flown with the replay node alone. A flight with an event, such as a late release, a
pause, a push or a new plan, has a planner and a replay node, which receive the vehicles' odometry.
The clock then stands while the planner solves, and is never faster than _PACE times real time,
because the planner checks for a replan every 0.1 s of real time.
"""

from dataclasses import dataclass, replace
import math
from pathlib import Path
import tempfile
import time

import numpy as np
from secure_uav_planner.mission.scenario import Scenario
from secure_uav_planner.output.autopilots import Setpoint
from secure_uav_planner.plan.playback import Playback
from secure_uav_planner.ros.client import ClientError
from secure_uav_planner.ros.messages import nanoseconds, read_plan_time
from secure_uav_planner.ros.planner_status import PlannerStatus

from .link import BEGIN_NS, Link, node, RATE, STEP_NS
from .missions import Event
from .quadrotor import Gusts, Quadrotor, STEP

WIND, GUSTS = (5.0, 0.0), 5 / 3
"""The steady wind, (x, y) in m/s, and the standard deviation of its gusts in m/s."""

_SETTLING = 10.0  # s of hovering in the wind before the flight
_PACE = 4.0
_START_DELAY = 5.0  # s, in which the planner makes the first plan and the replay adopts it
_AFTER = 8.0  # s after the landing
_DEVIATION = 8.0  # m
_SQUALL = (12.0, 0.0, 0.0)  # m/s, beside the setpoint


@dataclass(frozen=True)
class Flight:
    """The record of a flight from the first setpoint on; times are in s by the clock."""

    event: Event
    scenario: Scenario
    times: np.ndarray  # From point 0 of the first plan, (K,).
    plan_times: np.ndarray  # The replay's time in its plan, by the plan's stamps.
    plans: np.ndarray  # The identity of that plan, (K,).
    places: np.ndarray  # Positions of the UAVs, (U, K, 3) in m.
    setpoints: np.ndarray  # Positions of the setpoints, (U, K, 3) in m.
    velocities: np.ndarray  # Of the setpoints, (U, K, 2) in m/s.
    planned: np.ndarray  # The path of the first plan, (U, points, 2) in m.
    status: PlannerStatus  # The last one.
    warnings: dict  # Counts of the planner's WARN status after the landing, by text.

    @property
    def marks(self):
        """Return times in s, as for the Event, and texts of what happened."""
        marks = [(time, f'~/{service.partition("/")[2]}') for time, service in self.event.calls]
        if self.event.push is not None:
            marks += zip(self.event.push, ('pushed', 'let go'))
        return [mark for mark in marks if mark[0] >= self.times[0]]

    @property
    def splices(self):
        """Return the times in s at which the replay continued with another plan."""
        return self.times[1:][self.plans[1:] != self.plans[:-1]]


def fly_plan(name, plan, seed=0):
    """Return the Flight of a Plan whose UAVs start at rest, from start to goal."""
    playback = Playback(plan)
    first = playback.at(playback.begin)
    course = _Course(Event(name, ()), plan.scenario, first.headings.tolist(), seed)
    course.origin = BEGIN_NS - round(playback.begin * 1e9)
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / 'plan.json'
        replace(plan, start_ns=course.origin).save(file, evaluate=False)
        with node('replay', plan_file=file, autostart='true', rate=RATE), \
                Link(plan.scenario, 1) as link:
            link.wait_until(lambda: link.setpoints and link.has_come_to(BEGIN_NS),
                            'the first setpoints', lambda: link.publish_clock(BEGIN_NS))
            course.note(link)
            for _ in range(math.ceil((playback.duration - playback.begin) * RATE)):
                course.step(link)
    return course.flight(link, playback.curve.at(plan.times).positions)


def fly_event(event, scenario, seed=0):
    """Return the Flight of a Scenario with an Event, from start to goal."""
    course = _Course(event, scenario, [0.0] * len(scenario.uavs), seed)
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / 'mission.yaml'
        scenario.save(file)
        with node('planner', mission_file=file, start_delay=_START_DELAY,
                  replan_deviation=_DEVIATION), \
                node('replay', mission_file=file, vehicle_odometry='true', rate=RATE), \
                Link(scenario, 2) as link:
            odometry = [f'{name}/odom' for name in link.names]
            link.wait_until(lambda: link.knows_poses(*odometry), 'the poses in the planner',
                            lambda: course.hover(link))
            first = link.plan()
            link.wait_until(lambda: link.plan_time, 'the plan in the replay node',
                            lambda: course.hover(link))
            course.origin = first.start_ns
            while link.status.track.state != 'ended':
                if course.time > 3 * scenario.duration:
                    raise ClientError(f'no landing until {course.time:g} s: {link.status}')
                course.step(link, _PACE)
            link.warnings.clear()
            for _ in range(round(_AFTER * RATE)):
                course.step(link, _PACE)
    return course.flight(link, first.positions)


class _Course:
    """
    The course of one flight, step by step of the clock.

    :ivar origin: point 0 of the first plan, in ns of the clock.
    """

    def __init__(self, event, scenario, yaws, seed):
        self._event, self._scenario = event, scenario
        self._setpoints = [Setpoint('map', 0, (*uav.start, uav.altitude), yaw, (0.0,) * 3,
                                    (0.0,) * 3) for uav, yaw in zip(scenario.uavs, yaws)]
        self._vehicles = []
        for index, rest in enumerate(self._setpoints):
            gusts = Gusts(WIND, GUSTS, rest.position[2], STEP, (seed, index))
            self._vehicles.append(Quadrotor(rest.position, rest.yaw, gusts))
            self._vehicles[-1].follow(rest, _SETTLING)
        self._now, self._calls, self._rows = BEGIN_NS, list(event.calls), []
        self.origin = 0

    @property
    def time(self):
        """Return the time since point 0 of the first plan in s."""
        return (self._now - self.origin) * 1e-9

    def hover(self, link):
        """Go on by a step before the replay has a plan; the vehicles stand in it."""
        self._now += STEP_NS
        link.publish_clock(self._now)
        link.report(self._now, self._vehicles)

    def step(self, link, pace=math.inf):
        """Go on by a step with the vehicles and the nodes, at most so many times real time."""
        began = time.monotonic()
        while self._calls and self._calls[0][0] <= self.time:
            link.call(self._calls.pop(0)[1])
        begin, end = self._event.push or (math.inf, math.inf)
        for index, (vehicle, setpoint) in enumerate(
                zip(self._vehicles, self._setpoints, strict=True)):
            if index == 0 and self._rows and begin <= self.time < end:
                vehicle.carry(np.add(setpoint.velocity, _SQUALL), 1 / RATE)
            else:
                vehicle.follow(setpoint, 1 / RATE)
        self._now += STEP_NS
        link.wait_until(lambda: link.has_come_to(self._now), f'the setpoints at {self.time:g} s',
                        lambda: link.publish_clock(self._now))
        link.report(self._now, self._vehicles)
        link.wait_until(lambda: not link.is_solving, 'the end of a solve')
        self.note(link)
        time.sleep(max(0.0, began + 1 / RATE / pace - time.monotonic()))

    def note(self, link):
        """Take up the setpoints, if there are any, and note where everybody is."""
        if link.setpoints:
            self._setpoints = [link.setpoints[name] for name in link.names]
            plan_time = nanoseconds(link.plan_time.time_ref) - self.origin
            self._rows.append((
                self.time, plan_time * 1e-9, read_plan_time(link.plan_time)[0],
                [vehicle.place for vehicle in self._vehicles],
                [setpoint.position for setpoint in self._setpoints],
                [setpoint.velocity[:2] for setpoint in self._setpoints]))

    def flight(self, link, planned):
        """Return the Flight."""
        times, plan_times, plans, places, setpoints, velocities = map(np.array, zip(*self._rows))
        return Flight(
            self._event, self._scenario, times, plan_times, plans,
            *(np.moveaxis(values, 0, 1) for values in (places, setpoints, velocities)),
            planned, link.status, dict(link.warnings))
