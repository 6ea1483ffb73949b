"""Missions as `new` writes them and `check` judges them, in the words of `plan`."""

from dataclasses import replace
from itertools import chain
import math
import re

import city
import pytest
from secure_uav_planner import Eavesdropper, Scenario
from secure_uav_planner.mission.formats.mission_file import EXAMPLES
from test_mission_file import RICH


def test_the_new_mission_is_right_and_explains_each_field(tmp_path, command):
    file = tmp_path / 'mission.yaml'
    assert command('new', file).err == ''
    out, err = command('check', file)
    assert 'can be flown' in out and err == ''
    example = Scenario.load(file)
    assert example.separation > 0 and math.dist(*example.starts) > example.separation
    assert math.dist(*example.goals) > example.separation
    data = RICH.to_dict()
    for name in {'ground_node', *data, *data['origin'], *data['channel'], *data['uavs'][0],
                 *data['uavs'][0]['propulsion'], *data['no_fly_zones'][0], *chain(
                     *data['eavesdroppers'])} - {'ground_nodes', 'head_starts'}:
        assert re.search(rf'\b{name}:', file.read_text()), name
    # The example of a zone is right as well.
    text = re.sub(r'^#  ', '  ', file.read_text().replace('zones: []', 'zones:   '),
                  flags=re.MULTILINE)
    file.write_text(text)
    assert Scenario.load(file).no_fly_zones[0].name == 'tower'
    assert 'is there already' in command('new', file, status=2).err and file.read_text() == text
    assert command('new', file, '--force') and file.read_text() != text


@pytest.mark.parametrize('name', EXAMPLES)
def test_each_example_can_be_planned_as_it_is(tmp_path, command, name):
    file = tmp_path / 'mission.yaml'
    assert command('new', '--example', name, file).err == ''
    out, err = command('check', file)
    assert 'can be flown' in out and err == ''
    scenario = Scenario.load(file)
    assert name != 'paper' or scenario == Scenario.paper()
    assert name != 'city' or scenario == Scenario.load(city.FILE)
    assert (len(scenario.ground_nodes) > 1) == (name == 'several-nodes')
    assert scenario.has_tracks == (name == 'convoy')
    assert set(EXAMPLES) == {'paper', 'city', 'several-nodes', 'convoy'}


def test_check_notes_that_the_rate_is_0_for_certain(tmp_path, command):
    file = tmp_path / 'mission.yaml'
    for radius, is_covered in ((300.0, True), (30.0, False)):
        Scenario.paper(error_radius=radius, slots=20).save(file)
        out, err = command('check', file)
        assert 'It can be flown.' in out and is_covered == (
            'note: the rate is 0: the disc of eavesdropper covers the ground node' in err)


WALL = '  - {name: wall, vertices: [[-600, -5], [600, -5], [600, 5], [-600, 5]]}'


@pytest.mark.parametrize('fence, line, reason', [
    ('', 1, 'duration is 90 s; {} needs at least 1'),
    ('[[-500, -500], [500, -500], [500, 500], [-500, 500]]', 4,
     'no way leads {} from start to goal: wall is in its way')])
def test_check_and_plan_refuse_the_same_missions_in_the_same_words(
        tmp_path, command, fence, line, reason):
    file = tmp_path / 'mission.yaml'
    text = f"""\
duration: 90
slots: 45
uavs:
  - &one {{name: a, start: [90, 300], goal: [90, -300], altitude: 100, max_speed: 10}}
  - {{<<: *one, name: b, start: [120, 300], goal: [120, -300]}}
ground_node: [0, 0]
eavesdroppers: [{{position: [200, 0], error_radius: 10}}]
no_fly_zones:
{WALL}
geofence: {fence or 'null'}
"""
    file.write_text(text)
    told = []
    for arguments in (['check', file], ['plan', file, '-o', tmp_path / 'out']):
        out, err = command(*arguments, status=2)
        assert out == '' and len(err.splitlines()) == 2
        for number, name, words in zip((0, 1), 'ab', err.splitlines()):
            where = line + number if fence else line
            assert words.startswith(f'secure_uav_planner: {file}:{where}: {reason.format(name)}')
        told.append(err)
    assert told[0] == told[1]
    # Of values that are wrong, all are told, and flights are asked for when all are right.
    file.write_text(text.replace('max_speed: 10', 'max_speed: 10, average_power: 9').replace(
        'error_radius: 10', 'error_radius: 10 m'))
    err = command('check', file, status=2).err
    assert err.count('peak_power is 4.0') == 2 and "error_radius is '10 m'" in err
    assert len(err.splitlines()) == 3
    file.write_text(text.replace('duration: 90', 'duration: short'))
    assert len(command('check', file, status=2).err.splitlines()) == 1


@pytest.mark.parametrize('knots, notes', [
    ([[0, 200, -100, 10], [121, 200, 100, 10]], []),
    ([[500, 50, 0, 1], [600, 50, 9, 1]], ['covers 0 of 121 s']),
    ([[-9, 50, 0, 1], [60.5, 50, 9, 1]], ['covers 60.5 of 121 s']),
    ([[0, 50, 0, 1], [121000, 50, 900, 1]],
     ['lasts 121000 s, the flight 121 s; are its times in seconds?']),
    ([[0, 8.53, 47.37, 10], [121, 8.54, 47.38, 10]],
     ['starts and goals; are its positions in metres?'])])
def test_check_notes_a_track_that_hardly_meets_the_flight(tmp_path, command, knots, notes):
    file = tmp_path / 'mission.yaml'
    replace(Scenario.paper(120.0), eavesdroppers=(
        Eavesdropper(name='car', track=knots),)).save(file)
    err = command('check', file).err.splitlines()
    assert len(err) == len(notes)
    for line, note in zip(err, notes):
        assert line.startswith('note: ') and 'track of car' in line and note in line


def test_check_and_plan_warn_of_uavs_that_come_close(tmp_path, command):
    file = tmp_path / 'mission.yaml'
    for altitude, warnings in ((110.0, ()), (100.0, (
            'warning: nothing keeps uav1 and uav2 5 m apart; set separation',
            'warning: uav1 and uav2 come within 0.0 m of each other at'))):
        scenario = Scenario.paper(120.0, slots=10)
        replace(scenario, uavs=tuple(replace(uav, altitude=height) for uav, height in zip(
            scenario.uavs, (100.0, altitude)))).save(file)
        err = command('check', file).err.splitlines()
        err += command('plan', file, '-o', tmp_path, '--bound-time-limit', '0').err.splitlines()
        assert len(err) == len(warnings)
        assert all(line.startswith(warning) for line, warning in zip(err, warnings))
