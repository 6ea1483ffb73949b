"""Reports of flights: errors, rates and distances, from the true positions of the UAVs."""

import itertools
import math
from types import SimpleNamespace

import numpy as np
from secure_uav_planner.mission.polygons import depth
from secure_uav_planner.model import channel
from secure_uav_planner.output.tables import markdown_table
from secure_uav_planner.plan.player import POSITION_JUMP, VELOCITY_JUMP

from .link import RATE

_ERRORS = '{error_rms:.2f}, {error_max:.2f}'
_FLIGHTS = {
    'mission': '{mission}', 'error RMS, max (m)': _ERRORS, 'goal missed by (m)': '{arrival:.2f}',
    'rate planned, flown (bit/s/Hz)': '{planned_rate:.4f}, {flown_rate:.4f}', 'lost': '{lost:.2%}',
    'UAVs apart, planned, flown (m)': '{planned_apart:.1f}, {flown_apart:.1f}',
    'clear of zones, planned, flown (m)': '{planned_clear:.1f}, {flown_clear:.1f}'}
_EVENTS = {
    'event': '{event}', 'jump of a setpoint beyond speed times step (m)': '{jump:.3f}',
    'acceleration beyond the limit (m/s^2)': '{kick:.3f}', 'error RMS, max (m)': _ERRORS,
    'replans made, refused': '{replans}, {refusals}',
    'rate planned, achieved (bit/s/Hz)': '{planned_rate:.4f}, {achieved_rate:.4f}',
    'WARN after landing': '{warnings}'}


def flight_report(plan, flight):
    """
    Return the numbers of _FLIGHTS for the Flight of a plan.

    Errors are distances in space from the setpoints, which are the planned curve. Rates are means
    of the guaranteed rate along the curve and along the flown path with its heights.
    """
    scenario, planned, flown = plan.scenario, flight.setpoints, flight.places
    goals = np.array([[*uav.goal, uav.altitude] for uav in scenario.uavs])
    last = np.argmin(np.abs(flight.times - plan.curve.end))
    planned_rate, flown_rate = (mean_rate(plan, flight.times, places)
                                for places in (planned, flown))
    return SimpleNamespace(
        mission=flight.event.name, **_errors(flight),
        arrival=np.linalg.norm(flown[:, last] - goals, axis=-1).max(),
        planned_rate=planned_rate, flown_rate=flown_rate,
        lost=1 - flown_rate / planned_rate if planned_rate else 0.0,
        planned_apart=smallest_distance(planned), flown_apart=smallest_distance(flown),
        planned_clear=smallest_clearance(scenario, planned),
        flown_clear=smallest_clearance(scenario, flown))


def event_report(flight):
    """Return the numbers of _EVENTS for a Flight; it is_smooth if no setpoint jumped."""
    scenario, steps, status = flight.scenario, np.diff(flight.times), flight.status
    moves = np.linalg.norm(np.diff(flight.setpoints, axis=1), axis=-1)
    changes = np.linalg.norm(np.diff(flight.velocities, axis=1), axis=-1)
    jump = (moves - scenario.max_speeds[:, None] * steps).max(initial=0.0)
    kick = (changes / steps - scenario.max_accelerations[:, None]).max(initial=0.0)
    return SimpleNamespace(
        event=flight.event.name, jump=jump, kick=kick, **_errors(flight),
        replans=status.replans, refusals=status.refusals,
        achieved_rate=status.track.rate, planned_rate=status.track.planned_rate,
        warnings=sum(flight.warnings.values()),
        is_smooth=jump <= POSITION_JUMP and kick <= VELOCITY_JUMP * RATE)


def _errors(flight):
    """Return the root mean square and the largest distance from the setpoints in m."""
    errors = np.linalg.norm(flight.places - flight.setpoints, axis=-1)
    return {'error_rms': np.sqrt((errors**2).mean()), 'error_max': errors.max()}


def report_table(reports):
    """Return reports of a kind as a Markdown table, with a dash for infinite distances."""
    columns = _EVENTS if hasattr(reports[0], 'event') else _FLIGHTS
    return markdown_table(columns, (
        [cell.format(**vars(report)).replace('inf, inf', '-') for cell in columns.values()]
        for report in reports))


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
    """Return the smallest distance between two UAVs at a time, in m; infinite without a pair."""
    return min((float(np.linalg.norm(first - second, axis=-1).min())
                for first, second in itertools.combinations(places, 2)), default=math.inf)


def smallest_clearance(scenario, places):
    """Return the smallest distance to zones and fence, in m; negative for violations."""
    points, heights = places[..., :2], places[..., 2]
    clearances = [math.inf]
    for zone in scenario.no_fly_zones:
        at = (zone.floor <= heights) & (heights <= zone.ceiling)
        clearances.append(-depth(zone.vertices, points[at]).max(initial=-math.inf))
    if scenario.geofence is not None:
        clearances.append(depth(scenario.geofence, points).min())
    return float(min(clearances))
