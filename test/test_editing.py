"""A mission that is dragged, added to and written: what changes, and what stays."""

from dataclasses import replace
import json
import re

from hypothesis import given, settings, strategies as st
import numpy as np
from processes import ROOT
import pytest
from secure_uav_planner import Eavesdropper, GroundNode, NoFlyZone, Scenario, Uav
from secure_uav_planner.apps.editing import (
    add_member, drag, find_circle, list_handles, remove_member, set_field, to_mission)
from secure_uav_planner.apps.mission_text import MissionText
from secure_uav_planner.mission.formats.mission_file import EXAMPLE
from secure_uav_planner.output.drawing import map_extent
import shapely

PAPER = replace(Scenario.paper(120.0, slots=20), no_fly_zones=(
    NoFlyZone(((250.0, 200.0), (350.0, 200.0), (300.0, 300.0)), name='tower'),))
CAR = Eavesdropper(name='car', track=((0, 200, -300, 15), (60, 200, 0, 15), (120, 200, 300, 15)))
EVERYTHING = replace(
    PAPER, eavesdroppers=(*PAPER.eavesdroppers, CAR), ground_node=None,
    ground_node_track=((0, 0, 0), (120, 50, 0)),
    geofence=((-900, -900), (900, -900), (900, 900), (-900, 900)))
CITY = ROOT / 'config' / 'city.yaml'


# The mission after a drag


@pytest.mark.parametrize('number', range(len(list_handles(to_mission(EVERYTHING)))))
def test_a_dragged_shape_moves_its_own_value_by_as_much_and_no_other(number):
    mission = to_mission(EVERYTHING)
    shape, place, _ = list_handles(mission)[number]
    names = {name: shape[name] + (3.0 if name[0] == 'x' else -4.0)
             for name in ('x0', 'x1', 'xanchor', 'y0', 'y1', 'yanchor') if name in shape}
    if not names:
        steps = iter([3.0, -4.0] * shape['path'].count(','))
        names = {'path': re.sub(r'-?[\d.]+', lambda text: str(float(text[0]) + next(steps)),
                                shape['path'])}
    after = drag(mission, {f'shapes[{number}].{name}': value for name, value in names.items()})
    assert drag(after, {'xaxis.range[0]': 0.0}) == after != mission
    flat = [numbers_of(Scenario.from_dict(data)) for data in (mission, after)]
    difference = np.subtract(*flat[::-1])
    moved = difference[difference != 0].reshape(-1, 2)
    np.testing.assert_allclose(moved, np.broadcast_to([3.0, -4.0], moved.shape), atol=1e-9)
    whole = place[-1] in ('vertices', 'geofence')
    assert len(moved) == (shape['path'].count(',') - (place == ('geofence',)) if whole else 1)


def numbers_of(scenario):
    """Return all coordinates of a scenario as a list."""
    return [float(number) for points in (
        scenario.starts, scenario.goals, *(zone.vertices for zone in scenario.no_fly_zones),
        scenario.geofence, scenario.ground_node_track,
        *(eve.track or [(*eve.position, eve.error_radius)] for eve in scenario.eavesdroppers))
        for point in points for number in point]


@pytest.mark.parametrize('edge, sign', [('x0', -1), ('x1', 1), ('y0', -1), ('y1', 1)])
def test_a_dragged_edge_of_a_disc_is_a_new_radius_around_its_centre(edge, sign):
    mission = to_mission(PAPER)
    number, (shape, *_) = next(
        (number, handle) for number, handle in enumerate(list_handles(mission))
        if handle.shape['type'] == 'circle')
    after = drag(mission, {f'shapes[{number}].{edge}': shape[edge] + 25.0 * sign})
    eve, = Scenario.from_dict(after).eavesdroppers
    assert (eve.position, eve.error_radius) == ((200.0, 0.0), 35.0)


@pytest.mark.parametrize('change, center, radius', [
    ({'x0': 20.0, 'x1': 20.0, 'y0': -15.0, 'y1': -15.0}, (220.0, -15.0), 50.0),
    ({'x1': 30.0}, (200.0, 0.0), 80.0)])
def test_a_circle_of_many_corners_is_dragged_as_a_circle(change, center, radius):
    angles = np.arange(32) * np.pi / 16
    corners = np.array([200.0, 0.0]) + 50.0 * np.stack([np.cos(angles), np.sin(angles)], axis=1)
    mission = to_mission(replace(PAPER, no_fly_zones=(NoFlyZone(tuple(
        map(tuple, corners.round(3))), name='mast'),)))
    numbers = [number for number, handle in enumerate(list_handles(mission))
               if handle.place[0] == 'no_fly_zones']
    assert len(numbers) == 1
    shape = list_handles(mission)[numbers[0]].shape
    after = drag(mission, {f'shapes[{numbers[0]}].{name}': shape[name] + value
                           for name, value in change.items()})
    vertices = after['no_fly_zones'][0]['vertices']
    assert len(vertices) == 32
    assert find_circle(vertices) == pytest.approx((*center, radius), abs=0.02)
    assert find_circle(PAPER.no_fly_zones[0].vertices) is None


INDOORS = Scenario((0.0, 0.0), (Eavesdropper((2.0, 0.0), 0.2),), (
    Uav('hopper', (-2.0, -2.0), (2.0, 2.0), 3.0, 1.0),), 100.0, 20)


@pytest.mark.parametrize('scenario', [PAPER, EVERYTHING, Scenario.load(CITY), INDOORS])
def test_what_is_added_is_off_the_zones_and_can_be_flown(scenario):
    mission = to_mission(scenario)
    for kind in ('zone', 'jammer', 'zone', 'eavesdropper', 'jammer'):
        mission = add_member(mission, kind, map_extent(scenario))
    after = Scenario.from_dict(mission)  # It refuses starts and goals in zones.
    zones = [shapely.Polygon(zone.vertices) for zone in after.no_fly_zones]
    room = min(1.0, 0.01 * np.ptp(map_extent(scenario), axis=0).max())
    for uav in after.uavs[len(scenario.uavs):]:
        assert min(shapely.Point(end).distance(zone) for zone in zones for end in (
            uav.start, uav.goal)) > room + after.tracking_margin


@pytest.mark.parametrize('nodes', [1, 2])
def test_no_track_is_left_with_a_single_knot(nodes):
    cars = tuple(GroundNode(name=f'car {number}', track=EVERYTHING.ground_node_track)
                 for number in range(nodes))
    mission = to_mission(replace(PAPER, ground_nodes=cars))
    for number, handle in enumerate(list_handles(mission)):
        if 'track' in handle.place:
            after = Scenario.from_dict(remove_member(mission, number))
            assert len(after.ground_nodes) == 1


def test_a_ground_node_goes_with_its_head_start():
    nodes = tuple(GroundNode((60.0 * number, 0.0), f'node {number}') for number in range(3))
    mission = to_mission(replace(PAPER, ground_nodes=nodes, head_starts=(10.0, 20.0, 5.0)))
    number = next(number for number, handle in enumerate(list_handles(mission))
                  if handle.removes == ('ground_nodes', 1))
    mission = remove_member(mission, number)
    assert Scenario.from_dict(mission).head_starts == (10.0, 5.0)
    number = next(number for number, handle in enumerate(list_handles(mission))
                  if handle.removes == ('ground_nodes', 1))
    assert Scenario.from_dict(remove_member(mission, number)).head_starts == ()


def test_a_single_uav_cannot_be_removed():
    mission = to_mission(PAPER)
    for _ in range(2):
        mission = remove_member(mission, len(list_handles(mission)) - 1)
    assert len(mission['uavs']) == 1


# The text of the mission


@pytest.fixture
def airspace(tmp_path):
    """Return a mission file in degrees with the airspace of a file."""
    (tmp_path / 'zones.geojson').write_text(json.dumps({'type': 'Polygon', 'coordinates': [[
        [8.5478, 47.3995], [8.5491, 47.3995], [8.5491, 47.4004], [8.5478, 47.3995]]]}))
    file = tmp_path / 'mission.yaml'
    file.write_text(f"""# The square
origin: {{latitude: 47.3977, longitude: 8.5456}}
airspace: zones.geojson  # of the authority
ground_node: {{latitude: 47.3977, longitude: 8.5456}}  # the kiosk
{EXAMPLE.read_text().partition('at height 0; of one that moves:')[2].partition(
    'no_fly_zones')[0].partition('as below')[2]}""")
    return file


def test_a_loaded_text_keeps_comments_degrees_and_airspace_where_nothing_is_changed(airspace):
    source = MissionText(airspace)
    before = to_mission(source.scenario)
    assert len(before['no_fly_zones']) == 1
    after = set_field(before, 'mission', 'duration', 120.0)
    text = source.change(source.text, before, after)
    changed = [line for line in text.splitlines() if line not in source.text.splitlines()]
    assert [line.split(':')[0] for line in changed] == ['duration', 'slots']
    assert all('  # ' in line for line in changed) and source.read(text).duration == 120.0
    dragged = drag(after, {'shapes[0].path': 'M-20,200L70,200L70,300Z'})
    text = source.change(text, after, dragged)
    assert 'airspace' not in text and 'latitude: 47.3977' in text and '# the kiosk' in text
    assert to_mission(source.read(text)) == dragged


@settings(max_examples=30, deadline=None)
@given(file=st.sampled_from((EXAMPLE, CITY)), edits=st.lists(st.one_of(
    st.tuples(st.just('add'), st.sampled_from(('zone', 'jammer', 'eavesdropper'))),
    st.tuples(st.just('remove'), st.integers(0, 11)),
    st.tuples(st.just('power'), st.integers(1, 4)),
    st.tuples(st.just('move'), st.integers(0, 11))), max_size=4))
def test_the_text_is_the_mission_after_any_edits_and_keeps_its_first_comment(file, edits):
    source = MissionText(file)
    mission, text = to_mission(source.scenario), source.text
    for what, value in edits:
        shapes = list_handles(mission)
        number = value % len(shapes) if isinstance(value, int) else 0
        shift = {name: shapes[number].shape[name] + 1.0 for name in ('xanchor', 'x0', 'x1')
                 if name in shapes[number].shape}
        after = {
            'add': lambda: add_member(mission, value, map_extent(source.scenario)),
            'remove': lambda: remove_member(mission, number),
            'power': lambda: set_field(mission, 'transmitter', 'average_power', value / 2),
            'move': lambda: drag(mission, {f'shapes[{number}].{name}': place
                                           for name, place in shift.items()})}[what]()
        try:
            wanted = Scenario.from_dict(after)
        except ValueError:
            continue
        text, mission = source.change(text, mission, after), after
        assert source.read(text) == wanted
        assert text.startswith(source.text.partition('\n')[0])
