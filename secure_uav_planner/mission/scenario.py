"""What is asked: the mission, the channel and the receivers."""

from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass, fields
from functools import cached_property
from itertools import combinations
import math
import os
from typing import Any, TYPE_CHECKING

from .files import checked_path
from .participants import Eavesdropper, NoFlyZone, Uav
from .polygons import checked_polygon, depth, grown, Vertices
from .propagation import Channel
from .validation import (
    Array, checked_fields, checked_members, checked_number, checked_point, checked_real, Point,
    RANGES, read_only, set_checked, told_apart)
from .views import view
from ..errors import InfeasibleMissionError, ScenarioError, shown, within

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_EFFORT_TOLERANCE = 1e-9

POSITION_TOLERANCE = 1e-6
"""How far in m a place may be beyond a limit, for rounding."""

MAX_MEMBERS = 32
"""The most UAVs, and the most eavesdroppers."""

MAX_ZONES = 64
"""The most no-fly zones."""

MAX_COUPLINGS = 10**7
"""The most pairs of variables that meet in a slot, slots * (3 uavs)^2: a step takes about 1 s."""

_MEMBERS = {'eavesdroppers': (Eavesdropper, 1, MAX_MEMBERS), 'uavs': (Uav, 1, MAX_MEMBERS),
            'no_fly_zones': (NoFlyZone, 0, MAX_ZONES)}
"""The class of the members of each list, and the least and the most of them."""

_UNNAMED = 'eavesdroppers', Eavesdropper.name  # Several may have the default name.

__all__ = ['Array', 'Channel', 'Eavesdropper', 'MAX_COUPLINGS', 'MAX_MEMBERS', 'MAX_ZONES',
           'NoFlyZone', 'POSITION_TOLERANCE', 'Point', 'RANGES', 'Scenario', 'Uav',
           'checked_fields', 'read_only']


def _of_each(members: str, field: str, text: str) -> cached_property[Array]:
    """Return a property of Scenario: one field of all its UAVs, or of all its eavesdroppers."""
    def values(scenario: Any) -> Array:
        return read_only([getattr(one, field) for one in getattr(scenario, members)])

    values.__doc__ = text
    return cached_property(values)


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
    :param tracking_margin: largest error in m of a vehicle on its plan, in any direction. For the
        plan, zones grow and the geofence shrinks by it, and a separation grows by twice it.
    :param channel: a Channel; by default free space.
    :param colluding: whether the eavesdroppers put together what they hear, so that their SINRs
        add up; otherwise the one that hears most counts.
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
    tracking_margin: float = 0.0
    channel: Channel = Channel()
    colluding: bool = False

    def __post_init__(self) -> None:
        set_checked(self, '', checked_point, 'ground_node')
        for field, members in _MEMBERS.items():
            object.__setattr__(self, field, checked_members(
                field, getattr(self, field), *members))
        slots = checked_number('', 'slots', self.slots)
        if not slots.is_integer():
            raise ScenarioError(
                f'slots is {shown(self.slots)}; it must be a whole number', ('slots',))
        object.__setattr__(self, 'slots', int(slots))
        set_checked(self, '', checked_number,
                    'duration', 'reference_snr_db', 'separation', 'tracking_margin')
        set_checked(self, '', checked_polygon, 'geofence', optional=True)
        if not isinstance(self.channel, Channel):
            raise ScenarioError(
                f'channel is {shown(self.channel)}; it must be a Channel, such as '
                "Channel(los='urban')", ('channel',))
        if not isinstance(self.colluding, bool):
            raise ScenarioError(f'colluding is {shown(self.colluding)}; it must be true or false',
                                ('colluding',))
        problems = [*self._of_names_and_size(), *self._of_ends(), *self._of_durations()]
        if problems:
            problems[0].others = tuple(problems[1:])
            raise problems[0]

    def _of_names_and_size(self) -> Iterator[ScenarioError]:
        for field in ('uavs', 'eavesdroppers'):
            names = [member.name for member in getattr(self, field)]
            for number, name in enumerate(names):
                if name in names[:number] and (field, name) != _UNNAMED:
                    yield ScenarioError(f'{field} are named {shown(names)}; the names must be '
                                        'unique', (field, number, 'name'))
        most = MAX_COUPLINGS // (3 * len(self.uavs))**2
        if self.slots > most:
            yield ScenarioError(f'slots is {self.slots}; with {len(self.uavs)} uavs it must be '
                                f'at most {most}, or a plan would take too long and too much '
                                'memory', ('slots',))

    def _of_ends(self) -> Iterator[ScenarioError]:
        """Yield what is wrong with the ends of flights: zones, fence and separation."""
        for field in ('start', 'goal'):
            # How far the curve may be from the first or the last of its control points. A place
            # on a plan, with which the rest of it begins, is itself beyond a limit by rounding.
            slack = [2 * POSITION_TOLERANCE + uav.bend_at(field, self.slot_duration)
                     for uav in self.uavs]
            for number, most in enumerate(slack):
                yield from self._of_end(number, field, most)
            close = []
            for (uav, most), (other, most_of_other) in combinations(zip(self.uavs, slack), 2):
                distance = math.hypot(math.dist(getattr(uav, field), getattr(other, field)),
                                      uav.altitude - other.altitude)
                if distance < self.keep_apart - most - most_of_other:
                    close.append((distance, uav.name, other.name))
            if close:
                distance, *names = min(close)
                yield ScenarioError(
                    f'separation{self.margin_text} is {self.keep_apart:g} m; it must be at most '
                    f'{distance:g} m, the distance between the {field}s of {" and ".join(names)}',
                    ('separation',))

    def _of_end(self, number: int, field: str, slack: float) -> Iterator[ScenarioError]:
        """Yield what is wrong with the start or the goal of a UAV: zones and fence."""
        uav = self.uavs[number]
        place = getattr(uav, field)
        for vertices, name in self.keep_out(uav.altitude):
            if depth(vertices, place) > slack:
                yield ScenarioError(
                    f'{uav.name}.{field} is {shown(place)} at {uav.altitude:g} m, inside '
                    f'{name}{self.margin_text}; it must be outside all no_fly_zones',
                    ('uavs', number, field))
        if self.keep_in is not None and depth(self.keep_in, place) < -slack:
            yield ScenarioError(
                f'{uav.name}.{field} is {shown(place)}, outside the geofence{self.margin_text}; '
                'it must be inside', ('uavs', number, field))

    def _of_durations(self) -> Iterator[ScenarioError]:
        for uav, effort in zip(self.uavs, self.efforts, strict=True):
            if effort > 1 + _EFFORT_TOLERANCE:
                shortest = uav.vehicle.shortest_step(self.slots) * self.slots
                yield InfeasibleMissionError(
                    f'duration is {self.duration:g} s; {uav.name} needs at least '
                    f'{math.ceil(shortest * 1000) / 1000:g} s from start to goal at '
                    f'{uav.limits_text}',
                    ('duration',))

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
            slots=(max(1, round(checked_number('', 'duration', duration))) if slots is None
                   else slots))

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

    starts = _of_each('uavs', 'start', 'Where the UAVs start, (U, 2) in m, read-only as all here.')
    goals = _of_each('uavs', 'goal', 'Where the UAVs end, (U, 2) in m.')
    altitudes = _of_each('uavs', 'altitude', 'Flying heights H, (U,) in m.')
    max_speeds = _of_each('uavs', 'max_speed', 'Largest speeds V, (U,) in m/s.')
    average_powers = _of_each(
        'uavs', 'average_power', 'Limits P_ave of the mean powers, (U,) in W.')
    peak_powers = _of_each(
        'uavs', 'peak_power', 'Limits P_peak of the powers of every slot, (U,) in W.')
    eavesdropper_positions = _of_each(
        'eavesdroppers', 'position', 'Centres of the discs, (E, 2) in m.')
    error_radii = _of_each(
        'eavesdroppers', 'error_radius', 'Radii epsilon of the discs, (E,) in m.')

    @cached_property
    def max_step(self) -> Array:
        """Largest displacement from one point to the next, V * t_s, (U,) in m."""
        return read_only(self.max_speeds * self.slot_duration)

    @cached_property
    def eavesdropper_names(self) -> tuple[str, ...]:
        """Names of the eavesdroppers; where several have the default one, each with a number."""
        return told_apart([eve.name for eve in self.eavesdroppers])

    @cached_property
    def zone_names(self) -> tuple[str, ...]:
        """Names of the no-fly zones; likewise, and 'zone 2' for the second if it has none."""
        return told_apart([zone.name or f'zone {number}'
                           for number, zone in enumerate(self.no_fly_zones, start=1)])

    def zones_at(self, altitude: float) -> tuple[tuple[NoFlyZone, str], ...]:
        """Return the zones within tracking_margin of an altitude in m, with their names."""
        checked_real('altitude', altitude)
        return tuple((zone, name) for zone, name in zip(
            self.no_fly_zones, self.zone_names, strict=True)
            if zone.is_at(altitude, self.tracking_margin))

    def keep_out(self, altitude: float) -> tuple[tuple[Vertices, str], ...]:
        """
        Return what a plan may not enter at an altitude in m: zones grown by tracking_margin.

        :return: the vertices in m and the name of each.
        """
        return tuple((grown(zone.vertices, self.tracking_margin)[0], name)
                     for zone, name in self.zones_at(altitude))

    @cached_property
    def keep_in(self) -> Vertices | None:
        """
        Geofence less tracking_margin, which a plan does not leave: vertices in m, or None.

        Where that is in several parts, it is the one in which or next to which UAV 0 starts.
        """
        if self.geofence is None:
            return None
        parts = grown(self.geofence, -self.tracking_margin)
        if not parts:
            raise ScenarioError(f'tracking_margin is {self.tracking_margin:g} m, which leaves '
                                'nothing of the geofence; it must be smaller',
                                ('tracking_margin',))
        return max(parts, key=lambda part: float(depth(part, self.uavs[0].start)))

    @property
    def keep_apart(self) -> float:
        """Smallest distance in space between UAVs of a plan, in m; 0 for no limit."""
        return self.separation and self.separation + 2 * self.tracking_margin

    @property
    def margin_text(self) -> str:
        """Words to add to the name of a limit that tracking_margin has made tighter, or none."""
        margin = self.tracking_margin
        return f' with the tracking_margin of {margin:g} m' if margin else ''

    @cached_property
    def efforts(self) -> Array:
        """Share of its limits that the flight of least effort of each UAV uses, (U,)."""
        return read_only([uav.vehicle.least_effort(self.slots, self.slot_duration)[0]
                          for uav in self.uavs])

    @cached_property
    def end_velocities(self) -> Array:
        """Velocities at the starts and at the goals, (2, U, 2) in m/s, NaN where they are free."""
        free = (math.nan, math.nan)
        return read_only([[uav.start_velocity or free for uav in self.uavs],
                          [uav.goal_velocity or free for uav in self.uavs]])

    @cached_property
    def max_accelerations(self) -> Array:
        """Largest accelerations, (U,) in m/s^2, infinite without a limit."""
        return read_only([math.inf if uav.max_acceleration is None else uav.max_acceleration
                          for uav in self.uavs])

    def to_dict(self) -> dict[str, Any]:
        """
        Return the scenario as plain values that JSON has; an infinite ceiling is None.

        The fields `channel` and `colluding`, which version 0.1.0 does not know, are there where
        they are not the default.
        """
        data = asdict(self)
        for field in ('channel', 'colluding'):
            if getattr(self, field) == getattr(Scenario, field):
                del data[field]
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
        for field, (kind, *_) in _MEMBERS.items():
            members = values.get(field, ())
            if not isinstance(members, (list, tuple)):
                raise ScenarioError(f'{field} is {shown(members)}; it must be a list', (field,))
            values[field] = tuple(_part(kind, member, field, number)
                                  for number, member in enumerate(members))
        if 'channel' in values:
            values['channel'] = _part(Channel, values['channel'], 'channel')
        return cls(**values)

    def save(self, path: str | os.PathLike[str]) -> None:
        """
        Write the mission to a file, as JSON if its name ends with .json, otherwise as YAML.

        :raises OSError: when the file cannot be written; an old one is left as it was.
        """
        from . import formats  # Here and not above: its reader of YAML takes time to import.
        formats.write_mission(checked_path(path), self.to_dict())

    def plot(self) -> 'Figure':
        """
        Return a map of the mission: starts, goals, ground node, discs, zones and fence.

        :return: a matplotlib Figure, which notebooks show and whose savefig writes it to a file.
        :raises MissingPackageError: when Matplotlib is not installed.
        """
        return view('plot_scenario', self)

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> 'Scenario':
        """
        Return the mission that a file describes: YAML, JSON if the name ends with .json.

        It has the fields of Scenario with their units; those with a default may be missing.

        :raises OSError: when the file cannot be read, is no regular file, or is too large.
        :raises MissionFileError: naming the line and what is wrong; its `problems` are all that
            is wrong.
        """
        from . import formats
        return formats.read_mission(checked_path(path), cls)


def _part(kind: type[Any], data: object, *place: str | int) -> Any:
    """Return an object in a scenario's dictionary."""
    with within(*place):
        return kind(**checked_fields(kind, data))
