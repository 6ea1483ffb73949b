"""How close the UAVs of a plan come to each other and to zones, for the planner's status."""

from typing import Any

from ..model.clearance import CLOSE_DISTANCE
from ..plan.plan import Plan


def approaches_text(plan: Plan) -> str:
    """Return the smallest distances of a plan in words, with a warning where UAVs are close."""
    clearance = plan.clearance
    uavs, zones = clearance.between_uavs, clearance.to_zones
    found = []
    if uavs is not None:
        found.append(f'{uavs.names[0]} and {uavs.names[1]} come within {uavs.distance:.1f} m of '
                     f'each other{_left(plan, clearance.uavs_beyond_margin)}')
        if plan.clearance.is_close:
            found[-1] += (f' at {uavs.time:.1f} s, less than {CLOSE_DISTANCE:g} '
                          f'm{plan.scenario.margin_text}; set separation to keep them apart')
    if zones is not None:
        found.append(f'{zones.names[0]} comes within {zones.distance:.1f} m of {zones.names[1]}'
                     f'{_left(plan, clearance.zones_beyond_margin)}')
    return '; '.join(found)


def approaches_values(plan: Plan) -> dict[str, Any]:
    """Return the smallest distances of a plan as values of the status by key."""
    found: dict[str, Any] = {}
    clearance = plan.clearance
    for key, approach, left in (
            ('uav_distance', clearance.between_uavs, clearance.uavs_beyond_margin),
            ('zone_distance', clearance.to_zones, clearance.zones_beyond_margin)):
        if approach is not None:
            found[f'plan.{key}'] = approach.distance
            found[f'plan.{key}.beyond_margin'] = left
            found[f'plan.{key}.between'] = ', '.join(approach.names)
            found[f'plan.{key}.time'] = approach.time
    return found


def _left(plan: Plan, distance: float) -> str:
    """Return in words what is left of a distance beyond the margin, '' without a margin."""
    text = plan.scenario.margin_text
    return text and f' ({distance:.1f} m{text})'
