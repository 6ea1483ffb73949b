"""Construction of the scenario to solve from parameters and poses."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
import math
from typing import Any

from .channel_parameters import channel_from
from .parameters import uav_from
from .poses import error_radius, KnownPose, PoseBook
from .start_time import StartTime
from .zone_parameters import airspace_from
from ..errors import PoseError, ScenarioError
from ..mission.scenario import Eavesdropper, Point, Scenario, Uav
from ..plan.tracking import departing, expected, Flight, Sighting

GROUND_NODE_TOPIC = 'ground_node/pose'


def pose_topic(name: str) -> str:
    """Return the topic of a UAV's or an eavesdropper's pose."""
    return f'{name}/pose'


def odometry_topic(name: str) -> str:
    """Return the topic of a UAV's odometry."""
    return f'{name}/odom'


def uav_topics(name: str) -> tuple[str, str]:
    """Return the topics that say where a UAV is; the first counts before the second."""
    return odometry_topic(name), pose_topic(name)


def pose_problems(parameters: Mapping[str, Any], poses: PoseBook, now: float,
                  of_uavs: bool = True) -> list[PoseError]:
    """
    Return an error for every topic whose pose cannot be used for planning.

    :param parameters: values of the planner's parameters by name.
    :param of_uavs: whether to check the UAVs' poses as well.
    """
    frame_id, timeout = parameters['frame_id'], parameters['pose_timeout']
    problems = [
        poses.problem(topic, frame_id, now, timeout, parameters['height_tolerance'])
        for topic in (GROUND_NODE_TOPIC, *map(pose_topic, parameters['eavesdroppers']))]
    for name in parameters['uavs'] if of_uavs else ():
        if not parameters[f'{name}.use_pose'] or known_of(name, parameters, poses, now):
            continue
        of_uav = [poses.problem(topic, frame_id, now, timeout, optional=True)
                  for topic in uav_topics(name)]
        problem = next((problem for problem in of_uav if problem is not None), None)
        if problem is not None:
            problem = type(problem)(
                f'{problem}; send a new one, or set {name}.use_pose to false to plan from '
                f'{name}.start')
        problems.append(problem)
    return [problem for problem in problems if problem is not None]


def known_of(name: str, parameters: Mapping[str, Any], poses: PoseBook, now: float
             ) -> KnownPose | None:
    """Return the last usable odometry of a UAV, or else its last usable pose, or None."""
    return poses.usable(
        uav_topics(name), parameters['frame_id'], now, parameters['pose_timeout'])


def sighting_of(name: str, parameters: Mapping[str, Any], poses: PoseBook, now: float
                ) -> Sighting | None:
    """Return the last usable state of a UAV, at a time in s of the clock, or None."""
    known = known_of(name, parameters, poses, now)
    return known and Sighting(known.time, known.position, known.velocity)


def raise_first(problems: list[PoseError]) -> None:
    """Raise an error of the first problem's class with the texts of all, if there are any."""
    if problems:
        raise type(problems[0])('; '.join(map(str, problems)))


def scenario_from(parameters: Mapping[str, Any], poses: PoseBook, start: StartTime,
                  sightings: Sequence[Sighting | None] = (), flight: Flight | None = None
                  ) -> Scenario:
    """
    Return the Scenario of a new mission, from where the UAVs are or will be, if that is known.

    :param parameters: values of the planner's parameters by name.
    :param poses: the planner's PoseBook.
    :param start: when the mission begins.
    :param sightings: where each UAV is, in the time of the flight or else in s of the clock; None
        for one that is not known.
    :param flight: the Flight from which it goes on, or None.
    :raises PoseError: if poses cannot be used; the text names every such topic.
    :raises ScenarioError: for a mission that cannot be flown, or a wrong combination of values.
    """
    raise_first(pose_problems(parameters, poses, start.asked_ns * 1e-9))
    uavs = [uav_from(parameters, name) for name in parameters['uavs']]
    for index, sighting in enumerate(sightings):
        uavs[index] = _begun(uavs[index], index, sighting, parameters, start, flight)
    return Scenario(
        ground_node=poses.get(GROUND_NODE_TOPIC).position,
        eavesdroppers=_eavesdroppers(parameters, poses), uavs=tuple(uavs),
        duration=parameters['duration'], slots=parameters['slots'],
        reference_snr_db=parameters['reference_snr_db'], channel=channel_from(parameters),
        colluding=parameters['colluding'], **airspace_from(parameters))


def _begun(uav: Uav, index: int, sighting: Sighting | None, parameters: Mapping[str, Any],
           start: StartTime, flight: Flight | None) -> Uav:
    """Return a UAV with the place, and where it flies the velocity, with which it starts."""
    ahead = (start.effect_ns - start.asked_ns) * 1e-9
    if flight is None:
        if sighting is None or not start.is_delayed:
            return uav if sighting is None else replace(uav, start=sighting.position)
        state = expected(sighting, start.effect_ns * 1e-9)
    else:
        time = flight.time + flight.rate * ahead
        is_streamed = flight.is_reported and flight.state in ('flying', 'held')
        if sighting is None and flight.state == 'waiting':
            return uav
        if is_streamed or sighting is None:
            state = _planned(uav, index, flight, time)
        elif flight.is_reported or start.is_delayed:
            state = expected(sighting, time, flight.playback, index, parameters['track_tolerance'])
        else:
            return replace(uav, start=sighting.position)
    return departing(uav, *state, parameters['duration'] / parameters['slots'])


def _planned(uav: Uav, index: int, flight: Flight, time: float) -> tuple[Point, Point]:
    """
    Return where a UAV will be on the plan that is flown, and how fast.

    :raises ScenarioError: if it flies at another altitude, or faster than it may from now on.
    """
    flown = flight.playback.plan.scenario.uavs[index]
    if uav.altitude != flown.altitude:
        raise ScenarioError(
            f'{uav.name}.altitude is {uav.altitude:g} m and {uav.name} flies at '
            f'{flown.altitude:g} m; it can change when the flight has ended')
    moment = flight.playback.at(time)
    (x, y), (u, v) = moment.positions[index].tolist(), moment.velocities[index].tolist()
    if flight.rate == 0.0:
        u = v = 0.0
    if uav.max_acceleration is not None and math.hypot(u, v) > uav.max_speed * (1 + 1e-6):
        raise ScenarioError(
            f'{uav.name}.max_speed is {uav.max_speed:g} m/s and {uav.name} flies at '
            f'{math.hypot(u, v):.1f} m/s; it can be lower when the flight has ended')
    return (x, y), (u, v)


def updated(scenario: Scenario, parameters: Mapping[str, Any], poses: PoseBook,
            now: float) -> Scenario:
    """
    Return the scenario with the present poses of the ground node and the eavesdroppers.

    :raises PoseError: if poses cannot be used; the text names every such topic.
    """
    raise_first(pose_problems(parameters, poses, now, of_uavs=False))
    return replace(scenario, ground_node=poses.get(GROUND_NODE_TOPIC).position,
                   eavesdroppers=_eavesdroppers(parameters, poses))


def has_moved(scenario: Scenario, known: Scenario, distance: float) -> bool:
    """
    Return whether positions on the ground differ by more than a distance in m.

    It also returns True if an error radius has changed by more than a tenth of the distance.

    :param scenario: the Scenario of the last plan.
    :param known: the Scenario with the present poses.
    """
    return math.dist(scenario.ground_node, known.ground_node) > distance or any(
        math.dist(before.position, now.position) > distance
        or abs(before.error_radius - now.error_radius) > 0.1 * distance
        for before, now in zip(scenario.eavesdroppers, known.eavesdroppers))


def _eavesdroppers(parameters: Mapping[str, Any], poses: PoseBook) -> tuple[Eavesdropper, ...]:
    found = []
    for name in parameters['eavesdroppers']:
        known = poses.get(pose_topic(name))
        radius = (error_radius(known.covariance, parameters['confidence'])
                  if known.covariance.any() else parameters[f'{name}.error_radius'])
        found.append(Eavesdropper(known.position, radius, name,
                                  parameters[f'{name}.receiver_advantage_db']))
    return tuple(found)
