from dataclasses import replace
from itertools import combinations
import math

from hypothesis import given, settings
from hypothesis import strategies as st
import numpy as np
import pytest
from random_cities import random_polygon
from secure_uav_planner import Eavesdropper, NoFlyZone, Plan, Scenario, Uav
from secure_uav_planner.errors import PlanError
from secure_uav_planner.model.airspace.clearance import Clearance, least_distance, Pieces
from secure_uav_planner.model.curve import Curve
import shapely
from strategies import with_uavs

SAMPLES = 2001


def random_zone(rng, low=-300, high=300):
    """Return the vertices of a polygon that need not be convex."""
    return random_polygon(rng, rng.uniform(low, high, 2), 120.0, 8)


def random_flights(seed, count=3, slots=8):
    """Return a scenario and random points of flights, which keep no limit of it."""
    rng = np.random.default_rng(seed)
    positions = rng.uniform(-300, 300, (1, slots + 2, 2)) + rng.uniform(
        -100, 100, (count, slots + 2, 2))
    uavs, limit = [], None if rng.random() < 0.4 else 1000.0
    for number in range(count):
        velocities = [None if rng.random() < 0.3 else tuple(rng.uniform(-50, 50, 2).tolist())
                      if rng.random() < 0.5 else (0.0, 0.0) for _ in range(2)]
        uavs.append(Uav(f'uav{number}', *map(tuple, positions[number, [0, -1]].tolist()),
                        50.0 + 10 * float(rng.integers(3)), 2000.0, max_acceleration=limit,
                        start_velocity=velocities[0], goal_velocity=velocities[1]))
    return Scenario((0, 0), (Eavesdropper((100, 100)),), tuple(uavs), 4.0 * slots,
                    slots), positions


def sample_curve(scenario, positions):
    """Return the curve, and the positions of all UAVs at SAMPLES times."""
    curve = Curve(scenario, positions)
    times = np.linspace(curve.begin, curve.end, SAMPLES)
    return curve, curve.at(times).positions


@given(st.integers(0, 10**6))
def test_the_smallest_distance_between_uavs_is_that_of_dense_samples(seed):
    scenario, positions = random_flights(seed)
    scenario = with_uavs(scenario, start_velocity=(0.0, 0.0), goal_velocity=(0.0, 0.0))
    curve, places = sample_curve(scenario, positions)
    nearest = Clearance(scenario, curve).between_uavs
    names = [uav.name for uav in scenario.uavs]
    dense = {}
    for i, j in combinations(range(len(names)), 2):
        height = scenario.altitudes[i] - scenario.altitudes[j]
        dense[names[i], names[j]] = np.hypot(
            np.linalg.norm(places[i] - places[j], axis=-1), height).min()
    assert nearest.distance <= min(dense.values()) + 1e-9
    # Between two samples a UAV flies at most this far.
    step = np.linalg.norm(np.diff(places, axis=1), axis=-1).max()
    assert nearest.distance >= min(dense.values()) - 2 * step
    first, second = map(names.index, nearest.names)
    there = curve.at([nearest.time]).positions[:, 0]
    assert math.dist((*there[first], scenario.altitudes[first]),
                     (*there[second], scenario.altitudes[second])) == pytest.approx(
        nearest.distance, abs=1e-7)


@settings(max_examples=40)
@given(st.integers(0, 10**6))
def test_the_smallest_distance_to_a_zone_is_that_of_dense_samples(seed):
    scenario, positions = random_flights(seed)
    rng = np.random.default_rng(seed)
    zones = tuple(NoFlyZone(random_zone(rng, 250, 600), floor=float(rng.choice([0, 60])),
                            ceiling=float(rng.choice([60, 100])), name=name) for name in 'abc')
    ends = shapely.MultiPoint([place for uav in scenario.uavs for place in (uav.start, uav.goal)])
    zones = tuple(zone for zone in zones
                  if not shapely.Polygon(zone.vertices).intersects(ends))
    scenario = replace(scenario, no_fly_zones=zones)
    curve, places = sample_curve(scenario, positions)
    nearest = Clearance(scenario, curve).to_zones
    dense = [shapely.distance(shapely.Polygon(zone.vertices).exterior, shapely.points(path)).min()
             for uav, path in zip(scenario.uavs, places) for zone in zones
             if zone.is_at(uav.altitude)]
    if not dense:
        assert nearest is None
        return
    assert nearest.distance <= min(dense) + 1e-9
    step = np.linalg.norm(np.diff(places, axis=1), axis=-1).max()
    assert nearest.distance >= min(dense) - step
    uav = [uav.name for uav in scenario.uavs].index(nearest.names[0])
    zone = next(zone for zone in zones if zone.name == nearest.names[1])
    there = shapely.Point(curve.at([nearest.time]).positions[uav, 0])
    assert shapely.Polygon(zone.vertices).exterior.distance(there) == pytest.approx(
        nearest.distance, abs=1e-7)


@settings(max_examples=40)
@given(st.integers(0, 10**6))
def test_a_flight_is_refused_if_and_only_if_dense_samples_break_a_limit(seed):
    scenario, positions = random_flights(seed, count=2, slots=4)
    rng = np.random.default_rng(seed)
    ends = shapely.MultiPoint([place for uav in scenario.uavs for place in (uav.start, uav.goal)])
    low, high = positions.min(axis=(0, 1)) - 30, positions.max(axis=(0, 1)) + 30
    box = shapely.box(*low, *high)
    zones = [zone for zone in (random_zone(rng) for _ in range(seed % 3))
             if not shapely.Polygon(zone).buffer(1).intersects(ends)]
    fence = box.difference(shapely.Polygon(random_zone(rng))) if rng.random() < 0.5 else box
    if fence.geom_type != 'Polygon' or fence.interiors or not fence.buffer(-1).contains(ends):
        fence = box
    scenario = replace(scenario, no_fly_zones=tuple(map(NoFlyZone, zones)),
                       geofence=tuple(fence.exterior.coords[:-1]))
    curve, places = sample_curve(scenario, positions)
    fast = np.linalg.norm(np.diff(places, axis=1), axis=-1).max()
    worst = -math.inf  # How deep in a forbidden place.
    for path in places:
        points = shapely.points(path)
        for zone in zones:
            polygon = shapely.Polygon(zone)
            worst = max(worst, _depths(polygon, points).max())
        worst = max(worst, -_depths(fence, points).min())
    try:
        Clearance(scenario, curve).validate()
    except PlanError as error:
        assert worst > -fast
        text = str(error)
        uav = text.split(' ')[0]
        depth, at = float(text.split(' is ')[1].split(' m')[0]), float(
            text.split(' s after')[0].rpartition(' ')[2])
        there = shapely.points(
            curve.at([at]).positions[[each.name for each in scenario.uavs].index(uav), 0])
        expected = (-_depths(fence, there) if 'geofence' in text else _depths(
            shapely.Polygon(scenario.no_fly_zones[int(text.split('zone ')[1][0]) - 1].vertices),
            there))
        assert expected == pytest.approx(depth, abs=1e-2) and depth > 0
    else:
        assert worst <= 1e-6


def _depths(polygon, points):
    distance = shapely.distance(polygon.exterior, points)
    return np.where(shapely.contains(polygon, points), distance, -distance)


@given(st.integers(0, 10**6), st.sampled_from([0.0, 1e-9, 1e-3, 1.0]))
def test_the_least_distance_of_quadratic_motion_is_exact(seed, bend):
    rng = np.random.default_rng(seed)
    position, velocity, acceleration = rng.normal(0, 1, (3, 20, 2)) * [[[1]], [[3]], [[bend]]]
    if seed % 3 == 0:
        velocity[:] = 0
    if seed % 5 == 0:
        acceleration = velocity * -bend
    least, by = least_distance(Pieces(np.zeros(20), 0.5, position, velocity, acceleration))
    times = np.linspace(-0.5, 0.5, 20001)[:, None, None]
    paths = position + velocity * times + acceleration * times**2 / 2
    dense = np.linalg.norm(paths, axis=-1).min(axis=0)
    assert (least <= dense + 1e-12).all() and (least >= dense - 1e-3).all()
    there = position + velocity * by[:, None] + acceleration * by[:, None]**2 / 2
    assert np.linalg.norm(there, axis=-1) == pytest.approx(least)


def passing_plan(offset, separation, uavs=2):
    """Return a plan in which two UAVs pass each other in the middle of a slot."""
    uavs = (Uav('east', (0.0, 0.0), (30.0, 0.0), 50.0, 100.0),
            Uav('west', (30.0, offset), (0.0, offset), 53.0, 100.0))[:uavs]
    scenario = Scenario((0, 0), (Eavesdropper((0, 0)),), uavs, 2.0, 2, separation=separation)
    paths = np.linspace(scenario.starts, scenario.goals, 4, axis=1)
    return Plan(scenario, paths, np.zeros((len(uavs), 2)))


def test_uavs_that_pass_too_close_between_points_are_refused():
    plan = passing_plan(4.0, 0.0)
    assert plan.clearance.between_uavs == (
        pytest.approx(5.0), pytest.approx(1.5), ('east', 'west'))
    assert passing_plan(4.0, 5.0) and passing_plan(4.0, 5.0 + 0.9e-6)
    with pytest.raises(PlanError, match=r'east and west are 5\d* m apart 1.5 s after point 0; '
                                        'separation is 5.1 m'):
        passing_plan(4.0, 5.1)


@pytest.mark.parametrize('depth, is_refused', [(0.9e-6, False), (2e-6, True)])
@pytest.mark.parametrize('limit', ['no_fly_zones', 'geofence'])
def test_a_flight_may_be_in_a_zone_or_beyond_the_fence_by_the_tolerance(limit, depth, is_refused):
    plan = passing_plan(4.0, 0.0, uavs=1)  # Along y = 0.
    area = ((10.0, -50.0), (20.0, -50.0), (20.0, depth), (10.0, depth))
    fence = ((-50.0, 50.0), (-50.0, -50.0), area[0], area[3], area[2], area[1], (80.0, -50.0),
             (80.0, 50.0))
    scenario = replace(plan.scenario, **{
        limit: (NoFlyZone(area),) if limit == 'no_fly_zones' else fence})
    if is_refused:
        with pytest.raises(PlanError, match='is 2e-06 m'):
            replace(plan, scenario=scenario)
    else:
        assert replace(plan, scenario=scenario).clearance


def test_a_single_uav_without_zones_has_no_clearances():
    clearance = passing_plan(4.0, 0.0, uavs=1).clearance
    assert clearance.between_uavs is None and clearance.to_zones is None


def test_the_largest_plan_can_be_checked():
    rng = np.random.default_rng(1)
    slots, count = 20000, 3
    turn = np.linspace(0, 40 * math.pi, slots + 2)
    positions = np.array([[300 * np.cos(turn) + 700 * number, 300 * np.sin(turn)]
                          for number in range(count)]).swapaxes(1, 2) + rng.normal(
        0, 0.01, (count, slots + 2, 2))
    uavs = tuple(Uav(f'uav{number}', *map(tuple, path[[0, -1]].tolist()), 50.0, 100.0,
                     max_acceleration=1000.0) for number, path in enumerate(positions))
    zones = tuple(NoFlyZone(tuple(
        (x + 20 * math.cos(at), y + 20 * math.sin(at)) for at in np.linspace(0, 6, 8)))
        for x, y in rng.uniform(-150, 150, (64, 2)))
    scenario = Scenario((0, 0), (Eavesdropper((0, 0)),), uavs, float(slots), slots,
                        separation=1.0, no_fly_zones=zones, geofence=(
                            (-1e4, -1e4), (1e4, -1e4), (1e4, 1e4), (-1e4, 1e4)))
    clearance = Clearance(scenario, Curve(scenario, positions))
    clearance.validate()
    assert clearance.to_zones.distance > 0
