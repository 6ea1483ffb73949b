"""From parameters and poses to the scenario to solve."""

from dataclasses import replace
import math

from .parameters import uav_from
from .poses import error_radius
from ..scenario import Eavesdropper, Scenario

GROUND_NODE_TOPIC = 'ground_node/pose'


def pose_topic(name):
    """Return the topic of a UAV's or an eavesdropper's pose."""
    return f'{name}/pose'


def pose_problems(parameters, poses, now, of_uavs=True):
    """Return the PoseProblem of every topic whose pose cannot be planned with."""
    needed = [GROUND_NODE_TOPIC] + [pose_topic(name) for name in parameters['eavesdroppers']]
    optional = [pose_topic(name) for name in parameters['uavs']] if of_uavs else []
    problems = [
        poses.problem(topic, parameters['frame_id'], now, parameters['pose_timeout'],
                      optional=topic in optional)
        for topic in needed + optional]
    return [problem for problem in problems if problem]


def scenario_from(parameters, poses, now):
    """
    Return the Scenario of a new mission: from where the UAVs are, if they say so.

    :param parameters: values of the planner's parameters by name.
    :param poses: its PoseBook.
    :param now: the node's time in s.
    :raises ValueError: naming every topic without a usable pose, or what cannot be flown.
    """
    problems = pose_problems(parameters, poses, now)
    if problems:
        raise ValueError('; '.join(problem.text for problem in problems))
    starts = [poses.get(pose_topic(name)) for name in parameters['uavs']]
    return Scenario(
        ground_node=poses.get(GROUND_NODE_TOPIC).position,
        eavesdroppers=_eavesdroppers(parameters, poses),
        uavs=tuple(uav_from(parameters, name, known and known.position)
                   for name, known in zip(parameters['uavs'], starts)),
        duration=parameters['duration'], slots=parameters['slots'],
        reference_snr_db=parameters['reference_snr_db'])


def updated(scenario, parameters, poses, now):
    """
    Return the scenario with the ground node and the eavesdroppers where they are known now.

    :raises ValueError: naming every topic without a usable pose.
    """
    problems = pose_problems(parameters, poses, now, of_uavs=False)
    if problems:
        raise ValueError('; '.join(problem.text for problem in problems))
    return replace(scenario, ground_node=poses.get(GROUND_NODE_TOPIC).position,
                   eavesdroppers=_eavesdroppers(parameters, poses))


def has_moved(scenario, known, distance):
    """
    Return whether the places on the ground differ by more than a distance in m.

    An error radius counts when it has changed by more than a tenth of the distance.

    :param scenario: what was planned for.
    :param known: the Scenario as it is known now.
    """
    return math.dist(scenario.ground_node, known.ground_node) > distance or any(
        math.dist(before.position, now.position) > distance
        or abs(before.error_radius - now.error_radius) > 0.1 * distance
        for before, now in zip(scenario.eavesdroppers, known.eavesdroppers))


def _eavesdroppers(parameters, poses):
    found = []
    for name in parameters['eavesdroppers']:
        known = poses.get(pose_topic(name))
        radius = (error_radius(known.covariance, parameters['confidence'])
                  if known.covariance.any() else parameters[f'{name}.error_radius'])
        found.append(Eavesdropper(known.position, radius))
    return tuple(found)
