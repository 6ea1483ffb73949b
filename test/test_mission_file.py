"""Missions as files: right values survive, and all errors are reported with their lines."""

from dataclasses import fields, replace
import json
import math
import pickle
import re

from processes import ROOT
import pytest
from secure_uav_planner import (
    Channel, Eavesdropper, fly_hover_fly, GroundNode, NoFlyZone, Origin, Plan, Propulsion,
    Scenario, Uav)
from secure_uav_planner.apps.campaign_file import load_campaign
from secure_uav_planner.errors import MissionFileError
from secure_uav_planner.mission.fields import Number, Pair
from secure_uav_planner.mission.formats.documents import MOST_BYTES
from secure_uav_planner.output.tables import save_csv
import yaml

ZONE = NoFlyZone(((150.0, 0.0), (160.0, 0.0), (150.0, 10.0)), 5.0, 120.0, 'tower')
RICH = Scenario(
    ground_nodes=(
        GroundNode((0.0, 0.0), 'barn', 2.0, trusted=False),
        GroundNode(name='cart', track=((0.0, 5.0, 0.0), (60.0, 5.0, 5.0)))),
    eavesdroppers=(
        Eavesdropper((200.0, 0.0), 10.0, 'drone', 3.0),
        Eavesdropper(track=((0.0, 200.0, -300.0, 10.0), (200.0, 200.0, 300.0, 20.0)))),
    uavs=tuple(replace(
        uav, average_power=0.5, peak_power=2.0, max_acceleration=2.5, max_energy=40e3,
        start_velocity=(0.0, -1.0), goal_velocity=None,
        propulsion=Propulsion(80.0, 90.0, 150.0, 5.0, 0.5, 1.2, 0.04, 0.5))
        for uav in Scenario.paper().uavs),
    duration=200.0, slots=100, reference_snr_db=70.0, separation=5.0, tracking_margin=1.5,
    no_fly_zones=(ZONE, NoFlyZone(((170.0, 0.0), (180.0, 0.0), (170.0, 10.0)))),
    geofence=((-900.0, -900.0), (900.0, -900.0), (900.0, 900.0), (-900.0, 900.0)),
    origin=Origin(47.3977, 8.5456, 'ardupilot', 408.0), colluding=True,
    channel=Channel(2.6, (5.0, 0.2, 12.0), True, 3.0, 0.1), head_starts=(0.0, 70.0))
"""A mission in which no field has its default."""


def write_file(folder, text, name='mission.yaml'):
    file = folder / name
    file.write_text(text)
    return file


def change_values(data, change):
    """Return a dictionary, as JSON reads it, with changed values at some paths."""
    data = json.loads(json.dumps(data))
    for path, value in change.items():
        *owners, last = [int(part) if part.isdigit() else part for part in path.split('/')]
        inner = data
        for owner in owners:
            inner = inner[owner]
        inner[last] = value
    return data


def load_problems(file):
    """Return the problems of a file, as (line, text)."""
    with pytest.raises(MissionFileError) as error:
        Scenario.load(file)
    assert '\n' not in str(error.value) and len(str(error.value)) < 600
    assert str(error.value).startswith(str(file))
    assert all('\n' not in text and len(text) < 400 for _, text in error.value.problems)
    return [tuple(problem) for problem in error.value.problems]


def check_problems(problems, expected):
    """Assert that problems have the expected lines, and texts that contain the expected parts."""
    assert len(problems) == len(expected), problems
    for (line, text), (wanted_line, part) in zip(problems, expected):
        assert line == wanted_line and part in text, (line, text, part)


@pytest.mark.parametrize('name', ['a.yaml', 'a.json', 'a.yml', 'a'])
def test_all_fields_survive_a_file(tmp_path, name):
    for members in ((RICH,), RICH.ground_nodes, RICH.eavesdroppers, RICH.uavs,
                    (RICH.uavs[0].propulsion,), RICH.no_fly_zones, (RICH.channel,),
                    (RICH.origin,)):
        for field in fields(members[0]):
            assert {getattr(member, field.name) for member in members} - {field.default}
    RICH.save(tmp_path / name)
    again = Scenario.load(tmp_path / name)
    assert again == RICH and hash(again) == hash(RICH)
    for word in ('yes', '1e3', 'null', '01', '1:30', '<<', '~', "o'neill", 'ü: "x" #', ' a '):
        odd = replace(RICH, uavs=(replace(RICH.uavs[0], name=word), RICH.uavs[1]))
        odd.save(tmp_path / name)
        assert Scenario.load(tmp_path / name) == odd


def test_a_saved_mission_is_plain_yaml_without_what_has_its_default(tmp_path):
    RICH.save(tmp_path / 'a.yaml')
    text = (tmp_path / 'a.yaml').read_text()
    assert Scenario.from_dict(yaml.safe_load(text)) == RICH and 'start: [100.0, 500.0]' in text
    assert not {'channel', 'colluding', 'ground_nodes', 'origin'} & {*Scenario.paper().to_dict()}


def test_all_wrong_values_are_reported_with_their_lines(tmp_path):
    problems = load_problems(write_file(tmp_path, """\
ground_node: [0, 0]
eavesdropper: []
eavesdroppers:
  - {position: [200, 0], error_radius: 10 m}
uavs:
  - name: a
    start: [0, 100]
    goal: [1e3]
    average_power: 5
    peak_power: 4
    max_speed: 10
  - {name: b, start: [0, 0], goal: [0, 90000], altitude: 100, max_speed: 10}
  - name: c
    start: [0, 0]
    goal: [0, 0]
    altitude: 36 km
    altitude: 36
    max_speed: [10]
    hover: true
    propulsion:
      blade_power: 70 W
      solid: 0.1
no_fly_zones:
  - {vertices: [[0, 0], [1, 1]], floor: 5, ceiling: 1}
duration: 100
separation: -3
channel:
  exponent: 7
  loss: urban
  los: town
  outage: 0.1
colluding: maybe
"""))
    expected = [
        (1, 'mission lacks slots'),
        (2, "mission has no field 'eavesdropper'; did you mean eavesdroppers?"),
        (4, "error_radius is '10 m'; it must be a number from 0 to 1e+07, in m, without"),
        (6, 'uavs[0] lacks altitude'),
        (8, 'a.goal is [1000.0]; it must be two coordinates'),
        (10, 'a.peak_power is 4.0; it must be at least average_power, which is 5.0'),
        (17, "'altitude' comes twice"), (18, 'c.max_speed is [10]; it must be a number'),
        (19, "uavs[2] has no field 'hover'"),
        (21, "c.propulsion.blade_power is '70 W'; it must be a number from 0 to 1e+06, in W, "
         'without its unit'),
        (22, "c.propulsion has no field 'solid'; did you mean solidity?"),
        (24, 'zone vertices'), (24, 'zone floor is 5.0 m; it must be at most ceiling'),
        (26, 'separation is -3; it must be a number from 0 to 1e+06 m'),
        (27, 'rician_k_db is null'), (28, 'channel.exponent is 7'), (29, "no field 'loss'"),
        (30, 'null, one of suburban, urban, dense_urban, highrise'), (32, 'colluding is')]
    check_problems(problems, expected)


def test_inconsistencies_are_all_reported_once_the_fields_are_right(tmp_path):
    text = """\
ground_node: [0, 0]
eavesdroppers: [{position: [200, 0]}]
uavs:
  - {name: a, start: [0, 0], goal: [0, 900], altitude: 100, max_speed: 10, average_power: 5}
  - {name: a, start: [5, 0], goal: [50, 0], altitude: 100, max_speed: 10}
  - {name: b, start: [3, 0], goal: [900, 0], altitude: 100, max_speed: 10}
geofence: [[-100, -100], [800, -100], [800, 950], [-100, 950]]
duration: 60
slots: 60
separation: 20
"""
    check_problems(load_problems(write_file(tmp_path, text)), [
        (4, 'a.peak_power is 4.0; it must be at least average_power')])
    check_problems(load_problems(write_file(tmp_path, text.replace('_power: 5', '_power: 3'))), [
        (5, "uavs are named ['a', 'a', 'b']; the names must be unique"),
        (6, 'b.goal is (900.0, 0.0), outside the geofence'),
        (8, 'duration is 60 s; a needs at least 88.5246 s'),
        (8, 'duration is 60 s; b needs at least 88.2296 s'),
        (10, 'separation is 20 m; it must be at most 2 m, the distance between the starts of a '
         'and b')])


def test_missing_fields_take_the_default_of_their_class_or_the_value_of_the_merged_uav(tmp_path):
    scenario = Scenario.load(write_file(tmp_path, """
ground_node: [0, 0]
duration: 200
slots: 1e2
eavesdroppers: [{position: [200, 0]}]
uavs:
  - &first {name: one, start: [0, 0], goal: [100, 0], altitude: 100, max_speed: 10}
  - {<<: *first, name: two, altitude: 110}
no_fly_zones: [{vertices: [[150, 0], [160, 0], [150, 10]]}]
"""))
    assert scenario == Scenario((0, 0), (Eavesdropper((200, 0)),), (
        Uav('one', (0, 0), (100, 0), 100, 10), Uav('two', (0, 0), (100, 0), 110, 10)), 200, 100,
        no_fly_zones=(NoFlyZone(((150, 0), (160, 0), (150, 10))),))


@pytest.mark.parametrize('path, value, start, end', [
    ('eavesdroppers', {'a': [False]}, "eavesdroppers is {'a': [false]}",
     'a list of 1 to 32 eavesdropper'),
    ('ground_node', math.inf, 'ground_node is inf;', ' 1e+07 m'),
    ('uavs/0/start_velocity', 5, 'uav1.start_velocity is 5; it must be null or', ' m/s'),
    ('uavs/0/propulsion', {'blade_power': -5}, 'uav1.propulsion.blade_power is -5', ' 1e+06 W'),
    ('geofence', 100, 'geofence is 100', ' in m'),
    ('channel', {'los': 'city'}, "channel.los is 'city'; it must be null, one of suburban, ", ''),
    ('channel', {'outage': 0.1}, 'channel.rician_k_db is null; it must be a number', ''),
    ('duration', '200s', "duration is '200s'", ', in s, without its unit'),
    ('channel', {'exponent': '2.4GHz'}, 'channel.exponent is', ', without a unit')])
def test_values_are_reported_in_yaml_notation_with_their_units(tmp_path, path, value, start, end):
    data = change_values(Scenario.paper().to_dict(), {path: value})
    [(_, text)] = load_problems(write_file(tmp_path, yaml.safe_dump(data)))
    assert text.startswith(start) and text.endswith(end) and ' m m' not in text
    assert not re.search('True|None|False|tuple|dict|float', text)


def test_plans_parameter_files_and_campaigns_are_recognised(tmp_path):
    fly_hover_fly(Scenario.paper()).save(tmp_path / 'plan.json')
    campaign = write_file(tmp_path, 'mission: a.yaml\nvary: {duration: [120]}\n', 'campaign.yaml')
    for file, kind in ((tmp_path / 'plan.json', 'a plan'), (campaign, 'a campaign'),
                       (ROOT / 'config' / 'paper.yaml', 'a parameter file')):
        [(_, text)] = load_problems(file)
        assert text.startswith(f'it is {kind}')
        if file != campaign:
            with pytest.raises(MissionFileError, match=f'it is {kind}'):
                load_campaign(file)


ROBOT = '\U0001f681 one'


@pytest.mark.parametrize('name', ['a.yaml', 'a.json'])
@pytest.mark.parametrize('mark', ['', '\ufeff'])
def test_names_are_those_that_json_writes_and_a_byte_order_mark_is_taken(tmp_path, name, mark):
    data = json.dumps(change_values(RICH.to_dict(), {'uavs/0/name': ROBOT}))
    assert r'\ud83d\ude81 one' in data
    scenario = Scenario.load(write_file(tmp_path, mark + data, name))
    assert scenario.uavs[0].name == ROBOT
    first, second = Scenario.paper().uavs
    plan = fly_hover_fly(replace(Scenario.paper(), uavs=(
        replace(first, name=json.loads(json.dumps(ROBOT)[:7] + '"') + chr(0xde81) + ' one'),
        second)))
    save_csv(plan, tmp_path / 'plan.csv')
    assert ROBOT in (tmp_path / 'plan.csv').read_text(encoding='utf-8')
    plan.save(tmp_path / 'plan.json')
    text = (tmp_path / 'plan.json').read_text()
    (tmp_path / 'plan.json').write_text(mark + text, encoding='utf-8')
    assert Plan.load(tmp_path / 'plan.json').scenario.uavs[0].name == ROBOT
    campaign = write_file(tmp_path, mark + json.dumps({'mission': name}), 'campaign.json')
    assert load_campaign(campaign).mission == scenario


def test_half_of_a_character_is_refused_with_its_line(tmp_path):
    text = json.dumps(change_values(RICH.to_dict(), {'uavs/0/name': ROBOT}), indent=1)
    [(line, problem)] = load_problems(write_file(tmp_path, text.replace(r'\ude81', ''), 'a.yaml'))
    assert text.splitlines()[line - 1].strip().startswith('"name": "\\ud83d')
    assert "name is '\\ud83d one'; it must be text of whole characters" in problem


@pytest.mark.parametrize('member', [7, None, [], 'uav1'])
def test_a_wrong_member_does_not_hide_the_errors_of_another(tmp_path, member):
    data = change_values(RICH.to_dict(), {'uavs/0': member, 'uavs/1/start': [2e9, 0.0]})
    problems = load_problems(write_file(tmp_path, json.dumps(data), 'a.json'))
    assert any(text.startswith('uavs[0] is ') for _, text in problems), problems
    assert any('uav2.start is ' in text for _, text in problems)


SYNTAX = [
    ('', 'empty'), ('# only a comment\n', 'empty'), ('null', 'empty'), ('[]', 'mapping'),
    ('7', 'mapping'), ('a mission', 'mapping'), ('uavs: [1, 2', 'expected'),
    ('uavs:\n\t- a', 'cannot start any token'), ('a: b: c', 'mapping values are not allowed'),
    ('a: *b', 'undefined alias'), ('a: !!python/object:os.system x', 'could not determine'),
    ('a: !!timestamp 2020-01-01', 'could not determine'), ('a: !!bool abc', "'abc'"),
    ('a: 1\n---\nb: 2\n', 'single document'), ('a: \x01', 'special characters'),
    ('[' * 30 + ']' * 30, 'levels'), ('{' * 1500 + '}' * 1500, 'levels'),
    ('a: &a [*a]', 'levels'), ('uavs: ' + '9' * 5000, ''), ('[1]: 2', 'must be text'),
    ('a: &a [' + '1, ' * 20 + ']\n' + ''.join(
        f'{chr(98 + n)}: &{chr(98 + n)} [{", ".join(["*" + chr(97 + n)] * 20)}]\n'
        for n in range(8)), 'values')]


@pytest.mark.parametrize('text, reason', SYNTAX, ids=range(len(SYNTAX)))
def test_a_file_with_wrong_syntax_is_refused_in_one_line(tmp_path, text, reason):
    for name in ('a.yaml', 'a.json'):
        problems = load_problems(write_file(tmp_path, text, name))
        assert problems
        if name == 'a.yaml':
            assert any(reason in text for _, text in problems), problems


def test_a_syntax_error_has_its_line(tmp_path):
    [(line, _)] = load_problems(write_file(tmp_path, 'duration: 1\nuavs: [\nslots: }\n'))
    assert line == 3
    [(line, _)] = load_problems(write_file(tmp_path, '{"duration": 1,\n"uavs" [}', 'a.json'))
    assert line == 2


def test_binary_too_large_and_irregular_files_are_refused(tmp_path):
    file = tmp_path / 'a.yaml'
    file.write_bytes(b'duration: \xff\xfe')
    assert 'not UTF-8' in load_problems(file)[0][1]
    with open(file, 'wb') as opened:
        opened.truncate(10**8)
    for path, reason in ((file, f'at most {MOST_BYTES}'), (tmp_path, 'not a regular file'),
                         (tmp_path / 'none.yaml', 'No such file')):
        with pytest.raises(OSError, match=reason):
            Scenario.load(path)


def test_the_error_of_a_file_survives_a_pickle(tmp_path):
    with pytest.raises(MissionFileError) as error:
        Scenario.load(write_file(tmp_path, 'a: 1'))
    copy = pickle.loads(pickle.dumps(error.value))
    assert str(copy) == str(error.value) and copy.problems == error.value.problems


def test_each_number_of_a_mission_has_a_unit_or_is_a_ratio():
    kinds = (Scenario, Uav, Propulsion, Eavesdropper, NoFlyZone, Channel, Origin)
    bare = {field.name for kind in kinds for field in fields(kind)
            if isinstance(field.metadata['check'], (Number, Pair)) and not field.metadata['unit']}
    assert bare == {'slots', 'exponent', 'outage', 'fuselage_drag_ratio', 'solidity'}
