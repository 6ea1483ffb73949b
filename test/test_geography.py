"""Places on Earth: the projections of autopilots, missions in degrees, and plans as maps."""

from dataclasses import replace
from functools import reduce
import json
import math
from pathlib import Path
from tempfile import TemporaryDirectory

import city
from city import FILE as CITY
from hypothesis import given, strategies as st
import numpy as np
import pytest
from secure_uav_planner import (
    Eavesdropper, NoFlyZone, Origin, read_zones, Scenario)
from secure_uav_planner.errors import OptionError, ScenarioError
from secure_uav_planner.mission.polygons import depth
from secure_uav_planner.output.geojson import _cut_line
from secure_uav_planner.ros.settings import load_mission, origin_from
import shapely
import yaml

ZURICH = (47.3977, 8.5456)


def px4(origin, place):
    """Transcribe PX4's MapProjection::project, for one place, to (east, north)."""
    lat0, lon0, lat, lon = map(math.radians, (*origin, *place))
    c = math.acos(min(1.0, math.sin(lat0) * math.sin(lat)
                      + math.cos(lat0) * math.cos(lat) * math.cos(lon - lon0)))
    k = c / math.sin(c) if c > 0 else 1.0
    return (k * math.cos(lat) * math.sin(lon - lon0) * 6371000.0,
            k * (math.cos(lat0) * math.sin(lat)
                 - math.sin(lat0) * math.cos(lat) * math.cos(lon - lon0)) * 6371000.0)


def ardupilot(origin, place):
    """Transcribe ArduPilot's Location::get_distance_NE, in its 1e-7 degrees, to (east, north)."""
    scale = 0.011131884502145034
    (lat0, lon0), (lat, lon) = ((1e7 * value for value in pair) for pair in (origin, place))
    return ((lon - lon0) * scale * math.cos(math.radians((lat + lat0) / 2 * 1e-7)),
            (lat - lat0) * scale)


def wgs84(origin, place):
    """Convert by the radii of curvature of WGS84 at the origin, right for short distances."""
    squared = 0.00669437999014
    sine = 1 - squared * math.sin(math.radians(origin[0]))**2
    meridian, normal = 6378137 * (1 - squared) / sine**1.5, 6378137 / sine**0.5
    north, east = (math.radians(there - here) for here, there in zip(origin, place))
    return east * normal * math.cos(math.radians(origin[0])), north * meridian


MODELS = {'px4': px4, 'ardupilot': ardupilot}


@pytest.mark.parametrize('projection', MODELS)
def test_places_are_where_each_autopilot_takes_them_to_be(projection):
    place = 47.4067, 8.5589
    reference = MODELS[projection](ZURICH, place)
    assert Origin(*ZURICH, projection).to_local(*place) == pytest.approx(reference, abs=1e-6)
    reached = {'px4': (1000.89950, 1000.83985), 'ardupilot': (1002.10053, 1001.86961)}
    assert reference == pytest.approx(reached[projection], abs=1e-5)
    # Errors of scale in m per km: the numbers that the documentation gives.
    for latitude, north, east in {'px4': [(0, 5.6, -1.1), (47, 0.2, -2.9)],
                                  'ardupilot': [(0, 6.7, 0.0), (47, 1.3, -1.8)]}[projection]:
        step = 1e-4
        for there, index, expected in (((latitude + step, 0.0), 1, north),
                                       ((latitude, step), 0, east)):
            own = Origin(latitude, 0.0, projection).to_local(*there)[index]
            truth = wgs84((latitude, 0.0), there)[index]
            assert 1000 * (own / truth - 1) == pytest.approx(expected, abs=0.06)


@pytest.mark.parametrize('projection', MODELS)
def test_both_directions_are_exact_inverses_within_50_km(projection):
    rng = np.random.default_rng(4)
    for latitude, longitude in [*zip(rng.uniform(-85, 85, 40), rng.uniform(-180, 180, 40)),
                                (85, 180), (-85, -180), (0, 0)]:
        distance, angle = 50e3 * rng.random(500)**2, rng.uniform(0, 2 * np.pi, 500)
        points = np.append(distance * [np.cos(angle), np.sin(angle)], [[0], [0]], axis=1)
        origin = Origin(latitude, longitude, projection)
        places = origin.to_geographic(*points)
        assert np.abs(origin.to_local(*places) - points).max() < 1e-6
        assert np.abs(places[1]).max() <= 180


def in_degrees(value, origin, name=''):
    """Return plain values of a mission with all places as latitude and longitude."""
    if isinstance(value, dict):
        return {field: in_degrees(item, origin, field) for field, item in value.items()}
    if not isinstance(value, list):
        return value
    if name == 'track':
        return [[time, in_degrees([x, y], origin, 'start'), *rest] for time, x, y, *rest in value]
    if name in ('vertices', 'geofence'):
        return [in_degrees(place, origin, 'start') for place in value]
    if name in ('ground_node', 'position', 'start', 'goal'):
        latitude, longitude = origin.to_geographic(*value)
        return {'latitude': float(latitude), 'longitude': float(longitude)}
    return [in_degrees(item, origin) for item in value]


def write_twins(folder, projection='px4'):
    """Write a city with tracks in metres and in degrees; return both files and the origin."""
    origin = Origin(*ZURICH, projection)
    data = yaml.safe_load(CITY.read_text()) | {'slots': 40}
    data['eavesdroppers'][0] = {'name': 'car', 'track': [[0, 190, 130, 30], [190, 90, 130, 40]]}
    data['ground_node'] = {'track': [[0, 0, 0], [190, 20, 0]]}
    text = yaml.safe_dump(in_degrees(data, origin) | {'origin': {
        'latitude': ZURICH[0], 'longitude': ZURICH[1], 'projection': projection}})
    assert text.count('latitude') == 1 + 2 + 2 + 1 + 6 + 18 + 7  # All places.
    files = folder / 'metres.yaml', folder / 'degrees.yaml'
    for file, content in zip(files, (yaml.safe_dump(data), text)):
        file.write_text(content)
    return *files, origin


@pytest.mark.parametrize('projection', MODELS)
def test_a_city_in_degrees_is_its_twin_in_metres(tmp_path, projection):
    file, degrees, origin = write_twins(tmp_path, projection)
    # As the nodes take it; only the origin tells the two apart.
    values, twin = load_mission(degrees), load_mission(file)
    assert origin == origin_from(values)
    for field in ('latitude', 'longitude', 'projection'):
        del values[f'origin.{field}']

    def numbers(value):
        if isinstance(value, dict):
            value = [value[name] for name in sorted(value)]
        return [number for item in value for number in numbers(item)] if isinstance(
            value, (list, tuple)) else [value]

    assert [*values] == [*twin] and len(numbers(twin)) > 100
    for left, right in zip(numbers(values), numbers(twin), strict=True):
        assert left == right  # So that they are planned alike.


def test_a_list_however_deep_is_refused_by_its_field():
    deep = reduce(lambda inner, _: [inner], range(3000), 1.0)
    fields = Scenario.paper(120.0).to_dict() | {'geofence': deep, 'origin': {
        'latitude': ZURICH[0], 'longitude': ZURICH[1], 'projection': 'px4'}}
    with pytest.raises(ScenarioError, match=r'geofence\[0\]'):
        Scenario.from_dict(fields)


def test_numbers_that_look_like_degrees_get_a_note(tmp_path, command):
    file = tmp_path / 'mission.yaml'
    scenario = Scenario.paper(120.0)
    for zone in ((8.54, 47.39), (8.56, 47.39), (8.56, 47.41)), ((0, 0), (9, 0), (9, 9)):
        replace(scenario, no_fly_zones=(NoFlyZone(zone),)).save(file)
        notes = command('check', file).err
        assert ('note: zone 1: all places are within 1 m; are they degrees?' in notes) is (
            zone[0] != (0, 0)) and 'starts' not in notes
    places = {'ground_node': (8.54, 47.39), 'eavesdroppers': (Eavesdropper((8.55, 47.4)),),
              'uavs': tuple(replace(uav, start=(8.53, 47.39), goal=(8.56, 47.39))
                            for uav in scenario.uavs)}
    replace(scenario, **places).save(file)
    assert 'note: starts, goals and receivers: all places' in command('check', file).err


def test_a_plan_is_a_map_whose_places_are_those_of_the_plan(tmp_path):
    node, car = ((0, 1, 2), (126, 20, 0)), ((0, 200, 0, 10), (60, 210, 5, 20), (126, 200, 20, 5))
    with pytest.raises(OptionError, match='origin is None'):
        city.plan_by_hand(Scenario.load(CITY)).to_geojson(tmp_path / 'no.geojson')
    scenario = Scenario.load(CITY)
    scenario = replace(
        scenario, origin=Origin(*ZURICH, 'ardupilot'), ground_node=None, ground_node_track=node,
        eavesdroppers=(*scenario.eavesdroppers, Eavesdropper(name='car', track=car)))
    plan = city.plan_by_hand(scenario)
    plan.to_geojson(tmp_path / 'plan.geojson')
    features = json.loads((tmp_path / 'plan.geojson').read_text())['features']

    def listed(kind):
        return [item for item in features if item['properties']['kind'] == kind]

    def metres(item):
        longitudes, latitudes = np.reshape(item['geometry']['coordinates'], (-1, 2)).T
        return np.stack(scenario.origin.to_local(latitudes, longitudes), axis=1)

    for row, item, uav in zip(range(3), listed('path'), scenario.uavs, strict=True):
        properties = item['properties']
        assert (properties['name'], properties['altitude']) == (uav.name, uav.altitude)
        assert metres(item) == pytest.approx(
            plan.curve.at(np.array(properties['times'])).positions[row], abs=1e-6)
        assert properties['powers'][2:-2] == plan.powers[row].tolist()
    for item, eve in zip(listed('eavesdropper'), scenario.eavesdroppers):
        assert np.linalg.norm(metres(item) - eve.position, axis=1) == pytest.approx(
            item['properties']['error_radius'], abs=1e-6)
    for item, name, track in zip(
            listed('track'), ('ground_node', 'car'), (node, car), strict=True):
        times, x, y, *radii = map(list, zip(*track))
        assert item['geometry']['type'] == 'LineString' and item['properties']['name'] == name
        assert item['properties']['times'] == times
        assert item['properties']['radii'] == (radii[0] if radii else None)
        assert metres(item) == pytest.approx(np.array([x, y]).T, abs=1e-6)
    # Zones come back as they were.
    (tmp_path / 'zones.geojson').write_text(json.dumps(
        {'type': 'FeatureCollection', 'features': listed('zone')}))
    zones, _ = read_zones(tmp_path / 'zones.geojson', scenario.origin)
    for zone, expected in zip(zones, scenario.no_fly_zones, strict=True):
        assert replace(zone, vertices=expected.vertices) == expected
        assert np.abs(depth(zone.vertices, expected.vertices)).max() < 1e-6
    assert np.abs(depth(scenario.geofence, metres(*listed('geofence')))).max() < 1e-6


NEAR_180 = st.sampled_from([180.0, -180.0, 179.9999, -179.9999, 179.99, -179.97])
ORIGINS = st.builds(Origin, st.floats(-75, 75), NEAR_180 | st.floats(-180, 180),
                    st.sampled_from(sorted(MODELS)))


@st.composite
def polygons(draw, largest=20_000.0):
    """Return vertices (K, 2) in m of a polygon around a place near the point (0, 0)."""
    count, size = draw(st.integers(3, 12)), draw(st.floats(5.0, largest))
    angles = 2 * np.pi * (np.arange(count) + draw(st.floats(0, 1))) / count
    reaches = size * np.array(draw(st.lists(
        st.floats(0.3, 1.0), min_size=count, max_size=count)))
    centre = size * np.array([draw(st.floats(-1, 1)), draw(st.floats(-1, 1))])
    return centre + np.stack([reaches * np.cos(angles), reaches * np.sin(angles)], axis=1)


def distance(one, other):
    """Return the largest distance in m of the outlines of two polygons."""
    return shapely.hausdorff_distance(*(
        shapely.Polygon(vertices).exterior for vertices in (one, other)), densify=0.01)


@given(ORIGINS, polygons(), st.floats(1.0, 5000.0), st.data())
def test_files_are_read_across_180_degrees_as_anywhere_else(origin, vertices, radius, data):
    turned = replace(origin, longitude=10.0)
    latitudes, longitudes = turned.to_geographic(*vertices.T)
    results = []
    for own in (turned, origin):
        places = [(latitude, longitude if own is turned else (
            longitude - 10 + origin.longitude + 180) % 360 - 180)
            for latitude, longitude in zip(latitudes.tolist(), longitudes.tolist())]
        places = [(latitude, data.draw(st.sampled_from([-180.0, 180.0])) if abs(
            longitude) == 180 else longitude) for latitude, longitude in places]
        ring = [[longitude, latitude] for latitude, longitude in [*places, places[0]]]
        text = ' '.join(f'{longitude!r},{latitude!r}' for longitude, latitude in ring)
        with TemporaryDirectory() as folder:
            for name, content in (
                    ('a.geojson', json.dumps({'type': 'Polygon', 'coordinates': [ring]})),
                    ('a.plan', json.dumps({'geoFence': {
                        'version': 2, 'polygons': [{'polygon': places, 'inclusion': True}],
                        'circles': [{'inclusion': False, 'circle': {
                            'center': places[0], 'radius': radius}}]}})),
                    ('a.kml', '<kml><Placemark><Polygon><outerBoundaryIs><LinearRing>'
                     f'<coordinates>{text}</coordinates></LinearRing></outerBoundaryIs></Polygon>'
                     '</Placemark></kml>')):
                (Path(folder) / name).write_text(content)
                zones, fence = read_zones(Path(folder) / name, own)
                results += [zone.vertices for zone in zones] + ([fence] if fence else [])
    half = len(results) // 2
    assert half == 4
    for one, other in zip(results[:half], results[half:], strict=True):
        assert np.array(one) == pytest.approx(np.array(other), abs=1e-6)


@given(ORIGINS, polygons(), polygons(), st.integers(3, 9), st.floats(2000, 40_000))
def test_the_map_of_a_plan_is_cut_at_180_degrees_and_read_back(
        origin, zone, other, corners, reach):
    scenario = Scenario.load(CITY)
    high = [NoFlyZone(tuple(map(tuple, vertices.tolist())), 5000.0, ceiling, name)
            for vertices, ceiling, name in ((zone, math.inf, 'A'), (other, 6000.0, ''))]
    angles = 2 * np.pi * np.arange(corners) / corners
    scenario = replace(
        scenario, origin=origin, no_fly_zones=(*scenario.no_fly_zones, *high),
        geofence=tuple(zip(*(reach * trend(angles) for trend in (np.cos, np.sin)))))
    plan = city.plan_by_hand(scenario)
    with TemporaryDirectory() as folder:
        file = Path(folder) / 'a.geojson'
        plan.to_geojson(file)
        zones, fence = read_zones(file, origin)
        features = json.loads(file.read_text())['features']
    assert len(zones) == len(scenario.no_fly_zones)
    for found, expected, name in zip(zones, scenario.no_fly_zones, scenario.zone_names):
        assert replace(found, vertices=expected.vertices, name='') == replace(expected, name='')
        assert found.name == name and distance(found.vertices, expected.vertices) < 0.11
    assert distance(fence, scenario.geofence) < 0.11
    for item in features:
        geometry, properties = item['geometry'], item['properties']
        for line in [geometry] if geometry['type'] in ('LineString', 'Polygon') else [
                {'coordinates': part} for part in geometry['coordinates']
                if geometry['type'] != 'Point']:
            places = np.reshape([*flatten(line['coordinates'])], (-1, 2))
            assert np.abs(places[:, 0]).max() <= 180 and np.ptp(places[:, 0]) < 180
        if properties['kind'] == 'path':
            index = [uav.name for uav in scenario.uavs].index(properties['name'])
            places, times, powers = (np.array([*flatten(values)]) for values in (
                geometry['coordinates'], properties['times'], properties['powers']))
            assert np.abs(np.stack(origin.to_local(*places.reshape(-1, 2).T[::-1]), axis=1)
                          - plan.curve.at(times).positions[index]).max() < 0.5
            assert len(times) == len(powers) == len(places) / 2
            own = np.isin(times, plan.times[1:-1])
            assert set(powers[own]) == set(plan.powers[index])


def test_a_line_that_begins_at_180_degrees_has_no_part_without_length():
    geometry, values = _cut_line(np.array([[180.0, 10.0], [179.9, 10.0], [179.8, 10.0]]),
                                 {'times': [0.0, 1.0, 2.0], 'powers': None})
    assert geometry == {'type': 'LineString', 'coordinates': [
        (180.0, 10.0), (179.9, 10.0), (179.8, 10.0)]}
    assert values == {'times': [0.0, 1.0, 2.0], 'powers': None}


def flatten(values):
    """Give the numbers in nested lists."""
    for value in values if isinstance(values, list) else ():
        yield from flatten(value) if isinstance(value, list) else (value,)
