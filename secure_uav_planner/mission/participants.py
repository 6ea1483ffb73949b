"""The participants of a mission: UAVs with their propulsion, eavesdroppers, no-fly zones."""

from dataclasses import dataclass, fields
import math
from typing import Any

import numpy as np

from .kinematics import Vehicle
from .polygons import checked_polygon, Vertices
from .tracks import checked_track, interpolate, Track
from .validation import (
    Array, checked_array, checked_block, checked_name, checked_number, checked_point, Point,
    set_checked)
from ..errors import OptionError, quote, ScenarioError

_ROUNDING = 1e-9


@dataclass(frozen=True)
class Eavesdropper:
    """
    An eavesdropper and the disc in which it is: Theta of the paper's Section II.

    :param position: centre of the disc, (x, y) in m.
    :param error_radius: epsilon, the radius in m within which it surely is.
    :param name: used in messages, topics and pictures.
    :param receiver_advantage_db: SNR at its receiver relative to that of the ground node's
        receiver at the same place, in dB: a better antenna or less noise. Guarantees hold for
        every receiver up to that.
    :param track: of an eavesdropper that moves, the disc at 2 to 1000 times: (t, x, y, radius)
        each, t in s from point 0 and the rest in m; linear in between, and held before the first
        and after the last. Then position and error_radius become those of the track at point 0.
    :raises ScenarioError: naming the field, its value and what is allowed.
    """

    position: Point
    error_radius: float = 0.0
    name: str = 'eavesdropper'
    receiver_advantage_db: float = 0.0
    track: Track | None = None

    def __post_init__(self) -> None:
        checked_name('eavesdropper', self.name)
        owner = f'{quote(self.name)[1:-1]} '
        set_checked(self, owner, checked_point, 'position')
        set_checked(self, owner, checked_number, 'error_radius', 'receiver_advantage_db')
        set_checked(self, owner, checked_track, 'track', optional=True)
        if self.track is not None:
            x, y, radius = interpolate(self.track, np.zeros(1))[0].tolist()
            object.__setattr__(self, 'position', (x, y))
            object.__setattr__(self, 'error_radius', radius)


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
        set_checked(self, 'propulsion.', checked_number, *(field.name for field in fields(self)))

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
        checked_name('uav', self.name)
        owner = f'{quote(self.name)[1:-1]}.'
        set_checked(self, owner, checked_point, 'start', 'goal')
        set_checked(self, owner, checked_number,
                    'altitude', 'max_speed', 'average_power', 'peak_power')
        if self.peak_power < self.average_power:
            raise ScenarioError(
                f'{owner}peak_power is {self.peak_power!r}; '
                f'it must be at least average_power, which is {self.average_power!r}',
                ('peak_power',))
        set_checked(self, owner, checked_number, 'max_acceleration', optional=True)
        set_checked(self, owner, self._checked_velocity, 'start_velocity', 'goal_velocity',
                    optional=True)
        if self.propulsion is not None:
            try:
                object.__setattr__(self, 'propulsion', checked_block(
                    'propulsion', self.propulsion, Propulsion))
            except ScenarioError as error:
                raise ScenarioError(f'{owner}{error}', error.place) from None

    def _checked_velocity(self, owner: str, field: str, value: Any) -> Point:
        velocity = checked_point(owner, field, value, None,
                                 f'{quote(None)} or two components', 'm/s')
        if math.hypot(*velocity) > self.max_speed * (1 + _ROUNDING):
            raise ScenarioError(
                f'{owner}{field} is {quote(velocity)}, {math.hypot(*velocity):g} m/s; it must be '
                f'at most max_speed, which is {quote(self.max_speed)} m/s', (field,))
        return velocity

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
        if not isinstance(self.name, str):
            raise ScenarioError(f'zone name is {quote(self.name)}; it must be text', ('name',))
        owner = f'{quote(self.name)[1:-1]}.' if self.name else 'zone '
        set_checked(self, owner, checked_polygon, 'vertices')
        if self.ceiling is None:
            object.__setattr__(self, 'ceiling', math.inf)
        set_checked(self, owner, checked_number, 'floor', 'ceiling')
        if self.floor > self.ceiling:
            raise ScenarioError(f'{owner}floor is {quote(self.floor)} m; it must be at most '
                                f'ceiling, which is {quote(self.ceiling)} m', ('floor',))

    def is_at(self, altitude: float, margin: float = 0.0) -> bool:
        """Return True if an altitude in m is from floor to ceiling, within a margin in m."""
        return self.floor - margin <= altitude <= self.ceiling + margin
