"""The margin for the errors of vehicles: its offset of zones, fence and separation."""

from dataclasses import replace

from hypothesis import example, given
from hypothesis import strategies as st
import numpy as np
import pytest
from random_cities import random_polygon
from secure_uav_planner import NoFlyZone, Plan, Scenario, Uav
from secure_uav_planner.errors import PlanError, ScenarioError
from secure_uav_planner.mission.polygons import checked_polygon, offset_polygon
from secure_uav_planner.model.airspace import Airspace
import shapely
from strategies import SEEDS

SPIKE = ((0.0, 0.0), (100.0, 0.0), (0.0, 5.0))
SQUARE = ((0.0, 0.0), (20.0, 0.0), (20.0, 20.0), (0.0, 20.0))
# A margin of 5 m closes its gap.
COURT = ((0, 0), (90, 0), (90, 90), (48, 90), (48, 80), (80, 80), (80, 10), (10, 10), (10, 80),
         (42, 80), (42, 90), (0, 90))


@st.composite
def outlines(draw):
    """Return the vertices of a polygon of any shape and size, anywhere."""
    rng = np.random.default_rng(draw(SEEDS))
    centre = rng.uniform(-1, 1, 2) * 10**rng.uniform(0, 5)
    return checked_polygon(random_polygon(rng, centre, 10**rng.uniform(0, 3)))


margins = st.floats(-3, 3).map(lambda power: 10**power)


@example(SPIKE, 1.0)
@example(COURT, 5.0)
@given(outlines(), margins)
def test_an_outward_offset_contains_all_places_within_the_margin_and_few_more(vertices, margin):
    polygon = shapely.Polygon(vertices)
    [outline] = offset_polygon(vertices, margin)
    shape = shapely.Polygon(outline)
    assert shape.is_valid and shape.contains(polygon)
    assert shapely.distance(shape.exterior, polygon) >= margin - 1e-6
    corners = shapely.points(outline)
    assert shapely.distance(corners, polygon).max() <= 1.81 * margin + 1e-6


@example(COURT, 4.0)
@example(SQUARE, 10.0)
@given(outlines(), margins)
def test_an_inward_offset_keeps_the_margin_and_loses_little_more(vertices, margin):
    polygon = shapely.Polygon(vertices)
    for outline in offset_polygon(vertices, -margin):
        shape = shapely.Polygon(outline)
        assert shape.is_valid and polygon.contains(shape)
        assert shapely.distance(shape.exterior, polygon.exterior) >= margin - 1e-6
    # All places inside by the mitred corners' distance are left.
    left = shapely.union_all([*map(shapely.Polygon, offset_polygon(vertices, -margin))])
    assert polygon.buffer(-1.81 * margin - 1e-6).difference(left.buffer(1e-6)).area < 1e-6


def test_a_margin_offsets_zones_in_height_as_well_and_the_separation_twice():
    paper = Scenario.paper()
    scenario = replace(
        paper, separation=2.0, tracking_margin=3.0,
        geofence=((-200, -600), (400, -600), (400, 600), (-200, 600)),
        no_fly_zones=(NoFlyZone(SQUARE, 113.0, name='high'), NoFlyZone(SQUARE, 0.0, 96.5)))
    assert [[piece.name for piece in pieces] for pieces in Airspace(scenario).obstacles] == [
        [], ['high']]
    [[], [piece]] = Airspace(scenario).obstacles
    assert shapely.box(-3, -3, 23, 23).equals(shapely.Polygon(piece.vertices))
    assert scenario.boundaries.keep_apart == 8.0
    normals, offsets = Airspace(scenario).hull
    assert sorted(offsets) == pytest.approx([197, 397, 597, 597])
    assert replace(scenario, separation=0.0).boundaries.keep_apart == 0.0


def test_without_a_margin_the_geometry_is_the_given_one_to_the_last_digit():
    vertices = tuple((x / 3, y / 7) for x, y in COURT)
    for margin in (0.0, 0.1 * 3 - 0.3, -1e-9):  # A width below rounding is none.
        assert offset_polygon(vertices, margin) == (vertices,)
    fence = ((-200.1, -600.2), (400.3, -600.4), (400.5, 600.6), (-200.7, 600.8))
    scenario = replace(Scenario.paper(), separation=7.7, geofence=fence,
                       no_fly_zones=(NoFlyZone(vertices, name='court'),))
    assert scenario.boundaries.keep_out(100.0) == ((vertices, 'court'),)
    assert (scenario.boundaries.keep_in, scenario.boundaries.keep_apart) == (fence, 7.7)


def make_team(**fields):
    """Return a mission of two UAVs 20 m apart that fly along a wall and a fence 10 m away."""
    uavs = tuple(Uav(name, (x, 0.0), (x, 80.0), 50.0, 20.0) for name, x in (
        ('one', 0.0), ('two', 20.0)))
    wall = NoFlyZone(((-30, -30), (-10, -30), (-10, 40), (-30, 40)), 0.0, 60.0, 'wall')
    return replace(Scenario.paper(), **{
        'uavs': uavs, 'duration': 8.0, 'slots': 8, 'no_fly_zones': (wall,), 'separation': 4.0,
        'geofence': ((-99, -99), (30, -99), (30, 99), (-99, 99)), **fields})


def fly_straight(scenario):
    """Return the plan of straight flights."""
    share = np.linspace(0, 1, scenario.slots + 2)[:, None]
    ends = zip(scenario.starts, scenario.goals)
    return Plan(scenario, [start + share * (goal - start) for start, goal in ends],
                np.zeros((2, scenario.slots)))


def test_a_plan_has_its_distances_with_and_without_the_margin():
    clearance = fly_straight(make_team(tracking_margin=8.0)).clearance
    assert clearance.to_zones.distance == pytest.approx(10.0)
    assert clearance.zones_beyond_margin == pytest.approx(2.0)
    assert clearance.between_uavs.distance == pytest.approx(20.0)
    assert clearance.uavs_beyond_margin == pytest.approx(4.0)
    # A zone below a UAV by less than the margin counts as well.
    assert fly_straight(make_team(tracking_margin=8.0, no_fly_zones=(
        NoFlyZone(((-30, -30), (-10, -30), (-10, 40)), 0.0, 45.0),))).clearance.to_zones


def test_a_margin_can_make_uavs_close():
    assert not fly_straight(make_team(separation=0.0, tracking_margin=7.4)).clearance.is_close
    assert fly_straight(make_team(separation=0.0, tracking_margin=7.6)).clearance.is_close


@pytest.mark.parametrize('margin, places, reason', [
    (9.5, (-1.0, 20.0), 'one is 0.5 m inside wall with the tracking_margin of 9.5 m'),
    (9.5, (0.0, 21.0), 'two is 0.5 m outside the geofence with the tracking_margin of 9.5 m'),
    (7.0, (2.5, 17.5), 'one and two are 15 m apart 1 s after point 0; separation with the '
                       'tracking_margin of 7 m is 18 m')])
def test_a_plan_within_the_margin_is_refused(margin, places, reason):
    scenario = make_team(separation=1.0 if margin > 9 else 4.0)
    positions = fly_straight(scenario).positions.copy()
    positions[:, 1:-1, 0] = np.array(places)[:, None]
    Plan(scenario, positions, np.zeros((2, 8)))
    with pytest.raises(PlanError, match=reason):
        Plan(replace(scenario, tracking_margin=margin), positions, np.zeros((2, 8)))


def test_of_a_fence_that_a_margin_divides_the_part_of_the_first_start_is_kept():
    rooms = ((-50, -50), (50, -50), (50, 40), (52, 40), (52, -50), (150, -50), (150, 50),
             (-50, 50))
    uavs = tuple(Uav(name, (x, 0.0), (x, 10.0), 50.0, 20.0) for name, x in (
        ('one', 100.0), ('two', 120.0)))
    scenario = make_team(uavs=uavs, geofence=rooms, no_fly_zones=(), tracking_margin=5.5)
    fence = shapely.Polygon(scenario.boundaries.keep_in)
    assert fence.bounds == pytest.approx((57.5, -44.5, 144.5, 44.5))
    with pytest.raises(ScenarioError, match='one.start .* outside the geofence with the'):
        replace(scenario, uavs=(uavs[1], replace(uavs[0], start=(0.0, 0.0))))
