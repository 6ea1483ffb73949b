"""Zones and fence in the picture, the page and the markers."""

from dataclasses import replace

import city
from matplotlib.patches import Polygon
import numpy as np
import pytest
from secure_uav_planner import NoFlyZone, Scenario
from secure_uav_planner.mission.polygons import offset_polygon
from secure_uav_planner.output.drawing import altitude_label, extend_corners, margin_rings
from secure_uav_planner.output.picture import draw_plan
from secure_uav_planner.ros import messages
import shapely
from visualization_msgs.msg import Marker

SQUARE = ((0, 0), (1, 0), (1, 1), (0, 1))


@pytest.fixture(scope='module')
def plan():
    return city.plan_by_hand(Scenario.load(city.FILE))


def test_picture_and_page_have_every_zone_with_its_altitudes_and_the_fence(plan):
    wanted = [plan.scenario.geofence, *(zone.vertices for zone in plan.scenario.no_fly_zones)]
    axes = draw_plan(plan).axes[0]
    shapes = [patch.get_xy()[:-1] for patch in axes.patches
              if isinstance(patch, Polygon) and 'margin' not in patch.get_label()]
    for shape, vertices in zip(shapes, wanted, strict=True):
        assert shape == pytest.approx(np.array(vertices))
    texts = {text.get_text() for text in axes.texts}
    assert {'hospital', 'tower\nup to 150 m', 'stadium\nup to 95 m'} <= texts
    legend = {text.get_text() for text in axes.get_legend().get_texts()}
    assert {'no-fly zone', 'geofence', 'margin of 3 m'} <= legend
    pytest.importorskip('plotly')
    from secure_uav_planner.output.page import draw_page
    traces = {trace.text if trace.name == 'no-fly zone' else 'geofence': trace
              for trace in draw_page(plan).data if trace.name in ('no-fly zone', 'geofence')}
    assert set(traces) == {'hospital', 'tower, up to 150 m', 'stadium, up to 95 m', 'geofence'}
    drawn = {(*zip(trace.x, trace.y),) for trace in traces.values()}
    assert drawn == {(*vertices, vertices[0]) for vertices in wanted}


@pytest.mark.filterwarnings('error')
@pytest.mark.parametrize('name', ['禁飞区', 'निषिद्ध क्षेत्र', 'منطقة', '\U0001f681'])
def test_zones_and_receivers_may_be_named_in_any_script(plan, tmp_path, name):
    scenario = plan.scenario
    named = replace(plan, scenario=replace(
        scenario, no_fly_zones=(replace(scenario.no_fly_zones[0], name=name),
                                *scenario.no_fly_zones[1:]),
        eavesdroppers=(replace(scenario.eavesdroppers[0], name=name), *scenario.eavesdroppers[1:]),
        uavs=(replace(scenario.uavs[0], name=name), *scenario.uavs[1:])))
    named.plot().savefig(tmp_path / 'plan.png')
    named.scenario.plot().savefig(tmp_path / 'mission.png')


def check_rims(outlines, scenario):
    """Assert that outlines are the rims of the margin around zones and inside the fence."""
    wanted = [shapely.Polygon(vertices).buffer(3, quad_segs=64).difference(
        shapely.Polygon(vertices)) for vertices in (
            zone.vertices for zone in scenario.no_fly_zones)]
    fence = shapely.Polygon(scenario.geofence)
    wanted.append(fence.difference(fence.buffer(-3)))
    assert len(outlines) == len(wanted)
    for outline, rim in zip(outlines, wanted):
        signed = np.sum(outline[:-1, 0] * outline[1:, 1] - outline[1:, 0] * outline[:-1, 1]) / 2
        assert abs(signed) == pytest.approx(rim.area, rel=0.02)
        assert shapely.distance(shapely.points(outline), rim).max() < 0.81 * 3  # Mitred corners.


def test_the_margin_is_a_rim_around_zones_and_inside_the_fence(plan):
    axes = draw_plan(plan).axes[0]
    check_rims([patch.get_xy() for patch in axes.patches if 'margin' in patch.get_label()],
               plan.scenario)
    pytest.importorskip('plotly')
    from secure_uav_planner.output.page import draw_page
    traces = [trace for trace in draw_page(plan).data if trace.name == 'margin of 3 m']
    check_rims([np.stack([trace.x, trace.y], axis=1) for trace in traces], plan.scenario)
    assert sum(bool(trace.showlegend) for trace in traces) == 1
    assert not margin_rings(replace(plan.scenario, tracking_margin=0.0))


def test_markers_are_prisms_between_floor_and_ceiling(plan):
    markers = messages.markers(
        type(plan)(plan.scenario, plan.positions, plan.powers, start_ns=0), 'map').markers
    prisms = [marker for marker in markers if marker.ns == 'no_fly_zone']
    assert len({(marker.ns, marker.id) for marker in markers}) == len(markers)
    for marker, zone in zip(prisms, plan.scenario.no_fly_zones, strict=True):
        assert marker.type == Marker.TRIANGLE_LIST and len(marker.points) % 3 == 0
        points = np.array([(point.x, point.y, point.z) for point in marker.points])
        # Without a ceiling it ends above the highest UAV.
        top = 132.0 if np.isinf(zone.ceiling) else zone.ceiling
        assert sorted(set(points[:, 2].tolist())) == pytest.approx([zone.floor, min(top, 132.0)])
        roof = points.reshape(-1, 3, 3)[(points.reshape(-1, 3, 3)[..., 2] > 50).all(axis=1)]
        shape = shapely.union_all([shapely.Polygon(corners[:, :2]) for corners in roof])
        assert shape.symmetric_difference(shapely.Polygon(zone.vertices)).area < 1e-6
    [rim] = [marker for marker in markers if marker.ns == 'tracking_margin']
    corners = {(point.x, point.y) for point in rim.points}
    assert corners == {*plan.scenario.boundaries.keep_in, *(
        place for zone in plan.scenario.no_fly_zones
        for place in offset_polygon(zone.vertices, 3.0)[0])}
    assert min(point.z for point in rim.points) == 0.0
    [fence] = [marker for marker in markers if marker.ns == 'geofence']
    assert {(point.x, point.y) for point in fence.points} == set(plan.scenario.geofence)
    assert [marker.text for marker in markers if marker.ns == 'label'][-3:] == [
        'hospital', 'tower', 'stadium']


@pytest.mark.parametrize('floor, ceiling, text', [
    (0, np.inf, ''), (0, 50, 'up to 50 m'), (20, 50, '20 to 50 m'), (20, None, 'above 20 m')])
def test_the_altitude_label_a_zone_have_a_text(floor, ceiling, text):
    assert altitude_label(NoFlyZone(SQUARE, floor, ceiling)) == text


def test_a_very_large_fence_does_not_make_the_plan_small(plan):
    corners = [[-100.0, -100.0], [100.0, 100.0]]
    assert extend_corners(plan.scenario, corners).tolist() == [
        [-300.0, -300.0], [300.0, 300.0]]
