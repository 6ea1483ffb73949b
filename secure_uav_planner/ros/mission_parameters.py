"""
What is made of the parameters' values, and the values that a mission stands for.

A wrong combination of values raises a PlanningError that names the parameter.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict
import math
from typing import Any

import numpy as np

from .parameters import (
    NO_LIMIT, NO_LOS, NO_OUTAGE, OWN_OBJECTIVE, PROPULSION_FIELDS, PROPULSIONS, UAV_FIELDS)
from ..errors import ParameterError, quote, ScenarioError
from ..mission import Objective
from ..mission.participants import NoFlyZone, Propulsion
from ..mission.polygons import checked_polygon
from ..mission.propagation import Channel
from ..mission.scenario import Point, Scenario, Uav
from ..optimize.methods import check_objective

_NOTHING = {'geofence': [], 'los': NO_LOS, 'rician_k_db': 0.0, 'outage': NO_OUTAGE,
            'max_acceleration': NO_LIMIT, 'start_velocity': [], 'goal_velocity': [],
            'ceiling': NO_LIMIT}
"""What a parameter has where a field of the mission has None or infinity."""


def objective_from(values: Mapping[str, Any]) -> Objective:
    """Return the objective that the parameter values describe, if the method maximises it."""
    objective = values['objective']
    return check_objective(values['method'], None if objective == OWN_OBJECTIVE else objective)


def uav_from(values: Mapping[str, Any], name: str) -> Uav:
    """Return the Uav that the parameter values describe."""
    fields = {field: values[f'{name}.{field}'] for field in UAV_FIELDS}
    for field in ('max_acceleration', 'start_velocity', 'goal_velocity'):
        fields[field] = fields[field] or None
    if values[f'{name}.propulsion.model'] != PROPULSIONS[0]:
        fields['propulsion'] = Propulsion(**{
            field: values[f'{name}.propulsion.{field}'] for field in PROPULSION_FIELDS})
    return Uav(name, **fields)


def channel_from(values: Mapping[str, Any]) -> Channel:
    """Return the Channel that the parameter values describe."""
    los, numbers = values['channel.los'], values['channel.los_numbers']
    if numbers and los != NO_LOS:
        raise ParameterError(
            f'channel.los_numbers is {quote(numbers)}; it must be empty where channel.los is '
            f'{los}')
    outage = values['channel.outage'] or None
    return Channel(values['channel.exponent'], numbers or (None if los == NO_LOS else los),
                   values['channel.cautious'],
                   None if outage is None else values['channel.rician_k_db'], outage)


def airspace_from(values: Mapping[str, Any]) -> dict[str, Any]:
    """Return the zones and the geofence that the parameter values describe."""
    zones = (NoFlyZone(_points(f'{name}.vertices', values[f'{name}.vertices']),
                       values[f'{name}.floor'], values[f'{name}.ceiling'] or math.inf, name)
             for name in values['no_fly_zones'])
    fence = _points('geofence', values['geofence'])
    return {'no_fly_zones': tuple(zones),
            'geofence': checked_polygon('', 'geofence', fence) if fence else None}


def _points(field: str, numbers: Sequence[float]) -> tuple[Point, ...]:
    """Return x1, y1, x2, y2, ... as points."""
    if len(numbers) % 2:
        raise ParameterError(f'{field} is {quote(list(numbers))}; it must have an even number of '
                             'coordinates x1, y1, x2, y2, ...')
    return tuple(zip(numbers[::2], numbers[1::2], strict=True))


def of_mission(file: str) -> dict[str, Any]:
    """Return the values of parameters by name that a mission file stands for."""
    try:
        return values_of(Scenario.load(file))
    except OSError as error:
        reason = f'{file} cannot be read: {error.strerror or error}'
    except ScenarioError as error:
        reason = str(error)
    raise ParameterError(f'parameter mission_file: {reason}', ('mission_file',))


def values_of(mission: Scenario) -> dict[str, Any]:
    """Return the values of parameters by name that a mission stands for, and others beside."""
    data = asdict(mission)
    names = {'uavs': [uav.name for uav in mission.uavs],
             'eavesdroppers': list(mission.eavesdropper_names),
             'no_fly_zones': [name.replace(' ', '_') for name in mission.zone_names]}
    members = {kind: data.pop(kind) for kind in names}
    values = names | dict(_flat(data)) | {'channel.los_numbers': []}
    for kind, found in members.items():
        for name, member in zip(names[kind], found, strict=True):
            values |= _flat(member, f'{name}.')
    if not isinstance(values['channel.los'], str):
        values |= {'channel.los': NO_LOS, 'channel.los_numbers': values['channel.los']}
    for uav in mission.uavs:
        values[f'{uav.name}.propulsion.model'] = PROPULSIONS[uav.propulsion is not None]
    return values


def _flat(data: Mapping[str, Any], prefix: str = '') -> Iterator[tuple[str, Any]]:
    """Yield the values of nested mappings by their names as parameters, lists without levels."""
    for field, value in data.items():
        if isinstance(value, Mapping):
            yield from _flat(value, f'{prefix}{field}.')
        elif value in (None, math.inf):
            yield f'{prefix}{field}', _NOTHING.get(field)
        else:
            yield f'{prefix}{field}', (
                np.ravel(value).tolist() if isinstance(value, tuple) else value)
