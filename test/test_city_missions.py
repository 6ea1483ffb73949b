"""Random missions with all limits at once, checked by dense sampling of the flown curves."""

from dataclasses import replace

import numpy as np
import pytest
from secure_uav_planner import fly_hover_fly, solve
from secure_uav_planner.bench.missions import random_city_mission
from secure_uav_planner.errors import InfeasibleMissionError
import shapely

SAMPLES = 40  # In a slot.
TOLERANCE = 1e-4  # m


def curve(uav, path, step):
    """Return the places that a UAV flies through at many times from -1/2 to N+3/2 slots."""
    last = len(path) - 1
    times = np.linspace(-0.5, last + 0.5, SAMPLES * (last + 1) + 1)
    if uav.max_acceleration is None:
        inside = np.clip(times, 0, last)
        return np.stack([np.interp(inside, np.arange(last + 1), x) for x in path.T], axis=-1)
    first = path[0] - (path[1] - path[0] if uav.start_velocity is None
                       else np.array(uav.start_velocity) * step)
    beyond = path[-1] + (path[-1] - path[-2] if uav.goal_velocity is None
                         else np.array(uav.goal_velocity) * step)
    points = np.concatenate([[first], path, [beyond]])
    node = np.clip(np.round(times), 0, last).astype(int)
    by = (times - node)[:, None]
    # The three basis functions of a uniform quadratic B-spline.
    return (0.5 * (0.5 - by)**2 * points[node] + (0.75 - by**2) * points[node + 1]
            + 0.5 * (0.5 + by)**2 * points[node + 2])


def check_flown(plan):
    """Assert all limits of flights of a plan at many times."""
    scenario = plan.scenario
    step = scenario.slot_duration
    curves = [curve(uav, path, step) for uav, path in zip(scenario.uavs, plan.positions)]
    seconds = step / SAMPLES
    for uav, places in zip(scenario.uavs, curves):
        speed = np.linalg.norm(np.diff(places, axis=0), axis=1) / seconds
        assert speed.max() <= uav.max_speed * (1 + 1e-6) + TOLERANCE / seconds * 1e-3
        if uav.max_acceleration is not None:
            change = np.linalg.norm(np.diff(places, n=2, axis=0), axis=1) / seconds**2
            assert change.max() <= uav.max_acceleration * 1.001 + 1e-6 / seconds**2
        points = shapely.points(places)
        for zone in scenario.no_fly_zones:
            if zone.floor <= uav.altitude <= zone.ceiling:
                depth = shapely.contains(shapely.Polygon(zone.vertices).buffer(-TOLERANCE), points)
                assert not depth.any(), f'{uav.name} enters {zone.name}'
        if scenario.geofence is not None:
            fence = shapely.Polygon(scenario.geofence).buffer(TOLERANCE)
            assert shapely.contains(fence, points).all(), f'{uav.name} leaves the fence'
    for index, one in enumerate(curves):
        for other in range(index):
            apart = np.hypot(np.linalg.norm(one - curves[other], axis=1),
                             scenario.uavs[index].altitude - scenario.uavs[other].altitude)
            assert apart.min() >= scenario.separation - TOLERANCE, 'too close'


def fly(seed, method='joint', slots=None, objective='guaranteed'):
    """Return the plan of a mission, checked, and its baseline, or a refusal."""
    scenario = random_city_mission(seed, slots)
    try:
        baseline = fly_hover_fly(scenario, 'optimised')
    except InfeasibleMissionError as error:
        return error, None
    check_flown(baseline)
    plan = solve(scenario, method, objective=objective)
    check_flown(plan)
    assert plan.guaranteed_rate >= baseline.guaranteed_rate - 1e-7, (
        seed, plan.guaranteed_rate, baseline.guaranteed_rate)
    return plan, baseline


@pytest.mark.parametrize('seed', range(6))
def test_a_plan_with_all_limits_keeps_them_all_the_time_and_is_not_below_its_baseline(seed):
    found, _ = fly(seed, slots=60)
    assert not isinstance(found, InfeasibleMissionError)


def longer(scenario, factor):
    return replace(scenario, duration=factor * scenario.duration)
