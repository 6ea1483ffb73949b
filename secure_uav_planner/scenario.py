"""What is asked: the mission, the channel and the people on the ground."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields
from functools import cached_property
import math
import os
from typing import Any

import numpy as np

from .errors import InfeasibleMissionError, ScenarioError, shown
from .fields import (
    Array, checked_fields, checked_members, checked_number, checked_point, LIMITS, Point,
    read_only, told_apart)
from .members import Eavesdropper, NoFlyZone, Uav
from .mission.schema import Schema
from .polygons import checked_polygon, depth, Vertices

_EFFORT_TOLERANCE = 1e-9

POSITION_TOLERANCE = 1e-6
"""How far in m a place may be beyond a limit, for rounding."""

MAX_MEMBERS = 32
"""The most UAVs, and the most eavesdroppers."""

MAX_ZONES = 64
"""The most no-fly zones."""

MAX_COUPLINGS = 10**7
"""The most pairs of variables that meet in a slot, slots * (3 uavs)^2: a step takes about 1 s."""

__all__ = ['Array', 'Eavesdropper', 'LIMITS', 'MAX_COUPLINGS', 'MAX_MEMBERS', 'MAX_ZONES',
           'NoFlyZone', 'POSITION_TOLERANCE', 'Point', 'Scenario', 'Uav', 'checked_fields',
           'read_only']


@dataclass(frozen=True)
class Scenario:
    """
    A mission: problems (P1) and (P2) of the paper for any number of jammers and eavesdroppers.

    UAV 0 transmits to the ground node, every other UAV jams. Point n of a trajectory is passed
    at time n * duration / slots, n = 0..slots+1; power n holds from point n to
    point n + 1, n = 1..slots.

    :param ground_node: w_0, (x, y) in m, at altitude zero.
    :param eavesdroppers: at least one Eavesdropper.
    :param uavs: at least one Uav; names are unique.
    :param duration: T in s. The flight itself lasts (slots + 1) / slots * T.
    :param slots: N.
    :param reference_snr_db: beta_0 / sigma^2, the SNR at 1 m and 1 W, in dB.
    :param separation: smallest distance in space between any two UAVs at any time, in m; 0 for
        no limit.
    :param no_fly_zones: up to 64 NoFlyZone.
    :param geofence: vertices of a polygon, each (x, y) in m, that no UAV leaves at any altitude;
        None for no limit.
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
    separation: float = 0.0
    no_fly_zones: tuple[NoFlyZone, ...] = ()
    geofence: Vertices | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, 'ground_node', checked_point('', 'ground_node', self.ground_node))
        for field, kind in (('eavesdroppers', Eavesdropper), ('uavs', Uav)):
            object.__setattr__(self, field, checked_members(
                field, getattr(self, field), kind, 1, MAX_MEMBERS))
        names = [uav.name for uav in self.uavs]
        if len(set(names)) < len(names):
            raise ScenarioError(f'uavs are named {shown(names)}; the names must be unique')
        object.__setattr__(self, 'duration', checked_number('', 'duration', self.duration))
        if isinstance(self.slots, bool) or not isinstance(self.slots, (int, np.integer)):
            raise ScenarioError(f'slots is {shown(self.slots)}; it must be a whole number')
        object.__setattr__(self, 'slots', int(checked_number('', 'slots', self.slots)))
        for field in ('reference_snr_db', 'separation'):
            object.__setattr__(self, field, checked_number('', field, getattr(self, field)))
        object.__setattr__(self, 'no_fly_zones', checked_members(
            'no_fly_zones', self.no_fly_zones, NoFlyZone, 0, MAX_ZONES))
        if self.geofence is not None:
            object.__setattr__(self, 'geofence', checked_polygon('', 'geofence', self.geofence))
        self._check_size()
        self._check_ends()
        self._check_reachable()

    def _check_size(self) -> None:
        most = MAX_COUPLINGS // (3 * len(self.uavs))**2
        if self.slots > most:
            raise ScenarioError(f'slots is {self.slots}; with {len(self.uavs)} uavs it must be '
                                f'at most {most}, or a plan would take too long and too much '
                                'memory')

    def _check_ends(self) -> None:
        """Check where flights begin and end against zones, fence and separation."""
        for field in ('start', 'goal'):
            # How far the curve may be from the first or the last of its control points. A place
            # on a plan, with which the rest of it begins, is itself beyond a limit by rounding.
            slack = [2 * POSITION_TOLERANCE + uav.bend_at(field, self.slot_duration)
                     for uav in self.uavs]
            for uav, most in zip(self.uavs, slack, strict=True):
                self._check_place(uav, field, most)
            for second, other in enumerate(self.uavs):
                for first, uav in enumerate(self.uavs[:second]):
                    distance = math.hypot(
                        math.dist(getattr(uav, field), getattr(other, field)),
                        uav.altitude - other.altitude)
                    if distance < self.separation - slack[first] - slack[second]:
                        raise ScenarioError(
                            f'separation is {self.separation:g} m; it must be at most '
                            f'{distance:g} m, the distance between the {field}s of {uav.name} '
                            f'and {other.name}')

    def _check_place(self, uav: Uav, field: str, slack: float) -> None:
        """Check the start or the goal of a UAV against zones and fence."""
        place = getattr(uav, field)
        for zone, name in zip(self.no_fly_zones, self.zone_names, strict=True):
            if zone.is_at(uav.altitude) and depth(zone.vertices, place) > slack:
                raise ScenarioError(
                    f'{uav.name}.{field} is {place} at {uav.altitude:g} m, inside {name}; it '
                    'must be outside all no_fly_zones')
        if self.geofence is not None and depth(self.geofence, place) < -slack:
            raise ScenarioError(f'{uav.name}.{field} is {place}, outside the geofence; it must '
                                'be inside')

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

    def __hash__(self) -> int:
        return self._hash

    @cached_property
    def _hash(self) -> int:
        # Known values are found by it many times in a solve.
        return hash(tuple(getattr(self, field.name) for field in fields(self)))

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
    def receiver_advantages(self) -> Array:
        """By what factor the SNR at the eavesdroppers' receivers is larger, linear, (E,)."""
        return read_only([10.0 ** (eve.receiver_advantage_db / 10.0)
                          for eve in self.eavesdroppers])

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
        return told_apart([eve.name for eve in self.eavesdroppers])

    @cached_property
    def zone_names(self) -> tuple[str, ...]:
        """Names of the no-fly zones; likewise, and 'zone 2' for the second if it has none."""
        return told_apart([zone.name or f'zone {number}'
                           for number, zone in enumerate(self.no_fly_zones, start=1)])

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
        """Return the scenario as plain values that JSON has; an infinite ceiling is None."""
        data = asdict(self)
        for zone in data['no_fly_zones']:
            if math.isinf(zone['ceiling']):
                zone['ceiling'] = None
        return data

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> 'Scenario':
        """
        Return the scenario that to_dict wrote; missing fields take their defaults.

        :raises ScenarioError: for an unknown field, a missing one that has no default, or a
            wrong value.
        """
        values = checked_fields(cls, data)
        for field, kind in (('eavesdroppers', Eavesdropper), ('uavs', Uav),
                            ('no_fly_zones', NoFlyZone)):
            members = values.get(field, ())
            if not isinstance(members, (list, tuple)):
                raise ScenarioError(f'{field} is {shown(members)}; it must be a list')
            values[field] = tuple(kind(**checked_fields(kind, member)) for member in members)
        return cls(**values)

    def save(self, path: str | os.PathLike[str]) -> None:
        """
        Write the mission to a file, as JSON if its name ends with .json, otherwise as YAML.

        :raises OSError: when the file cannot be written; an old one is left as it was.
        """
        from . import mission  # Here and not above: its reader of YAML takes time to import.
        mission.save(path, self.to_dict())

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> 'Scenario':
        """
        Return the mission that a file describes: YAML, JSON if the name ends with .json.

        It has the fields of Scenario with their units; those with a default may be missing. A
        parameter file of the planner node is read as well, if it also has `ground_node` and, for
        each eavesdropper, `<eavesdropper>.position`.

        :raises OSError: when the file cannot be read, is no regular file, or is too large.
        :raises MissionFileError: naming the line and what is wrong; its `problems` are all that
            is wrong.
        """
        from . import mission
        scenario: Scenario = mission.load(path, _schema())
        return scenario


def _schema() -> Schema:
    """Return what a mission file may have: each class with limits that any right value fits."""
    uav = Uav('uav', (0.0, 0.0), (0.0, 0.0), LIMITS['altitude'][0], LIMITS['max_speed'][1],
              LIMITS['average_power'][0], LIMITS['peak_power'][1])
    eavesdropper = Eavesdropper((0.0, 0.0))
    zone = NoFlyZone(((0.0, 0.0), (1.0, 0.0), (0.0, 1.0)))
    return Schema(
        Scenario((0.0, 0.0), (eavesdropper,), (uav,), LIMITS['duration'][1], slots=1),
        {'eavesdroppers': eavesdropper, 'uavs': uav, 'no_fly_zones': zone},
        Scenario.paper().to_dict())
