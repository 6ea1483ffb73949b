"""
The receivers of a mission, from their estimates and the tracks of the mission file.

The planner predicts an estimate from its measurement to a horizon, in the time of the clock. A
track of the mission file holds in the time of the plan. A fresh estimate replaces the track of its
receiver.
"""

from dataclasses import replace
import math
from typing import Any, NamedTuple

import numpy as np

from .poses import error_radius, KnownPose, PoseBook
from .settings import PlannerSettings
from ...mission.fields import RADIUS
from ...mission.scenario import Eavesdropper, GroundNode, Scenario
from ...mission.tracks import LEFT_OUT, Track
from ...plan.splice import move_receivers
from ...plan.tracking import PlanClock

SHORTEST_TRACK = 1.0
"""Shortest duration of a predicted track [s], also if predictions end earlier."""


class Receivers(NamedTuple):
    """
    The receivers of a mission.

    :ivar fields: the ground nodes and the eavesdroppers by the fields of Scenario.
    :ivar promised_until: time of the plan in s until which estimates are predicted, or None where
        no receiver moves by an estimate.
    :ivar notes: what an operator should know of each receiver, by its name.
    :ivar scheduled: names of the receivers that move on their tracks in the mission file, whose
        times count from point 0. Predicted tracks follow the clock.
    """

    fields: dict[str, Any]
    promised_until: float | None
    notes: dict[str, str]
    scheduled: frozenset[str]

    def postpone(self, scenario: Scenario, seconds: float) -> Scenario:
        """
        Return a scenario whose point 0 is `seconds` later on the clock.

        Predicted tracks get earlier times from point 0, and `scheduled` tracks keep their times.
        """
        later = move_receivers(scenario, scenario, seconds)
        members: dict[str, Any] = {
            kind: tuple(old if old.name in self.scheduled else new for old, new in zip(
                getattr(scenario, kind), getattr(later, kind), strict=True))
            for kind in ('ground_nodes', 'eavesdroppers')}
        return replace(later, **members)


def predict_receivers(settings: PlannerSettings, poses: PoseBook, now: float, clock: PlanClock,
                      end: float) -> Receivers:
    """
    Return the Receivers, predicted for the time _horizon or until `end`, whichever is earlier.

    The horizon begins at the later of `now` and clock.clock. A receiver starts at its usable pose.
    Without one, it moves on its track in the mission file, which it must have.

    :param now: time of the clock [s].
    :param clock: clock of the plan that converts to its time; its time_scale is not 0.
    :param end: end of the flight [s] from point 0.
    :raises ScenarioError: for a track whose values are out of range.
    """
    # Time of the clock [s] at which the predictions end.
    until = min(max(now, clock.clock) + _horizon(settings), clock.to_clock(end))
    nodes, eavesdroppers, notes = [], [], {}
    moves_by_estimate, scheduled = False, set()
    for name in settings.receivers:
        is_node, track = name in settings.ground_nodes, settings.tracks.get(name)
        pose = poses.usable_pose(name, settings, now)
        position = radius = LEFT_OUT  # The values for a receiver with a track.
        if pose is None:
            notes[name] = f'{name} moves on its track in the mission file'
            scheduled.add(name)
        else:
            if track is not None:
                notes[name] = (f'using the estimate of {name} instead of its track in the mission '
                               'file')
            known_radius, speed = (0.0, 0.0) if is_node else (
                pose.radius(name, settings), settings.eavesdroppers[name].max_speed)
            if speed and pose.velocity is not None and math.hypot(*pose.velocity) > speed:
                notes[name] = (f'{name} is faster than {name}.max_speed, which is {speed:g} m/s; '
                               'using the measured speed')
            track = _predict(pose, known_radius, speed, settings.confidence, until, clock)
            if track is None:
                position, radius = pose.position, known_radius
            else:
                moves_by_estimate = True
        if is_node:
            node = settings.ground_nodes[name]
            nodes.append(GroundNode(position, name, node.weight,
                                    # Knots (time, x, y) without the radius of a disc.
                                    track and tuple(knot[:3] for knot in track),
                                    node.trusted))
        else:
            eavesdroppers.append(Eavesdropper(
                position, radius, name, settings.eavesdroppers[name].receiver_advantage_db,
                track))
    return Receivers(
        {'ground_nodes': tuple(nodes), 'eavesdroppers': tuple(eavesdroppers)},
        clock.to_plan(until) if moves_by_estimate else None, notes, frozenset(scheduled))


def _horizon(settings: PlannerSettings) -> float:
    """Return the time [s] for which receivers are predicted; infinite if nothing limits it."""
    if settings.prediction_horizon:
        return settings.prediction_horizon
    if settings.has_replans:
        # The next replan begins a period later and takes effect after its lead.
        return settings.replan_period + 2 * (settings.replan_lead + settings.slot_duration)
    return math.inf


def _predict(pose: KnownPose, radius: float, max_speed: float, confidence: float, until: float,
             clock: PlanClock) -> Track | None:
    """
    Return the track of a receiver from its measurement until a time of the clock [s].

    The track has two knots: (time [s] from point 0, x, y, radius [m]). It lasts at least
    SHORTEST_TRACK, unless its radius reaches RADIUS.high earlier. It is None for a receiver that
    stands: one without max_speed and without a velocity that has a covariance.

    With a max_speed the receiver may go anywhere from its measured place at max_speed. If its
    measured speed is larger, it may do so at this speed plus the error of the velocity. Without a
    max_speed it goes straight on, and its radius grows by the error of the velocity. A message
    does not say how position and velocity correlate. The standard deviation after t s is therefore
    bounded by the position's plus t times the velocity's.
    """
    velocity, growth = (0.0, 0.0), 0.0
    if pose.velocity is not None and pose.velocity_covariance is not None:
        velocity, growth = pose.velocity, error_radius(pose.velocity_covariance, confidence)
    if max_speed:
        speed = math.hypot(*velocity)
        velocity, growth = (0.0, 0.0), speed + growth if speed > max_speed else max_speed
    if not (any(velocity) or growth):
        return None
    duration, most = max(until - pose.time, SHORTEST_TRACK), RADIUS.high
    if growth:  # The track ends when its disc has the largest radius that a mission allows.
        duration = min(duration, (most - radius) / growth)
    return tuple((clock.to_plan(pose.time + age), pose.position[0] + age * velocity[0],
                  pose.position[1] + age * velocity[1], radius + age * growth)
                 for age in (0.0, duration))


def has_moved(before: Scenario, now: Scenario, time: float, distance: float) -> bool:
    """
    Return True if a receiver is not where a plan expects it at a time [s] from point 0.

    A receiver has moved if it is farther than `distance` [m] from there. An eavesdropper has also
    moved if it has a track in `now` and its centre is outside of its expected disc, or if its
    radius differs by more than 0.1 * distance. With a track only a larger radius counts, because a
    new prediction starts with a small one. A `distance` of 0 allows any distance and any radius.

    :param before: the scenario of the plan.
    :param now: the same scenario with the present receivers.
    """
    # (G, 1, 2), (E, 1, 2) and (E, 1) in m, for one time.
    old_grounds, old_centres, old_radii = before.receivers_at([time])
    grounds, centres, radii = now.receivers_at([time])
    distance = distance or math.inf
    if (np.linalg.norm(old_grounds - grounds, axis=-1) > distance).any():
        return True
    # For each eavesdropper:
    moving = np.array([eve.track is not None for eve in now.eavesdroppers])
    moves = np.linalg.norm(centres - old_centres, axis=-1)[:, 0]
    growth = (radii - old_radii)[:, 0]
    has_left_disc = moving & (moves > old_radii[:, 0])
    has_other_radius = np.where(moving, growth, np.abs(growth)) > 0.1 * distance
    return bool((has_left_disc | has_other_radius | (moves > distance)).any())
