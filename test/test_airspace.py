from dataclasses import replace
import math

from hypothesis import given
from hypothesis import strategies as st
import numpy as np
import pytest
from random_cities import random_polygon
from secure_uav_planner import NoFlyZone, Scenario
from secure_uav_planner.errors import ScenarioError
from secure_uav_planner.mission.polygons import convex_parts, depth, half_planes, pockets
from secure_uav_planner.model.airspace import Airspace
import shapely
from strategies import SEEDS

SQUARE = ((0.0, 0.0), (40.0, 0.0), (40.0, 40.0), (0.0, 40.0))
HOOK = ((0.0, 0.0), (40.0, 0.0), (40.0, 40.0), (30.0, 40.0), (30.0, 10.0), (0.0, 10.0))
FENCE = ((-400.0, -800.0), (600.0, -800.0), (600.0, 800.0), (-400.0, 800.0))


@st.composite
def polygons(draw):
    """Return simple polygons of any size, in either order."""
    rng = np.random.default_rng(draw(SEEDS))
    vertices = random_polygon(
        rng, rng.uniform(-500, 500, 2), draw(st.sampled_from([1e-2, 1.0, 300.0, 1e6])), 40)
    return vertices[::draw(st.sampled_from([1, -1]))]


@given(polygons())
def test_convex_parts_are_convex_and_cover_the_polygon_once(vertices):
    polygon, parts = shapely.Polygon(vertices), convex_parts(vertices)
    for part in parts:
        before, after = part - np.roll(part, 1, axis=0), np.roll(part, -1, axis=0) - part
        turns = before[:, 0] * after[:, 1] - before[:, 1] * after[:, 0]
        assert turns.min() > -1e-9 * polygon.length**2
        assert len(part) == 3 or set(map(tuple, part.tolist())) <= set(vertices)
    shapes = [shapely.Polygon(part) for part in parts]
    assert sum(shape.area for shape in shapes) == pytest.approx(polygon.area, rel=1e-6)
    assert shapely.union_all(shapes).symmetric_difference(polygon).area < 1e-6 * polygon.area
    assert len(parts) <= max(1, len(vertices) - 2)


@given(polygons(), st.integers(0, 10**6))
def test_a_fence_is_its_half_planes_without_its_pockets(vertices, seed):
    polygon = shapely.Polygon(vertices)
    normals, offsets = half_planes(vertices)
    assert np.linalg.norm(normals, axis=1) == pytest.approx(np.ones(len(normals)))
    low, high = np.min(vertices, axis=0), np.max(vertices, axis=0)
    margin = 1e-6 * np.ptp(vertices)
    for point in np.random.default_rng(seed).uniform(low, high, (100, 2)):
        if polygon.exterior.distance(shapely.Point(point)) < margin:
            continue
        inside = (normals @ point <= offsets).all() and all(
            depth(pocket, tuple(point)) < 0 for pocket in pockets(vertices))
        assert inside == polygon.contains(shapely.Point(point)) == (
            depth(vertices, tuple(point)) > 0)


def test_a_convex_polygon_is_one_part_and_an_l_is_two():
    assert [len(part) for part in convex_parts(SQUARE)] == [4]
    assert len(convex_parts(HOOK)) == 2
    assert len(convex_parts(((0.0, 0.0), (20.0, 0.0), *SQUARE[1:]))) == 1
    [clockwise] = convex_parts(SQUARE[::-1])
    assert shapely.Polygon(clockwise).exterior.is_ccw


def test_each_uav_has_the_named_pieces_at_its_altitude():
    scenario = replace(Scenario.paper(), geofence=(*FENCE[:3], (100.0, 700.0), FENCE[3]),
                       no_fly_zones=(
        NoFlyZone(HOOK, name='tower'), NoFlyZone(SQUARE, ceiling=105.0), NoFlyZone(SQUARE, 110.0)))
    first, second = Airspace(scenario).obstacles
    assert [piece.name for piece in first] == ['tower', 'tower', 'zone 2', 'the geofence']
    assert [piece.name for piece in second] == ['tower', 'tower', 'zone 3', 'the geofence']
    for array in (first[0].vertices, *Airspace(scenario).hull):
        with pytest.raises(ValueError):
            array[0] = 0.0
    plain = Airspace(Scenario.paper())
    assert plain.obstacles == ((), ()) and len(plain.hull[1]) == 0


def test_the_horizontal_separation_is_less_for_different_altitudes():
    scenario = replace(Scenario.paper(), uavs=tuple(
        replace(uav, start=(uav.start[0] + 20 * number, 500.0), goal=(20.0 * number, -400.0))
        for number, uav in enumerate(Scenario.paper().uavs)), separation=20.0)
    assert Airspace(scenario).separations == pytest.approx(
        np.array([[0, math.sqrt(300)], [math.sqrt(300), 0]]))
    assert Airspace(replace(scenario, separation=9.0)).separations.max() == 0


def test_a_closed_ring_is_the_polygon():
    assert NoFlyZone((*SQUARE, SQUARE[0])) == NoFlyZone(SQUARE)
    assert NoFlyZone([list(point) for point in SQUARE]) == NoFlyZone(SQUARE)


def around(point, half=5.0):
    """Return a square around a point."""
    x, y = point
    return ((x - half, y - half), (x + half, y - half), (x + half, y + half), (x - half, y + half))


def test_the_edge_of_a_zone_and_of_a_fence_may_be_a_start():
    scenario = Scenario.paper()
    edge = around((100, 500 + 5))
    assert replace(scenario, no_fly_zones=(NoFlyZone(edge),), separation=10.0,
                   geofence=((100, 500), (100, -500), (300, -500)))


def test_a_start_in_motion_may_be_off_the_curve_by_its_bend():
    scenario = Scenario.paper(200.0)  # One-second slots: the curve passes within 0.25 m.
    zone = NoFlyZone(((99, 499.8), (101, 499.8), (101, 520), (99, 520)))

    def with_start(velocity):
        return replace(scenario, no_fly_zones=(zone,), uavs=tuple(
            replace(uav, max_acceleration=2.0, start_velocity=velocity)
            for uav in scenario.uavs))
    assert with_start((0.0, -5.0))
    with pytest.raises(ScenarioError, match='uav1.start is .* inside zone 1'):
        with_start((0.0, 0.0))
