"""The participants of a mission: UAVs with their propulsion, eavesdroppers, no-fly zones."""

from dataclasses import dataclass, fields
from functools import partial
import math
from typing import Any

import numpy as np

from .kinematics import Vehicle
from .polygons import checked_polygon, Vertices
from .tracks import checked_track, LEFT_OUT, set_by_track, Track
from .validation import (
    Array, check_object, checked_array, checked_block, checked_name, checked_number,
    checked_point, FieldChecks, Point)
from ..errors import OptionError, quote

_ROUNDING = 1e-9


@dataclass(frozen=True)
class Eavesdropper:
    """
    An eavesdropper and the disc in which it is: Theta of the paper's Section II.

    :param position: centre of the disc, (x, y) in m; left out with a track.
    :param error_radius: epsilon, the radius in m within which it surely is, 0 by default; left out
        with a track.
    :param name: used in messages, topics and pictures.
    :param receiver_advantage_db: SNR at its receiver relative to that of the ground node's
        receiver at the same place, in dB: a better antenna or less noise. Guarantees hold for
        every receiver up to that.
    :param track: of an eavesdropper that moves, the disc at 2 to 1000 times: (t, x, y, radius)
        each, t in s from point 0 and the rest in m; linear in between, and held before the first
        and after the last. Then position and error_radius are those of the track at point 0; other
        values are an error, so that `replace` of a track needs `position=None, error_radius=None`.
    :raises ScenarioError: naming the field, its value and what is allowed.
    """

    position: Point = LEFT_OUT
    error_radius: float = LEFT_OUT
    name: str = 'eavesdropper'
    receiver_advantage_db: float = 0.0
    track: Track | None = None

    def __post_init__(self) -> None:
        check_object(self)

    @staticmethod
    def _check_fields(checks: FieldChecks) -> None:
        item, checks.owner = checks.item, 'eavesdropper '
        checks.check(checked_name, 'name')
        if checks.are_right('name'):
            checks.owner = f'{quote(item.name)[1:-1]} '
        checks.check(checked_point, 'position', optional=True)
        checks.check(checked_number, 'error_radius', optional=True)
        checks.check(checked_number, 'receiver_advantage_db')
        checks.check(checked_track, 'track', optional=True)
        if item.track is not None and checks.are_right('track'):
            for field in ('position', 'error_radius'):
                if checks.are_right(field):
                    set_by_track(checks, field, item.track)
        elif item.track is None and item.position is None:
            checks.add('position', f'is {quote(None)}; it must be two coordinates (x, y) in m, or '
                       'there must be a track')
        elif item.track is None and item.error_radius is None:
            object.__setattr__(item, 'error_radius', 0.0)


@dataclass(frozen=True)
class Propulsion:
    """
    The propulsion power of a rotary wing.

    Source: equation (12) of Y. Zeng, J. Xu, R. Zhang, Energy Minimization for Wireless
    Communication with Rotary-Wing UAV, IEEE Trans. Wireless Commun. 18 (2019), whose numbers are
    the defaults. As there, the power of accelerating is neglected.

    :param blade_power: P_0, the blade profile power while hovering, in W.
    :param induced_power: P_i, the induced power while hovering, in W.
    :param tip_speed: U_tip, of the rotor blades, in m/s.
    :param induced_velocity: v_0, mean rotor induced velocity while hovering, in m/s.
    :param fuselage_drag_ratio: d_0.
    :param air_density: rho, in kg/m^3.
    :param solidity: s, of the rotor.
    :param disc_area: A, of the rotor, in m^2.
    :raises ScenarioError: naming the field, its value and what is allowed.
    """

    blade_power: float = 79.8563
    induced_power: float = 88.6279
    tip_speed: float = 120.0
    induced_velocity: float = 4.03
    fuselage_drag_ratio: float = 0.6
    air_density: float = 1.225
    solidity: float = 0.05
    disc_area: float = 0.503

    def __post_init__(self) -> None:
        check_object(self)

    @staticmethod
    def _check_fields(checks: FieldChecks) -> None:
        checks.owner = 'propulsion.'
        checks.check(checked_number, *(field.name for field in fields(Propulsion)))

    def power(self, speeds: Any) -> Array:
        """
        Return P(V), equation (12), in W at speeds V in m/s of any shape.

        :raises OptionError: for a speed that is not a number of at least 0.
        """
        values = checked_array('speeds', speeds)
        if not (values >= 0).all():
            raise OptionError(f'speeds is {quote(speeds)}; it must have numbers of at least 0 m/s',
                              ('speeds',))
        squared = np.square(values)
        ratio = squared / (2 * self.induced_velocity**2)
        # sqrt(1 + x^2) - x, without the loss of digits for a large x.
        induced = 1 / np.sqrt(np.hypot(1.0, ratio) + ratio)
        drag = 0.5 * self.fuselage_drag_ratio * self.air_density * self.solidity * self.disc_area
        return (self.blade_power * (1 + 3 * squared / self.tip_speed**2)
                + self.induced_power * induced + drag * squared**1.5)


@dataclass(frozen=True)
class Uav:
    """
    One UAV and its limits, equations (1) and (7).

    :param name: used in messages, topics and files.
    :param start: horizontal position at the start, (x, y) in m.
    :param goal: horizontal position at the end, (x, y) in m.
    :param altitude: constant flying height H above the ground node in m.
    :param max_speed: V in m/s.
    :param average_power: P_ave, the limit of the mean over the slots, in W.
    :param peak_power: P_peak, the limit in every slot, in W.
    :param max_acceleration: the largest acceleration along the flown curve in m/s^2, or None for
        the paper's vehicle, which has no such limit.
    :param start_velocity: (x, y) in m/s at the start, or None for a free one. Used only with a
        limit of acceleration.
    :param goal_velocity: likewise at the goal.
    :param propulsion: a Propulsion, for the energy of the flight, or None.
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
    propulsion: Propulsion | None = None

    def __post_init__(self) -> None:
        check_object(self)

    @staticmethod
    def _check_fields(checks: FieldChecks) -> None:
        item, checks.owner = checks.item, 'uav '
        checks.check(checked_name, 'name')
        if checks.are_right('name'):
            checks.owner = f'{quote(item.name)[1:-1]}.'
        checks.check(checked_point, 'start', 'goal')
        checks.check(checked_number, 'altitude', 'max_speed', 'average_power', 'peak_power')
        if (checks.are_right('average_power', 'peak_power')
                and item.peak_power < item.average_power):
            checks.add('peak_power', f'is {item.peak_power!r}; it must be at least '
                       f'average_power, which is {item.average_power!r} W')
        checks.check(checked_number, 'max_acceleration', optional=True)
        checks.check(partial(checked_point, index=None, unit='m/s',
                             allowed=f'{quote(None)} or two components'),
                     'start_velocity', 'goal_velocity', optional=True)
        for field in ('start_velocity', 'goal_velocity'):
            if not checks.are_right(field, 'max_speed') or getattr(item, field) is None:
                continue
            speed = math.hypot(*getattr(item, field))
            if speed > item.max_speed * (1 + _ROUNDING):
                checks.add(field, f'is {quote(getattr(item, field))}, {speed:g} m/s; it must be '
                           f'at most max_speed, which is {quote(item.max_speed)} m/s')
        with checks.collecting(owner=checks.owner):
            if item.propulsion is not None:
                object.__setattr__(item, 'propulsion', checked_block(
                    'propulsion', item.propulsion, Propulsion))

    def bend_at(self, end: str, slot_duration: float) -> float:
        """
        Return the largest distance in m of the flown curve from the point 'start' or 'goal'.

        It is 0 for a UAV that rests there, whose curve begins or ends exactly at that point.
        """
        if self.max_acceleration is None or getattr(self, f'{end}_velocity') == (0.0, 0.0):
            return 0.0
        return self.max_acceleration * slot_duration**2 / 8

    @property
    def limits_text(self) -> str:
        """Largest speed and acceleration as text, such as '10 m/s and 2 m/s^2'."""
        return f'{self.max_speed:g} m/s' + (
            '' if self.max_acceleration is None else f' and {self.max_acceleration:g} m/s^2')

    @property
    def vehicle(self) -> Vehicle:
        """Displacement and limits of the flight."""
        displacement = (self.goal[0] - self.start[0], self.goal[1] - self.start[1])
        if self.max_acceleration is None:
            return Vehicle(displacement, self.max_speed)
        return Vehicle(displacement, self.max_speed, self.max_acceleration,
                       self.start_velocity, self.goal_velocity)


@dataclass(frozen=True)
class NoFlyZone:
    """
    A prism that no UAV may enter: a polygon on the map between two altitudes.

    A plan may touch its edge, or that of the zone offset by Scenario.tracking_margin.

    :param vertices: of the polygon in either order, each (x, y) in m. It need not be convex, but
        its outline may not cross or touch itself.
    :param floor: lowest forbidden altitude in m.
    :param ceiling: highest forbidden altitude in m; infinite, or None, for all above.
    :param name: used in messages and pictures; without it the zone is named by its number.
    :raises ScenarioError: naming the zone, the field, its value and what is allowed.
    """

    vertices: Vertices
    floor: float = 0.0
    ceiling: float = math.inf
    name: str = ''

    def __post_init__(self) -> None:
        check_object(self)

    @staticmethod
    def _check_fields(checks: FieldChecks) -> None:
        item, checks.owner = checks.item, 'zone '
        if not isinstance(item.name, str):
            checks.add('name', f'is {quote(item.name)}; it must be text')
        elif item.name:
            checks.owner = f'{quote(item.name)[1:-1]}.'
        checks.check(checked_polygon, 'vertices')
        if item.ceiling is None:
            object.__setattr__(item, 'ceiling', math.inf)
        checks.check(checked_number, 'floor', 'ceiling')
        if checks.are_right('floor', 'ceiling') and item.floor > item.ceiling:
            checks.add('floor', f'is {quote(item.floor)} m; it must be at most ceiling, which is '
                       f'{quote(item.ceiling)} m')

    def is_at(self, altitude: float, margin: float = 0.0) -> bool:
        """Return True if an altitude in m is from floor to ceiling, within a margin in m."""
        return self.floor - margin <= altitude <= self.ceiling + margin
