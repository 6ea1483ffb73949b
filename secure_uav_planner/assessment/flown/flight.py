"""The flight of all UAVs by their logs, in the frame and in the time of the plan."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
import math
import os
from pathlib import Path
from typing import Any

import numpy as np

from .alignment import find_shift, find_time_source, fit_shift, Shift, STEP_S
from .bag import FlightBag, read_bag
from .dataflash import read_dataflash
from .log import refuse_damage, VehicleLog
from .telemetry import read_telemetry
from .text import read_csv, read_tum
from .ulog import read_ulog
from ...errors import LogFileError, OptionError, quote
from ...mission import TIME_SOURCES, TimeSource
from ...mission.fields import check_argument, checked_point, Choice
from ...mission.files import checked_path
from ...mission.scenario import Array, read_only
from ...mission.validation import checked_kind
from ...plan.plan import Plan

_READERS = {'.ulg': read_ulog, '.bin': read_dataflash, '.tlog': read_telemetry, '.tum': read_tum,
            '.txt': read_tum}
_BAGS = ('.mcap', '.db3')

START_TOLERANCE_M = 5.0
"""Distance from the plan's start up to which local frames are taken as equal."""

_DOUBTFUL_S = 2.0  # A fitted time that differs by more is worth a word.

Path_ = str | os.PathLike[str]


@dataclass(frozen=True, eq=False)
class FlownFlight:
    """
    Where the UAVs of a plan really were.

    :ivar plan: the plan in force at the end of the flight.
    :ivar times: (K,) in s from point 0 of the plan, in steps of at most 0.1 s.
    :ivar positions: (U, K, 3) in m; NaN where a log does not cover the flight.
    :ivar velocities: (U, K, 2) in m/s by the plan's time; NaN as the positions.
    :ivar powers: (U, K) in W that were really set, or None if the logs have none.
    :ivar time_from: where the time of the plan was taken from.
    :ivar shifts: by UAV, its log's time less the plan's time, with the uncertainty.
    :ivar battery: by UAV, the energy in J taken from its battery, where its log has one.
    :ivar setpoint_errors: by UAV, the RMS distance in m of its setpoints from the plan.
    :ivar notes: what a reader should know of the logs.
    """

    plan: Plan
    times: Array
    positions: Array
    velocities: Array
    powers: Array | None
    time_from: TimeSource
    shifts: dict[str, Shift]
    battery: dict[str, float]
    setpoint_errors: dict[str, float]
    notes: tuple[str, ...] = ()

    def at(self, times: Array) -> Array:
        """Return positions at times (K,) in s from point 0, (U, K, 2) in m; NaN in gaps."""
        return np.stack([[np.interp(times, self.times, column) for column in path.T[:2]]
                         for path in self.positions]).swapaxes(1, 2)

    def __repr__(self) -> str:
        covered = np.isfinite(self.positions).all(axis=(0, 2)).mean()
        return (f'<FlownFlight of {len(self.positions)} UAVs: time from {self.time_from}, '
                f'{covered:.0%} of the plan covered>')


def read_flight(source: Path_ | Mapping[str, Path_], plan: Plan, at: TimeSource | None = None,
                shifts: Mapping[str, Any] | None = None) -> FlownFlight:
    """
    Read the flight of a plan from logs.

    :param source: a file with all UAVs (a bag, .mcap, .db3, .csv), or for a single UAV any log; or
        a mapping from the names of UAVs to .ulg, .BIN, .tlog, .csv or .tum.
    :param plan: the plan that was flown.
    :param at: where the time of the plan is taken from: 'plan_time' of a bag, 'utc', 'takeoff'
        (when each vehicle leaves its place) or 'fit' (the least squared distance); by default the
        first of these that all logs have.
    :param shifts: by UAV, the place (x, y) in m of its log's origin in the plan's frame. Without
        it and without an origin of mission and log, frames are equal if the vehicle begins within
        START_TOLERANCE_M, or tracking_margin, of its start.
    :raises OptionError: for a wrong argument.
    :raises LogFileError: for a file that is no log of this flight, naming the file and the reason.
    :raises MissingPackageError: when the library of the format is not installed.
    :raises OSError: when a file cannot be read.
    """
    checked_kind('plan', plan, Plan)
    if at is not None:
        check_argument('at', at, Choice(TIME_SOURCES))
    shifts = {} if shifts is None else shifts
    if not isinstance(shifts, Mapping):
        raise OptionError(f'shifts is {quote(shifts)}; it must be a mapping from UAVs to places',
                          ('shifts',))
    names = tuple(uav.name for uav in plan.scenario.uavs)
    logs, bag, files = _read_logs(source, names)
    if bag is not None:
        plan = _choose_plan(bag, plan, files[names[0]])
    for name, place in shifts.items():
        if name not in names:
            raise OptionError(f'shift names {quote(name)}; it must be one of {", ".join(names)}')
        logs[name] = logs[name].move(check_argument(f'shift of {name}', place, checked_point))
    moved = {name: _place_by_origin(log, plan) if name not in shifts else None
             for name, log in logs.items()}
    logs = {name: moved[name] or log for name, log in logs.items()}
    is_shared = len({*files.values()}) == 1
    groups = [names] if is_shared else [(name,) for name in names]
    time_from = at or find_time_source([*logs.values()], plan)
    found: dict[str, Shift] = {}
    times = np.arange(plan.curve.begin, plan.curve.end + STEP_S / 2, STEP_S)
    paths, doubts = [], list[str]()
    for group in groups:
        indices = [names.index(name) for name in group]
        members = [logs[name] for name in group]
        with refuse_damage(files[group[0]]):
            if time_from == 'plan_time':
                if any(log.plan_times is None for log in members):
                    raise LogFileError('it has no plan_time of this plan')
                shift = Shift(math.nan, 0.0)
            else:
                is_placed = all(name in shifts or moved[name] for name in group)
                shift = find_shift(members, plan, indices, time_from, not is_placed)
                doubts += _doubt_shift(group, members, plan, indices, shift)
            for name, index in zip(group, indices, strict=True):
                clock = _to_plan_time(logs[name], shift)
                if name not in shifts and moved[name] is None:
                    _check_start(logs[name], clock, plan, index, time_from)
                found[name] = shift
                paths.append(_sample(logs[name], clock, times))
    positions, velocities, powers = zip(*paths, strict=True)
    return FlownFlight(
        plan, read_only(times), read_only(np.stack(positions)), read_only(np.stack(velocities)),
        None if any(power is None for power in powers) else read_only(np.stack(powers)),
        time_from, found,
        {name: _take_battery(log, _to_plan_time(log, found[name]), times)
         for name, log in logs.items() if log.battery is not None},
        {name: _measure_setpoints(log, found[name], plan, index)
         for index, (name, log) in enumerate(logs.items()) if log.setpoints is not None},
        (*doubts, *(f'{name}: {note}' for name, log in logs.items() for note in log.notes)))


def _read_logs(source: Path_ | Mapping[str, Path_], names: tuple[str, ...]
               ) -> tuple[dict[str, VehicleLog], FlightBag | None, dict[str, Path]]:
    """Return the logs by UAV, the bag if the source is one, and the files by UAV."""
    if not isinstance(source, Mapping):
        if not isinstance(source, (str, os.PathLike)):
            raise OptionError(f'source is {quote(source)}; it must be a path, or a mapping of '
                              'paths', ('source',))
        path = Path(source)
        kind = path.suffix.lower()
        if kind in _BAGS or path.is_dir():
            with refuse_damage(path):
                bag = read_bag(path, names)
            return bag.logs, bag, dict.fromkeys(names, path)
        if kind == '.csv':
            with refuse_damage(path):
                logs = read_csv(path, names)
            missing = [name for name in names if name not in logs]
            if missing:
                raise LogFileError(f'{path}: it has no rows of {missing[0]}')
            return {name: logs[name] for name in names}, None, dict.fromkeys(names, path)
        if len(names) > 1:
            raise OptionError(
                f'source is {quote(str(path))}; for several UAVs it must be a bag, a .csv, or '
                f'a log of each, such as {names[0]}=a.ulg {names[1]}=b.ulg')
        source = {names[0]: path}
    wrong = [name for name in (*source, *names) if name not in names or name not in source]
    if wrong:
        raise OptionError(f'source has logs of {", ".join(map(str, source))}; it must have one of '
                          f'each of {", ".join(names)}')
    files = {name: Path(checked_path(source[name])) for name in names}
    return {name: _read_log(path, name) for name, path in files.items()}, None, files


def _read_log(path: Path, name: str) -> VehicleLog:
    """Return the log of one UAV, read by the ending of the file."""
    kind = path.suffix.lower()
    if kind not in (*_READERS, '.csv'):
        raise LogFileError(f'{path} has the ending {quote(path.suffix)}; it must be one of '
                           f'{", ".join((*_READERS, ".csv"))}')
    path.stat()  # An OSError names the file, whatever the library raises.
    with refuse_damage(path):
        if kind == '.csv':
            logs = read_csv(path, (name,))
            if name not in logs:
                raise LogFileError(f'it has no rows of {name}')
            return logs[name]
        return _READERS[kind](path)


def _choose_plan(bag: FlightBag, plan: Plan, path: Path) -> Plan:
    """Return the last plan of a bag; its slots before the last replan hold the plans before."""
    known = [*bag.identities, *(item.identity for item in bag.plans)]
    if known and plan.identity not in known:
        raise LogFileError(f'{path}: it is a flight of the plan {known[-1]}; the plan that was '
                           f'given is {plan.identity}')
    flown = [item for item in bag.plans if not bag.identities or item.identity in bag.identities]
    return flown[-1] if flown else plan


def _place_by_origin(log: VehicleLog, plan: Plan) -> VehicleLog | None:
    """Return a log moved into the plan's frame by the origins on Earth of both, or None."""
    origin = plan.scenario.origin
    if origin is None or log.reference is None:
        return None
    east, north = origin.to_local(*log.reference)
    return log.move((float(east), float(north)))


def _to_plan_time(log: VehicleLog, shift: Shift) -> Array:
    """Return the time of the plan at each sample of a log, (K,) in s; NaN where it is unknown."""
    if math.isfinite(shift.seconds):
        return log.times - shift.seconds
    assert log.plan_times is not None
    clock, plan = log.plan_times
    order = np.argsort(clock, kind='stable')
    return np.interp(log.times, clock[order], plan[order], left=np.nan, right=np.nan)


def _check_start(log: VehicleLog, clock: Array, plan: Plan, uav: int,
                 time_from: TimeSource) -> None:
    """Refuse a log whose frame differs from the plan's: nothing tells where it lies."""
    scenario = plan.scenario
    name, most = scenario.uavs[uav].name, max(START_TOLERANCE_M, scenario.tracking_margin)
    after = np.flatnonzero(clock >= plan.curve.begin)
    if not len(after):
        raise LogFileError('it ends before the plan begins; give another --at, such as fit')
    first = after[0]
    begin = plan.curve.at([clock[first]]).positions[uav, 0]
    offset = begin - log.positions[first, :2]
    if np.linalg.norm(offset) <= most:
        return
    hint = ''
    try:
        fitted = fit_shift([log], plan.curve, [uav], is_moved=True)
        inside = log.times - fitted.seconds
        at = np.clip(inside, plan.curve.begin, plan.curve.end)
        kept = at == inside
        place = np.median(plan.curve.at(at[kept]).positions[uav]
                          - log.positions[kept, :2], axis=0) + 0.0
        hint = (f'; give --shift {name}={place[0]:.1f},{place[1]:.1f}, with which it flies '
                f'{fitted.rms:.2f} m from its plan' if np.linalg.norm(place) > most else
                '; give --at fit')
    except LogFileError:
        pass
    raise LogFileError(
        f'{name} is {np.linalg.norm(offset):.1f} m from its plan at its begin, by {time_from}; '
        f'at most {most:g} m are taken as one frame{hint}')


def _doubt_shift(names: tuple[str, ...], logs: list[VehicleLog], plan: Plan, uavs: list[int],
                 shift: Shift) -> list[str]:
    """Return a note where another time of the plan fits far better."""
    try:
        fitted = fit_shift(logs, plan.curve, uavs, is_moved=True)
    except LogFileError:
        return []
    apart = fitted.seconds - shift.seconds
    if abs(apart) < _DOUBTFUL_S or fitted.rms > START_TOLERANCE_M:
        return []
    return [f'{" and ".join(names)}: the time of the plan fits {abs(apart):.1f} s '
            f'{"later" if apart > 0 else "earlier"} in the log: try --at fit']


def _sample(log: VehicleLog, clock: Array, times: Array) -> tuple[Array, Array, Array | None]:
    """Return positions (K, 3), velocities (K, 2) and powers (K,) of a log at times of the plan."""
    known = np.isfinite(clock)
    known[known] = np.append(True, np.diff(clock[known]) > 0)
    at, places = clock[known], log.positions[known]
    if len(at) < 2:
        raise LogFileError('it does not reach the time of the plan')
    positions = np.stack([np.interp(times, at, column, left=np.nan, right=np.nan)
                          for column in places.T], axis=-1)
    steps = np.gradient(positions[:, :2], times, axis=0)
    covered = replace(log, times=log.times[known], positions=places, velocities=None,
                      jumps=tuple(time for time in log.jumps if time in log.times[known]),
                      ).is_covered
    index = np.clip(np.searchsorted(at, times, 'right') - 1, 0, len(covered) - 1)
    inside = (times >= at[0]) & (times <= at[-1]) & (covered[index] | np.isin(times, at))
    positions[~inside] = np.nan
    steps[~inside] = np.nan
    powers = None
    if log.powers is not None:
        when = np.interp(log.powers[0], log.times[known], at, left=np.nan, right=np.nan)
        valid = np.isfinite(when)
        last = np.searchsorted(when[valid], times + 1e-9, 'right') - 1
        powers = np.where(last < 0, 0.0, log.powers[1][valid][np.maximum(last, 0)])
    return positions, steps, powers


def _take_battery(log: VehicleLog, clock: Array, times: Array) -> float:
    """Return the energy [J] from the battery during a flight."""
    assert log.battery is not None
    when, energy = log.battery
    begin, end = np.interp([times[0], times[-1]], clock, log.times)
    return float(np.diff(np.interp([begin, end], when, energy))[0])


def _measure_setpoints(log: VehicleLog, shift: Shift, plan: Plan, uav: int) -> float:
    """Return the RMS distance in m of the autopilot's targets from the plan."""
    assert log.setpoints is not None
    when, places = log.setpoints
    clock = when - shift.seconds if math.isfinite(shift.seconds) else np.interp(
        when, log.times, _to_plan_time(log, shift), left=np.nan, right=np.nan)
    inside = (clock >= plan.curve.begin) & (clock <= plan.curve.end)
    inside &= np.isfinite(places).all(axis=1)
    offsets = places[inside] - plan.curve.at(clock[inside]).positions[uav]
    return float(np.sqrt((offsets**2).sum(axis=1).mean())) if inside.any() else math.nan
