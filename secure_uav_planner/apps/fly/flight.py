"""A flight of quadrotors after the setpoints that the replay node streams over DDS."""

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
import math
import pathlib
import tempfile

import numpy as np

from .link import BEGIN_NS, FlightError, Link, node, RATE, STEP_NS
from .quadrotor import Gusts, Quadrotor, STEP
from ...output.autopilots import Setpoint
from ...plan.playback import Playback

_SETTLING = 10.0  # s of hovering in the wind before the flight
_SAME_PLACE = 1e-3  # m


@dataclass(frozen=True)
class SimulatedFlight:
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


def fly_plan(plan, steady=(5.0, 0.0), deviation=5 / 3, seed=0):
    """
    Return the SimulatedFlight of a plan, from start to goal.

    :param plan: a Plan whose UAVs start at rest.
    :param steady: the steady wind, (x, y) in m/s.
    :param deviation: the standard deviation of the gusts in m/s, a third of their peaks.
    :param seed: of the gusts.
    """
    with tempfile.TemporaryDirectory() as folder:
        file = pathlib.Path(folder) / 'plan.json'
        plan.save(file, evaluate=False)
        with node('replay', plan_file=file, autostart='true', rate=RATE), \
                Link([uav.name for uav in plan.scenario.uavs]) as link:
            return _fly(plan, link, _vehicles(plan, steady, deviation, seed))


def hovering(place, yaw=0.0, steady=(5.0, 0.0), deviation=5 / 3, seed=0):
    """Return a Quadrotor that has hovered at a place for a while; see fly_plan."""
    vehicle = Quadrotor(place, yaw, Gusts(steady, deviation, place[2], STEP, seed))
    vehicle.follow(resting(place, yaw), _SETTLING)
    return vehicle


def resting(place, yaw=0.0):
    """Return the Setpoint of a UAV that rests at a place."""
    return Setpoint('map', 0, place, yaw, (0.0,) * 3, (0.0,) * 3)


def _vehicles(plan, steady, deviation, seed):
    """Return the quadrotors, which hover at their starts."""
    first = Playback(plan)
    moment = first.at(first.begin)
    return [hovering((*moment.positions[index].tolist(), uav.altitude),
                     float(moment.headings[index]), steady, deviation, (seed, index))
            for index, uav in enumerate(plan.scenario.uavs)]


def _fly(plan, link, vehicles):
    playback = Playback(plan)
    steps = math.ceil((playback.duration - playback.begin) * RATE)
    now = BEGIN_NS
    setpoints = link.setpoints(now)
    times, places, wanted = [], [], []
    with ThreadPoolExecutor(1) as pool:
        for number in range(steps + 1):
            times.append(playback.begin + number / RATE)
            places.append([vehicle.place for vehicle in vehicles])
            wanted.append([setpoint.position for setpoint in setpoints])
            # The replay computes the next setpoints while the vehicles follow these.
            now += STEP_NS
            coming = pool.submit(link.setpoints, now)
            for vehicle, setpoint in zip(vehicles, setpoints, strict=True):
                vehicle.follow(setpoint, 1 / RATE)
            setpoints = coming.result()
    flight = SimulatedFlight(plan, np.array(times), np.moveaxis(np.array(places), 0, 1),
                             np.moveaxis(np.array(wanted), 0, 1))
    off = np.linalg.norm(flight.setpoints - flight.planned, axis=-1).max()
    if not off <= _SAME_PLACE:
        raise FlightError(f'setpoints were up to {off:.3g} m beside the plan; is there another '
                          'node that publishes them?')
    return flight
