"""What a campaign file asks for: its missions one by one, or all that is wrong with it."""

from dataclasses import replace
import json
from pathlib import Path
import re

import pytest
from secure_uav_planner import Eavesdropper, run_campaign, Scenario
from secure_uav_planner.apps.campaign_file import load_campaign
from secure_uav_planner.errors import MissionFileError

TRACK = [[0.0, 200.0, -300.0, 10.0], [120.0, 200.0, 300.0, 10.0]]


@pytest.fixture
def missions(tmp_path, monkeypatch):
    """Write a mission, and one whose receivers move, in the folder in which the test runs."""
    monkeypatch.chdir(tmp_path)
    scenario = Scenario.paper(120.0, slots=8)
    scenario.save('mission.yaml')
    replace(scenario, ground_node_track=((0.0, 0.0, 0.0), (120.0, 5.0, 0.0)), eavesdroppers=(
        Eavesdropper(track=TRACK),)).save('moving.yaml')


@pytest.mark.parametrize('mission, vary, find, expected', [
    ('mission', {'uavs.*.max_speed': [12.0], 'uavs.0.start.1': [450.0]},
     lambda data: [(uav['max_speed'], uav['start'][1]) for uav in data['uavs']],
     [[(12.0, 450.0), (12.0, 500.0)]]),
    ('mission', {'eavesdroppers.0.track': [None, TRACK]},
     lambda data: [data['eavesdroppers'][0].get(field) for field in (
         'position', 'error_radius', 'track')],
     [[[200.0, 0.0], 10.0, None], [None, None, TRACK]]),
    ('moving', {'eavesdroppers.*.track.*.3': [0.0, 60.0], 'eavesdroppers.0.track.1.2': [200.0]},
     lambda data: data['eavesdroppers'][0]['track'],
     [[[0.0, 200.0, -300.0, radius], [120.0, 200.0, 200.0, radius]] for radius in (0.0, 60.0)]),
    ('mission', {'channel.exponent': [2.0, 2.5], 'colluding': [True]},
     lambda data: (data['channel']['exponent'], data['colluding']), [(2.0, True), (2.5, True)]),
    ('mission', {}, lambda data: data, [json.loads(json.dumps(
        Scenario.paper(120.0, slots=8).to_dict()))])])
def test_any_field_can_be_varied_and_no_other_changes(missions, mission, vary, find, expected):
    tasks = load_campaign({'mission': f'{mission}.yaml', 'vary': vary}).tasks()
    assert [find(task['mission']) for task in tasks] == expected


def test_draws_are_those_of_the_seed_and_the_same_for_each_scheme_and_place(missions):
    def draw_positions(seed):
        return [(task['sample'], *task['fields']['eavesdroppers.0.position'])
                for task in load_campaign({
                    'mission': 'mission.yaml', 'samples': 2, 'seed': seed,
                    'vary': {'duration': [60.0, 120.0], 'eavesdroppers.0.position': {
                        'uniform': [[150, -50], [250, 50]]}},
                    'methods': ['joint', 'fly_hover_fly_constant']}).tasks()]
    assert draw_positions(3) == draw_positions(3) != draw_positions(4)
    assert len(set(draw_positions(3))) == 2
    assert all(150 <= x <= 250 and -50 <= y <= 50 for _, x, y in draw_positions(3))


def test_a_baseline_is_compared_by_the_rate_that_the_planner_maximises(missions):
    fields = {'mission': Scenario.load('mission.yaml'), 'methods': [
        'joint', 'fly_hover_fly_optimised']}
    for objectives, own in ((None, 'worst_case'), (['guaranteed'], 'guaranteed')):
        assert load_campaign({**fields, 'objectives': objectives}).schemes == [
            ('joint', own), ('fly_hover_fly_optimised', own)]
    # Methods that do not have one in common have their own, and the baseline both.
    assert load_campaign({**fields, 'methods': [
        'joint', 'alternating', 'fly_hover_fly_optimised']}).schemes == [
            ('joint', 'worst_case'), ('alternating', 'guaranteed'),
            ('fly_hover_fly_optimised', 'worst_case'), ('fly_hover_fly_optimised', 'guaranteed')]


SCHEME = """
from dataclasses import replace
from secure_uav_planner import fly_hover_fly, Scenario


def plan(scenario):
    return fly_hover_fly(scenario, 'optimised')


def plan_unpromised(scenario):
    return replace(plan(scenario), promised_until=0.0)


def plan_another(scenario):
    return fly_hover_fly(Scenario.paper(200.0))


number = 5
"""


def test_a_function_of_ones_own_is_a_scheme(missions, tmp_path, monkeypatch):
    module = f'scheme_{tmp_path.name}'
    Path(f'{module}.py').write_text(SCHEME)
    fields = {'mission': 'mission.yaml', 'methods': [f'{module}:plan', 'fly_hover_fly_optimised']}
    with pytest.raises(MissionFileError, match='No module named .*PYTHONPATH'):
        load_campaign(fields)
    monkeypatch.syspath_prepend(tmp_path)
    own, baseline = run_campaign(fields, jobs=1).to_dict('records')
    assert own['outcome'] == 'ok' and own['objective'] == baseline['objective'] == 'worst_case'
    assert own['rate'] == baseline['rate'] > 0
    [row] = run_campaign({**fields, 'methods': [f'{module}:plan_another']}, jobs=1).to_dict(
        'records')
    assert row['outcome'] == 'invalid_option' and 'another scenario' in row['reason']
    # An assessment has no promised rate of this plan.
    [row] = run_campaign({**fields, 'methods': [f'{module}:plan_unpromised'], 'assess': {
        'draws': 5}}, jobs=1).to_dict('records')
    assert row['outcome'] == 'ok' and row['assess.delivered'] == 0.0
    for name in ('missing', 'number'):
        with pytest.raises(MissionFileError, match=f'{module}:{name} (cannot|is 5)'):
            load_campaign({**fields, 'methods': [f'{module}:{name}']})


def test_a_field_of_all_members_that_one_of_them_lacks_is_refused():
    mission = replace(Scenario.paper(110.0, slots=4), eavesdroppers=(
        Eavesdropper((200.0, 0.0), 10.0),
        Eavesdropper(track=((0.0, 0.0, 90.0, 5.0), (110.0, 0.0, -90.0, 5.0)))))
    with pytest.raises(MissionFileError, match=r'eavesdroppers\.1\.error_radius.*knots'):
        load_campaign({'mission': mission.to_dict(),
                       'vary': {'eavesdroppers.*.error_radius': [0.0, 30.0]}})


@pytest.mark.parametrize('text, reason', [
    ('mision: mission.yaml', 'did you mean mission?'),
    ('vary: {}', 'lacks mission'), ('', 'or a mapping of its fields'),
    ('mission: none.yaml', 'mission none.yaml cannot be read: No such file'),
    ('mission: {slots: 3}', 'lacks eavesdroppers'), *(
        (f'mission: mission.yaml\n{line}', words) for line, words in (
            ('vary: 7', 'vary is 7'), ('vary: {uavs.7.altitude: [1]}', 'no field'),
            ('vary: {uavs.².altitude: [1]}', 'no field'),
            ('vary: {geofence.*.0: [1]}', 'no field'), ('vary: {slots.*.x: [1]}', 'no field'),
            ('vary: {duration: []}', 'must be a list of values'),
            *((f'vary: {{uavs.0.start{end}: [[90, 500]], uavs.{uav}.start: [[80, 500]]}}',
               'set the same field') for end, uav in (('', '*'), ('.0', '0'))),
            ('vary: {duration: {from: 1, to: 2, count: 1000000000}}', 'from 1 to 1000000'),
            ('vary: {duration: {from: 1, to: x, count: 3}}', 'from 1 to 1000000'),
            ('vary: {duration: {uniform: [2, 1]}}', 'the first at most'),
            ('vary: {duration: {uniform: [0, .inf]}}', 'two numbers'),
            ('vary: {duration: {normal: [1, -1]}}', 'the second at least 0'),
            ('vary: {duration: {gamma: [1, 1]}}', 'must be a list of values'),
            ('vary: {duration: [120, .inf]}', 'its numbers must be finite'),
            ('seed: -1', 'seed is -1'), (f'samples: {10**400}', 'samples is'),
            ('vary: {slots: [1, 2]}\nsamples: 1000000', 'it must have 1 to'),
            ('methods: [magic]', "methods is ['magic']"),
            ('methods: [alternating]\nobjectives: [worst_case]', 'only the method'),
            ('time_limit: 0', 'time_limit is 0'), ('plans: maybe', "plans is 'maybe'"),
            ('assess: {draw: 5}', "world has no field 'draw'"), ('assess: 7', 'assess is 7'),
            ('assess: {channel: {exponent: 9}}', 'channel.exponent is 9'),
            (f'vary: {{eavesdroppers.0.track: [{TRACK}], eavesdroppers.*.error_radius: [5]}}',
             'eavesdroppers.*.error_radius is decided by'))), *(
        (f'mission: moving.yaml\nvary: {{{vary}: [[0, 0], [5, 5]]}}', words)
        for vary, words in (
            ('eavesdroppers.0.error_radius', "no field 'eavesdroppers.0.error_radius'"),
            ('eavesdroppers.*.position.0', 'vary the knots of the track instead'),
            ('eavesdroppers.0.errorradius', 'or eavesdroppers.*.error_radius'),
            ('ground_node.position', "no field 'ground_node.position'")))])
def test_a_wrong_campaign_is_refused_in_a_line(missions, command, text, reason):
    Path('campaign.yaml').write_text(text)
    with pytest.raises(MissionFileError) as error:
        load_campaign('campaign.yaml')
    assert any(reason in problem for _, problem in error.value.problems)
    assert re.search('error_radius|position', text) or 'knots' not in str(error.value)
    assert reason in command('sweep', 'campaign.yaml', status=2).err and not Path('out').exists()
