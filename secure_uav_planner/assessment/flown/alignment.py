"""The time of the plan at a time of a log."""

from collections.abc import Sequence
import math
from typing import NamedTuple

import numpy as np
import scipy

from .course import Course
from .log import VehicleLog
from ...errors import LogFileError
from ...mission import TimeSource
from ...mission.scenario import Array
from ...plan.plan import Plan
from ...plan.tracking import LONGEST_GAP

STEP_S = 0.1
"""Step of the times at which a flight is compared with its plan."""

_LONGEST_S = 86400.0  # Longest log of a fit: the fit takes memory for each STEP_S.
_LEAST_OVERLAP = 0.5  # Share of the plan that a log must cover for a fit.
_APART_S = 2.0  # Time within which two minima of a fit are taken as one.
_ALIKE = 1.5  # Largest ratio of the RMS of two minima that are alike.
_ALIKE_M = 0.5  # Distance by which the RMS of two alike minima may differ beyond the ratio.
_POOR = 0.1  # Nothing fits where the RMS is above this share of the extent of the paths.
_REST_S = 2.0  # Duration of the motion by which a vehicle is judged to begin at rest.
_REST_M = 0.5  # Distance that a vehicle at rest moves at most in _REST_S.
_LEFT_M = 2.0  # Distance from its start at which a vehicle has left.
_FAR_M = 10.0  # Distance that a vehicle reaches after it has left: a shorter way is no departure.
_STOOD_S = 5.0  # Time before the departure at which a vehicle stands at its start.
_LEFT_S = 0.2  # Standard deviation of the time of leaving.
_INDEPENDENT_S = 1.0  # Errors of a flight are independent after this time.


class Shift(NamedTuple):
    """
    The time of the plan at a time of a log: plan = log - seconds.

    :ivar seconds: time of the log less time of the plan, in s; the median for plan_time.
    :ivar uncertainty: standard deviation of `seconds`, in s; for plan_time the largest deviation,
        which is the time of pauses.
    :ivar rms: RMS distance of the flight from the plan in m; NaN if the shift was not fitted.
    """

    seconds: float
    uncertainty: float
    rms: float = math.nan


def find_time_source(logs: Sequence[VehicleLog], course: Course) -> TimeSource:
    """Return the first of 'plan_time', 'utc', 'takeoff' and 'fit' that plan and all logs allow."""
    if all(log.plan_times is not None for log in logs):
        return 'plan_time'
    if course.last.start_ns is not None and all(log.utc_offset is not None for log in logs):
        return 'utc'
    return 'takeoff' if all(map(_begins_at_rest, logs)) else 'fit'


def find_shift(logs: Sequence[VehicleLog], course: Course, uavs: Sequence[int],
               source: TimeSource, is_moved: bool) -> Shift:
    """
    Return the shift of logs that share one clock: time of the log minus time of the plan.

    :param uavs: index of the UAV of each log.
    :param source: what tells the time of the plan, as in TIME_SOURCES.
    :param is_moved: whether the log's frame may be displaced; used by 'fit' only.
    :raises LogFileError: if the source has no answer, or two.
    """
    if source == 'plan_time':
        return _find_reported_shift(logs[0])
    if source == 'utc':
        offset, start_ns = logs[0].utc_offset, course.last.start_ns
        if offset is None or start_ns is None:
            what = 'the plan has no start' if offset is not None else 'the log has no UTC'
            raise LogFileError(f'{what}; give --at takeoff or --at fit')
        # Time of the log at point 0 of the plan.
        return Shift(start_ns * 1e-9 + course.last.promise_delay - offset, 0.0)
    if source == 'takeoff':
        return _find_takeoff_shift(logs, course, uavs)
    return fit_shift(logs, course, uavs, is_moved)


def find_clock(log: VehicleLog, shift: Shift, source: TimeSource, times: Array, plan: Plan
               ) -> Array:
    """
    Return the log's time [s] at times (K,) of the plan; NaN outside of reports of plan_time.

    :param plan: the plan by whose promise_speed a flight by 'utc' is timed.
    """
    if source != 'plan_time':
        return times / (plan.promise_speed if source == 'utc' else 1.0) + shift.seconds
    assert log.plan_times is not None
    clock, flown = log.plan_times
    inside = np.clip(times, flown[0], flown[-1])  # Reports are rounded to ns.
    return np.where(np.abs(times - inside) < 1e-6, np.interp(inside, flown, clock), np.nan)


def _find_reported_shift(log: VehicleLog) -> Shift:
    """Return the Shift by plan_time: median of log minus plan [s], largest deviation from it."""
    if log.plan_times is None:
        raise LogFileError('it has no plan_time of this plan')
    delays = np.subtract(*log.plan_times)
    median = float(np.median(delays))
    return Shift(median, float(np.abs(delays - median).max()))


def _find_takeoff_shift(logs: Sequence[VehicleLog], course: Course, uavs: Sequence[int]) -> Shift:
    """
    Return the Shift by the times at which UAVs leave their starts.

    The shift is the median over UAVs of the time in the log minus the time in the plan. Its
    uncertainty is half of the range, at least _LEFT_S.
    """
    times = sample_times(course)
    planned = course.at(times).positions
    shifts = []
    for log, uav in zip(logs, uavs, strict=True):
        start = planned[uav, 0]
        in_plan = _find_departure(times, planned[uav], start)
        in_log = _find_departure(log.times, log.positions[:, :2], start)
        if in_log is not None and in_plan is not None:
            shifts.append(in_log - in_plan)
    if not shifts:
        raise LogFileError('no vehicle leaves a place; give --at fit')
    return Shift(float(np.median(shifts)), max(float(np.ptp(shifts)) / 2, _LEFT_S))


def fit_shift(logs: Sequence[VehicleLog], course: Course, uavs: Sequence[int],
              is_moved: bool = False) -> Shift:
    """
    Return the shift, log minus plan, with the least mean squared distance of logs from the course.

    :param uavs: index of the UAV of each log.
    :param is_moved: True if each log's frame may be displaced: its mean difference is subtracted.
    :raises LogFileError: if a second minimum over _APART_S away has nearly the same RMS, as after
        several flights of one plan or if nothing fits, if every shift covers less than the share
        _LEAST_OVERLAP of the plan, or if the logs are longer than _LONGEST_S.
    """
    first = min(log.times[0] for log in logs)
    length = max(log.times[-1] for log in logs) - first
    if length > _LONGEST_S:
        raise LogFileError(f'it spans {length / 3600:.3g} h and a fit takes at most '
                           f'{_LONGEST_S / 3600:g} h; cut the log to one flight')
    clock = first + STEP_S * np.arange(math.ceil(length / STEP_S) + 1)
    lags, means, counts = _measure_lags(
        [log.positions_at(clock)[:, :2] for log in logs], course, uavs, is_moved)
    planned = len(logs) * len(sample_times(course))
    means[counts < _LEAST_OVERLAP * planned] = np.inf
    best = int(np.argmin(means))
    if not math.isfinite(means[best]):
        raise LogFileError(f'the log covers less than {_LEAST_OVERLAP:.0%} of the plan by '
                           f'positions that are at most {LONGEST_GAP:g} s apart')
    lags += first
    rms, seconds = math.sqrt(means[best]), _refine_lag(lags, means, best)
    second, second_rms = _find_second_minimum(lags, means, best)
    if second_rms < _ALIKE * rms + _ALIKE_M:
        if rms > _POOR * np.ptp(course.at(sample_times(course)).positions, axis=1).max():
            raise LogFileError(f'no time fits: it flies {rms:.0f} m RMS from the plan at best')
        raise LogFileError(
            f'two times fit alike: shifts of {lags[best]:.1f} s ({rms:.2f} m) and '
            f'{lags[second]:.1f} s ({second_rms:.2f} m); give --at utc, or cut the '
            'log to one flight')
    # Near the minimum, the mean is rms^2 + rise * n^2 at n steps from it. With `independent`
    # errors, the standard deviation of n is rms / sqrt(rise * independent).
    rise = max(float(np.diff(means[max(best - 1, 0):best + 2], 2).sum()), 0.0) / 2
    independent = max(1.0, float(counts[best]) * STEP_S / _INDEPENDENT_S)
    if not math.isfinite(rise) or rise == 0.0:
        return Shift(seconds, STEP_S, rms)
    return Shift(seconds, rms * STEP_S / math.sqrt(rise * independent), rms)


def _find_second_minimum(lags: Array, means: Array, best: int) -> tuple[int, float]:
    """
    Return index and RMS [m] of the least local minimum over _APART_S from the best; inf if none.

    The first lag over _APART_S away is a minimum if the mean of the next lag is not smaller.

    :param lags: lags [s], STEP_S apart, (L,).
    :param means: mean squared distance at each lag, (L,) in m^2.
    :param best: index of the least mean.
    """
    is_minimum = np.r_[True, means[1:] <= means[:-1]] & np.r_[means[:-1] <= means[1:], True]
    is_apart = np.abs(lags - lags[best]) > _APART_S
    minima = np.where(is_minimum & is_apart, means, np.inf)
    second = int(np.argmin(minima))
    return second, math.sqrt(minima[second])


def find_delay(positions: Array, course: Course, uav: int) -> float:
    """
    Return the time in s by which a UAV is behind its course; NaN if it hovers or no lag fits.

    :param positions: (K, 2) in m at the times of the course in steps of STEP_S; NaN in gaps.
    """
    planned = course.at(sample_times(course)).positions[uav]
    if np.ptp(planned, axis=0).max() < _LEFT_M or not np.isfinite(positions).any():
        return math.nan
    lags, means, counts = _measure_lags([positions], course, [uav], False)
    means[counts < _LEAST_OVERLAP / 2 * counts.max()] = np.inf
    best = int(np.argmin(means))
    if not np.isfinite(means[max(best - 1, 0):best + 2]).all():
        return math.nan  # The best lag is at the edge of the lags with enough samples.
    return _refine_lag(lags, means, best) + course.begin


def _measure_lags(tracks: Sequence[Array], course: Course, uavs: Sequence[int], is_moved: bool
                  ) -> tuple[Array, Array, Array]:
    """
    Return lags (L,) [s], mean squared distances (L,) [m^2] of tracks, and samples compared (L,).

    At a lag, the first sample of the tracks is flown at the time -lag of the plan. The sum of
    |flown - planned|^2 over the samples that a lag compares is sum |flown|^2 + sum |planned|^2
    - 2 sum flown . planned, and each of the three sums is a correlation over all lags.

    :param tracks: positions (K, 2) in m in steps of STEP_S; NaN in gaps.
    :param is_moved: True if each track's frame may be displaced: |sum (flown - planned)|^2 / n is
        subtracted for n samples, which leaves the squared distances from the mean difference.
    """
    times = sample_times(course)
    planned = course.at(times).positions
    squares, counts = np.zeros(1), np.zeros(1)
    for track, uav in zip(tracks, uavs, strict=True):
        # Coordinates (2, K) of both are relative to their centres, which avoids cancellation.
        path = planned[uav].T
        centre = path.mean(axis=1, keepdims=True)
        covered = np.isfinite(track[:, 0]).astype(float)
        middle = np.nanmean(track, axis=0)[:, None] if is_moved else centre
        flown, path = np.where(covered, track.T - middle, 0.0), path - centre
        ones = np.ones(len(times))
        count = _correlate(covered, ones)
        squares = squares + _correlate((flown**2).sum(axis=0), ones) + _correlate(
            covered, (path**2).sum(axis=0)) - 2 * sum(map(_correlate, flown, path))
        if is_moved:
            differences = np.stack([_correlate(row, ones) - _correlate(covered, target)
                                    for row, target in zip(flown, path)])
            squares = squares - (differences**2).sum(axis=0) / np.maximum(count, 1.0)
        counts = counts + count
    lags = STEP_S * (np.arange(len(counts)) - (len(times) - 1)) - times[0]
    return lags, np.maximum(squares, 0.0) / np.maximum(counts, 1.0), counts


def _refine_lag(lags: Array, means: Array, best: int) -> float:
    """Return the lag [s] at the minimum of the parabola through the least mean and both beside."""
    if not 0 < best < len(means) - 1 or not np.isfinite(means[best - 1:best + 2]).all():
        return float(lags[best])
    before, here, after = means[best - 1:best + 2]
    bend = before - 2 * here + after
    return float(lags[best] + (STEP_S * (before - after) / (2 * bend) if bend > 0 else 0.0))


def _correlate(values: Array, kernel: Array) -> Array:
    """Return sums of values times a kernel, for each lag of the values behind the kernel."""
    return np.asarray(scipy.signal.correlate(values, kernel, mode='full', method='fft'))


def sample_times(course: Course) -> Array:
    """Return the times [s] of a course in steps of STEP_S, (K,)."""
    return np.arange(course.begin, course.end + STEP_S / 2, STEP_S)


def _begins_at_rest(log: VehicleLog) -> bool:
    """Return whether the vehicle moves less than _REST_M in the first _REST_S of its log."""
    begin = log.positions[log.times <= log.times[0] + _REST_S, :2]
    return bool(np.linalg.norm(begin - begin[0], axis=1).max() < _REST_M)


def _find_departure(times: Array, positions: Array, start: Array) -> float | None:
    """
    Return the time [s] at which a vehicle is _LEFT_M from its start, or None if it stays there.

    If the vehicle comes back, the last departure before the first time at a distance of _FAR_M
    counts. If it never gets that far, _FAR_M is replaced by its largest distance.

    :param times: times of the positions, (K,) in s.
    :param positions: positions of the vehicle, (K, 2) in m.
    :param start: planned start, (2,) in m. If no position is within _LEFT_M of the planned start,
        the frame of the positions is another one, and the first position replaces it.
    """
    # The first pass measures distances from the planned start, and the second pass from where the
    # vehicle stood _STOOD_S before it left in the first pass.
    for _ in range(2):
        distances = np.linalg.norm(positions - start, axis=1)
        if distances.min() > _LEFT_M:
            distances = np.linalg.norm(positions - positions[0], axis=1)
        arrival = int(np.argmax(distances <= _LEFT_M))
        reach = min(_FAR_M, distances[arrival:].max())
        far = arrival + int(np.argmax(distances[arrival:] >= reach))
        near = int(np.flatnonzero(distances[:far + 1] <= _LEFT_M)[-1])
        start = positions[np.searchsorted(times, times[near] - _STOOD_S)]
    if near == far:
        return None
    return float(np.interp(_LEFT_M, distances[near:near + 2], times[near:near + 2]))
