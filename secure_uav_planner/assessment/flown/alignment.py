"""The time of the plan at a time of a log, and the frame of the plan."""

from collections.abc import Sequence
import math
from typing import NamedTuple

import numpy as np
import scipy

from .log import VehicleLog
from ...errors import LogFileError
from ...mission import TimeSource
from ...mission.scenario import Array
from ...model.curve import Curve
from ...plan.plan import Plan

STEP_S = 0.1
"""Step of the times at which a flight is compared with its plan."""

_LEAST_OVERLAP = 0.5  # Share of the plan that a log must cover for a fit.
_APART_S = 2.0  # Time within which two minima of a fit are taken as one.
_ALIKE, _ALIKE_M = 1.5, 0.5  # A second minimum is alike below _ALIKE * RMS + _ALIKE_M.
_MOVED_M = 2.0  # Distance from the first place at which a vehicle has left it.
_REST_S, _REST_M = 2.0, 0.5  # A vehicle begins at rest if it moves less than _REST_M in _REST_S.
_INDEPENDENT_S = 1.0  # Errors of a flight are independent after this time.


class Shift(NamedTuple):
    """
    The time of the plan at a time of a log: plan = log - seconds.

    :ivar seconds: time of the log less time of the plan, in s.
    :ivar uncertainty: standard deviation of `seconds`, in s.
    :ivar rms: RMS distance of the flight from the plan in m; NaN if the shift was not fitted.
    """

    seconds: float
    uncertainty: float
    rms: float = math.nan


def find_time_source(logs: Sequence[VehicleLog], plan: Plan) -> TimeSource:
    """Return the best source of the time that all logs have."""
    if all(log.plan_times is not None for log in logs):
        return 'plan_time'
    if plan.start_ns is not None and all(log.utc_offset is not None for log in logs):
        return 'utc'
    return 'takeoff' if all(map(_begins_at_rest, logs)) else 'fit'


def find_shift(logs: Sequence[VehicleLog], plan: Plan, uavs: Sequence[int],
               source: TimeSource, is_moved: bool = False) -> Shift:
    """
    Return the shift of logs on one clock by a source of time other than plan_time.

    :param uavs: index of the UAV of each log.
    :param is_moved: whether the frame of each log may lie anywhere.
    :raises LogFileError: where the source has no answer, or two.
    """
    if source == 'utc':
        offset = logs[0].utc_offset
        if offset is None or plan.start_ns is None:
            what = 'the plan has no start' if offset is not None else 'the log has no UTC'
            raise LogFileError(f'{what}; give --at takeoff or --at fit')
        return Shift(plan.start_ns * 1e-9 - offset, 0.0)
    if source == 'takeoff':
        leaves = [(_find_departure(log.times, log.positions), _find_departure(*_sample(
            plan.curve, uav))) for log, uav in zip(logs, uavs, strict=True)]
        shifts = [log - planned for log, planned in leaves
                  if log is not None and planned is not None]
        if not shifts:
            raise LogFileError('no vehicle leaves a place; give --at fit')
        return Shift(float(np.median(shifts)), float(np.ptp(shifts)) / 2 + STEP_S)
    return fit_shift(logs, plan.curve, uavs, is_moved)


def fit_shift(logs: Sequence[VehicleLog], curve: Curve, uavs: Sequence[int],
              is_moved: bool = False) -> Shift:
    """
    Return the shift with the least mean squared distance of logs from a plan.

    :param is_moved: whether the frame of each log may lie anywhere.
    :raises LogFileError: where two shifts are alike, as after several flights of one plan.
    """
    first = min(log.times[0] for log in logs)
    count = math.ceil((max(log.times[-1] for log in logs) - first) / STEP_S) + 1
    clock = first + STEP_S * np.arange(count)
    planned, _ = _sample(curve, 0)
    squares, weights, products = np.zeros(1), np.zeros(1), 0
    for log, uav in zip(logs, uavs, strict=True):
        inside = ((clock >= log.times[0]) & (clock <= log.times[-1])).astype(float)
        flown = np.stack([np.interp(clock, log.times, column)
                          for column in log.positions.T[:2]]) * inside
        path = _sample(curve, uav)[1].T
        centre = path.mean(axis=1, keepdims=True)
        flown, path = (flown - centre * inside), path - centre
        ones = np.ones(path.shape[1])
        number = _correlate(inside, ones)
        sums = np.stack([_correlate(row, ones) - _correlate(inside, target)
                         for row, target in zip(flown, path)])
        square = _correlate((flown**2).sum(axis=0), ones) + _correlate(
            inside, (path**2).sum(axis=0))
        cross = sum(_correlate(row, target) for row, target in zip(flown, path))
        squares = squares + square - 2 * cross
        if is_moved:
            squares = squares - (sums**2).sum(axis=0) / np.maximum(number, 1.0)
        weights = weights + number
        products = products + len(ones)
    lags = STEP_S * (np.arange(len(weights)) - (len(planned) - 1)) + first - planned[0]
    means = np.where(weights >= _LEAST_OVERLAP * products,
                     np.maximum(squares, 0.0) / np.maximum(weights, 1.0), np.inf)
    best = int(np.argmin(means))
    if not math.isfinite(means[best]):
        raise LogFileError(f'the log covers less than {_LEAST_OVERLAP:.0%} of the plan')
    rms = math.sqrt(means[best])
    others = np.where(np.abs(lags - lags[best]) > _APART_S, means, np.inf)
    is_minimum = np.r_[True, others[1:] <= others[:-1]] & np.r_[others[:-1] <= others[1:], True]
    others[~is_minimum] = np.inf
    second = int(np.argmin(others))
    if math.sqrt(others[second]) < _ALIKE * rms + _ALIKE_M:
        raise LogFileError(
            f'two times fit alike: shifts of {lags[best]:.1f} s ({rms:.2f} m) and '
            f'{lags[second]:.1f} s ({math.sqrt(others[second]):.2f} m); give --at utc, or cut the '
            'log to one flight')
    seconds = float(lags[best])
    if 0 < best < len(means) - 1 and np.isfinite(means[[best - 1, best + 1]]).all():
        before, here, after = means[best - 1:best + 2]
        bend = before - 2 * here + after
        seconds += STEP_S * float((before - after) / (2 * bend)) if bend > 0 else 0.0
        slope = math.sqrt(max(bend, 0.0) / 2) / STEP_S  # RMS speed in m/s.
        independent = max(1.0, float(weights[best]) * STEP_S / _INDEPENDENT_S)
        return Shift(seconds, rms / max(slope * math.sqrt(independent), 1e-9), rms)
    return Shift(seconds, STEP_S, rms)


def _correlate(values: Array, kernel: Array) -> Array:
    """Return sums of values times a kernel, for each lag of the values behind the kernel."""
    return np.asarray(scipy.signal.correlate(values, kernel, mode='full', method='fft'))


def _sample(curve: Curve, uav: int) -> tuple[Array, Array]:
    """Return times in s and positions (K, 2) in m of a UAV on its plan."""
    times = np.arange(curve.begin, curve.end + STEP_S / 2, STEP_S)
    return times, curve.at(times).positions[uav]


def _begins_at_rest(log: VehicleLog) -> bool:
    begin = log.positions[log.times <= log.times[0] + _REST_S, :2]
    return bool(np.linalg.norm(begin - begin[0], axis=1).max() < _REST_M)


def _find_departure(times: Array, positions: Array) -> float | None:
    """Return the time in s at which a vehicle has left its first place, or None if it stays."""
    distances = np.linalg.norm(positions[:, :2] - positions[0, :2], axis=1)
    index = int(np.argmax(distances > _MOVED_M))
    if not index:
        return None
    near, far = distances[index - 1], distances[index]
    share = (_MOVED_M - near) / (far - near)
    return float(times[index - 1] + share * (times[index] - times[index - 1]))
