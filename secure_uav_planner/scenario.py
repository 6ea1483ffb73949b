"""What is asked: the mission, the channel and the people on the ground."""

from dataclasses import asdict, dataclass, fields
from functools import cached_property
import math

import numpy as np

LIMITS = {
    'coordinate': (-1e7, 1e7),
    'error_radius': (0.0, 1e7),
    'altitude': (1e-3, 1e6),
    'max_speed': (1e-6, 1e6),
    'average_power': (1e-9, 1e6),
    'peak_power': (1e-9, 1e6),
    'duration': (1e-6, 1e8),
    'slots': (1, 20000),
    'reference_snr_db': (-200.0, 300.0),
}
"""Smallest and largest value of every field; beyond them squares lose their accuracy."""

MAX_MEMBERS = 32
"""The most UAVs, and the most eavesdroppers."""


def _number(owner, field, value):
    """Return value as a float, or raise ValueError naming field, value and what is allowed."""
    low, high = LIMITS[field]
    try:
        number = float(value)
    except (TypeError, ValueError):
        number = math.nan
    if isinstance(value, bool) or not low <= number <= high:
        raise ValueError(
            f'{owner}{field} is {value!r}; it must be a number from {low:g} to {high:g}')
    return number


def _point(owner, field, value):
    """Return value as a tuple of two floats, or raise ValueError naming field and value."""
    low, high = LIMITS['coordinate']
    try:
        x, y = (float(coordinate) for coordinate in value)
    except (TypeError, ValueError):
        x = y = math.nan
    if not (low <= x <= high and low <= y <= high):
        raise ValueError(f'{owner}{field} is {value!r}; it must be two coordinates (x, y) '
                         f'from {low:g} to {high:g} m')
    return (x, y)


@dataclass(frozen=True)
class Eavesdropper:
    """
    Where an eavesdropper is believed to be: the disc Theta of the paper's Section II.

    :param position: centre of the disc, (x, y) in m.
    :param error_radius: epsilon, the radius in m within which it surely is.
    :raises ValueError: naming the field, its value and what is allowed.
    """

    position: tuple[float, float]
    error_radius: float = 0.0

    def __post_init__(self):
        object.__setattr__(self, 'position', _point('eavesdropper ', 'position', self.position))
        object.__setattr__(self, 'error_radius', _number(
            'eavesdropper ', 'error_radius', self.error_radius))


@dataclass(frozen=True)
class Uav:
    """
    One UAV and its limits, equations (trajectory) and (power).

    :param name: used in messages, topics and files.
    :param start: horizontal position at the start, (x, y) in m.
    :param goal: horizontal position at the end, (x, y) in m.
    :param altitude: constant flying height H above the ground in m.
    :param max_speed: V in m/s.
    :param average_power: P_ave, the limit of the mean over the slots, in W.
    :param peak_power: P_peak, the limit in every slot, in W.
    :raises ValueError: naming the UAV, the field, its value and what is allowed.
    """

    name: str
    start: tuple[float, float]
    goal: tuple[float, float]
    altitude: float
    max_speed: float
    average_power: float = 1.0
    peak_power: float = 4.0

    def __post_init__(self):
        if not isinstance(self.name, str) or not self.name:
            raise ValueError(f'uav name is {self.name!r}; it must be a non-empty string')
        owner = f'{self.name}.'
        for field in ('start', 'goal'):
            object.__setattr__(self, field, _point(owner, field, getattr(self, field)))
        for field in ('altitude', 'max_speed', 'average_power', 'peak_power'):
            object.__setattr__(self, field, _number(owner, field, getattr(self, field)))
        if self.peak_power < self.average_power:
            raise ValueError(
                f'{owner}peak_power is {self.peak_power!r}; '
                f'it must be at least average_power, which is {self.average_power!r}')


@dataclass(frozen=True)
class Scenario:
    """
    Problem (P2) of the paper, for any number of jammers and eavesdroppers.

    UAV 0 transmits to the ground node, every other UAV jams. Point n of a trajectory is passed
    at time n * duration / slots, n = 0..slots+1; power n holds at point n, n = 1..slots.

    :param ground_node: w_0, (x, y) in m, at altitude zero.
    :param eavesdroppers: at least one Eavesdropper.
    :param uavs: at least one Uav; names are unique.
    :param duration: T in s. The flight itself lasts (slots + 1) / slots * T.
    :param slots: N.
    :param reference_snr_db: beta_0 / sigma^2, the SNR at 1 m and 1 W, in dB.
    :raises ValueError: naming the field, its value and what is allowed; for a mission that
        cannot be flown, the shortest duration that can.
    """

    ground_node: tuple[float, float]
    eavesdroppers: tuple[Eavesdropper, ...]
    uavs: tuple[Uav, ...]
    duration: float
    slots: int
    reference_snr_db: float = 80.0

    def __post_init__(self):
        object.__setattr__(self, 'ground_node', _point('', 'ground_node', self.ground_node))
        for field, kind in (('eavesdroppers', Eavesdropper), ('uavs', Uav)):
            members = getattr(self, field)
            if (not isinstance(members, (tuple, list)) or not members
                    or len(members) > MAX_MEMBERS
                    or not all(isinstance(member, kind) for member in members)):
                raise ValueError(f'{field} is {members!r}; it must be a tuple of '
                                 f'1 to {MAX_MEMBERS} {kind.__name__}')
            object.__setattr__(self, field, tuple(members))
        names = [uav.name for uav in self.uavs]
        if len(set(names)) < len(names):
            raise ValueError(f'uavs are named {names!r}; the names must be unique')
        object.__setattr__(self, 'duration', _number('', 'duration', self.duration))
        if not isinstance(self.slots, (int, np.integer)):
            raise ValueError(f'slots is {self.slots!r}; it must be a whole number')
        object.__setattr__(self, 'slots', int(_number('', 'slots', self.slots)))
        object.__setattr__(self, 'reference_snr_db', _number(
            '', 'reference_snr_db', self.reference_snr_db))
        self._check_reachable()

    def _check_reachable(self):
        for uav, step in zip(self.uavs, self.max_step):
            distance = math.dist(uav.start, uav.goal)
            # The tolerance admits the very duration that the message names.
            if distance > (self.slots + 1) * step * (1 + 1e-12):
                shortest = distance * self.slots / ((self.slots + 1) * uav.max_speed)
                raise ValueError(
                    f'duration is {self.duration:g} s; {uav.name} needs at least '
                    f'{math.ceil(shortest * 1000) / 1000:g} s from start to goal '
                    f'at {uav.max_speed:g} m/s')

    @classmethod
    def paper(cls, duration=200.0, error_radius=10.0, slots=None):
        """
        Return the scenario of the paper's Section IV.

        :param duration: T in s, at least 1000 m * N / (N + 1) / (10 m/s).
        :param error_radius: epsilon in m.
        :param slots: N; by default slots of one second.
        :raises ValueError: as Scenario does.
        """
        ends = {'start': (100.0, 500.0), 'goal': (100.0, -500.0)}
        return cls(
            ground_node=(0.0, 0.0),
            eavesdroppers=(Eavesdropper((200.0, 0.0), error_radius),),
            uavs=(Uav('uav1', altitude=100.0, max_speed=10.0, **ends),
                  Uav('uav2', altitude=110.0, max_speed=10.0, **ends)),
            duration=duration,
            slots=max(1, round(duration)) if slots is None else slots)

    @property
    def slot_duration(self):
        """Length of a slot, t_s = T / N, in s."""
        return self.duration / self.slots

    @cached_property
    def max_step(self):
        """Largest displacement from one point to the next, V_i * t_s, (U,) in m."""
        return np.array([uav.max_speed for uav in self.uavs]) * self.slot_duration

    @cached_property
    def reference_snr(self):
        """SNR at 1 m and 1 W, beta_0 / sigma^2, linear."""
        return 10.0 ** (self.reference_snr_db / 10.0)

    def to_dict(self):
        """Return the scenario as plain numbers, strings, lists and dictionaries."""
        return asdict(self)

    @classmethod
    def from_dict(cls, data):
        """
        Return the scenario that to_dict wrote.

        :raises ValueError: for a missing or unknown field as well as for a wrong value.
        """
        data = _known_fields(cls, data)
        for field, kind in (('eavesdroppers', Eavesdropper), ('uavs', Uav)):
            if not isinstance(data[field], (list, tuple)):
                raise ValueError(f'{field} is {data[field]!r}; it must be a list')
            data[field] = tuple(kind(**_known_fields(kind, member)) for member in data[field])
        return cls(**data)


def _known_fields(kind, data):
    names = {field.name for field in fields(kind)}
    if not isinstance(data, dict) or set(data) != names:
        found = sorted(data) if isinstance(data, dict) else data
        raise ValueError(
            f'{kind.__name__} has the fields {found!r}; it must have {sorted(names)!r}')
    return dict(data)
