"""What to solve, from the values of parameters and poses: the scenario, and when it begins."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
import math
from typing import Any

from .mission_parameters import airspace_from, channel_from, uav_from
from .parameters import SCENARIO_FIELDS
from .poses import error_radius, PoseBook
from .topics import GROUND_NODE_TOPIC
from ..errors import LateError, ScenarioError
from ..mission.scenario import Eavesdropper, Point, Scenario, Uav
from ..plan.tracking import Flight, MeasuredState, predict_state, start_from_state

_RESERVE = 1.0  # For what follows a solve, in s; at most half of the time there is.


@dataclass(frozen=True)
class StartTime:
    """
    When the plan of a request begins.

    :param asked_ns: the time of the request in ns.
    :param delay: from then to point 0 in s, or 0 for a plan that begins once it has been solved.
    :param lead_in: how long before point 0 setpoints pass over to the plan in s: half a slot if
        any UAV has a limit of acceleration, for then it leaves its start.
    """

    asked_ns: int
    delay: float
    lead_in: float

    @classmethod
    def of(cls, settings: Mapping[str, Any], now_ns: int, is_flying: bool) -> 'StartTime':
        """Return that of a request; in flight, a plan takes effect replan_lead ahead or later."""
        is_smooth = any(settings[f'{name}.max_acceleration'] for name in settings['uavs'])
        lead_in = settings['duration'] / settings['slots'] / 2 if is_smooth else 0.0
        delay = settings['start_delay']
        if is_flying:
            delay = max(delay, settings['replan_lead'] + lead_in)
        return cls(now_ns, delay, lead_in)

    @property
    def ahead(self) -> float:
        """How far ahead of the request the plan takes effect, in s."""
        return max(0.0, self.delay - self.lead_in)

    @property
    def effect_ns(self) -> int:
        """When the plan takes effect, in ns."""
        return self.asked_ns + round(self.ahead * 1e9)

    def time_limit(self, limit: float | None) -> float | None:
        """Return the time limit of the solve in s for that of the parameters; None for none."""
        if not self.delay:
            return limit
        left = self.ahead - min(_RESERVE, self.ahead / 2)
        return left if limit is None else min(limit, left)

    def start_of(self, now_ns: int) -> int:
        """Return the time in ns of point 0 of a plan that has been solved now."""
        return (self.effect_ns if self.delay else now_ns) + round(self.lead_in * 1e9)

    def check_in_time(self, now_ns: int) -> None:
        """Raise a LateError if the time at which the plan takes effect has passed."""
        if self.delay and now_ns > self.effect_ns:
            raise LateError('the new plan came after the moment it was to take effect; a longer '
                            'start_delay gives it more time, and in flight a longer replan_lead')


def scenario_from(settings: Mapping[str, Any], poses: PoseBook, start: StartTime,
                  states: Sequence[MeasuredState | None], flight: Flight | None) -> Scenario:
    """
    Return the Scenario of a new mission, from where the UAVs are or will be, if that is known.

    :param states: where each UAV is, in the time of the flight or else in s of the clock.
    :param flight: the Flight from which it goes on, or None.
    :raises PlanningError: if poses cannot be used, or for a mission that cannot be flown.
    """
    poses.check(settings, start.asked_ns * 1e-9)
    uavs = [_with_start_state(uav_from(settings, name), index, state, settings, start, flight)
            for index, (name, state) in enumerate(
                zip(settings['uavs'], states, strict=True))]
    return _scenario(settings, uavs, _receivers(settings, poses))


def parameter_scenario(settings: Mapping[str, Any]) -> Scenario:
    """
    Return the Scenario of the parameters, with receivers at places of no account.

    :raises PlanningError: for a mission that cannot be flown.
    """
    return _scenario(settings, [uav_from(settings, name) for name in settings['uavs']],
                     {'ground_node': (0.0, 0.0), 'eavesdroppers': (Eavesdropper((0.0, 0.0)),)})


def _scenario(settings: Mapping[str, Any], uavs: Sequence[Uav], receivers: Mapping[str, Any]
              ) -> Scenario:
    return Scenario(
        uavs=tuple(uavs), channel=channel_from(settings), **receivers,
        **airspace_from(settings), **{field: settings[field] for field in SCENARIO_FIELDS})


def _with_start_state(uav: Uav, index: int, state: MeasuredState | None,
                      settings: Mapping[str, Any], start: StartTime, flight: Flight | None
                      ) -> Uav:
    """Return a UAV with the place, and where it flies the velocity, with which it starts."""
    if state is None and (flight is None or flight.state == 'waiting'):
        return uav
    time = start.effect_ns * 1e-9 if flight is None else flight.time + flight.rate * start.ahead
    is_reported = flight is not None and flight.is_reported
    if state is None or is_reported and flight.is_under_way:
        start_state = _planned(uav, index, flight, time)
    elif is_reported or start.delay:
        start_state = predict_state(
            state, time, uav.max_acceleration, flight and flight.playback, index,
            settings['track_tolerance'])
    else:
        return replace(uav, start=state.position)
    return start_from_state(uav, *start_state, settings['duration'] / settings['slots'])


def _planned(uav: Uav, index: int, flight: Flight, time: float) -> tuple[Point, Point]:
    """Return where a UAV will be on the plan that is flown, and how fast, if it may go on so."""
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


def update_receivers(scenario: Scenario, settings: Mapping[str, Any], poses: PoseBook, now: float
                     ) -> Scenario:
    """Return the scenario with the present poses of the ground node and the eavesdroppers."""
    poses.check(settings, now, of_uavs=False)
    return replace(scenario, **_receivers(settings, poses))


def has_moved(scenario: Scenario, known: Scenario, distance: float) -> bool:
    """Return whether a receiver has moved by more than a distance in m, or a radius by a tenth."""
    return math.dist(scenario.ground_node, known.ground_node) > distance or any(
        math.dist(before.position, now.position) > distance
        or abs(before.error_radius - now.error_radius) > 0.1 * distance
        for before, now in zip(scenario.eavesdroppers, known.eavesdroppers))


def _receivers(settings: Mapping[str, Any], poses: PoseBook) -> dict[str, Any]:
    """Return the ground node and the eavesdroppers of a Scenario."""
    found = []
    for name in settings['eavesdroppers']:
        known = poses.get(f'{name}/pose')
        radius = (error_radius(known.covariance, settings['confidence'])
                  if known.covariance.any() else settings[f'{name}.error_radius'])
        found.append(Eavesdropper(known.position, radius, name,
                                  settings[f'{name}.receiver_advantage_db']))
    return {'ground_node': poses.get(GROUND_NODE_TOPIC).position, 'eavesdroppers': tuple(found)}
