"""
Flights with what happens on the way: a late release, a pause, a push aside, a new plan.

A planner and a replay node fly together, and the quadrotors are their vehicles: these follow the
setpoints of the replay and send the odometry that both nodes hear. The clock stands while the
planner solves, and is never faster than _PACE times real time, because the planner looks every
0.1 s of real time whether a replan is due.
"""

from dataclasses import dataclass
import math
import time

import numpy as np

from .flight import hovering, resting
from .link import BEGIN_NS, FlightError, node, NodesLink, RATE, STEP_NS
from ...ros.messages import nanoseconds

_PACE = 4.0
_START_DELAY = 5.0  # s, in which the planner makes the first plan and the replay takes it up
_AFTER = 8.0  # s after the landing
_DEVIATION = 8.0  # m
_SQUALL = (12.0, 0.0, 0.0)  # m/s, beside the setpoint


@dataclass(frozen=True)
class EventFlight:
    """
    What was flown, from the first setpoint on.

    :param event: the Event of `missions.py`.
    :param scenario: that of the first plan.
    :param times: from point 0 of the first plan by the clock, (K,) in s.
    :param plan_times: to what time of its plan the replay had come then, by the plan's stamps.
    :param plans: the identity of that plan, (K,).
    :param places: where the UAVs were, (U, K, 3) in m.
    :param setpoints: where they should have been, (U, K, 3) in m.
    :param velocities: of the setpoints, (U, K, 2) in m/s.
    :param points: those of the first plan, (U, N+2, 2) in m.
    :param status: the values of the planner's status at the end, by key.
    :param warnings: how many times the planner's status was WARN after the landing, by text.
    """

    event: object
    scenario: object
    times: np.ndarray
    plan_times: np.ndarray
    plans: np.ndarray
    places: np.ndarray
    setpoints: np.ndarray
    velocities: np.ndarray
    points: np.ndarray
    status: dict
    warnings: dict

    @property
    def marks(self):
        """Return what happened when: times in s, as for the Event, and texts."""
        found = [(time, f'~/{service.partition("/")[2]}') for time, service in self.event.calls]
        if self.event.push is not None:
            found += zip(self.event.push, ('pushed', 'let go'))
        return [mark for mark in found if mark[0] >= self.times[0]]

    @property
    def turns(self):
        """Return when the replay went over to another plan, in s."""
        return self.times[1:][self.plans[1:] != self.plans[:-1]]


def fly_event(event, scenario, seed=0):
    """
    Return the EventFlight of a mission, from start to goal.

    :param event: an Event of `missions.py`.
    :param scenario: the mission, with the paper's powers and its one eavesdropper's radius.
    :param seed: of the gusts.
    """
    names = [uav.name for uav in scenario.uavs]
    members = {f'{uav.name}__{field}': value for uav in scenario.uavs for field, value in (
        ('start', list(uav.start)), ('goal', list(uav.goal)), ('altitude', uav.altitude),
        ('max_speed', uav.max_speed), ('max_acceleration', uav.max_acceleration))}
    with node('planner', uavs=names, duration=scenario.duration, slots=scenario.slots,
              start_delay=_START_DELAY, replan_deviation=_DEVIATION, **members), \
            node('replay', uavs=names, vehicle_odometry='true', rate=RATE), \
            NodesLink(scenario) as link:
        return _Course(event, scenario, link, seed).fly()


class _Course:
    """The course of one flight, step by step of the clock."""

    def __init__(self, event, scenario, link, seed):
        self._event, self._scenario, self._link = event, scenario, link
        starts = [(*uav.start, uav.altitude) for uav in scenario.uavs]
        self._vehicles = [hovering(start, seed=(seed, index))
                          for index, start in enumerate(starts)]
        self._setpoints = [resting(start) for start in starts]
        self._now, self._calls = BEGIN_NS, list(event.calls)
        self._rows = []

    def fly(self):
        """Return the EventFlight."""
        link = self._link
        link.wait(link.knows_poses, 'the poses in the planner', self._hover)
        link.call('planner/plan')
        link.wait(lambda: link.plan_time and all(link.paths), 'the plan in the replay node',
                  self._hover)
        self._origin = nanoseconds(link.paths[0][0].header.stamp)
        while link.status['track.state'] != 'ended':
            if self._time > 3 * self._scenario.duration:
                raise FlightError(f'no landing until {self._time:g} s: {link.status}')
            self._step()
        link.warnings.clear()
        for _ in range(round(_AFTER * RATE)):
            self._step()
        times, plan_times, plans, places, setpoints, velocities = map(np.array, zip(*self._rows))
        return EventFlight(
            self._event, self._scenario, times, plan_times, plans,
            *(np.moveaxis(values, 0, 1) for values in (places, setpoints, velocities)),
            np.array([[(at.pose.position.x, at.pose.position.y) for at in paths[0].poses]
                      for paths in link.paths]), link.status, dict(link.warnings))

    @property
    def _time(self):
        return (self._now - self._origin) * 1e-9

    def _hover(self):
        """Go on by a step before the replay has a plan; the vehicles stand in it."""
        self._now += STEP_NS
        self._link.publish_clock(self._now)
        self._link.report(self._now, self._vehicles)

    def _step(self):
        began = time.monotonic()
        while self._calls and self._calls[0][0] <= self._time:
            self._link.call(self._calls.pop(0)[1])
        self._move()
        self._link.go_on(self._now, lambda: self._link.has_come_to(self._now))
        self._link.report(self._now, self._vehicles)
        self._link.wait(lambda: not self._link.is_solving, 'the end of a solve')
        if self._link.received:
            self._setpoints = [self._link.received[uav.name] for uav in self._scenario.uavs]
            self._note()
        time.sleep(max(0.0, began + 1 / RATE / _PACE - time.monotonic()))

    def _move(self):
        """Let the vehicles fly for a step after their setpoints."""
        for index, (vehicle, setpoint) in enumerate(
                zip(self._vehicles, self._setpoints, strict=True)):
            if index == 0 and self._rows and self._is_pushed():
                vehicle.carry(np.add(setpoint.velocity, _SQUALL), 1 / RATE)
            else:
                vehicle.follow(setpoint, 1 / RATE)
        self._now += STEP_NS

    def _is_pushed(self):
        begin, end = self._event.push or (math.inf, math.inf)
        return begin <= self._time < end

    def _note(self):
        plan_time = nanoseconds(self._link.plan_time.time_ref) - self._origin
        self._rows.append((
            self._time, plan_time * 1e-9, self._link.plan_time.source,
            [vehicle.place for vehicle in self._vehicles],
            [setpoint.position for setpoint in self._setpoints],
            [setpoint.velocity[:2] for setpoint in self._setpoints]))
