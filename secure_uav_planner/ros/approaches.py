"""How close the UAVs of a plan come to each other and to zones, for the planner's status."""

from typing import Any

from ..plan.plan import Plan


def approaches_text(plan: Plan) -> str:
    """Return the smallest distances of a plan in words, with a warning where UAVs are close."""
    clearance = plan.clearance
    zones, margin = clearance.to_zones, plan.scenario.margin_text
    found = [clearance.between_uavs_text]
    if zones is not None:
        left = margin and f' ({clearance.zones_beyond_margin:.1f} m{margin})'
        found.append(f'{zones.names[0]} comes within {zones.distance:.1f} m of {zones.names[1]}'
                     f'{left}')
    return '; '.join(filter(None, found))


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
