"""Who and what a mission is about: UAVs, eavesdroppers, and places that are forbidden."""

from dataclasses import dataclass
import math
from typing import Any

from .kinematics import Vehicle
from .polygons import checked_polygon, Vertices
from .propulsion import Propulsion
from .validation import (
    checked_block, checked_name, checked_number, checked_point, Point, set_checked)
from ..errors import ScenarioError, shown

_ROUNDING = 1e-9


@dataclass(frozen=True)
class Eavesdropper:
    """
    Where an eavesdropper is believed to be: the disc Theta of the paper's Section II.

    :param position: centre of the disc, (x, y) in m.
    :param error_radius: epsilon, the radius in m within which it surely is.
    :param name: used in messages, topics and pictures.
    :param receiver_advantage_db: by how much in dB the SNR at its receiver is larger than the
        ground node's would be at its place: a better antenna or less noise. What is guaranteed
        holds for every receiver up to that.
    :raises ScenarioError: naming the field, its value and what is allowed.
    """

    position: Point
    error_radius: float = 0.0
    name: str = 'eavesdropper'
    receiver_advantage_db: float = 0.0

    def __post_init__(self) -> None:
        checked_name('eavesdropper', self.name)
        owner = f'{shown(self.name)[1:-1]} '
        set_checked(self, owner, checked_point, 'position')
        set_checked(self, owner, checked_number, 'error_radius', 'receiver_advantage_db')


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
    :param start_velocity: (x, y) in m/s at the start, or None where it is free. It counts only
        with a limit of acceleration.
    :param goal_velocity: likewise at the goal.
    :param propulsion: what flying takes, a Propulsion, or None where no energy is asked for.
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
        owner = f'{shown(self.name)[1:-1]}.'
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
                                 f'{shown(None)} or two components', 'm/s')
        if math.hypot(*velocity) > self.max_speed * (1 + _ROUNDING):
            raise ScenarioError(
                f'{owner}{field} is {shown(velocity)}, {math.hypot(*velocity):g} m/s; it must be '
                f'at most max_speed, which is {self.max_speed:g} m/s', (field,))
        return velocity

    def bend_at(self, end: str, slot_duration: float) -> float:
        """
        Return how far in m the flown curve may pass the control point 'start' or 'goal'.

        A UAV that rests there begins or ends its flight exactly at that point.
        """
        if self.max_acceleration is None or getattr(self, f'{end}_velocity') == (0.0, 0.0):
            return 0.0
        return self.max_acceleration * slot_duration**2 / 8

    @property
    def limits_text(self) -> str:
        """Largest speed and acceleration in words."""
        return f'{self.max_speed:g} m/s' + (
            '' if self.max_acceleration is None else f' and {self.max_acceleration:g} m/s^2')

    @property
    def vehicle(self) -> Vehicle:
        """Flight limits, and where the flight begins and ends."""
        displacement = (self.goal[0] - self.start[0], self.goal[1] - self.start[1])
        if self.max_acceleration is None:
            return Vehicle(displacement, self.max_speed)
        return Vehicle(displacement, self.max_speed, self.max_acceleration,
                       self.start_velocity, self.goal_velocity)


@dataclass(frozen=True)
class NoFlyZone:
    """
    A prism that no UAV may enter: a polygon on the map between two altitudes.

    A plan may touch its edge, or that of the zone grown by Scenario.tracking_margin.

    :param vertices: of the polygon in either order, each (x, y) in m. It need not be convex, but
        its outline may not cross or touch itself.
    :param floor: lowest altitude that is forbidden, in m.
    :param ceiling: highest altitude that is forbidden, in m; infinite, or None, for all above.
    :param name: used in messages and pictures; without one the zone is called by its number.
    :raises ScenarioError: naming the zone, the field, its value and what is allowed.
    """

    vertices: Vertices
    floor: float = 0.0
    ceiling: float = math.inf
    name: str = ''

    def __post_init__(self) -> None:
        if not isinstance(self.name, str):
            raise ScenarioError(f'zone name is {shown(self.name)}; it must be text', ('name',))
        owner = f'{shown(self.name)[1:-1]}.' if self.name else 'zone '
        set_checked(self, owner, checked_polygon, 'vertices')
        if self.ceiling is None:
            object.__setattr__(self, 'ceiling', math.inf)
        set_checked(self, owner, checked_number, 'floor', 'ceiling')
        if self.floor > self.ceiling:
            raise ScenarioError(f'{owner}floor is {self.floor:g} m; it must be at most ceiling, '
                                f'which is {self.ceiling:g} m', ('floor',))

    def is_at(self, altitude: float, margin: float = 0.0) -> bool:
        """Return whether the zone, higher and deeper by a margin in m, is at an altitude in m."""
        return self.floor - margin <= altitude <= self.ceiling + margin
