"""Errors of each UAV of a flight against its plan, and the energy that it took."""

import math
from typing import NamedTuple

import numpy as np
import shapely

from .alignment import find_delay, STEP_S
from .flight import find_jumps, FlownFlight
from ...mission.scenario import Array
from ...model.curve import integrate_powers

_WINDOW_S = 0.5  # Accelerations are differences of velocities over this time.
_WH = 3600.0  # J


class UavErrors(NamedTuple):
    """
    Errors of one UAV against its plan; NaN for what its log does not tell.

    :ivar delay_s: time by which the UAV is behind its plan along its way.
    :ivar error_rms_m: horizontal distance from the plan at the same time, RMS.
    :ivar error_max_m: largest horizontal distance from the plan at the same time.
    :ivar error_max_time_s: time of the largest distance, from point 0.
    :ivar cross_track_rms_m: distance from the nearest point of the planned way, RMS.
    :ivar cross_track_95_m: 95% quantile of the distance from the way.
    :ivar cross_track_99_m: 99% quantile of the distance from the way.
    :ivar cross_track_max_m: largest distance from the way.
    :ivar cross_track_max_time_s: time of the largest distance from the way, from point 0.
    :ivar cross_track_mean_m: mean distance to the left of the way, negative to the right.
    :ivar height_error_max_m: largest difference of heights.
    :ivar speed_max_m_s: largest speed that was flown.
    :ivar acceleration_max_m_s2: largest acceleration that was flown.
    :ivar gap_max_s: longest time without a position.
    :ivar jumps_s: times at which the frame of the log jumps, from point 0.
    :ivar energy_j: energy by the model of propulsion along the way flown, in the time covered.
    :ivar planned_energy_j: energy of the plan by the same model.
    :ivar battery_wh: energy taken from the battery.
    :ivar battery_factor: energy taken from the battery in units of `energy_j`.
    :ivar setpoint_error_rms_m: RMS distance of the autopilot's targets from the plan.
    """

    delay_s: float
    error_rms_m: float
    error_max_m: float
    error_max_time_s: float
    cross_track_rms_m: float
    cross_track_95_m: float
    cross_track_99_m: float
    cross_track_max_m: float
    cross_track_max_time_s: float
    cross_track_mean_m: float
    height_error_max_m: float
    speed_max_m_s: float
    acceleration_max_m_s2: float
    gap_max_s: float
    jumps_s: tuple[float, ...]
    energy_j: float
    planned_energy_j: float
    battery_wh: float
    battery_factor: float
    setpoint_error_rms_m: float


def measure_errors(flight: FlownFlight, index: int) -> tuple[UavErrors, Array]:
    """Return the errors of a UAV, and its distances from its way at flight.times, (K,) in m."""
    times, uav = flight.times, flight.plan.scenario.uavs[index]
    log, clock = flight.logs[uav.name], flight.clocks[index]
    flown, planned = flight.positions[index], flight.course.at(times).positions[index]
    distances = np.linalg.norm(flown[:, :2] - planned, axis=1)
    sides = measure_sides(flown[:, :2], planned)
    ways = np.abs(sides)
    worst, farthest = _find_largest(distances), _find_largest(ways)
    inside = ways[np.isfinite(ways)]
    quantiles = np.quantile(inside, [0.95, 0.99]).tolist() if len(inside) else [math.nan] * 2
    speed, acceleration, energy = _measure_motion(flight, index)
    energies = flight.plan.energies[index]
    joules = _take_battery(flight, index)
    return UavErrors(
        find_delay(flown[:, :2], flight.course, index), _find_rms(distances), distances[worst],
        times[worst], _find_rms(ways), *quantiles, ways[farthest], times[farthest],
        float(np.mean(sides[np.isfinite(sides)])) if len(inside) else math.nan,
        _find_maximum(np.abs(flown[:, 2] - uav.altitude)), speed, acceleration,
        _find_gap(np.isfinite(flown[:, 0])),
        tuple(time for _, time in find_jumps(log, clock, times)),
        energy, math.nan if energies is None else energies.total, joules / _WH, joules / energy,
        _measure_setpoints(flight, index, planned)), ways


def measure_sides(positions: Array, way: Array) -> Array:
    """
    Return the distances of positions (K, 2) from a way (M, 2) in m, positive on its left, (K,).

    A position that is NaN has the distance NaN.
    """
    sides, known = np.full(len(positions), np.nan), np.isfinite(positions[:, 0])
    moves = np.diff(way, axis=0)
    moving = np.linalg.norm(moves, axis=1) > 0
    begins, moves = (way[:-1][moving], moves[moving]) if moving.any() else (way[:1], moves[:1])
    tree = shapely.STRtree(shapely.linestrings(np.stack([begins, begins + moves], axis=1)))
    (_, nearest), distances = tree.query_nearest(
        shapely.points(positions[known]), return_distance=True, all_matches=False)
    offsets, along = positions[known] - begins[nearest], moves[nearest]
    is_right = along[:, 0] * offsets[:, 1] < along[:, 1] * offsets[:, 0]
    sides[known] = np.where(is_right, -distances, distances)
    return sides


def _measure_motion(flight: FlownFlight, index: int) -> tuple[float, float, float]:
    """Return the largest speed in m/s and acceleration in m/s^2, and the energy in J."""
    uav, clock = flight.plan.scenario.uavs[index], flight.clocks[index]
    known = clock[np.isfinite(clock)]
    # The limits and the energy count in the time of the vehicle, which goes on in a pause.
    times = np.arange(known[0], known[-1], STEP_S) if len(known) else np.zeros(0)
    if len(times) < 2:
        return math.nan, math.nan, math.nan
    velocities = flight.logs[uav.name].velocities_at(times)
    window = max(1, round(_WINDOW_S / STEP_S))
    changes = np.linalg.norm(velocities[window:] - velocities[:-window], axis=1)
    whole = np.isfinite(velocities[1:, 0]) & np.isfinite(velocities[:-1, 0])
    energy = math.nan if uav.propulsion is None else float(integrate_powers(
        (uav,), velocities[:-1][whole][None], velocities[1:][whole][None], STEP_S).sum())
    return (_find_maximum(np.linalg.norm(velocities, axis=1)),
            _find_maximum(changes) / (window * STEP_S), energy)


def _take_battery(flight: FlownFlight, index: int) -> float:
    """Return the energy in J taken from the battery in the time covered."""
    log = flight.logs[flight.plan.scenario.uavs[index].name]
    clock = flight.clocks[index][flight.covered[index]]
    if log.battery is None or not len(clock):
        return math.nan
    return float(np.diff(np.interp(clock[[0, -1]], *log.battery))[0])


def _measure_setpoints(flight: FlownFlight, index: int, planned: Array) -> float:
    """Return the RMS distance in m of the autopilot's targets from planned positions (K, 2)."""
    log, clock = flight.logs[flight.plan.scenario.uavs[index].name], flight.clocks[index]
    if log.setpoints is None:
        return math.nan
    when, places = log.setpoints
    valid = np.isfinite(places).all(axis=1)
    if not valid.any():
        return math.nan
    targets = np.stack([np.interp(clock, when[valid], column[valid], np.nan, np.nan)
                        for column in places.T], axis=-1)
    return _find_rms(np.linalg.norm(targets - planned, axis=1))


def _find_gap(known: Array) -> float:
    """Return the longest time without a position in s."""
    edges = np.flatnonzero(np.diff(np.concatenate([[True], known, [True]]).astype(int)))
    return float(max((last - first for first, last in edges.reshape(-1, 2)), default=0) * STEP_S)


def _find_rms(values: Array) -> float:
    inside = values[np.isfinite(values)]
    return float(np.sqrt((inside**2).mean())) if len(inside) else math.nan


def _find_maximum(values: Array) -> float:
    return float(np.nanmax(values)) if np.isfinite(values).any() else math.nan


def _find_largest(values: Array) -> int:
    """Return the index of the largest value; 0 if all are NaN."""
    return int(np.nanargmax(values)) if np.isfinite(values).any() else 0
