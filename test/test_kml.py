"""Areas of KML: each is read as it is in force, or its file is refused."""

from contextlib import suppress
import math
from pathlib import Path
import re
from tempfile import TemporaryDirectory

from hypothesis import event, given, strategies as st
import pytest
from secure_uav_planner.errors import MissionFileError
from test_airspace_files import check_refused, feature, geojson, kml, read, SQUARE

RING = re.search('<LinearRing>.*</LinearRing>', kml(), re.S)[0]
POLYGON = re.search('<Polygon>.*</Polygon>', kml(), re.S)[0]
SCHEMA = '<Schema parent="Placemark" name="S_zone"><SimpleField name="a" type="string"/></Schema>'
EAST = RING.replace('8.54', '8.55')
EXTRUDED = '<extrude>1</extrude><altitudeMode>relativeToGround</altitudeMode>'
LEGACY = 'xmlns="http://earth.google.com/kml/2.1"'
MODERN = 'xmlns="http://www.opengis.net/kml/2.2"'

READ_KML = {
    'a placemark by Schema': kml(outside=f'{SCHEMA}<S_zone><name>B</name>{POLYGON}</S_zone>'),
    'a parent in an element': kml(outside=(
        f'<Schema name="S_zone"><parent>Placemark</parent></Schema><S_zone>{POLYGON}</S_zone>')),
    'a MultiGeometry': kml().replace(POLYGON, (
        f'<MultiGeometry><MultiGeometry>{POLYGON}</MultiGeometry>{POLYGON}</MultiGeometry>')),
    'two placemarks': kml(outside=f'<Placemark>{POLYGON}</Placemark>'),
    'another name space in it': kml(
        outside=f'<Placemark {LEGACY}>{POLYGON}</Placemark>'),
}
WHOLE_KML = {
    'KML 2.1': kml().replace(MODERN, LEGACY), 'no name space': kml().replace(MODERN, ''),
    'a name space of its own': kml().replace(MODERN, 'xmlns="urn:zones"'),
    'a prefix': re.sub('<(/?)(?=[A-Zakc])', r'<\1k:', kml(outside='')).replace(
        MODERN, MODERN.replace('xmlns', 'xmlns:k')),
    'ISO-8859-1': kml(name='Bahnh\xf6fe').replace('UTF-8', 'ISO-8859-1').encode('latin-1'),
    'windows-1252': kml(name='\u20ac').replace('UTF-8', 'windows-1252').encode('cp1252'),
    'UTF-16': kml(name='Bahnh\xf6fe').replace('UTF-8', 'UTF-16').encode('utf-16'),
    'a byte order mark': kml().encode('utf-8-sig'),
    'blanks beside commas': kml().replace(',47', ', 47').replace(',0', ' ,\n0'),
    'without heights': kml().replace(',0', ''), 'with a comment': kml().replace(
        '47.398', '47.<!-- a comment -->398', 1),
    'HTML in CDATA': kml(
        outside='<description><![CDATA[<!DOCTYPE html><b>&nbsp;]]></description>'),
    'entities of XML': kml(name='A &amp; B &#x1f681;'), 'in CDATA': kml(name='<![CDATA[A & B]]>'),
    'extruded on the ground': kml('<extrude>1</extrude>', height=50),
    'no offset': kml('<gx:altitudeOffset>-0.00</gx:altitudeOffset>'),
    'UTF-16 without a mark': kml().replace('UTF-8', 'UTF-16').encode('utf-16-le'),
}


@pytest.mark.parametrize('case', {**READ_KML, **WHOLE_KML})
def test_every_area_of_kml_is_read(tmp_path, case):
    expected, = read(tmp_path, 'a.geojson', geojson(feature([SQUARE])))[0]
    zones, fence = read(tmp_path, 'a.kml', {**READ_KML, **WHOLE_KML}[case])
    assert len(zones) == 2 - (case in WHOLE_KML) and fence is None
    for zone in zones:
        assert zone.vertices == expected.vertices and zone.ceiling == math.inf
    names = {'ISO-8859-1': 'Bahnh\xf6fe', 'windows-1252': '\u20ac', 'UTF-16': 'Bahnh\xf6fe',
             'entities of XML': 'A & B \U0001f681', 'in CDATA': 'A & B'}
    assert zones[-1].name == names.get(case, 'Rail yard')


@pytest.mark.parametrize('extrude', ['1', 'true', ' 1 ', '\n true\t'])
def test_extruded_areas_of_kml_end_at_their_height(tmp_path, extrude):
    (zone,), _ = read(tmp_path, 'a.kml', kml(
        EXTRUDED.replace('>1<', f'>{extrude}<'), height=60))
    assert (zone.floor, zone.ceiling) == (0.0, 60.0)


REFUSED_KML = {
    'a document type': (kml(head='<!DOCTYPE b SYSTEM "file:///etc/passwd">'), 'document type'),
    'a document type of HTML': (kml(head='<!doctype html>'), 'syntax error'),
    'unclosed': ('<kml>', 'no element found'), 'a link': (
        kml(outside='<NetworkLink><name>Live</name></NetworkLink>'), 'Live: it is in another'),
    'above the sea': (kml('<altitudeMode>absolute</altitudeMode>'), "Rail yard: .* 'absolute'"),
    'in the air': (kml('<altitudeMode>relativeToGround</altitudeMode>'), 'Rail yard: .*extruded'),
    'a hole': (kml('<innerBoundaryIs/>'), 'Rail yard: it has a hole'),
    'a time': (kml(outside='<name>Shows</name><TimeSpan/>'), 'Shows: it has a time of validity'),
    'a line': (kml().replace('Polygon', 'LineString'), 'Rail yard: it is a LineString'),
    'a height in words': (kml(height='high'), 'Rail yard: .*high'),
    'two rings': (kml().replace(RING, RING + EAST), "Rail yard: .*not read, '8.557,47.398"),
    'two outlines': (kml().replace('</Polygon>', (
        f'<outerBoundaryIs>{EAST}</outerBoundaryIs></Polygon>')), "not read, '8.557,47.398"),
    'two coordinates': (kml().replace('</LinearRing>', (
        '<coordinates>8.7,47.4 8.8,47.4 8.8,47.5</coordinates></LinearRing>')),
        "not read, '8.7,47.4 "),
    'a ring beside': (kml().replace(POLYGON, (
        f'<MultiGeometry>{POLYGON}{EAST}</MultiGeometry>')), 'it is a LinearRing'),
    'a point beside': (kml().replace(POLYGON, (
        f'<MultiGeometry>{POLYGON}<Point><coordinates>8.5,47.4</coordinates></Point>'
        '</MultiGeometry>')), 'it is a Point'),
    'a track': (kml().replace(POLYGON, (
        '<gx:Track><gx:coord>8.5 47.4 0</gx:coord></gx:Track>')), 'it is a Track'),
    'a polygon of GML': (kml().replace('</Placemark>', (
        f'<ExtendedData>{POLYGON}</ExtendedData></Placemark>')).replace(
        '<ExtendedData><Polygon>', '<ExtendedData><Polygon xmlns="urn:gml">'),
        'Rail yard: .*not read'),
    'a placemark in another': (kml().replace('</Placemark>', (
        f'<Placemark>{POLYGON}</Placemark></Placemark>')), 'not read'),
    'an undeclared tag': (kml(outside=f'<S_zone><name>B</name>{POLYGON}</S_zone>'),
                          'coordinates outside of a Placemark'),
    'a Schema of a Folder': (kml(outside=(
        f'{SCHEMA.replace("Placemark", "Folder")}<S_zone>{POLYGON}</S_zone>')), 'outside of a'),
    'a picture': (kml(outside=(
        '<GroundOverlay><gx:LatLonQuad><coordinates>8.5,47.4 8.6,47.4 8.6,47.5 8.5,47.5'
        '</coordinates></gx:LatLonQuad></GroundOverlay>')), 'LatLonQuad: .*outside of a'),
    'an update': (kml().replace('</kml>', (
        '<NetworkLinkControl><Update><Delete><Placemark/></Delete></Update></NetworkLinkControl>'
        '</kml>')), 'Update: it is in another'),
    'a time by Schema': (kml(outside=(
        f'{SCHEMA}<S_zone><name>B</name><TimeSpan/>{POLYGON}</S_zone>')), 'B: it has a time'),
    'an offset': (kml(EXTRUDED + '<gx:altitudeOffset>50</gx:altitudeOffset>', height=60),
                  "altitudeOffset is '50'"),
    'two modes': (kml(EXTRUDED, height=60).replace('<LinearRing>', (
        '<LinearRing><altitudeMode>absolute</altitudeMode>')), "altitudeModes 'rel.*'absolute'"),
    'a mode of the ring': (kml(height=60).replace('<LinearRing>', (
        f'<LinearRing>{EXTRUDED}')), "altitudeModes 'clampToGround' and 'relativeToGround'"),
    'over the sea floor': (kml('<extrude>1</extrude><gx:altitudeMode>relativeToSeaFloor'
                               '</gx:altitudeMode>', height=60), "'relativeToSeaFloor'"),
    'no height': (kml(EXTRUDED).replace(',0', ''), 'Rail yard: its ceiling is 0 m.*nowhere'),
    'a height of 0': (kml(EXTRUDED), 'its ceiling is 0 m'),
    'a height below': (kml(EXTRUDED, height=-5), 'ceiling is -5'),
    'a vague extrude': (kml('<extrude>yes</extrude>'), "extrude is 'yes'"),
    'a number of Python': (kml().replace('8.547', '8.5_47'), "a corner is '8.5_47,47.398,0'"),
    'no number': (kml(height='nan'), "a corner is '8.547,47.398,nan'"),
    'commas alone': (kml().replace(',0 ', ',0,'), 'Rail yard: a corner is '),
    'swapped': (kml().replace(RING, re.sub('([0-9.]+),([0-9.]+),0', r'\2,\1', RING)),
                'a place is 5.* km from the origin'),
    'a far longitude': (kml().replace('8.549', '541.5'), 'longitude 541.5; they must be from'),
    'an unknown encoding': (kml().replace('UTF-8', 'klingon'), 'unknown encoding'),
    'a wrong encoding': (kml(name='\xf6').encode('latin-1'), 'not well-formed'),
    'an entity': (kml(name='&nbsp;'), 'undefined entity'),
    'a bomb': ('<!DOCTYPE b [<!ENTITY a "%s">]><kml>%s</kml>' % ('a' * 99_999, '&a;' * 999_999),
               'it has a document type or entities'),
    'deep': ('<kml><Placemark>' + '<MultiGeometry>' * 99_999, 'no element found|unclosed'),
}


@pytest.mark.parametrize('case', REFUSED_KML)
def test_kml_that_cannot_be_kept_is_refused_in_one_line_with_its_feature(tmp_path, case):
    check_refused(tmp_path, f'{case}.kml', *REFUSED_KML[case])


COORDINATES = re.search('<coordinates>.*</coordinates>', kml(), re.S)[0]
TAGS = ('Document', 'Folder', 'Placemark', 'S_zone', 'MultiGeometry', 'Polygon', 'outerBoundaryIs',
        'innerBoundaryIs', 'LinearRing', 'LineString', 'gx:Track', 'ExtendedData', 'x')
TREES = st.recursive(
    st.sampled_from([COORDINATES, RING, POLYGON, f'<Placemark>{POLYGON}</Placemark>', SCHEMA]),
    lambda children: st.builds(
        lambda tag, parts: f'<{tag}>{"".join(parts)}</{tag}>', st.sampled_from(TAGS),
        st.lists(children, min_size=1, max_size=3)), max_leaves=8)


@given(st.lists(TREES, min_size=1, max_size=3))
def test_every_coordinates_element_is_a_zone_or_the_file_is_refused(trees):
    text = f'<kml {MODERN} xmlns:gx="http://www.google.com/kml/ext/2.2">{"".join(trees)}</kml>'
    with TemporaryDirectory() as folder, suppress(MissionFileError):
        zones, _ = read(Path(folder), 'a.kml', text)
        event('read')
        assert len(zones) == text.count('<coordinates>')
