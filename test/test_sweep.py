"""Campaigns: every mission once, none lost, whatever dies on the way."""

import csv
from dataclasses import replace
import fcntl
from itertools import product
import json
import os
from pathlib import Path
from random import Random
import re
import signal
import subprocess
import sys
import time
from types import SimpleNamespace

from processes import environment
import pytest
from secure_uav_planner import Eavesdropper, Plan, run_campaign, Scenario, solve
from secure_uav_planner.apps.campaign_file import load_campaign
from secure_uav_planner.apps.cli import main
from secure_uav_planner.apps.results import draw_figure, save_tables
from secure_uav_planner.errors import MissionFileError
from test_cli import limit_file_size, MODULE, PATIENCE

CAMPAIGN = """
mission: mission.yaml
vary:
  duration: [60.0, 120.0]
  eavesdroppers.*.error_radius: {from: 0.0, to: 20.0, count: 2}
  eavesdroppers.0.position: {uniform: [[150, -50], [250, 50]]}
samples: 2
seed: 3
methods: [joint, fly_hover_fly_constant]
objectives: [guaranteed, worst_case]
"""


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """Return a folder with a mission and a campaign, in which the test runs."""
    monkeypatch.chdir(tmp_path)
    Scenario.paper(120.0, slots=8).save('mission.yaml')
    Path('campaign.yaml').write_text(CAMPAIGN)
    return tmp_path


def journal():
    """Return the rows that are written."""
    with open('out/results.jsonl') as file:
        return [json.loads(line) for line in file]


def start(*arguments, **options):
    """Start the command in the present folder; Ctrl-C ends it even if this process ignores it."""
    options.setdefault('preexec_fn', lambda: signal.signal(signal.SIGINT, signal.SIG_DFL))
    return subprocess.Popen([*MODULE, *arguments], env=environment(), text=True,
                            stdout=subprocess.PIPE, stderr=subprocess.PIPE, **options)


def wait_for(condition, process=None):
    """Wait until a condition holds, which a process that has ended cannot make true."""
    until = time.monotonic() + PATIENCE
    while not condition():
        assert time.monotonic() < until
        has_ended = process is not None and process.poll() is not None
        assert not has_ended or condition(), process.communicate()
        time.sleep(0.02)


def written(least):
    """Return whether so many rows are written."""
    path = Path('out/results.jsonl')
    return path.exists() and path.read_bytes().count(b'\n') >= least


def test_each_mission_is_planned_once_and_is_a_row(folder, capsys):
    assert main(['sweep', 'campaign.yaml', '-o', 'out', '--jobs', '2']) == 0
    rows = journal()
    # Two durations, two radii, two draws, two methods by two objectives.
    assert load_campaign('campaign.yaml').size == 32
    assert len(rows) == len({row['key'] for row in rows}) == 32
    # 60 s are too short: a failure is a row with its reason.
    failed = [row for row in rows if row['outcome'] != 'ok']
    assert {row['fields']['duration'] for row in failed} == {60.0} and len(failed) == 16
    assert all(row['outcome'] == 'infeasible' and 'needs at least' in row['reason']
               for row in failed)
    for row in rows:
        if row['method'] == 'joint' and row['outcome'] == 'ok':
            scenario = Scenario.paper(120.0, row['fields']['eavesdroppers.*.error_radius'], 8)
            place = tuple(row['fields']['eavesdroppers.0.position'])
            scenario = replace(scenario, eavesdroppers=(
                replace(scenario.eavesdroppers[0], position=place),))
            plan = solve(scenario, objective=row['objective'])
            assert row['worst_case_rate'] == pytest.approx(plan.worst_case_rate, abs=1e-6)
            assert row['guaranteed_rate'] == pytest.approx(plan.guaranteed_rate, abs=1e-6)
            break
    with open('out/results.csv', newline='') as file:
        table = list(csv.DictReader(file))
    assert len(table) == 32 and {row['duration'] for row in table} == {'60.0', '120.0'}
    assert Path('out/summary.png').read_bytes().startswith(b'\x89PNG')
    assert '16 ok, 16 infeasible' in capsys.readouterr().out
    # Again, nothing is left to plan.
    before = Path('out/results.jsonl').read_bytes()
    assert main(['sweep', 'campaign.yaml', '-o', 'out']) == 0
    assert Path('out/results.jsonl').read_bytes() == before


def rows_of_campaign(**fields):
    """Return rows whose rate is duration times the number of the second field's value."""
    second = next(iter(fields))
    return [{'outcome': 'ok', 'sample': draw, 'method': 'joint', 'objective': 'guaranteed',
             'guaranteed_rate': duration * (1 + fields[second].index(values[0])) + draw,
             'worst_case_rate': 0.0,
             'fields': {'duration': duration, 'place': [draw, 0.0], **dict(zip(fields, values))}}
            for duration in (10.0, 20.0) for draw in range(11)
            for values in product(*fields.values())]


@pytest.mark.parametrize('values', [[5.0, 10.0, 30.0], [[0, 0], [1, 1]]])
def test_the_figure_has_a_line_for_each_value_of_a_second_field_and_says_what_bands_are(values):
    figure = draw_figure(rows_of_campaign(second=values))
    [legend], [axes] = figure.legends, figure.axes
    assert legend.get_title().get_text() == (
        'lines: medians; bands: from 10 to 90% of the missions, over place')
    figure.draw_without_rendering()
    assert not legend.get_window_extent().overlaps(axes.bbox)
    assert axes.get_xlabel() == 'duration (s)'
    assert [line.get_label() for line in axes.lines] == [
        f'second {json.dumps(value)}, joint' for value in values]
    for number, (line, band) in enumerate(zip(axes.lines, axes.collections)):
        medians = [duration * (1 + number) + 5 for duration in (10, 20)]
        assert line.get_xydata().tolist() == [[10, medians[0]], [20, medians[1]]]
        heights = {round(y) for _, y in band.get_paths()[0].vertices}
        assert heights == {middle + by for middle in medians for by in (-4, 4)}


def test_a_third_and_a_fourth_field_are_small_multiples():
    figure = draw_figure(rows_of_campaign(
        second=[1, 2], third=['a', 'b', 'c'], fourth=[0, 7], fifth=[1, 2]))
    assert [axes.get_title() for axes in figure.axes] == [
        f'third "{letter}"\nfourth {number}' for number in (0, 7) for letter in 'abc']
    assert all(len(axes.lines) == 2 for axes in figure.axes)
    assert figure.legends[0].get_title().get_text().endswith('over place, fifth')


def test_a_baseline_is_compared_by_the_rate_that_the_planner_maximises(folder):
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
    rows = run_campaign({**fields, 'objectives': ['guaranteed', 'worst_case']}, jobs=1)
    figure = draw_figure([{**row, 'fields': {}} for row in rows.to_dict('records')])
    assert [axes.get_xlabel() for axes in figure.axes] == [
        'guaranteed rate (bit/s/Hz)', 'worst-case rate (bit/s/Hz)']
    for axes in figure.axes:
        assert axes.get_legend_handles_labels()[1] == ['joint', 'fly_hover_fly_optimised']


def test_draws_are_those_of_the_seed_and_the_same_for_each_scheme_and_place(folder):
    def draw_positions(seed):
        Path('campaign.yaml').write_text(CAMPAIGN.replace('seed: 3', f'seed: {seed}'))
        return [(task['sample'], *task['fields']['eavesdroppers.0.position'])
                for task in load_campaign('campaign.yaml').tasks()]
    assert draw_positions(3) == draw_positions(3) != draw_positions(4)
    assert len(set(draw_positions(3))) == 2
    assert all(150 <= x <= 250 and -50 <= y <= 50 for _, x, y in draw_positions(3))


SCHEME = """
from secure_uav_planner import fly_hover_fly, Scenario


def plan(scenario):
    return fly_hover_fly(scenario, 'optimised')


def plan_another(scenario):
    return fly_hover_fly(Scenario.paper(200.0))


number = 5
"""


def test_a_function_of_ones_own_is_a_scheme(folder, monkeypatch):
    module = f'scheme_{folder.name}'
    Path(f'{module}.py').write_text(SCHEME)
    fields = {'mission': 'mission.yaml', 'methods': [f'{module}:plan', 'fly_hover_fly_optimised']}
    with pytest.raises(MissionFileError, match='No module named .*PYTHONPATH'):
        load_campaign(fields)
    monkeypatch.syspath_prepend(folder)
    own, baseline = run_campaign(fields, jobs=1).to_dict('records')
    assert own['outcome'] == 'ok' and own['objective'] == baseline['objective'] == 'worst_case'
    assert own['rate'] == baseline['rate'] > 0
    [row] = run_campaign({**fields, 'methods': [f'{module}:plan_another']}, jobs=1).to_dict(
        'records')
    assert row['outcome'] == 'invalid_option' and 'another scenario' in row['reason']
    for name in ('missing', 'number'):
        with pytest.raises(MissionFileError, match=f'{module}:{name} (cannot|is 5)'):
            load_campaign({**fields, 'methods': [f'{module}:{name}']})


def test_from_python_a_campaign_is_a_table_and_goes_on_in_its_folder(folder):
    fields = {'mission': Scenario.load('mission.yaml'), 'vary': {
        'duration': [60.0, 120.0], 'uavs.*.start': ((100, 500), (90, 500))},
        'methods': ('fly_hover_fly_constant',), 'plans': True}
    with pytest.raises(ValueError, match='folder is None'):
        run_campaign(fields)
    frame = run_campaign(fields, folder='out', jobs=1)
    assert frame.outcome.tolist() == ['infeasible'] * 2 + ['ok'] * 2
    assert frame['uavs.*.start'].tolist() == [[100, 500], [90, 500]] * 2
    before = Path('out/results.jsonl').read_bytes()
    assert run_campaign(fields, folder='out').key.tolist() == frame.key.tolist()
    assert Path('out/results.jsonl').read_bytes() == before
    for wrong in ({**fields, 'vary': {'duration': object}}, {'mision': 5}, {}):
        with pytest.raises(ValueError, match='^campaign'):
            run_campaign(wrong)


def test_shards_have_each_mission_once_and_join(folder, capsys):
    arguments = ['sweep', 'campaign.yaml', '-o', 'out', '--jobs', '1']
    for number in Random(0).sample(range(1, 4), 3):
        assert main([*arguments, '--shard', f'{number}/3']) == 0
        assert not Path('out/results.csv').exists()
    shards = [[json.loads(line)['key'] for line in Path(
        f'out/results-{number}-of-3.jsonl').read_text().splitlines()] for number in (1, 2, 3)]
    assert sorted(map(len, shards)) == [10, 11, 11] and len({*sum(shards, [])}) == 32
    # Another shard may be writing its last line.
    with open('out/results-2-of-3.jsonl', 'a') as file:
        file.write('{"key": "half')
    assert main(arguments) == 0 and journal() == []
    shown = capsys.readouterr()
    assert '16 ok, 16 infeasible' in shown.out and 'no result' not in shown.err
    with open('out/results.csv', newline='') as file:
        assert len(list(csv.DictReader(file))) == 32
    for wrong in ('0/3', '4/3', '1', 'a/b'):
        with pytest.raises(SystemExit):
            main([*arguments, '--shard', wrong])


def test_in_a_file_each_period_has_a_line_with_done_failed_rate_and_time_left(
        folder, capsys, monkeypatch):
    monkeypatch.setattr('secure_uav_planner.apps.campaigns._PERIODS', {False: 0.001})
    assert main(['sweep', 'campaign.yaml', '-o', 'out', '--jobs', '1']) == 0
    lines = [re.fullmatch(
        r'sweep: (\d+) of 32 missions done, (\d+) failed, (\S+)/s(?:, (\S.*) left)?', line)
             for line in capsys.readouterr().err.splitlines()]
    assert len(lines) > 2 and all(lines)
    counts = [int(line[1]) for line in lines]
    assert counts == sorted(counts) and lines[-1].group(1, 2, 4) == ('32', '16', '0:00:00')


def test_plans_are_kept_on_request_with_their_bounds(folder):
    Path('campaign.yaml').write_text("""
mission: mission.yaml
vary: {duration: [60.0, 120.0]}
bound_time_limit: .inf
plans: true
""")
    assert main(['sweep', 'campaign.yaml', '-o', 'out', '--jobs', '1']) == 0
    short, long = journal()
    assert short['outcome'] == 'infeasible' and long['outcome'] == 'ok'
    [file] = Path('out/plans').iterdir()
    plan = Plan.load(file)
    assert file.stem == long['key'] and plan.rate == pytest.approx(long['rate'])
    assert plan.bound.rate == pytest.approx(long['bound']) and plan.bound.status == 'converged'
    # A plan that is gone is planned again; what cannot be flown has none.
    file.unlink()
    assert main(['sweep', 'campaign.yaml', '-o', 'out', '--jobs', '1']) == 0
    assert file.exists() and [row['key'] for row in journal()] == [
        short['key'], long['key'], long['key']]


DAMAGES = [b'', b'null', b'[]', b'7', b'{}', b'\0' * 40, b'\xff\xfe', b'[' * 100000,
           b'{"key": NaN}', b'{"key": 5, "fields": {}}']


def test_damaged_lines_are_named_and_they_and_failures_of_workers_are_planned_again(
        folder, capsys):
    arguments = ['sweep', 'campaign.yaml', '-o', 'out', '--jobs', '1']
    assert main(arguments) == 0
    lines = Path('out/results.jsonl').read_bytes().splitlines()
    table = Path('out/results.csv').read_text()
    odd = json.loads(lines[10])
    lines[:10] = DAMAGES
    lines[10:13] = [json.dumps({**odd, 'fields': 3}).encode(), lines[11][:-30],
                    json.dumps({**odd, 'outcome': 'ok', 'rate': None}).encode()]
    good = [number for number in range(13, 32) if json.loads(lines[number])['outcome'] == 'ok']
    for number, outcome in zip(good, ('worker_lost', 'error')):
        lines[number] = json.dumps({
            **json.loads(lines[number]), 'outcome': outcome, 'reason': '', 'rate': None}).encode()
    Path('out/results.jsonl').write_bytes(b'\n'.join([*lines, b'']))
    capsys.readouterr()
    assert main(arguments) == 0
    out, err = capsys.readouterr()
    warning = err.splitlines()[0]
    assert warning.startswith('out/results.jsonl: no result in line 1, 2, 3') and (
        '12, 13; a mission without another line is planned again' in warning)
    assert '16 ok, 16 infeasible' in out and Path(
        'out/results.jsonl').read_bytes().count(b'\n') == 32 + 13 + 2

    def rates(text):
        return {row['key']: row['rate'] and float(row['rate'])
                for row in csv.DictReader(text.splitlines())}
    assert rates(Path('out/results.csv').read_text()) == pytest.approx(rates(table))


def test_a_driver_that_was_killed_goes_on_where_it_was(folder):
    Path('campaign.yaml').write_text(CAMPAIGN.replace('samples: 2', 'samples: 3'))
    process = start('sweep', 'campaign.yaml', '-o', 'out', '--jobs', '1')
    wait_for(lambda: written(3), process)
    process.kill()
    process.communicate()
    kept = len(journal()) if Path('out/results.jsonl').read_bytes().endswith(b'\n') else 0
    # As if it had been killed in the middle of a line.
    with open('out/results.jsonl', 'a') as file:
        file.write('{"key": "half')
    assert main(['sweep', 'campaign.yaml', '-o', 'out', '--jobs', '1']) == 0
    keys = [row['key'] for row in journal()]
    assert len(keys) == len(set(keys)) == 48 and kept >= 3


def test_ctrl_c_keeps_what_is_finished(folder):
    Path('campaign.yaml').write_text(CAMPAIGN.replace('samples: 2', 'samples: 50'))
    process = start('sweep', 'campaign.yaml', '-o', 'out', '--jobs', '2', start_new_session=True)
    wait_for(lambda: written(2), process)
    os.killpg(process.pid, signal.SIGINT)  # As a terminal does.
    _, errors = process.communicate(timeout=PATIENCE)  # The end of the workers, too.
    assert process.returncode == 130 and 'stopped' in errors and 'Traceback' not in errors
    assert len(journal()) >= 2


def test_a_full_disk_keeps_what_is_finished_and_is_status_1(folder):
    process = start('sweep', 'campaign.yaml', '-o', 'out', '--jobs', '1',
                    preexec_fn=limit_file_size)
    _, errors = process.communicate(timeout=PATIENCE)
    assert process.returncode == 1 and 'File too large' in errors and 'Traceback' not in errors
    *whole, _ = Path('out/results.jsonl').read_bytes().split(b'\n')
    assert 0 < len([json.loads(line) for line in whole]) < 32


def test_two_sweeps_do_not_write_to_one_folder(folder, capsys):
    Path('out').mkdir()
    with open('out/results.jsonl', 'ab') as file:
        fcntl.flock(file, fcntl.LOCK_EX)
        assert main(['sweep', 'campaign.yaml', '-o', 'out']) == 2
    assert 'another sweep' in capsys.readouterr().err


@pytest.mark.parametrize('text, reason', [
    ('mision: mission.yaml', 'did you mean mission?'),
    ('vary: {}', 'lacks mission'), ('', 'or a mapping of its fields'),
    ('mission: none.yaml', 'mission none.yaml cannot be read: No such file'),
    ('mission: {slots: 3}', 'lacks eavesdroppers'), *(
        (f'mission: mission.yaml\n{line}', words) for line, words in (
            ('vary: 7', 'vary is 7'), ('vary: {uavs.7.altitude: [1]}', 'no field'),
            ('vary: {uavs.².altitude: [1]}', 'no field'),
            ('vary: {duration: []}', 'must be a list of values'),
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
            ('assess: {channel: {exponent: 9}}', 'channel.exponent is 9')))])
def test_a_wrong_campaign_is_refused_in_a_line(folder, capsys, text, reason):
    Path('campaign.yaml').write_text(text)
    with pytest.raises(MissionFileError) as error:
        load_campaign('campaign.yaml')
    assert any(reason in problem for _, problem in error.value.problems)
    assert main(['sweep', 'campaign.yaml']) == 2
    assert reason in capsys.readouterr().err and not Path('out').exists()


def test_a_field_of_all_members_and_of_one_coordinate_can_be_varied(folder):
    Path('campaign.yaml').write_text("""
mission: mission.yaml
vary: {uavs.*.max_speed: [12.0], uavs.0.start.1: [450.0]}
""")
    [task] = load_campaign('campaign.yaml').tasks()
    assert [uav['max_speed'] for uav in task['mission']['uavs']] == [12.0, 12.0]
    assert task['mission']['uavs'][0]['start'] == [100.0, 450.0]


TRACK = [[0.0, 200.0, -300.0, 10.0], [120.0, 200.0, 300.0, 10.0]]


@pytest.mark.parametrize('moves, vary, reason', [
    (True, 'eavesdroppers.0.error_radius: [0, 60]', "no field 'eavesdroppers.0.error_radius'"),
    (True, 'eavesdroppers.*.position.0: [0, 60]', 'vary the knots of a track instead'),
    (True, 'ground_node.position: [[0, 0], [5, 5]]', "no field 'ground_node.position'"),
    (False, f'eavesdroppers.0.track: [null, {TRACK}], eavesdroppers.*.error_radius: [5]',
     'eavesdroppers.*.error_radius is decided by')])
def test_what_a_track_decides_is_not_varied(folder, moves, vary, reason):
    if moves:
        scenario = Scenario.load('mission.yaml')
        replace(scenario, ground_node_track=((0.0, 0.0, 0.0), (120.0, 5.0, 0.0)), eavesdroppers=(
            Eavesdropper((200.0, -300.0), 10.0, track=TRACK),)).save('mission.yaml')
    Path('campaign.yaml').write_text(f'mission: mission.yaml\nvary: {{{vary}}}')
    with pytest.raises(MissionFileError, match=re.escape(reason)):
        load_campaign('campaign.yaml')


def test_tracks_and_their_knots_can_be_varied(folder):
    vary = f'eavesdroppers.0.track: [null, {TRACK}]'
    Path('campaign.yaml').write_text(f'mission: mission.yaml\nvary: {{{vary}}}')
    standing, moving = (task['mission']['eavesdroppers'][0]
                        for task in load_campaign('campaign.yaml').tasks())
    assert (standing['track'], standing['error_radius']) == (None, 10.0)
    assert moving['track'] == TRACK and not {'position', 'error_radius'} & moving.keys()
    scenario = Scenario.load('mission.yaml')
    replace(scenario, eavesdroppers=(Eavesdropper((200.0, -300.0), 10.0, track=TRACK),)).save(
        'mission.yaml')
    Path('campaign.yaml').write_text("""
mission: mission.yaml
vary: {eavesdroppers.*.track.*.3: [0.0, 60.0], eavesdroppers.0.track.1.2: [200.0]}
""")
    tracks = [task['mission']['eavesdroppers'][0]['track']
              for task in load_campaign('campaign.yaml').tasks()]
    assert tracks == [[[0.0, 200.0, -300.0, radius], [120.0, 200.0, 200.0, radius]]
                      for radius in (0.0, 60.0)]


def test_fields_left_out_at_their_defaults_can_be_varied_and_no_other_key_changes(folder):
    Path('campaign.yaml').write_text('mission: mission.yaml')
    [task] = load_campaign('campaign.yaml').tasks()
    mission = json.loads(json.dumps(Scenario.load('mission.yaml').to_dict()))
    assert task['mission'] == mission and not {'channel', 'colluding'} & mission.keys()
    Path('campaign.yaml').write_text("""
mission: mission.yaml
vary: {channel.exponent: [2.0, 2.5], colluding: [true, false]}
bound_time_limit: 0.1
methods: [fly_hover_fly_constant]
""")
    assert main(['sweep', 'campaign.yaml', '-o', 'out', '--jobs', '1']) == 0
    rows = {(row['fields']['channel.exponent'], row['fields']['colluding']): row
            for row in journal()}
    assert len({row['rate'] for row in rows.values()}) >= 2
    # Where no bound is proven, there is a row without one.
    assert all(row['outcome'] == 'ok' and (row['bound'] is None) == (exponent != 2.0)
               for (exponent, _), row in rows.items()) and len(rows) == 4


def test_values_of_several_kinds_are_columns_of_json_and_null_is_nothing(tmp_path):
    rows = [{'key': str(number), 'outcome': 'ok', 'fields': {
        'mixed': mixed, 'limit': limit, 'large': large, 'colluding': bool(number)}}
            for number, (mixed, limit, large) in enumerate(
                [(5, None, 1.5), ('x', 2.0, 10**30), (None, 3, 2), ([1, 2], None, True)])]
    csv_file, *parquet_files = save_tables(rows, tmp_path)
    with open(csv_file, newline='') as file:
        table = list(csv.DictReader(file))
    assert [row['mixed'] for row in table] == ['5', '"x"', '', '[1, 2]']
    assert [row['limit'] for row in table] == ['', '2.0', '3', '']
    parquet = pytest.importorskip('pyarrow.parquet')
    [file] = parquet_files
    columns = parquet.read_table(file).to_pydict()
    assert columns['key'] == [row['key'] for row in rows]
    assert columns['mixed'] == ['5', '"x"', None, '[1, 2]']
    assert columns['limit'] == [None, 2.0, 3.0, None]
    assert columns['large'] == ['1.5', f'{10**30}', '2', 'true']
    assert columns['colluding'] == [False, True, True, True]


# Dask


@pytest.fixture
def cluster(tmp_path, request):
    """Return the address of a scheduler, and its two workers, all processes of their own."""
    pytest.importorskip('distributed')
    file = tmp_path / 'scheduler.json'
    common = {'env': environment(**getattr(request, 'param', {})),
              'stdout': subprocess.DEVNULL, 'stderr': subprocess.DEVNULL}
    processes = [subprocess.Popen(
        [sys.executable, '-m', 'dask', 'scheduler', '--host', '127.0.0.1', '--port',
         '0', '--no-dashboard', '--scheduler-file', str(file)], **common)]
    try:
        wait_for(lambda: file.exists() and file.read_text().strip().endswith('}'), processes[0])
        address = json.loads(file.read_text())['address']
        processes += [subprocess.Popen(
            [sys.executable, '-m', 'dask', 'worker', address, '--nthreads', '1',
             '--no-nanny', '--no-dashboard', '--local-directory', str(tmp_path / str(number))],
            **common) for number in range(2)]
        yield address, processes
    finally:
        for process in processes:
            process.kill()
            process.wait()


@pytest.mark.slow
def test_a_cluster_loses_nothing_when_a_worker_the_driver_and_the_scheduler_are_killed(
        folder, cluster):
    address, (scheduler, victim, _) = cluster
    Path('campaign.yaml').write_text(CAMPAIGN.replace('samples: 2', 'samples: 4'))
    arguments = ['sweep', 'campaign.yaml', '-o', 'out', '--scheduler', address]
    driver = start(*arguments)
    wait_for(lambda: written(3), driver)
    victim.kill()
    kept = len(journal())
    wait_for(lambda: written(kept + 5), driver)
    driver.kill()
    driver.communicate()
    driver = start(*arguments)
    printed, errors = driver.communicate(timeout=PATIENCE)
    assert driver.returncode == 0, errors
    keys = [row['key'] for row in journal()]
    assert len(keys) == len(set(keys)) == 64
    assert '32 ok, 32 infeasible' in printed, [
        row['reason'] for row in journal() if row['outcome'] == 'worker_lost']
    Path('campaign.yaml').write_text(CAMPAIGN.replace('samples: 2', 'samples: 200'))
    driver = start(*arguments)
    wait_for(lambda: written(67), driver)
    scheduler.kill()
    _, errors = driver.communicate(timeout=PATIENCE)
    assert driver.returncode == 1 and 'goes on from here' in errors
    assert len(journal()) >= 67


def distributed_client(address):
    """Return a client of a scheduler."""
    from distributed import Client
    return Client(address)


@pytest.mark.slow
@pytest.mark.parametrize(
    'cluster', [{'DASK_DISTRIBUTED__SCHEDULER__ALLOWED_FAILURES': '0'}], indirect=True)
def test_a_mission_that_lost_its_worker_is_reported_and_retried(folder, cluster):
    address, (_, victim, _) = cluster
    Path('campaign.yaml').write_text(CAMPAIGN.replace('samples: 2', 'samples: 10'))
    with distributed_client(address) as client:
        client.wait_for_workers(2, PATIENCE)
    victim.send_signal(signal.SIGSTOP)  # So it gets missions, and finishes none.
    arguments = ['sweep', 'campaign.yaml', '-o', 'out', '--scheduler', address]
    driver = start(*arguments)
    wait_for(lambda: written(1), driver)
    victim.kill()
    _, errors = driver.communicate(timeout=PATIENCE)
    rows = journal()
    lost = {row['key'] for row in rows if row['outcome'] == 'worker_lost'}
    assert driver.returncode == 1 and len(rows) == 160 and lost
    assert f'{len(lost)} missions failed for reasons outside of them' in errors
    driver = start(*arguments)
    printed, errors = driver.communicate(timeout=PATIENCE)
    assert driver.returncode == 0 and '80 ok, 80 infeasible' in printed, errors
    assert {row['key'] for row in journal()[160:]} == lost


@pytest.mark.slow
def test_the_example_for_slurm_runs_on_a_cluster_of_processes(folder, monkeypatch):
    distributed = pytest.importorskip('distributed')

    class Cluster(distributed.LocalCluster):

        def __init__(self, **options):
            assert set(options) == {'cores', 'processes', 'memory', 'walltime'}
            super().__init__(n_workers=0, threads_per_worker=1, dashboard_address=None)

        def scale(self, n=2, jobs=None):
            super().scale(n)
    monkeypatch.setitem(sys.modules, 'dask_jobqueue', SimpleNamespace(SLURMCluster=Cluster))
    page = (Path(__file__).parents[1] / 'docs' / 'reference.md').read_text()
    [code] = re.findall('```python\n(from dask_jobqueue.*?)```', page, re.DOTALL)
    assert len(code.splitlines()) == 6
    names = {}
    try:
        exec(code, names)
        assert names['rows'].outcome.value_counts().to_dict() == {'ok': 16, 'infeasible': 16}
    finally:
        names['client'].close()
        names['cluster'].close()


def test_a_scheduler_that_cannot_be_reached_is_status_2(folder, capsys, monkeypatch):
    pytest.importorskip('distributed')
    monkeypatch.setattr('secure_uav_planner.apps.tasks._CONNECT_TIMEOUT', 1.0)
    assert main(['sweep', 'campaign.yaml', '-o', 'out', '--scheduler', 'tcp://127.0.0.1:1']) == 2
    assert 'cannot be reached' in capsys.readouterr().err
