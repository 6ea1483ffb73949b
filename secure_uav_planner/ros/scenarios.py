"""Construction of the scenario to solve from parameters and poses."""

from collections.abc import Mapping
from dataclasses import replace
import math
from typing import Any

from .departure import Departure
from .parameters import uav_from
from .poses import error_radius, KnownPose, PoseBook
from .zone_parameters import airspace_from
from ..errors import PoseError
from ..plan import Plan
from ..playback import Playback
from ..scenario import Eavesdropper, Scenario, Uav
from ..tracking import departing, expected, Sighting

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


def sighting_of(name: str, parameters: Mapping[str, Any], poses: PoseBook, now: float,
                origin: float) -> Sighting | None:
    """
    Return the last usable state of a UAV, or None.

    :param origin: the time in s from which times of the Sighting count.
    """
    known = known_of(name, parameters, poses, now)
    return known and Sighting(known.time - origin, known.position, known.velocity)


def raise_first(problems: list[PoseError]) -> None:
    """Raise an error of the first problem's class with the texts of all, if there are any."""
    if problems:
        raise type(problems[0])('; '.join(map(str, problems)))


def scenario_from(parameters: Mapping[str, Any], poses: PoseBook, departure: Departure,
                  last: Plan | None = None) -> Scenario:
    """
    Return the Scenario of a new mission, from where the UAVs are or will be, if that is known.

    :param parameters: values of the planner's parameters by name.
    :param poses: the planner's PoseBook.
    :param departure: when the mission begins.
    :param last: the last Plan, along which UAVs may fly until the new one begins.
    :raises PoseError: if poses cannot be used; the text names every such topic.
    :raises ScenarioError: for a mission that cannot be flown, or a wrong combination of values.
    """
    raise_first(pose_problems(parameters, poses, departure.asked_ns * 1e-9))
    return Scenario(
        ground_node=poses.get(GROUND_NODE_TOPIC).position,
        eavesdroppers=_eavesdroppers(parameters, poses),
        uavs=_uavs(parameters, poses, departure, last),
        duration=parameters['duration'], slots=parameters['slots'],
        reference_snr_db=parameters['reference_snr_db'], **airspace_from(parameters))


def _uavs(parameters: Mapping[str, Any], poses: PoseBook, departure: Departure,
          last: Plan | None) -> tuple[Uav, ...]:
    """Return the UAVs with the places, and for a delayed start the velocities, they start with."""
    playback = Playback(last) if last is not None and departure.is_delayed else None
    origin_ns = 0 if playback is None else last.start_ns
    found = []
    for index, name in enumerate(parameters['uavs']):
        uav = uav_from(parameters, name)
        sighting = sighting_of(
            name, parameters, poses, departure.asked_ns * 1e-9, origin_ns * 1e-9)
        if sighting is None or not parameters[f'{name}.use_pose']:
            pass
        elif not departure.is_delayed:
            uav = replace(uav, start=sighting.position)
        else:
            state = expected(sighting, (departure.effect_ns - origin_ns) * 1e-9, playback, index,
                             parameters['track_tolerance'])
            uav = departing(uav, *state, parameters['duration'] / parameters['slots'])
        found.append(uav)
    return tuple(found)


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
