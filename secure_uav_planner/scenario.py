"""What is asked: the mission, the channel and the people on the ground."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields, MISSING
import difflib
from functools import cached_property
import math
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .errors import InfeasibleMissionError, ScenarioError, shown
from .kinematics import Vehicle

_ROUNDING = 1e-9
_EFFORT_TOLERANCE = 1e-9

Array: TypeAlias = NDArray[np.float64]
Point: TypeAlias = tuple[float, float]

LIMITS = {
    'coordinate': (-1e7, 1e7),
    'error_radius': (0.0, 1e7),
    'altitude': (1e-3, 1e6),
    'max_speed': (1e-6, 1e6),
    'max_acceleration': (1e-6, 1e6),
    'average_power': (1e-9, 1e6),
    'peak_power': (1e-9, 1e6),
    'duration': (1e-6, 1e8),
    'slots': (1, 20000),
    'reference_snr_db': (-200.0, 300.0),
}
"""Smallest and largest value of every field; beyond them squares lose their accuracy."""

MAX_MEMBERS = 32
"""The most UAVs, and the most eavesdroppers."""

MAX_COUPLINGS = 10**7
"""The most pairs of variables that meet in a slot, slots * (3 uavs)^2: a step takes about 1 s."""


@dataclass(frozen=True)
class Eavesdropper:
    """
    Where an eavesdropper is believed to be: the disc Theta of the paper's Section II.

    :param position: centre of the disc, (x, y) in m.
    :param error_radius: epsilon, the radius in m within which it surely is.
    :param name: used in messages, topics and pictures.
    :raises ScenarioError: naming the field, its value and what is allowed.
    """

    position: Point
    error_radius: float = 0.0
    name: str = 'eavesdropper'

    def __post_init__(self) -> None:
        _check_name('eavesdropper', self.name)
        owner = f'{shown(self.name)[1:-1]} '
        object.__setattr__(self, 'position', _point(owner, 'position', self.position))
        object.__setattr__(self, 'error_radius', _number(
            owner, 'error_radius', self.error_radius))


@dataclass(frozen=True)
class Uav:
    """
    One UAV and its limits, equations (trajectory) and (power).

    :param name: used in messages, topics and files.
    :param start: horizontal position at the start, (x, y) in m.
    :param goal: horizontal position at the end, (x, y) in m.
    :param altitude: constant flying height H above the ground node in m.
    :param max_speed: V in m/s.
    :param average_power: P_ave, the limit of the mean over the slots, in W.
    :param peak_power: P_peak, the limit in every slot, in W.
    :param max_acceleration: the largest acceleration along the flown curve in m/s^2, or None for
        the paper's vehicle, which has no such limit.
    :param start_velocity: (x, y) in m/s at the start, or None where it is free. It counts only
        with a limit of acceleration.
    :param goal_velocity: likewise at the goal.
    :raises ScenarioError: naming the UAV, the field, its value and what is allowed.
    """

    name: str
    start: Point
    goal: Point
    altitude: float
    max_speed: float
    average_power: float = 1.0
    peak_power: float = 4.0
    max_acceleration: float | None = None
    start_velocity: Point | None = (0.0, 0.0)
    goal_velocity: Point | None = (0.0, 0.0)

    def __post_init__(self) -> None:
        _check_name('uav', self.name)
        owner = f'{shown(self.name)[1:-1]}.'
        for field in ('start', 'goal'):
            object.__setattr__(self, field, _point(owner, field, getattr(self, field)))
        for field in ('altitude', 'max_speed', 'average_power', 'peak_power'):
            object.__setattr__(self, field, _number(owner, field, getattr(self, field)))
        if self.peak_power < self.average_power:
            raise ScenarioError(
                f'{owner}peak_power is {self.peak_power!r}; '
                f'it must be at least average_power, which is {self.average_power!r}')
        if self.max_acceleration is not None:
            object.__setattr__(self, 'max_acceleration', _number(
                owner, 'max_acceleration', self.max_acceleration))
        for field in ('start_velocity', 'goal_velocity'):
            if getattr(self, field) is not None:
                velocity = _point(owner, field, getattr(self, field))
                if math.hypot(*velocity) > self.max_speed * (1 + _ROUNDING):
                    raise ScenarioError(
                        f'{owner}{field} is {velocity}, {math.hypot(*velocity):g} m/s; it must '
                        f'be at most max_speed, which is {self.max_speed:g} m/s')
                object.__setattr__(self, field, velocity)

    @property
    def vehicle(self) -> Vehicle:
        """Flight limits, and where the flight begins and ends."""
        displacement = (self.goal[0] - self.start[0], self.goal[1] - self.start[1])
        if self.max_acceleration is None:
            return Vehicle(displacement, self.max_speed)
        return Vehicle(displacement, self.max_speed, self.max_acceleration,
                       self.start_velocity, self.goal_velocity)


@dataclass(frozen=True)
class Scenario:
    """
    A mission: problems (P1) and (P2) of the paper for any number of jammers and eavesdroppers.

    UAV 0 transmits to the ground node, every other UAV jams. Point n of a trajectory is passed
    at time n * duration / slots, n = 0..slots+1; power n holds at point n, n = 1..slots.

    :param ground_node: w_0, (x, y) in m, at altitude zero.
    :param eavesdroppers: at least one Eavesdropper.
    :param uavs: at least one Uav; names are unique.
    :param duration: T in s. The flight itself lasts (slots + 1) / slots * T.
    :param slots: N.
    :param reference_snr_db: beta_0 / sigma^2, the SNR at 1 m and 1 W, in dB.
    :raises ScenarioError: naming the field, its value and what is allowed.
    :raises InfeasibleMissionError: for a mission that cannot be flown, naming the UAV and the
        shortest duration that can.
    """

    ground_node: Point
    eavesdroppers: tuple[Eavesdropper, ...]
    uavs: tuple[Uav, ...]
    duration: float
    slots: int
    reference_snr_db: float = 80.0

    def __post_init__(self) -> None:
        object.__setattr__(self, 'ground_node', _point('', 'ground_node', self.ground_node))
        for field, kind in (('eavesdroppers', Eavesdropper), ('uavs', Uav)):
            members = getattr(self, field)
            if (not isinstance(members, (tuple, list)) or not members
                    or len(members) > MAX_MEMBERS
                    or not all(isinstance(member, kind) for member in members)):
                raise ScenarioError(f'{field} is {shown(members)}; it must be a tuple of '
                                    f'1 to {MAX_MEMBERS} {kind.__name__}')
            object.__setattr__(self, field, tuple(members))
        names = [uav.name for uav in self.uavs]
        if len(set(names)) < len(names):
            raise ScenarioError(f'uavs are named {shown(names)}; the names must be unique')
        object.__setattr__(self, 'duration', _number('', 'duration', self.duration))
        if isinstance(self.slots, bool) or not isinstance(self.slots, (int, np.integer)):
            raise ScenarioError(f'slots is {shown(self.slots)}; it must be a whole number')
        object.__setattr__(self, 'slots', int(_number('', 'slots', self.slots)))
        object.__setattr__(self, 'reference_snr_db', _number(
            '', 'reference_snr_db', self.reference_snr_db))
        self._check_size()
        self._check_reachable()

    def _check_size(self) -> None:
        most = MAX_COUPLINGS // (3 * len(self.uavs))**2
        if self.slots > most:
            raise ScenarioError(f'slots is {self.slots}; with {len(self.uavs)} uavs it must be '
                                f'at most {most}, or a plan would take too long and too much '
                                'memory')

    def _check_reachable(self) -> None:
        for uav, effort in zip(self.uavs, self.efforts, strict=True):
            if effort > 1 + _EFFORT_TOLERANCE:
                shortest = uav.vehicle.shortest_step(self.slots) * self.slots
                limits = f'{uav.max_speed:g} m/s'
                if uav.max_acceleration is not None:
                    limits += f' and {uav.max_acceleration:g} m/s^2'
                raise InfeasibleMissionError(
                    f'duration is {self.duration:g} s; {uav.name} needs at least '
                    f'{math.ceil(shortest * 1000) / 1000:g} s from start to goal at {limits}')

    def __getstate__(self) -> dict[str, Any]:
        # Arrays would come back from a copy or a pickle writable; they are computed again.
        return {field.name: getattr(self, field.name) for field in fields(self)}

    @classmethod
    def paper(cls, duration: float = 200.0, error_radius: float = 10.0,
              slots: int | None = None) -> 'Scenario':
        """
        Return the scenario of the paper's Section IV.

        :param duration: T in s, at least 1000 m * N / (N + 1) / (10 m/s).
        :param error_radius: epsilon in m.
        :param slots: N; by default slots of one second.
        :raises ScenarioError: as Scenario does.
        """
        start, goal = (100.0, 500.0), (100.0, -500.0)
        return cls(
            ground_node=(0.0, 0.0),
            eavesdroppers=(Eavesdropper((200.0, 0.0), error_radius),),
            uavs=(Uav('uav1', start, goal, altitude=100.0, max_speed=10.0),
                  Uav('uav2', start, goal, altitude=110.0, max_speed=10.0)),
            duration=duration,
            slots=max(1, round(duration)) if slots is None else slots)

    @property
    def slot_duration(self) -> float:
        """Length of a slot, t_s = T / N, in s."""
        return self.duration / self.slots

    @cached_property
    def reference_snr(self) -> float:
        """SNR at 1 m and 1 W, beta_0 / sigma^2, linear."""
        return float(10.0 ** (self.reference_snr_db / 10.0))

    @cached_property
    def starts(self) -> Array:
        """Where the UAVs start, (U, 2) in m, read-only as all arrays here."""
        return read_only([uav.start for uav in self.uavs])

    @cached_property
    def goals(self) -> Array:
        """Where the UAVs end, (U, 2) in m."""
        return read_only([uav.goal for uav in self.uavs])

    @cached_property
    def altitudes(self) -> Array:
        """Flying heights H, (U,) in m."""
        return read_only([uav.altitude for uav in self.uavs])

    @cached_property
    def max_speeds(self) -> Array:
        """Largest speeds V, (U,) in m/s."""
        return read_only([uav.max_speed for uav in self.uavs])

    @cached_property
    def max_step(self) -> Array:
        """Largest displacement from one point to the next, V * t_s, (U,) in m."""
        return read_only(self.max_speeds * self.slot_duration)

    @cached_property
    def average_powers(self) -> Array:
        """Limits P_ave of the mean powers, (U,) in W."""
        return read_only([uav.average_power for uav in self.uavs])

    @cached_property
    def peak_powers(self) -> Array:
        """Limits P_peak of the powers of every slot, (U,) in W."""
        return read_only([uav.peak_power for uav in self.uavs])

    @cached_property
    def eavesdropper_positions(self) -> Array:
        """Centres of the discs, (E, 2) in m."""
        return read_only([eve.position for eve in self.eavesdroppers])

    @cached_property
    def error_radii(self) -> Array:
        """Radii epsilon of the discs, (E,) in m."""
        return read_only([eve.error_radius for eve in self.eavesdroppers])

    @cached_property
    def eavesdropper_names(self) -> tuple[str, ...]:
        """Names of the eavesdroppers; where several share one, it is followed by a number."""
        names = [eve.name for eve in self.eavesdroppers]
        found: list[str] = []
        for number, name in enumerate(names, start=1):
            unique = name
            while names.count(unique) > 1 or unique in found or (
                    unique != name and unique in names):
                unique, number = f'{name}{number}', number + 1
            found.append(unique)
        return tuple(found)

    @cached_property
    def efforts(self) -> Array:
        """Share of its limits that the flight of least effort of each UAV uses, (U,)."""
        return read_only([uav.vehicle.least_effort(self.slots, self.slot_duration)[0]
                          for uav in self.uavs])

    @cached_property
    def max_accelerations(self) -> Array:
        """Largest accelerations, (U,) in m/s^2, infinite without a limit."""
        return read_only([math.inf if uav.max_acceleration is None else uav.max_acceleration
                          for uav in self.uavs])

    def to_dict(self) -> dict[str, Any]:
        """Return the scenario as plain numbers, strings, lists and dictionaries."""
        return asdict(self)

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> 'Scenario':
        """
        Return the scenario that to_dict wrote; missing fields take their defaults.

        :raises ScenarioError: for an unknown field, a missing one that has no default, or a
            wrong value.
        """
        values = checked_fields(cls, data)
        for field, kind in (('eavesdroppers', Eavesdropper), ('uavs', Uav)):
            if not isinstance(values[field], (list, tuple)):
                raise ScenarioError(f'{field} is {shown(values[field])}; it must be a list')
            values[field] = tuple(
                kind(**checked_fields(kind, member)) for member in values[field])
        return cls(**values)


def read_only(values: ArrayLike) -> Array:
    """Return values as an array of floats of its own that cannot be written to."""
    array = np.array(values, dtype=float)
    array.setflags(write=False)
    return array


def checked_fields(kind: type[Any], data: object) -> dict[str, Any]:
    """
    Return data, a mapping, as the arguments of a dataclass.

    :raises ScenarioError: naming an unknown field and the nearest known one, or a missing field.
    """
    if not isinstance(data, Mapping):
        raise ScenarioError(f'{kind.__name__} is {shown(data)}; it must be a mapping of fields')
    known = {field.name: field for field in fields(kind)}
    for name in data:
        if name not in known:
            near = difflib.get_close_matches(str(name), known, 1)
            hint = f'; did you mean {near[0]}?' if near else f'; it has {", ".join(known)}'
            raise ScenarioError(f'{kind.__name__} has no field {shown(name)}{hint}')
    missing = [name for name, field in known.items() if name not in data
               and field.default is MISSING and field.default_factory is MISSING]
    if missing:
        raise ScenarioError(f'{kind.__name__} lacks {", ".join(missing)}')
    return dict(data)


def _check_name(what: str, name: object) -> None:
    if not isinstance(name, str) or not name:
        raise ScenarioError(f'{what} name is {shown(name)}; it must be a non-empty string')


def _number(owner: str, field: str, value: Any) -> float:
    """Return value as a float, or raise ScenarioError with field, value and what is allowed."""
    low, high = LIMITS[field]
    try:
        number = float(value)
    except (TypeError, ValueError, OverflowError):
        number = math.nan
    if isinstance(value, (bool, str)) or not low <= number <= high:
        raise ScenarioError(
            f'{owner}{field} is {shown(value)}; it must be a number from {low:g} to {high:g}')
    return number


def _point(owner: str, field: str, value: Any) -> Point:
    """Return value as a tuple of two floats, or raise ScenarioError with field and value."""
    low, high = LIMITS['coordinate']
    try:
        x, y = (float(coordinate) for coordinate in value)
    except (TypeError, ValueError, OverflowError):
        x = y = math.nan
    if not (low <= x <= high and low <= y <= high):
        raise ScenarioError(f'{owner}{field} is {shown(value)}; it must be two coordinates '
                            f'(x, y) from {low:g} to {high:g} m')
    return (x, y)
