"""What to solve, from parameters and poses: the scenario, and when its plan begins."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
import math
from typing import Any

from .mission_parameters import airspace_from, channel_from, uav_from
from .poses import error_radius, KnownPose, PoseBook
from .topics import GROUND_NODE_TOPIC, pose_topic, uav_topics
from ..errors import LateError, PoseError, ScenarioError
from ..mission.scenario import Eavesdropper, Point, Scenario, Uav
from ..plan.tracking import departing, expected, Flight, Sighting

_RESERVE = 1.0  # For what follows a solve, in s; at most half of the time there is.
_SHORTEST_SOLVE = 0.01


@dataclass(frozen=True)
class StartTime:
    """
    When the plan of a request begins.

    :param is_delayed: whether it begins at a time that is known before the solve.
    :param asked_ns: the time of the request in ns.
    :param start_ns: the time of point 0 in ns.
    :param effect_ns: when setpoints pass over to the plan, in ns: half a slot before point 0 if
        any UAV has a limit of acceleration, for then it leaves its start.
    """

    is_delayed: bool
    asked_ns: int
    start_ns: int
    effect_ns: int

    @classmethod
    def of(cls, parameters: Mapping[str, Any], now_ns: int, is_flying: bool = False
           ) -> 'StartTime':
        """
        Return the StartTime of a request.

        :param parameters: values of the planner's parameters by name.
        :param now_ns: the node's time in ns.
        :param is_flying: whether UAVs fly on another plan; the new one then takes effect
            replan_lead ahead, or later.
        """
        is_smooth = any(parameters[f'{name}.max_acceleration'] for name in parameters['uavs'])
        lead_in = parameters['duration'] / parameters['slots'] / 2 if is_smooth else 0.0
        delay = parameters['start_delay']
        if is_flying:
            delay = max(delay, parameters['replan_lead'] + lead_in)
        start_ns = now_ns + round(max(delay, lead_in) * 1e9)
        return cls(delay > 0, now_ns, start_ns, start_ns - round(lead_in * 1e9))

    def time_limit(self, limit: float | None) -> float | None:
        """
        Return the time limit of the solve in s, or None for none.

        :param limit: that of the parameters.
        """
        if not self.is_delayed:
            return limit
        ahead = (self.effect_ns - self.asked_ns) * 1e-9
        ahead = max(_SHORTEST_SOLVE, ahead - min(_RESERVE, ahead / 2))
        return ahead if limit is None else min(limit, ahead)

    def start_of(self, now_ns: int) -> int:
        """Return the time in ns of point 0 of a plan that has been solved now."""
        if self.is_delayed:
            return self.start_ns
        return now_ns + self.start_ns - self.effect_ns

    def check_in_time(self, now_ns: int) -> None:
        """
        Check that the plan may still be published.

        :raises LateError: if the time at which it takes effect has passed.
        """
        if self.is_delayed and now_ns > self.effect_ns:
            raise LateError('the new plan came after the moment it was to take effect; a longer '
                            'start_delay gives it more time, and in flight a longer replan_lead')


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
