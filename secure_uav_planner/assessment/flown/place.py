"""The position of a log's frame in the frame of the plan."""

from collections.abc import Mapping
import math
from typing import Any

import numpy as np

from .alignment import fit_shift
from .course import Course
from .log import VehicleLog
from ...errors import LogFileError, OptionError, quote
from ...mission import TimeSource
from ...mission.fields import check_argument, checked_point
from ...mission.scenario import Array, Scenario
from ...plan.tracking import LONGEST_GAP

START_TOLERANCE_M = 5.0
"""Distance from the plan's start up to which local frames are taken as equal."""

_CLOSE_FIT = 0.05  # A fit is close if its RMS is below this share of the extent of the way.


def place_logs(logs: Mapping[str, VehicleLog], scenario: Scenario, shifts: object
               ) -> tuple[dict[str, VehicleLog], set[str]]:
    """
    Return logs moved into the plan's frame, and the names of UAVs whose log was moved.

    A log is moved by its shift. Without a shift it is moved by the origins on Earth of log and
    mission. If one of these is missing, the log is returned as it is.

    :param shifts: position (x, y) in m of the origin of a log in the plan's frame, by UAV. UAVs
        may be missing; None is no shift at all.
    :raises OptionError: for wrong shifts.
    """
    shifts = {} if shifts is None else shifts
    if not isinstance(shifts, Mapping):
        raise OptionError(f'shifts is {quote(shifts)}; it must be a mapping from UAVs to places',
                          ('shifts',))
    places: dict[str, Any] = {}
    for name, place in shifts.items():
        if name not in logs:
            raise OptionError(f'shift names {quote(name)}; it must be one of {", ".join(logs)}')
        places[name] = check_argument(f'shift of {name}', place, checked_point)
    if scenario.origin is not None:
        for name, log in logs.items():
            if log.reference is not None and name not in places:
                places[name] = tuple(map(float, scenario.origin.to_local(*log.reference)))
    return {name: log.move(places[name]) if name in places else log
            for name, log in logs.items()}, set(places)


def check_place(log: VehicleLog, clock: Array, times: Array, course: Course, uav: int,
                time_from: TimeSource) -> None:
    """
    Refuse a log whose first position in the flight is too far from the plan: frames differ.

    The distance may be at most the larger one of START_TOLERANCE_M and the tracking margin.

    :param clock: the log's time in s at times (K,) of the plan.
    :raises LogFileError: also without a position in the flight; with the option to type, such as
        --shift, if one lets the log fit.
    """
    scenario = course.last.scenario
    name, tolerance = scenario.uavs[uav].name, max(START_TOLERANCE_M, scenario.tracking_margin)
    flown = log.positions_at(clock)[:, :2]
    inside = np.flatnonzero(np.isfinite(flown[:, 0]))
    if not len(inside):
        raise LogFileError(f'it has no position of {name} in the time of the plan, by '
                           f'{time_from}, or only positions over {LONGEST_GAP:g} s apart; give '
                           'another --at, such as fit')
    first = inside[0]
    offset = course.at(times[[first]]).positions[uav, 0] - flown[first]
    distance = float(np.linalg.norm(offset))
    if distance > tolerance:
        raise LogFileError(
            f'{name} is {distance:.1f} m from its plan at its begin, by {time_from}; at most '
            f'{tolerance:g} m are taken as one frame{_suggest(log, course, uav, tolerance)}')


def _suggest(log: VehicleLog, course: Course, uav: int, tolerance: float) -> str:
    """
    Return text on a log that is too far from its plan: the option to type, '' if nothing fits.

    The option is --shift for another frame, and --at fit if only the time differs. If the log fits
    with x and y swapped, the text says so instead.
    """
    name = course.last.scenario.uavs[uav].name
    swapped = VehicleLog(log.times, log.positions[:, [1, 0, 2]])
    for candidate in (log, swapped):
        try:
            shift = fit_shift([candidate], course, [uav], is_moved=True)
        except LogFileError:
            continue
        planned, flown = _pair(candidate, course, uav, shift.seconds)
        if shift.rms > _CLOSE_FIT * max(math.hypot(*np.ptp(planned, axis=0)), tolerance):
            continue
        if candidate is swapped:
            return '; its x and y fit when they are swapped: x is east and y is north'
        offset = np.median(planned - flown, axis=0) + 0.0  # The sum turns -0.0 into 0.0.
        if np.linalg.norm(offset) <= tolerance:
            return '; give --at fit'
        return (f'; give --shift {name}={offset[0]:.1f},{offset[1]:.1f}, with which it flies '
                f'{shift.rms:.2f} m from its plan')
    return ''


def _pair(log: VehicleLog, course: Course, uav: int, seconds: float) -> tuple[Array, Array]:
    """Return planned and flown positions (K, 2) at the samples of a log within the plan."""
    times = log.times - seconds
    inside = (times >= course.begin) & (times <= course.end)
    return course.at(times[inside]).positions[uav], log.positions[inside, :2]
