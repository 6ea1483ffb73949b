"""A node's settings: its parameters as declared, and how a mission becomes parameters and back."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, fields
import difflib
import math
import re
from typing import Any, Generic, Protocol, TypeVar

from rcl_interfaces.msg import SetParametersResult
from rclpy.node import Node
from rclpy.parameter import Parameter

from .parameters import (
    list_values, METHOD_DEFAULT, NO_LOS, NO_ORIGIN, NO_PROPULSION, NO_REFERENCE, read_fields,
    read_member_specs, Spec)
from ..errors import brief, ParameterError, PlanningError, prefix_path, quote, ScenarioError
from ..mission import Objective
from ..mission.geography import Origin
from ..mission.participants import NoFlyZone, Propulsion
from ..mission.polygons import checked_polygon
from ..mission.propagation import Channel
from ..mission.scenario import Point, Scenario, Uav
from ..mission.validation import make_unique
from ..optimize.methods import check_objective

Kind = TypeVar('Kind')
"""The settings of a node, or of a member of the node."""

# Prefixes of the parameters that every node of ROS has.
_ROS_PREFIXES = ('qos_overrides./parameter_events.', 'qos_overrides./clock.', 'use_sim_time',
                 'start_type_description_service')

_MOST_IN_ZONE = 80  # Largest length of a zone's name, to which a number may be added.


class Settings(Generic[Kind]):
    """
    The declared parameters of a node; a change is validated as a whole, then applied as a whole.

    A parameter that is not given has its value in the mission of the parameter `mission_file`, or
    its default.

    :param specs: a Spec for each parameter name.
    :param make: returns the settings of the node for all values by name, or raises a
        PlanningError for a wrong combination.
    :param sections: sections of the table for the members that parameters name; see
        read_member_specs.
    :raises ParameterError: for a wrong value at the start; the text names the parameter.
    :ivar current: the settings for the present values.
    """

    def __init__(self, node: Node, specs: Mapping[str, Spec],
                 make: Callable[[dict[str, Any]], Kind], sections: Mapping[str, str] = {}
                 ) -> None:
        self._specs: dict[str, Spec] = {}
        self._make = make
        self._values: dict[str, Any] = {'tracks': {}}  # Tracks of the mission file by receiver.
        self._node = node
        self._mission_values: dict[str, Any] = {}  # Values of the mission file by parameter.
        self._declare(specs)
        self._declare(read_member_specs(self._values, sections))
        self.current = make(self._values)
        node.add_on_set_parameters_callback(self._on_set)

    def _declare(self, specs: Mapping[str, Spec]) -> None:
        """Declare parameters: with the given value, else the mission file's, else the default."""
        overrides = _overrides(self._node)
        for name, spec in specs.items():
            value = self._mission_values.get(name, spec.default)
            if name in overrides:
                value = overrides[name].value
                if value is None and isinstance(spec.default, list):
                    value = []  # rcl does not tell an empty list from no value.
            self._specs[name] = spec
            self._values[name] = spec.convert(name, value, 'parameter ')
            self._node.declare_parameter(
                name, self._values[name], spec.descriptor(), ignore_override=True)
            if name == 'mission_file' and value:  # The first parameter.
                self._mission_values = load_mission(value)
                self._values['tracks'] = self._mission_values.pop('tracks')

    def warn_of_unknown(self) -> None:
        """
        Log each given parameter that does not exist, with the nearest name that does.

        A quality of service can be given of the topics that the node has now.
        """
        names = self._node.get_parameters_by_prefix('')
        for name in sorted(_overrides(self._node)):
            if self._node.has_parameter(name) or name.startswith(_ROS_PREFIXES):
                continue
            near = difflib.get_close_matches(name[:200], names, 1)
            hint = f'; did you mean {near[0]}?' if near else ''
            self._node.get_logger().warning(
                f'there is no parameter {brief(name, 100)}, it is ignored{hint}')

    def _on_set(self, parameters: list[Parameter]) -> SetParametersResult:
        """Accept changed parameters together if all settings stay valid."""
        ours = [parameter for parameter in parameters if parameter.name in self._specs]
        if not ours:  # rclpy declares many for each topic, and calls this each time.
            return SetParametersResult(successful=True)
        try:
            values = self._values | {
                parameter.name: self._specs[parameter.name].convert(
                    parameter.name, parameter.value) for parameter in ours}
            settings = self._make(values)
        except PlanningError as error:
            return SetParametersResult(successful=False, reason=brief(error))
        self._values, self.current = values, settings
        return SetParametersResult(successful=True)


def _overrides(node: Node) -> dict[str, Parameter]:
    """Return the parameters from the command line and parameter files of a node by name."""
    overrides: dict[str, Parameter] = node._parameter_overrides  # rclpy has no public access.
    return overrides


def read_settings(kind: type[Kind], values: Mapping[str, Any], prefix: str = '', **given: Any
                  ) -> Kind:
    """Return settings with `given` fields; any other field f is the parameter `prefix` + f."""
    return kind(**given, **{
        entry.name: tuple(value) if isinstance(value, list) else value
        for entry in fields(kind) if entry.name not in given  # type: ignore[arg-type]
        for value in [values[prefix + entry.name]]})


@dataclass(frozen=True)
class VehicleSettings:
    """
    The parameters of a vehicle's local frame.

    :ivar origin: origin of the local frame, (x, y, z) in m in the frame of the mission.
    :ivar reference: autopilot that reports the origin's place on Earth, or 'none'.
    """

    origin: tuple[float, float, float]
    reference: str


class FrameSettings(Protocol):
    """Settings of a node that converts positions of local frames."""

    @property
    def uavs(self) -> Mapping[str, VehicleSettings]:
        """Vehicle of each UAV by its name."""

    @property
    def origin(self) -> Origin | None:
        """Place on Earth of the mission's origin, or None."""


def check_references(values: Mapping[str, Any]) -> None:
    """Raise a ParameterError if an origin does not fit a `<uav>.reference`."""
    origin = origin_from(values)
    for name in values['uavs']:
        reference, place = values[f'{name}.reference'], values[f'{name}.origin']
        if reference == NO_REFERENCE:
            continue
        if origin is None or reference == 'px4' and origin.projection != 'px4':
            raise ParameterError(
                f'{name}.reference is {reference} and origin.projection is '
                f'{values["origin.projection"]}; it must be '
                f'{"px4" if reference == "px4" else "px4 or ardupilot"}, and origin.latitude and '
                'origin.longitude say where the mission is')
        if any(place[:2]):
            raise ParameterError(f'{name}.origin is {quote(place)}; with {name}.reference, x and '
                                 'y must be 0')


def objective_from(values: Mapping[str, Any]) -> Objective:
    """Return the objective of the parameter values, or raise an error if the method lacks it."""
    objective = values['objective']
    return check_objective(values['method'], None if objective == METHOD_DEFAULT else objective)


def uav_from(values: Mapping[str, Any], name: str) -> Uav:
    """Return the Uav of this name; a propulsion.model or a max_energy gives it a Propulsion."""
    fields = read_fields('uav', Uav, values, f'{name}.')
    if values[f'{name}.propulsion.model'] != NO_PROPULSION or fields['max_energy']:
        fields['propulsion'] = Propulsion(**read_fields('uav', Propulsion, values, f'{name}.'))
    return Uav(name, **fields)


def channel_from(values: Mapping[str, Any]) -> Channel:
    """Return the Channel of the parameter values; without an outage it has no fading."""
    fields = read_fields('planner', Channel, values)
    los, numbers = values['channel.los'], values['channel.los_numbers']
    if numbers and los != NO_LOS:
        raise ParameterError(
            f'channel.los_numbers is {quote(numbers)}; it must be empty where channel.los is '
            f'{los}')
    if fields['outage'] is None:
        fields['rician_k_db'] = None
    return Channel(los=numbers or (None if los == NO_LOS else los), **fields)


def airspace_from(values: Mapping[str, Any]) -> dict[str, Any]:
    """Return zones and geofence by the fields of Scenario; a ceiling of 0 is infinite."""
    zones = (NoFlyZone(points_from(f'{name}.vertices', values[f'{name}.vertices']),
                       values[f'{name}.floor'], values[f'{name}.ceiling'] or math.inf, name)
             for name in values['no_fly_zones'])
    fence = points_from('geofence', values['geofence'])
    with prefix_path('geofence'):
        return {'no_fly_zones': tuple(zones),
                'geofence': checked_polygon(fence) if fence else None}


def origin_from(values: Mapping[str, Any]) -> Origin | None:
    """Return the Origin of the parameter values, or None if there is none."""
    if values['origin.projection'] == NO_ORIGIN:
        return None
    return Origin(projection=values['origin.projection'], **read_fields('planner', Origin, values))


def points_from(field: str, numbers: Sequence[float]) -> tuple[Point, ...]:
    """Return x1, y1, x2, y2, ... as points, or raise a ParameterError for an odd number."""
    if len(numbers) % 2:
        raise ParameterError(f'{field} is {quote(list(numbers))}; it must have an even number of '
                             'coordinates x1, y1, x2, y2, ...')
    return tuple(zip(numbers[::2], numbers[1::2], strict=True))


def load_mission(file: str) -> dict[str, Any]:
    """Return the parameter values of a mission file by name, or raise a ParameterError."""
    try:
        return mission_values(Scenario.load(file))
    except OSError as error:
        reason = f'{file} cannot be read: {error.strerror or error}'
    except ScenarioError as error:
        reason = str(error)
    raise ParameterError(f'parameter mission_file: {reason}', ('mission_file',))


def mission_values(mission: Scenario) -> dict[str, Any]:
    """Return a mission's values by parameter; 'tracks' has the tracks by receiver."""
    uavs, channel, origin = mission.uavs, mission.channel, mission.origin
    nodes = dict(zip(mission.ground_node_names, mission.ground_nodes, strict=True))
    eavesdroppers = dict(zip(mission.eavesdropper_names, mission.eavesdroppers, strict=True))
    zones = dict(zip(_name_zones(
        mission.zone_names, [*(uav.name for uav in uavs), *nodes, *eavesdroppers]),
        mission.no_fly_zones, strict=True))
    is_named = isinstance(channel.los, str)
    values = list_values('planner', mission) | list_values('planner', channel) | {
        'uavs': [uav.name for uav in uavs], 'ground_nodes': [*nodes],
        'eavesdroppers': [*eavesdroppers], 'no_fly_zones': [*zones],
        'geofence': _flatten(mission.geofence or ()),
        'channel.los': channel.los if is_named else NO_LOS,
        'channel.los_numbers': [] if is_named else [*(channel.los or ())],
        'tracks': {name: receiver.track for name, receiver in (nodes | eavesdroppers).items()
                   if receiver.track is not None}}
    if origin is not None:
        values |= list_values('planner', origin) | {'origin.projection': origin.projection}
    for uav in uavs:
        values |= list_values('uav', uav, f'{uav.name}.')
        values[f'{uav.name}.propulsion.model'] = (
            'rotary_wing' if uav.propulsion else NO_PROPULSION)
        if uav.propulsion:
            values |= list_values('uav', uav.propulsion, f'{uav.name}.')
    for section, members in (('ground_node', nodes), ('eavesdropper', eavesdroppers)):
        for name, member in members.items():
            values |= list_values(section, member, f'{name}.')
    for name, zone in zones.items():
        values |= {f'{name}.vertices': _flatten(zone.vertices), f'{name}.floor': zone.floor,
                   f'{name}.ceiling': 0.0 if zone.ceiling == math.inf else zone.ceiling}
    return values


def _name_zones(names: Sequence[str], taken: Sequence[str]) -> tuple[str, ...]:
    """Return names of zones that are legal as prefixes of parameters, unique and not taken."""
    legal = [re.sub(r'\W|^(?=\d)', '_', name[:_MOST_IN_ZONE], flags=re.ASCII) for name in names]
    return make_unique([*taken, *legal])[len(taken):]


def _flatten(points: Iterable[Point]) -> list[float]:
    """Return points as x1, y1, x2, y2, ..."""
    return [coordinate for point in points for coordinate in point]
