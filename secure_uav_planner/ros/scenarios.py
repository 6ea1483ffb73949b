"""Construction of the scenario to solve from parameters and poses."""

from collections.abc import Mapping
from dataclasses import replace
import math
from typing import Any

from .parameters import uav_from
from .poses import error_radius, PoseBook
from .zone_parameters import airspace_from
from ..errors import PoseError
from ..scenario import Eavesdropper, Scenario

GROUND_NODE_TOPIC = 'ground_node/pose'


def pose_topic(name: str) -> str:
    """Return the topic of a UAV's or an eavesdropper's pose."""
    return f'{name}/pose'


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
        if not parameters[f'{name}.use_pose']:
            continue
        problem = poses.problem(pose_topic(name), frame_id, now, timeout, optional=True)
        if problem is not None:
            problem = type(problem)(
                f'{problem}; send a new one, or set {name}.use_pose to false to plan from '
                f'{name}.start')
        problems.append(problem)
    return [problem for problem in problems if problem is not None]


def raise_first(problems: list[PoseError]) -> None:
    """Raise an error of the first problem's class with the texts of all, if there are any."""
    if problems:
        raise type(problems[0])('; '.join(map(str, problems)))


def scenario_from(parameters: Mapping[str, Any], poses: PoseBook, now: float) -> Scenario:
    """
    Return the Scenario of a new mission, from the UAVs' present positions if they are known.

    :param parameters: values of the planner's parameters by name.
    :param poses: the planner's PoseBook.
    :param now: the node's time in s.
    :raises PoseError: if poses cannot be used; the text names every such topic.
    :raises ScenarioError: for a mission that cannot be flown, or a wrong combination of values.
    """
    raise_first(pose_problems(parameters, poses, now))
    starts = [poses.get(pose_topic(name)) if parameters[f'{name}.use_pose'] else None
              for name in parameters['uavs']]
    return Scenario(
        ground_node=poses.get(GROUND_NODE_TOPIC).position,
        eavesdroppers=_eavesdroppers(parameters, poses),
        uavs=tuple(uav_from(parameters, name, known and known.position)
                   for name, known in zip(parameters['uavs'], starts, strict=True)),
        duration=parameters['duration'], slots=parameters['slots'],
        reference_snr_db=parameters['reference_snr_db'], **airspace_from(parameters))


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
        found.append(Eavesdropper(known.position, radius, name))
    return tuple(found)
