"""Lemma 9: paths around zones and within the fence, in the bound."""

from dataclasses import replace

from bound_attack import largest_excess, slot_groups
import numpy as np
import pytest
from random_cities import random_city_mission
from secure_uav_planner import Eavesdropper, NoFlyZone, Plan, Scenario, solve, Uav, upper_bound
from secure_uav_planner.bound.method import list_ignored_limits
from secure_uav_planner.bound.proof import certificate, detours
from secure_uav_planner.bound.proof.detours import DetourSearch
from secure_uav_planner.bound.proof.reachable_set import Cells, ReachableSet
from secure_uav_planner.bound.proof.relaxation import EavesdropperSubset, SlotGroups
from secure_uav_planner.bound.proof.terms import Potential
from secure_uav_planner.errors import PlanningError
from secure_uav_planner.model.airspace import Airspace, VisibilityGraph
import shapely
from strategies import with_uavs


def regions_of(scenario, most=10**6):
    groups = SlotGroups.of(scenario.slots, most)
    subset = EavesdropperSubset.of(scenario, 'guaranteed')
    return groups, [ReachableSet.of(scenario, i, groups, subset, around)
                    for i, around in enumerate(DetourSearch(Airspace(scenario)).detours)]


def straight(seed):
    """Return a random city without limits of acceleration."""
    return with_uavs(random_city_mission(seed), max_acceleration=None)


def path_lengths_and_bounds(seed, count=300):
    """Yield the lengths of shortest paths to random places, and their bounds by lemma 9."""
    scenario, rng = straight(seed), np.random.default_rng(seed)
    fence = shapely.Polygon(scenario.geofence).convex_hull
    for i, region in enumerate(regions_of(scenario)[1]):
        graph = VisibilityGraph(Airspace(scenario), i, 1e-3)
        low, high = region.detours.low, region.detours.low + region.detours.size * detours.SIDE
        place = rng.uniform(low, high, (count, 2))
        positions = place * region.unit @ region.axes + region.origin
        within = shapely.contains_xy(fence, positions)
        place, positions = place[within], positions[within]
        bounds = region.detours.lengths[(slice(None), *region.detours.locate(place))] * region.unit
        size = np.hypot(*region.detours.size) * region.unit
        for end, bound in zip((scenario.uavs[i].start, scenario.uavs[i].goal), bounds):
            yield graph.measure_distances(positions, np.array(end)), bound, size


@pytest.mark.parametrize('seed', range(12))
def test_no_path_is_shorter_than_its_bound(seed):
    for exact, bound, size in path_lengths_and_bounds(seed):
        assert (bound <= exact + 1e-6).all()
        # The bound is tight.
        finite = np.isfinite(exact) & np.isfinite(bound)
        assert finite.mean() > 0.1
        assert np.quantile(exact[finite] - bound[finite], 0.9) < 2 * size


def test_no_place_within_a_zone_or_beyond_the_fence_is_reached():
    scenario = straight(4)
    groups, (region, _) = regions_of(scenario)
    zones = shapely.union_all([shapely.Polygon(zone.vertices) for zone in scenario.no_fly_zones
                               if zone.floor <= scenario.uavs[0].altitude <= zone.ceiling])
    fence = shapely.Polygon(scenario.geofence)
    places = np.random.default_rng(1).uniform(-900, 900, (4000, 2))
    points = shapely.points(places)
    # A cell of which a part is free counts as free.
    cell = np.hypot(*region.detours.size) * region.unit
    blocked = shapely.contains(zones.buffer(-cell), points) | ~shapely.contains(
        fence.convex_hull.buffer(cell), points)
    assert blocked.sum() > 100
    slot = np.full(blocked.sum(), len(groups.count) // 2)
    assert not region.contains(region.local(places[blocked]), slot).any()


@pytest.mark.parametrize('seed', range(10))
def test_flights_stay_in_their_reachable_sets(seed):
    scenario = random_city_mission(seed, slots=40)
    rng = np.random.default_rng(seed)
    # Not all begin and end at rest.
    scenario = replace(scenario, uavs=tuple(
        replace(uav, start_velocity=velocity, goal_velocity=velocity)
        if uav.max_acceleration is not None else uav
        for uav, velocity in zip(scenario.uavs, ((0.0, 0.0), None, tuple(rng.normal(0, 2, 2))))))
    try:
        plan = solve(scenario, objective='guaranteed', time_limit=20.0)
    except PlanningError:
        pytest.skip('this mission has no plan')
    for most in (40, 7):
        groups, regions = regions_of(scenario, most)
        for region, positions in zip(regions, plan.positions):
            assert region.contains(region.local(positions[1:-1]), slot_groups(groups)).all()


@pytest.mark.parametrize('before, signs, after, low, high', [
    (None, [1] * 6, None, -11.0, 131.0), (1, [1] * 6, None, -11.0, 131.0),
    (None, [1] * 6, 1, -11.0, 131.0), (1, [-1, -1, -1, 1, 1, 1], -1, -55.0, 0.01)])
def test_a_flight_at_all_its_limits_stays_in_its_reachable_set(before, signs, after, low, high):
    """The flight is along the fence. Its points may be inside a wall that its curve avoids."""
    step, ts = 20.0, 2.0
    x = np.cumsum([0.0, *(step * np.array(signs))])
    velocities = [sign and (sign * step / ts, 0.0) for sign in (before, after)]
    uav = Uav('uav1', (0.0, 0.0), (x[-1], 0.0), 100.0, step / ts, 1.0, 1.0,
              2 * step / ts**2 if before or after else None, *velocities)
    scenario = Scenario(
        (0.0, -99.0), (Eavesdropper((300.0, 0.0)),), (uav,), 5 * ts, 5,
        geofence=((-400, -200), (400, -200), (400, 0), (-400, 0)),
        no_fly_zones=tuple(NoFlyZone(((begin, -90), (end, -90), (end, 9), (begin, 9)), name=name)
                           for name, begin, end in (('low', low - 99, low),
                                                    ('high', high, high + 99))))
    path = np.stack([x, 0.0 * x], -1)
    plan = Plan(scenario, path[None], np.ones((1, 5)))
    groups, [region] = regions_of(scenario)
    assert region.contains(region.local(plan.positions[0, 1:-1]), np.arange(5)).all()


def test_the_cells_of_detours_cover_all_that_the_discs_allow():
    rng = np.random.default_rng(0)
    for region in (region for seed in range(3) for region in regions_of(straight(seed))[1]):
        around = region.detours
        high = around.low + detours.SIDE * around.size
        rectangle = replace(region, detours=None).bounding_box
        assert (around.low <= rectangle[0]).all() and (rectangle[1] <= high).all()
        places = rng.uniform(around.low, high, (10**4, 2))
        offset = places - around.find_centre(np.stack(around.locate(places), -1))
        assert (np.abs(offset) <= 0.5001 * around.size).all()


def courtyard(gap):
    """Return a mission whose transmitter begins between four walls, perhaps with a gap."""
    walls = [((-60, -60), (60, -60), (60, -50), (-60, -50)),
             ((-60, 50), (60, 50), (60, 60), (-60, 60)),
             ((-60, -60), (-50, -60), (-50, 60), (-60, 60)),
             ((50, -60), (60, -60), (60, 60 - gap), (50, 60 - gap))]
    return Scenario((0.0, 0.0), (Eavesdropper((300.0, 0.0), 10.0),), (
        Uav('uav1', (0.0, 0.0), (0.0, 30.0), 100.0, 20.0, 1.0, 4.0),), 60.0, 60, 80.0,
        no_fly_zones=tuple(NoFlyZone(wall, name=f'wall {n}') for n, wall in enumerate(walls)))


def test_a_courtyard_is_left_by_its_gap_or_not_at_all():
    for gap, beyond in ((0, False), (20, True)):
        (region,) = regions_of(courtyard(gap))[1]
        there = region.detours.lengths[0]
        inner = there[region.detours.locate(region.local(np.array([-40.0, 40.0])))] * region.unit
        assert inner == pytest.approx(np.hypot(40, 40), abs=40)
        outer = there[region.detours.locate(region.local(np.array([100.0, -100.0])))] * region.unit
        assert np.isfinite(outer) == beyond
        if beyond:
            # Around the corner of the wall with the gap.
            assert outer > np.hypot(50, 40) + np.hypot(40, 140) - 40


def halve_zones(scenario):
    """Return a mission of which every zone is cut into pieces that touch."""
    pieces = []
    for zone in scenario.no_fly_zones:
        polygon = shapely.Polygon(zone.vertices)
        left, low, right, high = polygon.bounds
        middle = polygon.centroid.x
        for box in ((left, low, middle, high), (middle, low, right, high)):
            for piece in shapely.get_parts(polygon.intersection(shapely.box(*box))):
                pieces.append(replace(zone, vertices=tuple(piece.exterior.coords[:-1]),
                                      name=f'piece {len(pieces)}'))
    return replace(scenario, no_fly_zones=tuple(pieces))


def narrow_fence():
    """
    Return a mission with a fence and a zone whose outlines are difficult.

    The fence is bent and 0.7 m wide, so that the extension of its pocket closes around it. The
    zone has a convex part that is sharp where the zone is not.
    """
    fence = (-100, 100), (0, 0), (100, 100), (99, 100), (0, 1), (-99, 100)
    zone = (43, -94), (33, -58), (-23, -15), (-66, -120), (-13, -125), (6, -109)
    return Scenario((0.0, 0.5), (Eavesdropper((300.0, 0.0), 10.0),), (
        Uav('uav1', (-50.0, 50.5), (50.0, 50.5), 100.0, 20.0),), 60.0, 60, geofence=fence,
        no_fly_zones=(NoFlyZone(zone),))


@pytest.mark.parametrize('scenario', [narrow_fence(), *(
    halve_zones(random_city_mission(seed)) for seed in range(8))], ids=range(9))
def test_the_polygon_to_go_around_is_a_little_smaller_than_the_obstacles(scenario):
    """A plan may fly along the line between two zones that touch, so this line is free."""
    airspace, fence = Airspace(scenario), shapely.Polygon(scenario.geofence)
    outside = fence.convex_hull.buffer(10.0).difference(fence)
    for altitude, parts in DetourSearch(airspace)._parts.items():
        zones = [shapely.Polygon(vertices) for vertices, name
                 in scenario.boundaries.keep_out(altitude) if name not in airspace.far]
        largest, smallest = (
            shapely.union_all([solid.buffer(-less, join_style='mitre') for solid in solids])
            for less, solids in ((5e-4, [*zones, outside]),
                                 (2e-3, [*zones, fence.convex_hull.difference(fence)])))
        assert shapely.union_all(parts).difference(largest).is_empty
        assert smallest.difference(shapely.union_all(parts)).is_empty


@pytest.mark.parametrize('seed', [63, 6])
def test_no_rectangle_loses_a_place_that_can_be_reached(seed):
    """A place may be at a corner of its rectangle, and on the lines between cells of detours."""
    groups, (region, *_) = regions_of(straight(seed), 10)
    rng, count, size = np.random.default_rng(seed), 2000, region.detours.size
    group = rng.integers(0, 10, count)
    places = rng.uniform(*(corner[group] for corner in region.bounding_box))
    cell = (places - region.detours.low) / size
    places = region.detours.low + size * np.where(rng.random((count, 2)) < 0.3, cell.round(), cell)
    reached = region.contains(places, group)
    places, group = places[reached], group[reached]
    half = size * rng.choice([0.0, 0.3, 4.0], (len(places), 2))
    share = rng.choice([0.0, 0.5, 1.0], half.shape)
    cells = Cells(group, places - 2 * share * half, places + 2 * (1 - share) * half)
    potential = Potential(np.cumsum(rng.normal(0, 1, (11, 2)), 0), np.zeros((11, 3)),
                          np.zeros((11, 2)), groups, region)
    bounds = certificate.bound_silence(
        potential, cells, np.arange(len(group)), np.full(len(group), -np.inf), bool)
    values = (places * potential.change[0][group]).sum(-1) + potential.constant()[group]
    assert len(group) > 100 and (bounds >= values).all()


def excess(seed):
    """Return the largest excess of climbing points over a group's bound in a random city."""
    return largest_excess(solve(random_city_mission(seed, slots=30), objective='guaranteed'))


@pytest.mark.parametrize('seed', [63, 6, 68])
def test_no_reachable_place_exceeds_a_slots_bound(seed):
    assert excess(seed) <= 0


@pytest.mark.parametrize('seed, most', [(63, 1.03), (6, 1.03), (7, 1.02), (4, 1.02), (68, 1.05)])
def test_zones_and_fence_make_the_bound_tighter(seed, most, monkeypatch):
    scenario = random_city_mission(seed)
    plan = solve(scenario, objective='guaranteed')
    bound = upper_bound(scenario, objective='guaranteed', plan=plan)
    assert plan.rate <= bound.rate <= most * plan.rate
    monkeypatch.setattr(detours, '_find_detours', lambda *_: None)
    assert bound.rate < upper_bound(scenario, objective='guaranteed', plan=plan).rate


def test_zones_of_too_many_corners_are_listed_as_ignored(monkeypatch):
    scenario = random_city_mission(63)
    airspace = Airspace(scenario)
    assert list_ignored_limits(DetourSearch(airspace)) == ('separation',)
    monkeypatch.setattr(detours, 'MOST_CORNERS', 20)
    assert list_ignored_limits(DetourSearch(airspace)) == (
        'separation', 'no_fly_zones', 'geofence')
    bound = upper_bound(scenario, objective='guaranteed')
    assert bound.ignored == ('separation', 'no_fly_zones', 'geofence')
    assert bound.rate > 1.1 * solve(scenario, objective='guaranteed').rate


def test_zones_that_are_ignored_at_one_altitude_are_listed_as_ignored(monkeypatch):
    search = DetourSearch(Airspace(random_city_mission(1)))
    fewest, most = sorted(
        shapely.get_num_coordinates(parts).sum() for parts in search._parts.values())
    monkeypatch.setattr(detours, 'MOST_CORNERS', fewest)
    assert fewest < most and not search.is_complete
    assert len({around is None for around in search.detours}) == 2


# -- deliberate errors

def lengthen(*args, right=detours.bound_path_lengths):
    return 1.02 * right(*args)


def enlarge_shadows(*args, right=detours._cast_shadow):
    return right(*args).buffer(5.0)


def leave_out_corners(array, axis=None, right=np.unique, **options):
    return right(array, axis=axis, **options)[:: 1 if axis is None else 2]


@pytest.mark.parametrize('owner, name, wrong', [
    (detours, 'bound_path_lengths', lengthen), (detours, '_cast_shadow', enlarge_shadows),
    (np, 'unique', leave_out_corners)])
def test_lengths_that_are_too_long_are_noticed(monkeypatch, owner, name, wrong):
    monkeypatch.setattr(owner, name, wrong)
    assert any((bound > exact + 1e-6).any() for seed in range(4)
               for exact, bound, _ in path_lengths_and_bounds(seed))


def test_a_bound_of_silence_that_is_too_small_is_noticed(monkeypatch):
    right = certificate.bound_silence
    monkeypatch.setattr(certificate, 'bound_silence', lambda *args: right(*args) - 3.0)
    assert excess(9) > 0
