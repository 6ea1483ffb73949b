"""The parameters of the nodes that a mission file stands for."""

from collections.abc import Iterable
from itertools import chain
import math
from typing import Any

from .channel_parameters import values_of_channel
from .parameters import NO_LIMIT, PROPULSION_FIELDS, PROPULSIONS, UAV_FIELDS
from ..errors import ParameterError, ScenarioError
from ..mission.scenario import Point, Scenario


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
    values = {
        **{name: getattr(mission, name) for name in (
            'duration', 'slots', 'reference_snr_db', 'separation', 'tracking_margin')},
        'ground_node': list(mission.ground_node), 'geofence': _flat(mission.geofence or ()),
        'uavs': [uav.name for uav in mission.uavs],
        'eavesdroppers': list(mission.eavesdropper_names), 'no_fly_zones': zones}
    values.update(values_of_channel(mission))
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
