"""Places on Earth: the projections of autopilots, missions in degrees, and airspace files."""

from contextlib import suppress
from dataclasses import replace
import json
import math
from types import SimpleNamespace

import city
from city import FILE as CITY
import numpy as np
import pytest
from secure_uav_planner import (
    Eavesdropper, fly_hover_fly, NoFlyZone, Origin, Plan, read_zones, Scenario)
from secure_uav_planner.apps.missions import check_mission
from secure_uav_planner.errors import MissionFileError, OptionError
from secure_uav_planner.mission.polygons import depth
from secure_uav_planner.plan.splice import cut_tail
from secure_uav_planner.ros.settings import load_mission, origin_from
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


def test_an_origin_stays_with_missions_and_plans_and_without_it_files_are_as_before(tmp_path):
    plain = Scenario.paper(120.0)
    assert 'origin' not in plain.to_dict()
    scenario = replace(plain, origin=Origin(*ZURICH, 'ardupilot'))
    for name in ('a.yaml', 'a.json'):
        scenario.save(tmp_path / name)
        assert Scenario.load(tmp_path / name) == scenario
    fly_hover_fly(scenario).save(tmp_path / 'plan.json')
    assert cut_tail(Plan.load(tmp_path / 'plan.json'), 3).scenario.origin == scenario.origin


def test_numbers_that_look_like_degrees_get_a_note(tmp_path, capsys):
    file = tmp_path / 'mission.yaml'
    scenario = Scenario.paper(120.0)
    for zone in ((8.54, 47.39), (8.56, 47.39), (8.56, 47.41)), ((0, 0), (9, 0), (9, 9)):
        replace(scenario, no_fly_zones=(NoFlyZone(zone),)).save(file)
        check_mission(SimpleNamespace(mission=str(file), autopilot=None))
        notes = capsys.readouterr().err
        assert ('note: zone 1: all places are within 1 m; are they degrees?' in notes) is (
            zone[0] != (0, 0)) and 'starts' not in notes
    places = {'ground_node': (8.54, 47.39), 'eavesdroppers': (Eavesdropper((8.55, 47.4)),),
              'uavs': tuple(replace(uav, start=(8.53, 47.39), goal=(8.56, 47.39))
                            for uav in scenario.uavs)}
    replace(scenario, **places).save(file)
    check_mission(SimpleNamespace(mission=str(file), autopilot=None))
    assert 'note: starts, goals and receivers: all places' in capsys.readouterr().err


# Airspace files, as QGroundControl 4, geojson.io and Google Earth write them

SQUARE = [[8.547, 47.398], [8.549, 47.398], [8.549, 47.399], [8.547, 47.399], [8.547, 47.398]]
LATITUDE_FIRST = [[latitude, longitude] for longitude, latitude in SQUARE[:-1]]


def feature(coordinates, kind='Polygon', **properties):
    return {'type': 'Feature', 'properties': properties,
            'geometry': {'type': kind, 'coordinates': coordinates}}


def geojson(*features):
    return json.dumps({'type': 'FeatureCollection', 'features': features})


def qgc(polygons=(), circles=()):
    return json.dumps({
        'fileType': 'Plan', 'groundStation': 'QGroundControl', 'version': 1,
        'geoFence': {'version': 2, 'polygons': [
            {'polygon': corners, 'inclusion': inclusion, 'version': 1}
            for corners, inclusion in polygons], 'circles': [
            {'circle': {'center': centre, 'radius': radius}, 'inclusion': inclusion, 'version': 1}
            for centre, radius, inclusion in circles]},
        'mission': {'items': [], 'version': 2}, 'rallyPoints': {'points': [], 'version': 2}})


def kml(inside='', name='Rail yard', head='', height=0, outside=''):
    corners = ' '.join(f'{longitude},{latitude},{height}' for longitude, latitude in SQUARE)
    return f"""<?xml version="1.0" encoding="UTF-8"?>{head}
<kml xmlns="http://www.opengis.net/kml/2.2" xmlns:gx="http://www.google.com/kml/ext/2.2">
<Document><name>Zones.kml</name><Folder>{outside}<Placemark><name>{name}</name><Polygon>{inside}
<outerBoundaryIs><LinearRing><coordinates>\n\t{corners} \n</coordinates></LinearRing>
</outerBoundaryIs></Polygon></Placemark></Folder></Document></kml>"""


def read(folder, name, text, projection='px4', altitude=None):
    (folder / name).write_text(text)
    return read_zones(folder / name, Origin(*ZURICH, projection, altitude))


@pytest.mark.parametrize('projection', MODELS)
def test_zones_of_all_formats_are_where_the_autopilot_takes_them_to_be(tmp_path, projection):
    corners = [MODELS[projection](ZURICH, place) for place in LATITUDE_FIRST]
    east = [[[longitude + 0.01, latitude] for longitude, latitude in SQUARE]]
    zones, fence = read(tmp_path, 'a.geojson', geojson(
        feature([SQUARE], name='Rail yard', floor=10, ceiling=60.0, stroke='#555555'),
        feature([[SQUARE], east], 'MultiPolygon')), projection)
    assert fence is None and [(zone.name, zone.floor, zone.ceiling) for zone in zones] == [
        ('Rail yard', 10.0, 60.0), ('', 0.0, math.inf), ('', 0.0, math.inf)]
    extruded = '<extrude>1</extrude><altitudeMode>relativeToGround</altitudeMode>'
    named, = read(tmp_path, 'a.kml', kml(extruded, height=60), projection)[0]
    ground, = read(tmp_path, 'b.kml', kml(height=450), projection)[0]
    assert (named.name, named.ceiling, ground.ceiling) == ('Rail yard', 60.0, math.inf)
    (excluded,), included = read(tmp_path, 'a.plan', qgc(
        [(LATITUDE_FIRST, False), (LATITUDE_FIRST, True)]), projection)
    for vertices in (zones[0].vertices, zones[1].vertices, named.vertices, ground.vertices,
                     excluded.vertices, included):
        assert np.array(vertices) == pytest.approx(np.array(corners), abs=1e-6)
    assert zones[2].vertices[0] == pytest.approx(
        MODELS[projection](ZURICH, (47.398, 8.557)), abs=1e-6)


def test_altitudes_above_sea_level_are_those_above_the_stated_ground(tmp_path):
    absolute = '<extrude>1</extrude><altitudeMode>absolute</altitudeMode>'
    relative = absolute.replace('absolute', 'relativeToGround')
    for inside, height, ceiling in (
            (absolute, 468, 60.0), (relative, 60, 60.0), ('', 468, math.inf)):
        (zone,), _ = read(tmp_path, 'a.kml', kml(inside, height=height), altitude=408.0)
        assert (zone.floor, zone.ceiling) == (0.0, ceiling)
    for inside, altitude, reason in (
            (absolute, None, "'absolute'"), (absolute, 470, 'ceiling is -2'),
            (absolute.replace('1', '0'), 408, "'absolute'.* extruded")):
        with pytest.raises(MissionFileError, match=f'Rail yard.*{reason}'):
            read(tmp_path, 'a.kml', kml(inside, height=468), altitude=altitude)
    heights = {'name': 'CTR', 'floor_amsl': 400, 'ceiling_amsl': 468}  # From below the ground.
    (zone,), _ = read(tmp_path, 'a.geojson', geojson(feature([SQUARE], **heights)), altitude=408.0)
    assert (zone.floor, zone.ceiling) == (0.0, 60.0)
    for change, altitude, reason in (
            ({}, None, 'floor_amsl is 400; it must be .* the altitude of the ground'),
            ({'ceiling_amsl': '1500 ft'}, 408.0, "ceiling_amsl is '1500 ft'"),
            ({}, 470.0, 'ceiling is -2')):
        with pytest.raises(MissionFileError, match=f'CTR.*{reason}'):
            read(tmp_path, 'a.geojson', geojson(feature([SQUARE], **heights | change)),
                 altitude=altitude)
    # In a mission file, whose nodes take the zones alone.
    data = yaml.safe_load(CITY.read_text()) | {'airspace': 'b.kml', 'origin': dict(
        zip(('latitude', 'longitude', 'altitude'), (*ZURICH, 408)))}
    (tmp_path / 'b.kml').write_text(kml(absolute, height=468))
    (tmp_path / 'a.yaml').write_text(yaml.safe_dump(data))
    scenario, values = Scenario.load(tmp_path / 'a.yaml'), load_mission(tmp_path / 'a.yaml')
    assert scenario.origin.altitude == 408 and scenario.no_fly_zones[-1].ceiling == 60
    assert values['Rail_yard.ceiling'] == 60 and 'origin.altitude' not in values


@pytest.mark.parametrize('projection', MODELS)
def test_a_polygon_for_a_circle_is_on_the_safe_side_of_it(tmp_path, projection):
    centre, radius = (47.45, 8.65), 300.0
    (zone,), fence = read(tmp_path, 'a.plan', qgc(
        circles=[(centre, radius, False), (centre, radius, True)]), projection)
    own = Origin(*centre, projection)
    for vertices, safe in ((zone.vertices, 1), (fence, -1)):
        # Edges in the frame of the circle itself, in which the autopilot measures its radius.
        corners = np.stack(own.to_local(*Origin(*ZURICH, projection).to_geographic(
            *np.array(vertices).T)), axis=1)
        middles = (corners + np.roll(corners, -1, axis=0)) / 2
        reach = np.linalg.norm(np.concatenate([corners, middles]), axis=1)
        assert len(corners) == 32 and (safe * (reach - radius) > -1e-3).all()
        assert np.abs(reach - radius).max() < 0.005 * radius


def test_a_long_edge_is_straight_in_degrees(tmp_path):
    ring = [[8.5, 47.4], [8.7, 47.4], [8.7, 47.45], [8.5, 47.45]]
    (zone,), _ = read(tmp_path, 'a.geojson', geojson(feature([ring])))
    origin = Origin(*ZURICH)
    places = np.stack(origin.to_local(np.full(500, 47.4), np.linspace(8.5, 8.7, 500)), axis=1)
    assert len(zone.vertices) < 40
    assert np.abs(depth(zone.vertices, places)).max() < 0.11 < 1 < np.abs(depth(tuple(
        zip(*map(np.ndarray.tolist, origin.to_local(*np.array(ring).T[::-1])))), places)).max()


HOSTILE = {
    'hole.geojson': (geojson(feature([SQUARE, SQUARE], name='Ring')), 'Ring: it has a hole'),
    'sea.geojson': (geojson(feature([SQUARE], name='CTR', upper=900, upperReference='AMSL')),
                    "CTR: it has 'upper', a height that may be above sea level"),
    'height.geojson': (geojson(feature([[[*corner, 500] for corner in SQUARE]], name='Peak')),
                       'Peak: a corner has the altitude 500 m, which is not above the ground'),
    'times.geojson': (geojson(feature([SQUARE], name='Fair', limits={'startDateTime': '2026'})),
                      "Fair: it has 'startDateTime', a time"),
    'swapped.geojson': (geojson(feature([[corner[::-1] for corner in SQUARE]], name='Swap')),
                        'Swap: a place is 5.* km from the origin'),
    'point.geojson': (geojson(feature(SQUARE[0], 'Point', name='Dot')), "Dot: it is a 'Point'"),
    'text.geojson': (geojson(feature([SQUARE], name='Text', ceiling='120 m')),
                     "Text: Text.ceiling is '120 m'; it must be a number .*without its unit"),
    'number.geojson': (geojson(feature([[['8', 47]] * 4])), 'feature 1: a corner is '),
    'many.geojson': (geojson(*[feature([SQUARE])] * 1001), 'it has 1001 features'),
    'deep.geojson': ('[' * 100_000, 'it has too many levels'),
    'crossing.json': (json.dumps({'type': 'Polygon', 'coordinates': [
        [SQUARE[0], SQUARE[2], SQUARE[1], SQUARE[3]]]}), 'feature 1: .*crosses'),
    'empty.geojson': (geojson(), 'it has no area'),
    'list.json': ('[1]', 'type is None'), 'null.geojson': (geojson(None), 'feature 1: geometry'),
    'nan.geojson': (geojson(feature([[[math.nan, 1]] * 4])), 'feature 1: a corner is '),
    'two.plan': (qgc([(LATITUDE_FIRST, True)] * 2), 'it has 2 areas to stay in'),
    'radius.plan': (qgc(circles=[(ZURICH, -5, True)]), 'circle 1: radius is -5'),
    'pole.plan': (qgc(circles=[((89.9, 0), 5, True)]), 'circle 1: origin.latitude is 89.9'),
    'vague.plan': (qgc([(LATITUDE_FIRST, None)]), 'polygon 1: inclusion is None'),
    'other.plan': ('{"fileType": "Plan"}', 'geoFence is None'),
    'broken.plan': ('{', 'line 1'),
    'bomb.kml': (kml('&a;', head='<!DOCTYPE b [<!ENTITY a "aaaa"><!ENTITY b "&a;&a;">]>'),
                 'it has a document type or entities'),
    'file.kml': (kml(head='<!doctype b SYSTEM "file:///etc/passwd">'), 'document type'),
    'unclosed.kml': ('<kml>', 'no element found'), 'link.kml': (
        kml(outside='<NetworkLink><name>Live</name></NetworkLink>'), 'Live: it is in another'),
    'sea.kml': (kml('<altitudeMode>absolute</altitudeMode>'), "Rail yard: .* 'absolute'"),
    'air.kml': (kml('<altitudeMode>relativeToGround</altitudeMode>'), 'Rail yard: .*extruded'),
    'hole.kml': (kml('<innerBoundaryIs/>'), 'Rail yard: it has a hole'),
    'time.kml': (kml(outside='<name>Shows</name><TimeSpan/>'), 'Shows: it has a time of validity'),
    'line.kml': (kml().replace('Polygon', 'LineString'), 'Rail yard: it is a LineString'),
    'words.kml': (kml(height='high'), 'Rail yard: .*high'),
    'zones.kmz': ('PK', 'its path must have the ending .geojson or .json'),
}


@pytest.mark.parametrize('name', HOSTILE)
def test_a_file_that_cannot_be_kept_is_refused_in_one_line_with_its_feature(tmp_path, name):
    text, reason = HOSTILE[name]
    with pytest.raises(MissionFileError, match=reason) as error:
        read(tmp_path, name, text)
    assert str(error.value).startswith(f'{tmp_path / name}: ')
    assert '\n' not in str(error.value) and len(str(error.value)) < 600


def replaced(value, odd):
    """Yield copies of nested values in each of which another part is odd."""
    yield odd
    for key, item in value.items() if isinstance(value, dict) else (
            enumerate(value) if isinstance(value, list) else ()):
        for other in replaced(item, odd):
            copy = value.copy()
            copy[key] = other
            yield copy


@pytest.mark.parametrize('name, text', [
    ('a.geojson', geojson(feature([SQUARE], name='A', floor=1, ceiling=2))),
    ('a.plan', qgc([(LATITUDE_FIRST, True)], [(ZURICH, 50.0, False)]))])
def test_odd_values_anywhere_in_a_file_are_read_or_refused(tmp_path, name, text):
    for odd in (None, True, -1, 1e300, math.nan, 10**400, 'x', '', [], {}, [[]], [[1, 2, 3]] * 4):
        for data in replaced(json.loads(text), odd):
            with suppress(MissionFileError):
                read(tmp_path, name, json.dumps(data))


def test_a_mission_takes_zones_and_fence_from_the_file_beside_it(tmp_path):
    data = in_degrees(yaml.safe_load(CITY.read_text()), Origin(*ZURICH))
    fence = [[place['latitude'], place['longitude']] for place in data.pop('geofence')]
    data |= {'origin': dict(zip(('latitude', 'longitude'), ZURICH)), 'airspace': 'a/zones.plan'}
    (tmp_path / 'a').mkdir()
    zones, vertices = read(tmp_path / 'a', 'zones.plan', qgc(
        [(fence, True), ([[*place] for place in LATITUDE_FIRST], False)]))
    file = tmp_path / 'mission.yaml'
    file.write_text(yaml.safe_dump(data))
    scenario = Scenario.load(file)
    assert scenario.zone_names == ('hospital', 'tower', 'stadium', 'polygon 2')
    assert scenario.no_fly_zones[3:] == zones and scenario.geofence == vertices
    for change, line, reason in (
            ({'origin': None}, 'origin', 'origin is null; it must be a'),
            ({'origin': {'latitude': 99}}, 'origin', 'origin lacks longitude'),
            ({'airspace': 'no.kml'}, 'airspace', "'no.kml' cannot be read: No such file"),
            ({'airspace': 3}, 'airspace', 'airspace is 3; it must be the path of a file'),
            ({'geofence': [[-480, -420], [480, -420], [480, 420], [-480, 420]]}, 'geofence',
             'in the mission and in its airspace')):
        file.write_text(yaml.safe_dump({**data, **change, 'slots': -1}))
        with pytest.raises(MissionFileError) as error:
            Scenario.load(file)
        text = file.read_text().splitlines()
        problem, = [item for item in error.value.problems if reason in item[1]]
        assert text[problem[0] - 1].startswith(line)
        assert any('slots is -1' in item[1] for item in error.value.problems)


def test_a_plan_is_a_map_whose_places_are_those_of_the_plan(tmp_path):
    scenario = replace(Scenario.load(CITY), origin=Origin(*ZURICH, 'ardupilot'))
    plan = city.plan_by_hand(scenario)
    with pytest.raises(OptionError, match='origin is None'):
        city.plan_by_hand(Scenario.load(CITY)).to_geojson(tmp_path / 'no.geojson')
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
    for item, eve in zip(listed('eavesdropper'), scenario.eavesdroppers, strict=True):
        assert np.linalg.norm(metres(item) - eve.position, axis=1) == pytest.approx(
            item['properties']['error_radius'], abs=1e-6)
    assert metres(listed('ground_node')[0]) == pytest.approx(np.zeros((1, 2)), abs=1e-6)
    assert not listed('track')
    # Zones come back as they were.
    (tmp_path / 'zones.geojson').write_text(geojson(*listed('zone')))
    zones, _ = read_zones(tmp_path / 'zones.geojson', scenario.origin)
    for zone, expected in zip(zones, scenario.no_fly_zones, strict=True):
        assert replace(zone, vertices=expected.vertices) == expected
        assert np.abs(depth(zone.vertices, expected.vertices)).max() < 1e-6
    assert np.abs(depth(scenario.geofence, metres(*listed('geofence')))).max() < 1e-6


def test_receivers_that_move_are_lines_of_their_knots_on_a_map(tmp_path):
    node, car = ((0, 1, 2), (126, 20, 0)), ((0, 200, 0, 10), (60, 210, 5, 20), (126, 200, 20, 5))
    scenario = replace(
        Scenario.paper(120.0, slots=20), ground_node=None, ground_node_track=node,
        eavesdroppers=(Eavesdropper((9.0, 9.0)), Eavesdropper(name='car', track=car)),
        origin=Origin(*ZURICH))
    fly_hover_fly(scenario).to_geojson(tmp_path / 'plan.geojson')
    features = json.loads((tmp_path / 'plan.geojson').read_text())['features']
    tracks = [item for item in features if item['properties']['kind'] == 'track']
    assert [item['properties']['name'] for item in tracks] == ['ground_node', 'car']
    for item, track in zip(tracks, (node, car), strict=True):
        assert item['geometry']['type'] == 'LineString'
        times, x, y, *radii = map(list, zip(*track))
        assert item['properties']['times'] == times
        assert item['properties']['radii'] == (radii[0] if radii else None)
        longitudes, latitudes = zip(*item['geometry']['coordinates'])
        assert np.array(scenario.origin.to_local(latitudes, longitudes)) == pytest.approx(
            np.array([x, y]), abs=1e-6)
