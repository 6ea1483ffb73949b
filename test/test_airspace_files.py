"""Files of zones, as QGroundControl 4, geojson.io and Google Earth write them."""

from contextlib import suppress
import json
import math

from city import FILE as CITY
import numpy as np
import pytest
from secure_uav_planner import Origin, read_zones, Scenario
from secure_uav_planner.errors import MissionFileError
from secure_uav_planner.mission.polygons import depth
from secure_uav_planner.ros.settings import load_mission
from test_geography import in_degrees, MODELS, ZURICH
import yaml

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
    (folder / name).write_bytes(text if isinstance(text, bytes) else text.encode())
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
            ({'ceiling': 60}, 408.0, 'it has ceiling and ceiling_amsl'),
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
    'double.geojson': (geojson(feature([SQUARE])).replace(
        '"coordinates"', '"coordinates": [], "coordinates"'), "'coordinates' comes twice"),
    'twice.plan': (qgc([(LATITUDE_FIRST, False)]).replace(
        '"inclusion"', '"inclusion": true, "inclusion"'), "'inclusion' comes twice"),
    'none.geojson': (geojson(feature([SQUARE]), feature([], 'MultiPolygon')), 'has no polygon'),
    'beside.geojson': (json.dumps({**feature([SQUARE]), 'area': feature([SQUARE])['geometry']}),
                       'it has a Polygon that is not the geometry of a feature'),
    'collection.geojson': (json.dumps({'type': 'GeometryCollection', 'geometries': [
        feature([SQUARE])['geometry'], feature(SQUARE[0], 'Point')['geometry']]}),
        "feature 1: it is a 'Point'"),
    'nothing.geojson': (json.dumps({'type': 'GeometryCollection', 'geometries': []}),
                        'feature 1: it has no polygon'),
    'unlocated.geojson': (geojson(feature([SQUARE]), {
        'type': 'Feature', 'geometry': None, 'properties': {'name': 'Lost'}}),
        'Lost: geometry is None'),
    'nowhere.geojson': (geojson(feature([SQUARE], name='Flat', ceiling=0)),
                        'Flat: its ceiling is 0 m above the ground, so that it holds nowhere'),
    'world.geojson': (geojson(feature([[[541, 47], [541.1, 47], [541, 47.1]]])),
                      'a corner has the latitude 47 and the longitude 541'),
    'beyond.geojson': (geojson(feature([[[180.001, 47], [179.9, 47], [179.9, 47.1]]])),
                       'a corner has the latitude 47 and the longitude 180.001; they must be'),
    'latin.geojson': (geojson(feature([SQUARE], name='?')).encode().replace(b'?', b'\xf6'),
                      'it is not UTF-8 text: invalid start byte'),
    'world.plan': (qgc(circles=[((47, 200), 5, True)]),
                   'circle 1: the centre has the latitude 47 and the longitude 200'),
    'fence1.plan': ('{"geoFence": {"version": 1, "polygon": [[47, 8], [47, 9], [48, 9]]}}',
                    'version of geoFence is 1; it must be 2'),
    'fence.plan': ('{"geoFence": {"polygons": []}}', 'version of geoFence is None'),
    'fields.plan': (qgc([(LATITUDE_FIRST, False)]).replace(
        '"polygons"', '"corridors": [[47, 8]], "polygons"'), "geoFence has 'corridors'"),
    'version.plan': (qgc([(LATITUDE_FIRST, False)]).replace(
        '"inclusion": false, "version": 1', '"inclusion": false, "version": 2'),
        'polygon 1: version is 2; it must be 1'),
    'both.plan': (qgc(circles=[(ZURICH, 5, True)]).replace(
        '"inclusion"', '"polygon": [], "inclusion"'), 'it is a polygon and a circle'),
    'list.json': ('[1]', 'type is None'), 'null.geojson': (geojson(None), 'feature 1: geometry'),
    'nan.geojson': (geojson(feature([[[math.nan, 1]] * 4])), 'feature 1: a corner is '),
    'two.plan': (qgc([(LATITUDE_FIRST, True)] * 2), 'it has 2 areas to stay in'),
    'radius.plan': (qgc(circles=[(ZURICH, -5, True)]), 'circle 1: radius is -5'),
    'pole.plan': (qgc(circles=[((89.9, 0), 5, True)]),
                  'circle 1: a place is 47.. km from the origin'),
    'vague.plan': (qgc([(LATITUDE_FIRST, None)]), 'polygon 1: inclusion is None'),
    'other.plan': ('{"fileType": "Plan"}', 'geoFence is None'),
    'broken.plan': ('{', 'line 1'),
    'zones.kmz': ('PK', 'its path must have the ending .geojson or .json'),
}


def check_refused(folder, name, text, reason):
    """Check that a file is refused in one line with its name and a reason."""
    with pytest.raises(MissionFileError, match=reason) as error:
        read(folder, name, text)
    assert str(error.value).startswith(f'{folder / name}: ')
    assert '\n' not in str(error.value) and len(str(error.value)) < 600


@pytest.mark.parametrize('name', HOSTILE)
def test_a_file_that_cannot_be_kept_is_refused_in_one_line_with_its_feature(tmp_path, name):
    check_refused(tmp_path, name, *HOSTILE[name])


def crs(name):
    return {'crs': {'type': 'name', 'properties': {'name': name}}}


def square(system, place=lambda data: data):
    """Return GeoJSON of the square with a coordinate system in one of its objects."""
    data = json.loads(geojson(feature([SQUARE], name='A')))
    place(data).update(system)
    return json.dumps(data)


PLACES = {'collection': lambda data: data, 'feature': lambda data: data['features'][0],
          'geometry': lambda data: data['features'][0]['geometry']}
EPSG = ('EPSG:4326', 'epsg:4979', 'urn:ogc:def:crs:EPSG::4326', 'urn:ogc:def:crs:EPSG:9.6:4979',
        'http://www.opengis.net/def/crs/EPSG/0/4326',
        'http://www.opengis.net/gml/srs/epsg.xml#4326')
CRS84 = ('urn:ogc:def:crs:OGC:1.3:CRS84', 'urn:ogc:def:crs:OGC::CRS84', 'OGC:CRS84',
         'http://www.opengis.net/def/crs/OGC/1.3/CRS84')


@pytest.mark.parametrize('place', PLACES)
def test_geojson_in_another_system_than_wgs84_is_refused_by_its_name(tmp_path, place):
    for number in (4267, 4314, 4277, 4301, 3857, 43260):
        for name in (f'urn:ogc:def:crs:EPSG::{number}', f'EPSG:{number}'):
            with pytest.raises(MissionFileError, match=f"crs is '{name}'; it must be CRS84"):
                read(tmp_path, 'a.geojson', square(crs(name), PLACES[place]))
    for system, shown in (
            (None, 'None'), ({}, 'None'), ({'type': 'EPSG', 'properties': {'code': 4267}}, '4267'),
            ({'type': 'link', 'properties': {'href': 'a.prj'}}, 'a.prj'), (4326, '4326'),
            ({'type': 'name', 'properties': {'name': 'urn:ogc:def:crs:OGC::CRS83'}}, 'CRS83')):
        with pytest.raises(MissionFileError, match=f'crs is .*{shown}'):
            read(tmp_path, 'a.geojson', square({'crs': system}, PLACES[place]))


@pytest.mark.parametrize('place', PLACES)
@pytest.mark.parametrize('name', EPSG + CRS84)
def test_geojson_in_wgs84_is_where_the_order_of_its_axes_puts_it(tmp_path, place, name):
    expected = read(tmp_path, 'a.geojson', geojson(feature([SQUARE], name='A')))
    text = square(crs(name), PLACES[place])
    assert read(tmp_path, 'a.geojson', text) == expected
    data = json.loads(text)
    data['features'][0]['geometry']['coordinates'] = [LATITUDE_FIRST]
    (tmp_path / 'a.geojson').write_text(json.dumps(data))
    if name in EPSG:
        assert read_zones(tmp_path / 'a.geojson', Origin(*ZURICH)) == expected
        with pytest.raises(MissionFileError, match='both lie near the origin'):
            data['features'][0]['geometry']['coordinates'] = [[[9, 9], [9.1, 9], [9.1, 9.2]]]
            (tmp_path / 'a.geojson').write_text(json.dumps(data))
            read_zones(tmp_path / 'a.geojson', Origin(9, 9))
    else:
        with pytest.raises(MissionFileError, match='a place is 5.* km'):
            read_zones(tmp_path / 'a.geojson', Origin(*ZURICH))


def test_a_geometry_collection_of_polygons_is_read(tmp_path):
    polygon = feature([SQUARE])['geometry']
    expected = read(tmp_path, 'a.geojson', geojson(feature([SQUARE], name='A')))[0]
    assert read(tmp_path, 'a.geojson', geojson({
        'type': 'Feature', 'properties': {'name': 'A'}, 'geometry': {
            'type': 'GeometryCollection', 'geometries': [polygon, {
                'type': 'GeometryCollection', 'geometries': [polygon]}]}}))[0] == 2 * expected


def test_the_name_of_a_feature_may_be_a_number(tmp_path):
    (first, second), _ = read(tmp_path, 'a.geojson', geojson(
        feature([SQUARE], name=7), feature([SQUARE], name=0)))
    assert (first.name, second.name) == ('7', '0')


@pytest.mark.parametrize('shift', [1e-13, -1e-13, 3e-12])
def test_a_last_corner_next_to_the_first_closes_a_ring(tmp_path, shift):
    last = [SQUARE[0][0] + shift, SQUARE[0][1] - shift]
    expected = read(tmp_path, 'a.geojson', geojson(feature([SQUARE])))
    for name, text in (
            ('a.geojson', geojson(feature([[*SQUARE[:-1], last]]))),
            ('b.geojson', geojson(feature([[*SQUARE, last]]))),
            ('a.plan', qgc([([*LATITUDE_FIRST, last[::-1]], False)]))):
        assert read(tmp_path, name, text)[0][0].vertices == expected[0][0].vertices


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
            ({'origin': None}, 'origin', 'a mission with airspace must have one: origin: {lat'),
            ({'origin': 5}, 'origin', 'origin is 5; it must be an origin or a mapping of its'),
            ({'airspace': '\ud83d'}, 'airspace', 'it must be text of whole characters'),
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
