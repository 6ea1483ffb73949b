"""A plan as missions of QGroundControl, one for each UAV."""

from collections.abc import Iterator
import json
import math
import os
from typing import Any

import numpy as np

from .geodesy import Origin
from ..mission.files import atomic_file
from ..model.clearance import CLOSE_DISTANCE
from ..plan.plan import Plan

TOLERANCE = 1.0
"""How far in m a mission may be from the plan at any time: several points become one leg."""

_TAKE_OFF, _WAYPOINT, _CHANGE_SPEED, _LAND = 22, 16, 178, 21  # Commands of MAVLink.
_RELATIVE_ALTITUDE, _NO_FRAME = 3, 2  # Frames of MAVLink.
_PX4, _QUADROTOR = 12, 2


def save_mission(plan: Plan, uav: int, origin: Origin, path: str | os.PathLike[str]) -> None:
    """
    Write the flight of a UAV, by index, as a `.plan` file of QGroundControl.

    A mission has no times: each leg has the speed that takes it to its end in time, and where the
    UAV hovers it is held. So the flight follows the plan within TOLERANCE if the autopilot
    reaches each speed at once; it is less exact than streamed setpoints. Powers are not part of
    it. It takes off and lands where no other UAV starts or ends within CLOSE_DISTANCE and margins;
    otherwise it begins, or ends, in the air. Zones at the UAV's altitude and the geofence become
    the mission's fence. The origin is that of the scenario, at the height of the ground node.
    """
    with atomic_file(path) as file:
        json.dump(mission(plan, uav, origin), file, indent=2, allow_nan=False)


def mission(plan: Plan, uav: int, origin: Origin) -> dict[str, Any]:
    """Return what save_mission writes, as plain values."""
    member = plan.scenario.uavs[uav]
    first = _TAKE_OFF if _is_apart(plan, uav, 'start') else _WAYPOINT
    items = [_item(first, origin, member.start, member.altitude)]
    for place, speed, hold in legs(plan, uav):
        if speed is not None:
            items.append(_speed(speed))
        items.append(_item(_WAYPOINT, origin, place, member.altitude, hold))
    if _is_apart(plan, uav, 'goal'):
        items.append(_item(_LAND, origin, member.goal, 0.0))
    for number, item in enumerate(items, start=1):
        item['doJumpId'] = number
    home = origin.coordinates(member.start).tolist()
    return {
        'fileType': 'Plan', 'groundStation': 'QGroundControl', 'version': 1,
        'geoFence': {'circles': [], 'polygons': _fence(plan, uav, origin), 'version': 2},
        'rallyPoints': {'points': [], 'version': 2},
        'mission': {
            'version': 2, 'firmwareType': _PX4, 'vehicleType': _QUADROTOR,
            'globalPlanAltitudeMode': 1, 'cruiseSpeed': member.max_speed,
            'hoverSpeed': member.max_speed, 'plannedHomePosition': [*home, origin.altitude],
            'items': items}}


def _is_apart(plan: Plan, uav: int, end: str) -> bool:
    """Return whether no other UAV starts, or ends, where this one would take off, or land."""
    least = CLOSE_DISTANCE + 2 * plan.scenario.tracking_margin
    places = [getattr(one, end) for one in plan.scenario.uavs]
    return all(math.dist(places[uav], place) >= least
               for number, place in enumerate(places) if number != uav)


def legs(plan: Plan, uav: int) -> Iterator[tuple[tuple[float, float], float | None, float]]:
    """
    Yield the legs of a flight: where each ends, its speed in m/s, and how long to stay there.

    A leg goes on as long as a UAV that flies it straight and with one speed is within TOLERANCE
    of the plan at all times of points. Legs that hardly move have no speed, and their time in s.
    """
    times = np.unique([plan.curve.begin, *plan.times, plan.curve.end])
    path = plan.curve.at(times).positions[uav]
    first = 0
    while first < len(times) - 1:
        last = _end_of_leg(times, path, first)
        length = float(np.linalg.norm(path[last] - path[first]))
        lasting = float(times[last] - times[first])
        place = (float(path[last, 0]), float(path[last, 1]))
        yield (place, None, lasting) if length <= TOLERANCE else (place, length / lasting, 0.0)
        first = last


def _end_of_leg(times: np.ndarray, path: np.ndarray, first: int) -> int:
    """Return the last point that a leg from a point can have: found by doubling, then halving."""
    good, step = first + 1, 1
    while good < len(times) - 1 and step:
        tried = min(good + step, len(times) - 1)
        if _is_straight(times, path, first, tried):
            good, step = tried, 2 * step
        else:
            step //= 2
    return good


def _is_straight(times: np.ndarray, path: np.ndarray, first: int, last: int) -> bool:
    """Return whether the points between two are near a straight flight of one speed."""
    part = slice(first, last + 1)
    share = ((times[part] - times[first]) / (times[last] - times[first]))[:, None]
    straight = path[first] + share * (path[last] - path[first])
    return bool(np.linalg.norm(path[part] - straight, axis=1).max() <= TOLERANCE)


def _item(command: int, origin: Origin, place: tuple[float, float], altitude: float,
          hold: float = 0.0) -> dict[str, Any]:
    """Return a command with a place; the hold in s is the first of its parameters."""
    latitude, longitude = origin.coordinates(place).tolist()
    return {'type': 'SimpleItem', 'autoContinue': True, 'command': command,
            'frame': _RELATIVE_ALTITUDE, 'AltitudeMode': 1, 'Altitude': altitude,
            'AMSLAltAboveTerrain': origin.altitude + altitude,  # Some versions refuse a null.
            'params': [hold, 0, 0, None, latitude, longitude, altitude]}


def _speed(speed: float) -> dict[str, Any]:
    """Return the command that sets the ground speed in m/s."""
    return {'type': 'SimpleItem', 'autoContinue': True, 'command': _CHANGE_SPEED,
            'frame': _NO_FRAME, 'params': [1, speed, -1, 0, 0, 0, 0]}


def _fence(plan: Plan, uav: int, origin: Origin) -> list[dict[str, Any]]:
    """Return the polygons that the UAV may not leave, or not enter at its altitude."""
    scenario = plan.scenario
    polygons = [(scenario.geofence, True)] if scenario.geofence is not None else []
    polygons += [(zone.vertices, False) for zone in scenario.no_fly_zones
                 if zone.is_at(scenario.uavs[uav].altitude)]
    return [{'inclusion': inclusion, 'version': 1,
             'polygon': origin.coordinates(vertices).tolist()} for vertices, inclusion in polygons]
