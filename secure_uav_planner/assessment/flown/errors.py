"""Errors of each UAV of a flight against its plan, and the energy that it took."""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
import scipy

from .alignment import find_delay, sample_times, STEP_S
from .flight import find_jumps, FlownFlight
from ...mission.validation import Array, find_runs
from ...model.curve import integrate_powers
from ...plan.tracking import LONGEST_GAP

_WINDOW_S = 0.5  # Accelerations are differences of velocities over this time.
_MOVING = 0.05  # Share of the largest speed below which a plan hovers.
_PROJECTIONS = 3  # Newton steps along the path to its nearest point.
_WH = 3600.0  # One watt-hour in J.


class UavErrors(NamedTuple):
    """
    Errors of one UAV against its plan; NaN for what its log does not tell.

    :ivar delay_s: time by which the UAV is behind its plan along the planned path.
    :ivar error_rms_m: horizontal distance from the plan at the same time, RMS.
    :ivar error_max_m: largest horizontal distance from the plan at the same time.
    :ivar error_max_time_s: time of the largest distance, from point 0.
    :ivar cross_track_rms_m: distance from the nearest point of the planned path, RMS.
    :ivar cross_track_95_m: 95% quantile of the distance from the planned path.
    :ivar cross_track_99_m: 99% quantile of the distance from the planned path.
    :ivar cross_track_max_m: largest distance from the planned path.
    :ivar cross_track_max_time_s: time of the largest distance from the planned path, from point 0.
    :ivar cross_track_mean_m: mean distance to the left of the planned path, negative to the right.
    :ivar offset_m: mean distance (x, y) from the plan at the time `delay_s` before.
    :ivar height_error_max_m: largest difference of heights.
    :ivar speed_max_m_s: largest speed that was flown.
    :ivar acceleration_max_m_s2: largest acceleration that was flown.
    :ivar gap_max_s: longest time without a position.
    :ivar jumps_s: times at which the frame of the log jumps, from point 0.
    :ivar energy_j: energy by the model of propulsion along the flown path, in the time covered.
    :ivar planned_energy_j: energy of the plan by the same model.
    :ivar battery_wh: energy taken from the battery, in the time covered.
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
    offset_m: tuple[float, float]
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
    """Return a UAV's errors, and its distances (K,) [m], >= 0, from its path at flight.times."""
    times, uav = flight.times, flight.plan.scenario.uavs[index]
    log, clock = flight.logs[uav.name], flight.clocks[index]
    flown, planned = flight.positions[index], flight.course.at(times).positions[index]
    distances = np.linalg.norm(flown[:, :2] - planned, axis=1)
    delay = find_delay(flown[:, :2], flight.course, index)
    signed = _measure_cross_track(flight, index)
    cross_track = np.abs(signed)
    error_max, error_max_time = _find_largest(distances, times)
    cross_max, cross_max_time = _find_largest(cross_track, times)
    speed, acceleration, energy = _measure_motion(flight, index)
    behind = flight.course.at(times - np.nan_to_num(delay)).positions[index]
    energies = flight.plan.energies[index]
    joules = _measure_battery(flight, index)
    return UavErrors(
        delay_s=delay,
        error_rms_m=_compute_rms(distances),
        error_max_m=error_max, error_max_time_s=error_max_time,
        cross_track_rms_m=_compute_rms(cross_track),
        cross_track_95_m=_compute_quantile(cross_track, 0.95),
        cross_track_99_m=_compute_quantile(cross_track, 0.99),
        cross_track_max_m=cross_max, cross_track_max_time_s=cross_max_time,
        cross_track_mean_m=_compute_mean(signed),
        offset_m=(_compute_mean(flown[:, 0] - behind[:, 0]),
                  _compute_mean(flown[:, 1] - behind[:, 1])),
        height_error_max_m=_compute_quantile(np.abs(flown[:, 2] - uav.altitude), 1.0),
        speed_max_m_s=speed, acceleration_max_m_s2=acceleration,
        gap_max_s=_find_gap(flight.covered[index]),
        jumps_s=tuple(time for _, time in find_jumps(log, clock, times)),
        energy_j=energy, planned_energy_j=math.nan if energies is None else energies.total,
        battery_wh=joules / _WH, battery_factor=joules / energy,
        setpoint_error_rms_m=_measure_setpoints(flight, index, planned)), cross_track


def _measure_cross_track(flight: FlownFlight, index: int) -> Array:
    """
    Return the cross-track errors of a UAV at flight.times, (K,) in m; NaN in gaps.

    Each is the distance from the nearest point of the planned path, positive on its left. That
    point is found by Newton steps in time, t + (offset . velocity) / |velocity|^2, each of at most
    STEP_S, from the nearest of points STEP_S apart. Where the plan hovers, the error is the
    distance from the hovering point.
    """
    flown = np.nan_to_num(flight.positions[index, :, :2])
    max_speed = flight.plan.scenario.uavs[index].max_speed
    samples = sample_times(flight.course)
    path = flight.course.at(samples).positions[index]
    times = samples[scipy.spatial.cKDTree(path).query(flown)[1]]
    for number in range(_PROJECTIONS + 1):
        motion = flight.course.at(times)
        offsets = flown - motion.positions[index]
        velocity = motion.velocities[index]
        squares = (velocity**2).sum(axis=1)
        is_moving = squares > (_MOVING * max_speed)**2
        if number < _PROJECTIONS:
            ahead = (offsets * velocity).sum(axis=1) / np.maximum(squares, 1e-9)
            times = times + np.where(is_moving, np.clip(ahead, -STEP_S, STEP_S), 0.0)
    headings = motion.headings[index]
    sides = offsets[:, 1] * np.cos(headings) - offsets[:, 0] * np.sin(headings)
    sides = np.where(is_moving, sides, np.copysign(np.linalg.norm(offsets, axis=1), sides))
    return np.where(flight.covered[index], sides, np.nan)


def _measure_motion(flight: FlownFlight, index: int) -> tuple[float, float, float]:
    """Return the largest speed [m/s] and acceleration [m/s^2], and the energy [J] by the model."""
    uav, clock = flight.plan.scenario.uavs[index], flight.clocks[index]
    clock = clock[np.isfinite(clock)]
    # Speeds and energy are measured on the log's clock, since the plan's time stops in a pause.
    times = np.arange(clock[0], clock[-1] + STEP_S / 2, STEP_S) if len(clock) else np.zeros(0)
    if len(times) < 2:
        return math.nan, math.nan, math.nan
    velocities = flight.logs[uav.name].velocities_at(times)
    window = max(1, round(_WINDOW_S / STEP_S))
    changes = np.linalg.norm(velocities[window:] - velocities[:-window], axis=1)
    is_step = np.isfinite(velocities[1:, 0]) & np.isfinite(velocities[:-1, 0])
    energy = math.nan if uav.propulsion is None or not is_step.any() else float(integrate_powers(
        (uav,), velocities[:-1][is_step][None], velocities[1:][is_step][None], STEP_S).sum())
    return (_compute_quantile(np.linalg.norm(velocities, axis=1), 1.0),
            _compute_quantile(changes, 1.0) / (window * STEP_S), energy)


def _measure_battery(flight: FlownFlight, index: int) -> float:
    """Return the energy [J] taken from the battery in the covered time, NaN if unknown."""
    log, covered = flight.logs[flight.plan.scenario.uavs[index].name], flight.covered[index]
    is_step = covered[1:] & covered[:-1]
    if log.battery is None or not is_step.any():
        return math.nan
    return float(np.diff(np.interp(flight.clocks[index], *log.battery))[is_step].sum())


def _measure_setpoints(flight: FlownFlight, index: int, planned: Array) -> float:
    """Return the RMS distance [m] of the log's setpoints from `planned` (K, 2), NaN for none."""
    log, clock = flight.logs[flight.plan.scenario.uavs[index].name], flight.clocks[index]
    if log.setpoints is None:
        return math.nan
    times, positions = log.setpoints
    targets = np.stack([np.interp(clock, times, column, np.nan, np.nan)
                        for column in positions.T], axis=-1)
    step = np.append(np.diff(times), 0.0)  # After each setpoint.
    targets[step[np.maximum(np.searchsorted(times, clock, 'right') - 1, 0)] > LONGEST_GAP] = np.nan
    return _compute_rms(np.linalg.norm(targets - planned, axis=1))


def _find_gap(covered: NDArray[np.bool_]) -> float:
    """Return the longest time [s] without a position; `covered` (K,) is in steps of STEP_S."""
    return float(np.ptp(find_runs(~covered), axis=1).max(initial=0) * STEP_S)


def _compute_mean(values: Array) -> float:
    """Return the mean of values without NaN; NaN if there is none."""
    inside = values[np.isfinite(values)]
    return float(inside.mean()) if len(inside) else math.nan


def _compute_rms(values: Array) -> float:
    """Return the root mean square of values without NaN; NaN if there is none."""
    return math.sqrt(_compute_mean(values**2))


def _compute_quantile(values: Array, share: float) -> float:
    """Return a quantile of values without NaN; NaN if there is none."""
    inside = values[np.isfinite(values)]
    return float(np.quantile(inside, share)) if len(inside) else math.nan


def _find_largest(values: Array, times: Array) -> tuple[float, float]:
    """Return the largest of values (K,) without NaN, and its time; NaN if there is none."""
    if not np.isfinite(values).any():
        return math.nan, math.nan
    index = int(np.nanargmax(values))
    return float(values[index]), float(times[index])
