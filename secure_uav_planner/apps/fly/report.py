"""What a flight was worth: errors, rates and distances, from where the UAVs really were."""

import itertools
import math
from typing import NamedTuple

import numpy as np

from .link import RATE
from ...mission.polygons import depth
from ...model import channel
from ...output.table import markdown_table
from ...plan.player import POSITION_JUMP, VELOCITY_JUMP


class Report(NamedTuple):
    """
    One line of the table of flights of plans.

    Errors are distances in space from the setpoints, which are the planned curve. Rates are means
    of the guaranteed rate in bit/s/Hz, along the curve and along the flown path with its heights.
    Clear is the smallest distance on the map from a zone at a UAV's height, or from outside the
    geofence: negative inside, infinite without any.
    """

    mission: str
    error_rms: float  # m
    error_max: float
    arrival: float  # The largest distance from a goal at the time of arrival, in m.
    planned_rate: float
    flown_rate: float
    planned_apart: float  # The smallest distance between two UAVs in m.
    flown_apart: float
    planned_clear: float  # m
    flown_clear: float


def report_of(plan, flight):
    """Return the Report of the Flight of a plan."""
    scenario, planned, flown = plan.scenario, flight.setpoints, flight.places
    goals = np.array([[*uav.goal, uav.altitude] for uav in scenario.uavs])
    last = np.argmin(np.abs(flight.times - plan.curve.end))
    return Report(
        flight.event.name, *_errors(flight),
        float(np.linalg.norm(flown[:, last] - goals, axis=-1).max()),
        mean_rate(plan, flight.times, planned), mean_rate(plan, flight.times, flown),
        smallest_distance(planned), smallest_distance(flown),
        smallest_clearance(scenario, planned), smallest_clearance(scenario, flown))


def _errors(flight):
    """Return the root mean square and the largest distance from the setpoints in m."""
    errors = np.linalg.norm(flight.places - flight.setpoints, axis=-1)
    return float(np.sqrt((errors**2).mean())), float(errors.max())


def mean_rate(plan, times, places):
    """Return the mean guaranteed rate over the slots, from places (U, K, 3), in bit/s/Hz."""
    slots, step = plan.scenario.slots, plan.scenario.slot_duration
    slot = np.floor(times / step + 1e-9).astype(int)
    sending = (slot >= 1) & (slot <= slots)
    places, powers = places[:, sending], plan.powers[:, slot[sending] - 1]
    level = np.pad(places[..., :2], ((0, 0), (1, 1), (0, 0)))
    rates = channel.guaranteed_rates(plan.scenario, level, powers, altitudes=places[..., 2])
    return float(np.maximum(rates, 0.0).mean())


def smallest_distance(places):
    """Return the smallest distance between two UAVs at a time, in m; infinite for one."""
    return min((float(np.linalg.norm(one - other, axis=-1).min())
                for one, other in itertools.combinations(places, 2)), default=math.inf)


def smallest_clearance(scenario, places):
    """Return the smallest distance from what is forbidden, in m; negative inside of it."""
    points, heights = places[..., :2], places[..., 2]
    found = [math.inf]
    for zone in scenario.no_fly_zones:
        at = (zone.floor <= heights) & (heights <= zone.ceiling)
        found.append(-depth(zone.vertices, points[at]).max(initial=-math.inf))
    if scenario.geofence is not None:
        found.append(depth(scenario.geofence, points).min())
    return float(min(found))


def flight_table(reports):
    """Return the Reports as a Markdown table."""
    return markdown_table(
        ('mission', 'error RMS, max (m)', 'goal missed by (m)', 'rate planned, flown (bit/s/Hz)',
         'lost', 'UAVs apart, planned, flown (m)', 'clear of zones, planned, flown (m)'),
        ((one.mission, f'{one.error_rms:.2f}, {one.error_max:.2f}', f'{one.arrival:.2f}',
          f'{one.planned_rate:.4f}, {one.flown_rate:.4f}',
          f'{100 * (1 - one.flown_rate / one.planned_rate):.2f}%',
          _pair(one.planned_apart, one.flown_apart), _pair(one.planned_clear, one.flown_clear))
         for one in reports))


class EventReport(NamedTuple):
    """One line of the table of events; errors are as in Report, rates by the planner's status."""

    event: str
    jump: float  # By how much a setpoint at most moved beyond speed times step, in m.
    kick: float  # By how much its acceleration was at most beyond the limit, in m/s^2.
    error_rms: float
    error_max: float
    replans: int  # How many the planner made.
    refusals: int  # How many plans and replans it refused.
    achieved_rate: float
    planned_rate: float
    warnings: int  # How many times the planner's status was not OK after the landing.

    @property
    def is_smooth(self):
        """Return whether no setpoint jumped, but for rounding."""
        return self.jump <= POSITION_JUMP and self.kick <= VELOCITY_JUMP * RATE


def event_report(flight):
    """Return the EventReport of the Flight with an event."""
    scenario, steps = flight.scenario, np.diff(flight.times)
    moves = np.linalg.norm(np.diff(flight.setpoints, axis=1), axis=-1)
    changes = np.linalg.norm(np.diff(flight.velocities, axis=1), axis=-1)
    status = flight.status
    return EventReport(
        flight.event.name,
        float((moves - scenario.max_speeds[:, None] * steps).max(initial=0.0)),
        float((changes / steps - scenario.max_accelerations[:, None]).max(initial=0.0)),
        *_errors(flight), int(status['replans']), int(status['refusals']),
        float(status['track.rate']), float(status['track.planned_rate']),
        sum(flight.warnings.values()))


def event_table(reports):
    """Return the EventReports as a Markdown table."""
    return markdown_table(
        ('event', 'jump of a setpoint beyond speed times step (m)',
         'acceleration beyond the limit (m/s^2)', 'error RMS, max (m)', 'replans made, refused',
         'rate planned, achieved (bit/s/Hz)', 'WARN after landing'),
        ((one.event, f'{one.jump:.3f}', f'{one.kick:.3f}',
          f'{one.error_rms:.2f}, {one.error_max:.2f}', f'{one.replans}, {one.refusals}',
          f'{one.planned_rate:.4f}, {one.achieved_rate:.4f}', one.warnings) for one in reports))


def _pair(planned, flown):
    return f'{planned:.1f}, {flown:.1f}' if math.isfinite(planned) else '-'
