"""How close the UAVs of a plan come to each other and to zones, for the planner's status."""

from typing import Any

from ..clearance import CLOSE_DISTANCE
from ..plan import Plan


def approaches_text(plan: Plan) -> str:
    """Return the smallest distances of a plan in words, with a warning where UAVs are close."""
    uavs, zones = plan.clearance.between_uavs, plan.clearance.to_zones
    found = []
    if uavs is not None:
        found.append(f'{uavs.names[0]} and {uavs.names[1]} come within {uavs.distance:.1f} m of '
                     'each other')
        if plan.clearance.is_close:
            found[-1] += (f' at {uavs.time:.1f} s, less than {CLOSE_DISTANCE:g} m; set '
                          'separation to keep them apart')
    if zones is not None:
        found.append(f'{zones.names[0]} comes within {zones.distance:.1f} m of {zones.names[1]}')
    return '; '.join(found)


def approaches_values(plan: Plan) -> dict[str, Any]:
    """Return the smallest distances of a plan as values of the status by key."""
    found: dict[str, Any] = {}
    for key, approach in (('uav_distance', plan.clearance.between_uavs),
                          ('zone_distance', plan.clearance.to_zones)):
        if approach is not None:
            found[f'plan.{key}'] = approach.distance
            found[f'plan.{key}.between'] = ', '.join(approach.names)
            found[f'plan.{key}.time'] = approach.time
    return found
