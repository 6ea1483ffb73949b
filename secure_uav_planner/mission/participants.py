"""The participants of a mission: UAVs, receivers, and zones and other boundaries of flights."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
import math
from typing import Any, ClassVar

import numpy as np

from .fields import (
    Block, check_degrees, Checked, checked_by, checked_name, checked_point, checked_text,
    checked_truth, ErrorList, FieldChecks, Number, number, Pair, Point, RADIUS, read_object)
from .kinematics import Vehicle
from .polygons import checked_polygon, depth, offset_polygon, Vertices
from .tracks import checked_track, interpolate, LEFT_OUT, set_by_track, Track
from .validation import Array, checked_array
from ..errors import OptionError, prefix_path, quote, ScenarioError

MAX_NODES = 16
"""Largest number of ground nodes."""

_ROUNDING = 1e-9  # Relative excess of an end velocity over max_speed that is accepted.
_VELOCITY = checked_by(Pair('m/s', 'two components', is_optional=True))


def _checked_ceiling(value: Any) -> float:
    """Return an altitude of at least 0 m as a float, infinite for None."""
    return Number(0.0, math.inf, 'm')(math.inf if value is None else value)


class Receiver(Checked):
    """
    A receiver on the ground, which stands or moves on a track.

    :cvar DECIDED: names of the fields whose values a track sets.
    """

    DECIDED: ClassVar[tuple[str, ...]] = ('position',)
    position: Point
    track: Track | None

    @classmethod
    def _check_together(cls, checks: FieldChecks) -> None:
        """Set the fields DECIDED, as position, by a track at point 0; else require a position."""
        item = checks.item
        if item.track is not None and checks.are_right('track'):
            for name in cls.DECIDED:
                if checks.are_right(name):
                    set_by_track(checks, name, item.track)
        elif item.track is None and item.position is None:
            checks.add('position', f'is {quote(None)}; it must be two coordinates (x, y) in m, or '
                       'there must be a track')

    @property
    def knots(self) -> Track:
        """Knots of the track; a receiver that stands has a single knot, at time 0."""
        return self.track or ((0.0, *self.position),)

    def at(self, times: Array) -> Array:
        """Return x, y and a disc's radius [m] at times (K,) [s from point 0], (K, 2 or 3)."""
        return interpolate(self.knots, times)


@dataclass(frozen=True)
class Eavesdropper(Receiver):
    """
    An eavesdropper, and the disc that surely contains it: Theta of the paper's Section II.

    :param position: centre of the disc, (x, y) in m; left out with a track.
    :param error_radius: epsilon, radius of the disc in m, 0 by default; left out with a track.
    :param name: name in messages, topics and pictures.
    :param receiver_advantage_db: SNR of the eavesdropper's receiver relative to a ground node's
        receiver at the same place, in dB, by a better antenna or less noise. Guarantees hold for
        this advantage and every smaller one.
    :param track: disc of an eavesdropper that moves, at 2 to 10000 times: each (t, x, y, radius),
        t in s from point 0, the rest in m. The disc is linear between two times, and stands
        before the first and after the last. A track sets position and error_radius to its disc at
        point 0. Other values are an error, so that `replace` of a track needs `position=None,
        error_radius=None`.
    :raises ScenarioError: naming the field, its value and what is allowed.
    """

    position: Point = field(default=LEFT_OUT, metadata=checked_by(checked_point))
    error_radius: float = field(default=LEFT_OUT, metadata=checked_by(RADIUS))
    name: str = field(default='eavesdropper', metadata=checked_by(checked_name))
    receiver_advantage_db: float = field(default=0.0, metadata=number(-100.0, 100.0, 'dB'))
    track: Track | None = field(default=None, metadata=checked_by(checked_track))

    DECIDED = 'position', 'error_radius'
    _OWNER = 'eavesdropper '

    @classmethod
    def _check_together(cls, checks: FieldChecks) -> None:
        super()._check_together(checks)
        if checks.item.track is None and checks.item.error_radius is None:
            object.__setattr__(checks.item, 'error_radius', 0.0)

    @property
    def knots(self) -> Track:
        return self.track or ((0.0, *self.position, self.error_radius),)


@dataclass(frozen=True)
class GroundNode(Receiver):
    """
    A ground node, which is served in a share of each slot.

    :param position: w_k, (x, y) in m, at altitude zero; left out with a track.
    :param name: name in messages, topics and pictures.
    :param weight: divisor of the node's mean rate: solve maximises the least rate over weight.
    :param track: position of a node that moves, at 2 to 10000 times: each (t, x, y), t in s from
        point 0, x and y in m. The position is linear between two times, and constant outside.
    :param trusted: whether the node may hear what is sent to other ground nodes. A node that is
        not trusted is one more eavesdropper, at its own position, for every other node.
    :raises ScenarioError: naming the field, its value and what is allowed.
    """

    position: Point = field(default=LEFT_OUT, metadata=checked_by(checked_point))
    name: str = field(default='ground_node', metadata=checked_by(checked_name))
    weight: float = field(default=1.0, metadata=number(1e-3, 1e3))
    track: Track | None = field(
        default=None, metadata=checked_by(partial(checked_track, radius=False)))
    trusted: bool = field(default=True, metadata=checked_by(checked_truth))

    _OWNER = 'ground node '


def expand_ground_node(values: Mapping[str, Any], errors: ErrorList) -> dict[str, Any]:
    """
    Return a Scenario's values with ground_nodes instead of ground_node and its track.

    :param values: values of the fields by name, not checked yet.
    :param errors: list to which the errors of ground_node are added; the value of ground_nodes is
        None after an error.
    """
    values = dict(values)
    nodes, place, track = (
        values.pop(name, None) for name in ('ground_nodes', 'ground_node', 'ground_node_track'))
    values['ground_nodes'] = None
    with errors.collecting():
        values['ground_nodes'] = _list_nodes(nodes, place, track)
    return values


def _list_nodes(nodes: Any, place: Any, track: Any) -> Any:
    """
    Return the ground_nodes as given, or a single node with the given place or track.

    dataclasses.replace of a place passes the present ground_nodes, too: if they are a single
    GroundNode, it keeps its name, weight and trust at the new place.

    :param nodes: value of ground_nodes; None or an empty tuple if there is none.
    :param place: value of ground_node: coordinates, or a mapping with the fields of a GroundNode.
    :param track: value of ground_node_track.
    :raises ScenarioError: if there are both or neither, or for a wrong value.
    """
    is_listed = nodes is not None and not (isinstance(nodes, tuple) and not nodes)
    is_single = isinstance(nodes, tuple) and [*map(type, nodes)] == [GroundNode]
    if place is None and track is None:
        if is_listed:
            return nodes
        raise ScenarioError(f'ground_node is {quote(None)}; it must be two coordinates (x, y) in '
                            'm, or there must be a ground_node_track or ground_nodes',
                            ('ground_nodes',))
    if is_listed and not is_single:
        name, value = ('ground_node', place) if track is None else ('ground_node_track', track)
        raise ScenarioError(f'{name} is {quote(value)}; it must be left out where there are '
                            'ground_nodes', (name,))
    with prefix_path('ground_node'):
        if isinstance(place, Mapping) and track is None:
            check_degrees(place)
            return (read_object(GroundNode, place),)
        place = None if place is None else checked_point(place)
    with prefix_path('ground_node_track'):
        track = None if track is None else checked_track(track, radius=False)
    try:
        return (replace(nodes[0] if is_single else _ORIGIN, position=place, track=track),)
    except ScenarioError as error:
        raise ScenarioError(str(error), ('ground_node',)) from None


_ORIGIN = GroundNode((0.0, 0.0))


@dataclass(frozen=True)
class Propulsion(Checked):
    """
    The propulsion power of a rotary wing.

    Source: equation (12) of Y. Zeng, J. Xu, R. Zhang, Energy Minimization for Wireless
    Communication with Rotary-Wing UAV, IEEE Trans. Wireless Commun. 18 (2019), whose numbers are
    the defaults. As in the article, the power of accelerating is neglected.

    :param blade_power: P_0, the blade profile power while hovering, in W.
    :param induced_power: P_i, the induced power while hovering, in W.
    :param tip_speed: U_tip, tip speed of the rotor blades, in m/s.
    :param induced_velocity: v_0, mean rotor induced velocity while hovering, in m/s.
    :param fuselage_drag_ratio: d_0, without a unit.
    :param air_density: rho, in kg/m^3.
    :param solidity: s, solidity of the rotor, without a unit.
    :param disc_area: A, area of the rotor disc, in m^2.
    :raises ScenarioError: naming the field, its value and what is allowed.
    """

    blade_power: float = field(default=79.8563, metadata=number(0.0, 1e6, 'W'))
    induced_power: float = field(default=88.6279, metadata=number(0.0, 1e6, 'W'))
    tip_speed: float = field(default=120.0, metadata=number(1.0, 1e4, 'm/s'))
    induced_velocity: float = field(default=4.03, metadata=number(1e-3, 1e3, 'm/s'))
    fuselage_drag_ratio: float = field(default=0.6, metadata=number(0.0, 1e3))
    air_density: float = field(default=1.225, metadata=number(0.0, 1e3, 'kg/m^3'))
    solidity: float = field(default=0.05, metadata=number(0.0, 1.0))
    disc_area: float = field(default=0.503, metadata=number(0.0, 1e4, 'm^2'))

    _OWNER = 'propulsion.'

    def power(self, speeds: Any) -> Array:
        """
        Return the power P(V) of equation (12) [W] at speeds V [m/s], in their shape.

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
        return (self.blade_power * (1 + 3 * squared / self.tip_speed**2)
                + self.induced_power * induced + self.drag * squared**1.5)

    @property
    def drag(self) -> float:
        """Power of the fuselage's drag divided by speed^3, in W / (m/s)^3."""
        return 0.5 * self.fuselage_drag_ratio * self.air_density * self.solidity * self.disc_area


@dataclass(frozen=True)
class Uav(Checked):
    """
    One UAV and its limits, equations (1) and (7).

    :param name: name in messages, topics and files.
    :param start: horizontal position at the start, (x, y) in m.
    :param goal: horizontal position at the end, (x, y) in m.
    :param altitude: constant flying height H above the ground node in m.
    :param max_speed: V in m/s.
    :param average_power: P_ave, limit of the mean power over the slots, in W.
    :param peak_power: P_peak, limit of the power in every slot, in W.
    :param max_acceleration: largest acceleration along the flown curve in m/s^2, or None for the
        paper's vehicle, which has no such limit.
    :param start_velocity: velocity at the start, (x, y) in m/s, or None if any is allowed. Used
        only with max_acceleration.
    :param goal_velocity: velocity at the goal, (x, y) in m/s, or None if any is allowed. Used
        only with max_acceleration.
    :param propulsion: Propulsion from which the energy of the flight is computed, or None.
    :param max_energy: largest energy of the flight by its propulsion in J; None for no limit. It
        is allowed only with max_acceleration. It makes Propulsion() the default propulsion.
    :raises ScenarioError: naming the UAV, the field, its value and what is allowed.
    """

    name: str = field(metadata=checked_by(checked_name))
    start: Point = field(metadata=checked_by(checked_point))
    goal: Point = field(metadata=checked_by(checked_point))
    altitude: float = field(metadata=number(1e-3, 1e6, 'm'))
    max_speed: float = field(metadata=number(1e-6, 1e6, 'm/s'))
    average_power: float = field(default=1.0, metadata=number(1e-9, 1e6, 'W'))
    peak_power: float = field(default=4.0, metadata=number(1e-9, 1e6, 'W'))
    max_acceleration: float | None = field(default=None, metadata=number(1e-6, 1e6, 'm/s^2'))
    start_velocity: Point | None = field(default=(0.0, 0.0), metadata=_VELOCITY)
    goal_velocity: Point | None = field(default=(0.0, 0.0), metadata=_VELOCITY)
    propulsion: Propulsion | None = field(default=None, metadata=checked_by(Block(Propulsion)))
    max_energy: float | None = field(default=None, metadata=number(1e-3, 1e12, 'J'))

    _OWNER = 'uav '

    @staticmethod
    def _check_together(checks: FieldChecks) -> None:
        """Check powers, end velocities, energy; max_energy sets a missing propulsion."""
        item = checks.item
        if (checks.are_right('average_power', 'peak_power')
                and item.peak_power < item.average_power):
            checks.add('peak_power', f'is {item.peak_power!r}; it must be at least '
                       f'average_power, which is {item.average_power!r} W')
        for name in ('start_velocity', 'goal_velocity'):
            if not checks.are_right(name, 'max_speed') or getattr(item, name) is None:
                continue
            speed = math.hypot(*getattr(item, name))
            if speed > item.max_speed * (1 + _ROUNDING):
                checks.add(name, f'is {quote(getattr(item, name))}, {speed:g} m/s; it must be '
                           f'at most max_speed, which is {quote(item.max_speed)} m/s')
        if item.max_energy is not None and checks.are_right('max_energy'):
            if item.max_acceleration is None:
                checks.add('max_energy', f'is {item.max_energy!r} J; it must be {quote(None)} '
                           'without max_acceleration: such a UAV would hop to and fro instead of '
                           'hovering, which the model takes for cheap and no vehicle can fly')
            if item.propulsion is None:
                object.__setattr__(item, 'propulsion', Propulsion())

    def end_deviation(self, end: str, slot_duration: float) -> float:
        """
        Return the largest distance in m of the flown curve at point 0 or N+1 from start or goal.

        The distance is 0 for a UAV that rests at this end, has a free velocity there, or has no
        limit of acceleration: its curve passes the start or the goal itself.

        :param end: 'start' or 'goal'.
        :param slot_duration: length of a slot in s.
        """
        if self.max_acceleration is None or (
                getattr(self, f'{end}_velocity') in (None, (0.0, 0.0))):
            return 0.0
        return self.max_acceleration * slot_duration**2 / 8

    @property
    def limits_text(self) -> str:
        """Largest speed and acceleration as text, such as '10 m/s and 2 m/s^2'."""
        return f'{self.max_speed:g} m/s' + (
            '' if self.max_acceleration is None else f' and {self.max_acceleration:g} m/s^2')

    @property
    def vehicle(self) -> Vehicle:
        """Way from start to goal and limits; end velocities only with a max_acceleration."""
        displacement = (self.goal[0] - self.start[0], self.goal[1] - self.start[1])
        if self.max_acceleration is None:
            return Vehicle(displacement, self.max_speed)
        return Vehicle(displacement, self.max_speed, self.max_acceleration,
                       self.start_velocity, self.goal_velocity)


@dataclass(frozen=True)
class NoFlyZone(Checked):
    """
    A prism that no UAV may enter: a polygon on the map between two altitudes.

    A plan may touch the edge of the zone, offset by Scenario.tracking_margin.

    :param vertices: corners of the polygon in either order, each (x, y) in m. The polygon need
        not be convex, but its outline may not cross or touch itself.
    :param floor: lowest forbidden altitude in m.
    :param ceiling: highest forbidden altitude in m; infinite, or None, for all above.
    :param name: name in messages and pictures; a zone without a name is named by its number.
    :raises ScenarioError: naming the zone, the field, its value and what is allowed.
    """

    vertices: Vertices = field(metadata=checked_by(checked_polygon, 'm'))
    floor: float = field(default=0.0, metadata=number(0.0, 1e6, 'm'))
    ceiling: float = field(default=math.inf, metadata=checked_by(_checked_ceiling, 'm'))
    name: str = field(default='', metadata=checked_by(checked_text))

    _OWNER = 'zone '

    @staticmethod
    def _check_together(checks: FieldChecks) -> None:
        """Check that the floor is not above the ceiling."""
        item = checks.item
        if checks.are_right('floor', 'ceiling') and item.floor > item.ceiling:
            checks.add('floor', f'is {quote(item.floor)} m; it must be at most ceiling, which is '
                       f'{quote(item.ceiling)} m')

    def is_at(self, altitude: float, margin: float = 0.0) -> bool:
        """Return True if an altitude is from floor - margin to ceiling + margin, all in m."""
        return self.floor - margin <= altitude <= self.ceiling + margin


class Boundaries:
    """
    Zones, fence and separation of a Scenario, offset by the tracking_margin: the limits of plans.

    :ivar margin: the tracking_margin in m.
    """

    def __init__(self, scenario: Any) -> None:
        self._scenario, self.margin = scenario, scenario.tracking_margin
        self._kept_out: dict[float, tuple[tuple[Vertices, str], ...]] = {}

    def zones_at(self, altitude: float) -> tuple[tuple[NoFlyZone, str], ...]:
        """Return (zone, name) of each zone within the margin of an altitude in m."""
        return tuple((zone, name) for zone, name in zip(
            self._scenario.no_fly_zones, self._scenario.zone_names, strict=True)
            if zone.is_at(altitude, self.margin))

    def keep_out(self, altitude: float) -> tuple[tuple[Vertices, str], ...]:
        """Return (vertices [m], name) of zones at an altitude [m], offset outwards by margin."""
        if altitude not in self._kept_out:
            self._kept_out[altitude] = tuple(
                (offset_polygon(zone.vertices, self.margin)[0], name)
                for zone, name in self.zones_at(altitude))
        return self._kept_out[altitude]

    @cached_property
    def keep_in(self) -> Vertices | None:
        """
        Polygon that no plan leaves, the geofence offset inwards by margin [m]; None without one.

        The margin may divide the geofence into parts. The polygon is then the part that contains
        the start of UAV 0, or the part nearest to this start if none contains it.

        :raises ScenarioError: if the margin leaves nothing of the geofence.
        """
        if self._scenario.geofence is None:
            return None
        parts = offset_polygon(self._scenario.geofence, -self.margin)
        if not parts:
            raise ScenarioError(f'tracking_margin is {self.margin:g} m, which leaves nothing of '
                                'the geofence; it must be smaller', ('tracking_margin',))
        return max(parts, key=lambda part: float(depth(part, self._scenario.uavs[0].start)))

    @property
    def keep_apart(self) -> float:
        """Smallest three-dimensional distance between UAVs of a plan in m; 0 for no limit."""
        separation = self._scenario.separation
        return float(separation + 2 * self.margin if separation else 0.0)

    @property
    def margin_text(self) -> str:
        """Suffix of a limit's name in messages: the margin, or '' without one."""
        return f' with the tracking_margin of {self.margin:g} m' if self.margin else ''
