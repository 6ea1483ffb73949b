"""What is made of the parameters' values, and the values that a mission stands for."""

from collections.abc import Iterable, Mapping, Sequence
from itertools import chain
import math
from typing import Any

from .parameters import (
    NO_LIMIT, NO_LOS, NO_OUTAGE, OWN_OBJECTIVE, PROPULSION_FIELDS, PROPULSIONS, UAV_FIELDS)
from ..errors import ParameterError, ScenarioError, shown
from ..mission import Objective
from ..mission.participants import NoFlyZone
from ..mission.polygons import checked_polygon
from ..mission.propagation import Channel
from ..mission.propulsion import Propulsion
from ..mission.scenario import Point, Scenario, Uav
from ..optimize.solve import checked_objective


def objective_from(values: Mapping[str, Any]) -> Objective:
    """
    Return the objective that the parameter values describe.

    :raises OptionError: if the method cannot maximise it.
    """
    objective = values['objective']
    return checked_objective(values['method'], None if objective == OWN_OBJECTIVE else objective)


def uav_from(values: Mapping[str, Any], name: str) -> Uav:
    """Return the Uav that the parameter values describe."""
    fields = {field: values[f'{name}.{field}'] for field in UAV_FIELDS}
    fields['max_acceleration'] = fields['max_acceleration'] or None
    for field in ('start_velocity', 'goal_velocity'):
        fields[field] = fields[field] or None
    if values[f'{name}.propulsion.model'] != PROPULSIONS[0]:
        fields['propulsion'] = Propulsion(**{
            field: values[f'{name}.propulsion.{field}'] for field in PROPULSION_FIELDS})
    return Uav(name, **fields)


def channel_from(values: Mapping[str, Any]) -> Channel:
    """
    Return the Channel that the parameter values describe.

    :raises PlanningError: for an environment and numbers at once, or wrong numbers.
    """
    los, numbers = values['channel.los'], values['channel.los_numbers']
    if numbers and los != NO_LOS:
        raise ParameterError(
            f'channel.los_numbers is {shown(numbers)}; it must be empty where channel.los is '
            f'{los}')
    outage = values['channel.outage'] or None
    return Channel(values['channel.exponent'], numbers or (None if los == NO_LOS else los),
                   values['channel.cautious'],
                   None if outage is None else values['channel.rician_k_db'], outage)


def airspace_from(values: Mapping[str, Any]) -> dict[str, Any]:
    """
    Return separation, margin, zones and geofence of a Scenario, as the parameter values say.

    :raises PlanningError: for a zone or a fence that is no polygon; the text names the parameter.
    """
    fence = values['geofence']
    return {
        'separation': values['separation'],
        'tracking_margin': values['tracking_margin'],
        'no_fly_zones': tuple(_zone(values, name) for name in values['no_fly_zones']),
        'geofence': checked_polygon('', 'geofence', _points('geofence', fence)) if fence else None}


def _zone(values: Mapping[str, Any], name: str) -> NoFlyZone:
    return NoFlyZone(
        _points(f'{name}.vertices', values[f'{name}.vertices']), values[f'{name}.floor'],
        values[f'{name}.ceiling'] or math.inf, name)


def _points(field: str, numbers: Sequence[float]) -> tuple[Point, ...]:
    """Return x1, y1, x2, y2, ... as points."""
    if len(numbers) % 2:
        raise ParameterError(f'{field} is {shown(list(numbers))}; it must have an even number of '
                             'coordinates x1, y1, x2, y2, ...')
    return tuple(zip(numbers[::2], numbers[1::2], strict=True))


def of_mission(file: str) -> dict[str, Any]:
    """
    Return the values of parameters by name that a mission file stands for.

    :raises ParameterError: if it holds no mission or cannot be read.
    """
    try:
        return values_of(Scenario.load(file))
    except OSError as error:
        reason = f'{file} cannot be read: {error.strerror or error}'
    except ScenarioError as error:
        reason = str(error)
    raise ParameterError(f'parameter mission_file: {reason}', ('mission_file',))


def values_of(mission: Scenario) -> dict[str, Any]:
    """Return the values of parameters by name that a mission stands for."""
    zones = [name.replace(' ', '_') for name in mission.zone_names]
    channel, has_name = mission.channel, isinstance(mission.channel.los, str)
    values = {
        **{name: getattr(mission, name) for name in (
            'duration', 'slots', 'reference_snr_db', 'separation', 'tracking_margin',
            'colluding')},
        'ground_node': list(mission.ground_node), 'geofence': _flat(mission.geofence or ()),
        'uavs': [uav.name for uav in mission.uavs],
        'eavesdroppers': list(mission.eavesdropper_names), 'no_fly_zones': zones,
        'channel.exponent': channel.exponent, 'channel.cautious': channel.cautious,
        'channel.los': channel.los if has_name else NO_LOS,
        'channel.los_numbers': [] if has_name else list(channel.los or ()),
        'channel.rician_k_db': channel.rician_k_db or 0.0,
        'channel.outage': channel.outage or NO_OUTAGE}
    for uav in mission.uavs:
        values.update({f'{uav.name}.{field}': _plain(field, getattr(uav, field))
                       for field in UAV_FIELDS})
        values[f'{uav.name}.propulsion.model'] = PROPULSIONS[uav.propulsion is not None]
        if uav.propulsion is not None:
            values.update({f'{uav.name}.propulsion.{field}': getattr(uav.propulsion, field)
                           for field in PROPULSION_FIELDS})
    for name, eve in zip(mission.eavesdropper_names, mission.eavesdroppers, strict=True):
        values.update({f'{name}.{field}': getattr(eve, field)
                       for field in ('error_radius', 'receiver_advantage_db')})
    for name, zone in zip(zones, mission.no_fly_zones, strict=True):
        values.update({
            f'{name}.vertices': _flat(zone.vertices), f'{name}.floor': zone.floor,
            f'{name}.ceiling': NO_LIMIT if math.isinf(zone.ceiling) else zone.ceiling})
    return values


def _plain(field: str, value: Any) -> Any:
    """Return a UAV's value as a parameter, which has another word for None."""
    if value is None:
        return NO_LIMIT if field == 'max_acceleration' else []
    return list(value) if isinstance(value, tuple) else value


def _flat(points: Iterable[Point]) -> list[float]:
    """Return points as x1, y1, x2, y2, ..."""
    return list(chain.from_iterable(points))
