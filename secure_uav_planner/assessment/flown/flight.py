"""The flight of all UAVs by their logs, in the frame and in the time of the plan."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .alignment import find_clock, find_shift, find_time_source, fit_shift, sample_times, Shift
from .course import Course
from .log import refuse_damage, VehicleLog
from .place import check_place, place_logs, START_TOLERANCE_M
from .recording import PathLike, read_recording
from ...errors import LogFileError
from ...mission import TIME_SOURCES, TimeSource
from ...mission.fields import check_argument, Choice
from ...mission.scenario import Array, read_only
from ...mission.validation import checked_array, checked_kind
from ...plan.plan import Plan

_DOUBTFUL_S = 2.0  # A fitted time that differs by more is worth a note.


@dataclass(frozen=True, eq=False)
class FlownFlight:
    """
    Where the UAVs of a plan really were.

    :ivar course: the plan in force at each time.
    :ivar logs: VehicleLog of each UAV by name, in the frame of the plan.
    :ivar times: (K,) in s from point 0 of the plan, in steps of at most 0.1 s.
    :ivar clocks: time of each UAV's log at these times, (U, K) in s; NaN if unknown.
    :ivar positions: (U, K, 3) in m; NaN where a log does not cover the flight. Heights are NaN in
        a log without heights.
    :ivar powers: (U, K) in W that were really set, or None if a log has none.
    :ivar time_from: source of the time of the plan.
    :ivar shifts: time of each UAV's log less the plan's time, by UAV, with the uncertainty.
    :ivar notes: what a reader should know of the logs.
    """

    course: Course
    logs: dict[str, VehicleLog]
    times: Array
    clocks: Array
    positions: Array
    powers: Array | None
    time_from: TimeSource
    shifts: dict[str, Shift]
    notes: tuple[str, ...] = ()

    @property
    def plan(self) -> Plan:
        """Plan in force at the end of the flight."""
        return self.course.last

    @property
    def covered(self) -> NDArray[np.bool_]:
        """Whether the log of each UAV has its position at `times`, (U, K)."""
        return np.isfinite(self.positions[..., 0])

    def at(self, times: Array) -> Array:
        """Return positions at times (K,) in s from point 0, (U, K, 2) in m; NaN in gaps."""
        times = checked_array('times', times, (None,))
        return np.stack([[np.interp(times, self.times, column) for column in path.T[:2]]
                         for path in self.positions]).swapaxes(1, 2)

    def powers_at(self, times: Array) -> Array | None:
        """
        Return powers set at times (K,) in s from point 0, (U, K) in W; None if a log has none.

        The last power set before a time holds, and 0 W holds before the first one.
        """
        times, rows = checked_array('times', times, (None,)), []
        for index, log in enumerate(self.logs.values()):
            if log.powers is None:
                return None
            set_times, watts = log.powers
            last = np.searchsorted(  # A power set at a time holds then, within 1e-6 s.
                set_times, np.interp(times, *self._pair_times(index)) + 1e-6, 'right') - 1
            rows.append(np.where(last < 0, 0.0, watts[np.maximum(last, 0)]))
        return np.stack(rows)

    def find_power_changes(self) -> Array:
        """Return the times (C,) [s] from point 0 at which the power set for a UAV changes."""
        changes = [np.zeros(0)]
        for index, log in enumerate(self.logs.values()):
            flown, clock = self._pair_times(index)
            if log.powers is not None and len(clock):
                set_times, watts = log.powers
                changes.append(np.interp(set_times[1:][np.diff(watts) != 0], clock, flown))
        return np.concatenate(changes)

    def _pair_times(self, index: int) -> tuple[Array, Array]:
        """
        Return times from point 0 and times of a UAV's log, (K,) each in s.

        Where reports of plan_time tell them, a pause is a single time from point 0.
        """
        log, clock = [*self.logs.values()][index], self.clocks[index]
        if self.time_from == 'plan_time' and log.plan_times is not None:
            return log.plan_times[1], log.plan_times[0]
        known = np.isfinite(clock)
        return self.times[known], clock[known]

    def due_at(self, times: Array, plan: Plan) -> Array:
        """
        Return the times (K,) [s] that were due, by a plan, at the flight's times (K,) [s].

        Receivers that move are where they are at the time that is due. It differs from the
        flight's time in a flight that pauses, is late, or has another playback speed. In a flight
        by 'takeoff' or 'fit' it counts if it differs by 1 s, since vehicles lag behind their plan,
        and by less than the plan's duration: a log of another day has another clock.

        :param plan: the plan in force at these times.
        """
        times, log = checked_array('times', times, (None,)), next(iter(self.logs.values()))
        checked_kind('plan', plan, Plan)
        if plan.start_ns is not None and log.utc_offset is not None:
            begin = plan.start_ns * 1e-9 - log.utc_offset
        elif self.time_from == 'plan_time' and log.plan_times is not None:
            begin = float(np.subtract(*log.plan_times)[0])
        else:
            return times
        due = np.asarray(plan.promise_speed * (
            np.interp(times, *self._pair_times(0)) - begin - plan.promise_delay))
        late = np.abs(due - times)
        counts = (self.time_from in ('plan_time', 'utc')) | (
            (late > 1.0) & (late < plan.scenario.duration))
        return np.where(counts, due, times)

    def __repr__(self) -> str:
        return (f'<FlownFlight of {len(self.positions)} UAVs: time from {self.time_from}, '
                f'{self.covered.all(axis=0).mean():.0%} of the plan covered>')


def read_flight(source: PathLike | Mapping[str, PathLike], plan: Plan,
                at: TimeSource | None = None, shifts: Mapping[str, Any] | None = None
                ) -> FlownFlight:
    """
    Read the flight of a plan from logs.

    :param source: a file with all UAVs (a bag, .mcap, .db3, .csv), or for a single UAV any log; or
        a mapping from the names of UAVs to .ulg, .BIN, .tlog, .csv or .tum.
    :param plan: the plan that was flown; of a bag with replans, any plan of the flight.
    :param at: source of the time of the plan: 'plan_time' of a bag, 'utc', 'takeoff'
        (when each vehicle leaves its place) or 'fit' (the least squared distance); by default the
        first of these that all logs have.
    :param shifts: place (x, y) in m of the origin of each UAV's log in the plan's frame, by UAV.
        Without a place and without an origin of mission and log, frames are taken as equal. Then
        the vehicle must begin within START_TOLERANCE_M of its start, or a larger tracking_margin.
    :raises OptionError: for a wrong argument.
    :raises LogFileError: for a file that cannot be read or is no log of this flight, naming the
        file and the reason.
    :raises MissingPackageError: when the library of the format is not installed.
    """
    checked_kind('plan', plan, Plan)
    if at is not None:
        check_argument('at', at, Choice(TIME_SOURCES))
    recording = read_recording(source, plan)
    course, names = recording.course, [*recording.logs]
    logs, placed = place_logs(recording.logs, plan.scenario, shifts)
    time_from = at or find_time_source([*logs.values()], course)
    times = sample_times(course)
    shift_of: dict[str, Shift] = {}
    clocks, doubts = [], list[str]()
    for group in [names] if recording.is_shared else [[name] for name in names]:
        members, uavs = [logs[name] for name in group], [names.index(name) for name in group]
        with refuse_damage(recording.files[group[0]]):
            shift = find_shift(members, course, uavs, time_from, not placed.issuperset(group))
            doubts += _doubt_shift(group, members, course, uavs, shift, time_from)
            for name, log, uav in zip(group, members, uavs, strict=True):
                shift_of[name] = shift
                clocks.append(find_clock(log, shift, time_from, times, course.last))
                if name not in placed:
                    check_place(log, clocks[-1], times, course, uav, time_from)
    if not recording.is_shared and time_from in ('takeoff', 'fit'):
        doubts.append('each log has its own time of the plan: distances between UAVs are those at '
                      'equal times of the plan')
    flight = FlownFlight(
        course, logs, read_only(times), read_only(np.stack(clocks)),
        read_only(np.stack([log.positions_at(clock) for log, clock in zip(
            logs.values(), clocks, strict=True)])), None, time_from, shift_of,
        (*doubts, *_list_notes(logs, clocks, times)))
    powers = flight.powers_at(times)
    return flight if powers is None else replace(flight, powers=read_only(powers))


def _list_notes(logs: Mapping[str, VehicleLog], clocks: list[Array], times: Array) -> list[str]:
    """Return the notes of each log, then its jumps in the flight and the data that it lacks."""
    notes = []
    for (name, log), clock in zip(logs.items(), clocks, strict=True):
        notes += [f'{name}: {note}' for note in log.notes]
        notes += [f'{name}: the frame jumps at {time:.1f} s ({jump:.1f} s of the log)'
                  for jump, time in find_jumps(log, clock, times)]
        if np.isnan(log.positions[:, 2]).all():
            notes.append(f'{name}: heights are not in the log')
    lacking = [name for name, log in logs.items() if log.powers is None]
    if 0 < len(lacking) < len(logs):
        notes.append(f'{", ".join(lacking)}: powers are not in the log')
    return notes


def find_jumps(log: VehicleLog, clock: Array, times: Array) -> list[tuple[float, float]]:
    """
    Return (time of the log, time of the plan) [s] of each jump of a log's frame in the flight.

    :param clock: the log's time in s at times (K,) of the plan.
    """
    clock, times = clock[np.isfinite(clock)], times[np.isfinite(clock)]
    return [(jump, float(np.interp(jump, clock, times))) for jump in log.jumps
            if len(clock) and clock[0] <= jump <= clock[-1]]


def _doubt_shift(names: list[str], logs: list[VehicleLog], course: Course, uavs: list[int],
                 shift: Shift, time_from: TimeSource) -> list[str]:
    """
    Return a note if a fit puts the flight at another time of the plan, or an empty list.

    The two times differ by _DOUBTFUL_S or more, and the RMS of the fit is at most
    START_TOLERANCE_M. Shifts by 'plan_time' and 'fit' get no note.
    """
    if time_from in ('plan_time', 'fit'):
        return []
    try:
        fitted = fit_shift(logs, course, uavs, is_moved=True)
    except LogFileError:
        return []
    apart = fitted.seconds - shift.seconds
    if abs(apart) < _DOUBTFUL_S or fitted.rms > START_TOLERANCE_M:
        return []
    return [f'{" and ".join(names)}: the time of the plan fits {abs(apart):.1f} s '
            f'{"later" if apart > 0 else "earlier"} in the log: try --at fit']
