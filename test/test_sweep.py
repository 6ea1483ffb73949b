"""Campaigns: every mission once, none lost, whatever dies on the way."""

import csv
import fcntl
import json
import os
from pathlib import Path
from random import Random
import re
import resource
import signal
import subprocess
import sys
import time
from types import SimpleNamespace

from processes import environment
import pytest
from secure_uav_planner import Plan, run_campaign, Scenario, solve
from secure_uav_planner.apps.campaign_file import load_campaign
from secure_uav_planner.apps.cli import main
from secure_uav_planner.apps.tasks import make_task, run_task
from strategies import with_eavesdroppers
from test_cli import MODULE, PATIENCE

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
SWEEP = 'sweep', 'campaign.yaml', '-o', 'out'


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


def test_each_mission_is_planned_once_and_is_a_row(folder, command):
    out, _ = command(*SWEEP, '--jobs', '2')
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
            plan = solve(with_eavesdroppers(scenario, position=place), objective=row['objective'])
            assert row['worst_case_rate'] == pytest.approx(plan.worst_case_rate, abs=1e-6)
            assert row['guaranteed_rate'] == pytest.approx(plan.guaranteed_rate, abs=1e-6)
            break
    with open('out/results.csv', newline='') as file:
        table = list(csv.DictReader(file))
    assert len(table) == 32 and {row['duration'] for row in table} == {'60.0', '120.0'}
    assert Path('out/summary.png').read_bytes().startswith(b'\x89PNG')
    assert '16 ok, 16 infeasible' in out
    # Again, nothing is left to plan.
    before = Path('out/results.jsonl').read_bytes()
    command(*SWEEP)
    assert Path('out/results.jsonl').read_bytes() == before


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
    # Another campaign in this folder has its own fields, also where missions are the same.
    more = {**fields, 'vary': {**fields['vary'], 'slots': [8, 9]}}
    frame = run_campaign(more, folder='out', jobs=1)
    assert sorted(frame.slots) == [8, 8, 8, 8, 9, 9, 9, 9]
    for wrong in ({**fields, 'vary': {'duration': object}}, {'mision': 5}, {}):
        with pytest.raises(ValueError, match='^campaign'):
            run_campaign(wrong)


def test_shards_have_each_mission_once_and_join(folder, command):
    for number in Random(0).sample(range(1, 4), 3):
        command(*SWEEP, '--jobs', '1', '--shard', f'{number}/3')
        assert not Path('out/results.csv').exists()
    shards = [[json.loads(line)['key'] for line in Path(
        f'out/results-{number}-of-3.jsonl').read_text().splitlines()] for number in (1, 2, 3)]
    assert sorted(map(len, shards)) == [10, 11, 11] and len({*sum(shards, [])}) == 32
    # Another shard may be writing its last line.
    with open('out/results-2-of-3.jsonl', 'a') as file:
        file.write('{"key": "half')
    out, err = command(*SWEEP, '--jobs', '1')
    assert '16 ok, 16 infeasible' in out and 'no result' not in err and journal() == []
    with open('out/results.csv', newline='') as file:
        assert len(list(csv.DictReader(file))) == 32
    for wrong in ('0/3', '4/3', '1', 'a/b'):
        with pytest.raises(SystemExit):
            main([*SWEEP, '--jobs', '1', '--shard', wrong])


def test_in_a_file_each_period_has_a_line_with_done_failed_rate_and_time_left(
        folder, command, monkeypatch):
    monkeypatch.setattr('secure_uav_planner.apps.campaigns._PERIODS', {False: 0.001})
    _, err = command(*SWEEP, '--jobs', '1')
    lines = [re.fullmatch(
        r'sweep: (\d+) of 32 missions done, (\d+) failed, (\S+)/s(?:, (\S.*) left)?', line)
             for line in err.splitlines()]
    assert len(lines) > 2 and all(lines)
    counts = [int(line[1]) for line in lines]
    assert counts == sorted(counts) and lines[-1].group(1, 2, 4) == ('32', '16', '0:00:00')


def test_plans_are_kept_on_request_with_their_bounds(folder):
    Path('campaign.yaml').write_text("""
mission: mission.yaml
vary: {duration: [60.0, 120.0], channel.exponent: [2.0, 2.5]}
bound_time_limit: .inf
plans: true
""")
    assert main([*SWEEP, '--jobs', '1']) == 0
    first, second, long, unproven = journal()
    assert [row['outcome'] for row in (first, second, long, unproven)] == [
        'infeasible', 'infeasible', 'ok', 'ok']
    assert unproven['bound'] is None  # Where no bound is proven, there is a row without one.
    Path(f'out/plans/{unproven["key"]}.json').unlink()
    [file] = Path('out/plans').iterdir()
    plan = Plan.load(file)
    assert file.stem == long['key'] and plan.rate == pytest.approx(long['rate'])
    assert plan.bound.rate == pytest.approx(long['bound']) and plan.bound.status == 'converged'
    # A plan that is gone is planned again; what cannot be flown has none.
    file.unlink()
    assert main([*SWEEP, '--jobs', '1']) == 0
    assert file.exists() and [row['key'] for row in journal()[4:]] == [
        long['key'], unproven['key']]


def test_what_is_assessed_and_kept_of_a_baseline_is_the_rate_of_its_row(folder):
    frame = run_campaign({
        'mission': Scenario.load('mission.yaml'), 'methods': ['joint', 'fly_hover_fly_optimised'],
        'objectives': ['guaranteed', 'worst_case'], 'assess': {'draws': 5}, 'plans': True},
        folder='out', jobs=1)
    assert frame['assess.promised'].tolist() == pytest.approx(frame.rate.tolist())
    assert [Plan.load(f'out/plans/{key}.json').objective for key in frame.key] == (
        frame.objective.tolist())


DAMAGES = [b'', b'null', b'[]', b'7', b'{}', b'\0' * 40, b'\xff\xfe', b'[' * 100000,
           b'{"key": NaN}', b'{"key": 5, "fields": {}}']


def test_damaged_lines_are_named_and_they_and_failures_of_workers_are_planned_again(
        folder, command):
    command(*SWEEP, '--jobs', '1')
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
    out, err = command(*SWEEP, '--jobs', '1')
    warning = err.splitlines()[0]
    assert warning.startswith('out/results.jsonl: no result in line 1, 2, 3') and (
        '12, 13; a mission without another line is planned again' in warning)
    assert '16 ok, 16 infeasible' in out and Path(
        'out/results.jsonl').read_bytes().count(b'\n') == 32 + 13 + 2

    def rates(text):
        return {row['key']: row['rate'] and float(row['rate'])
                for row in csv.DictReader(text.splitlines())}
    assert rates(Path('out/results.csv').read_text()) == pytest.approx(rates(table))


def limit_file_size():
    """Let no file grow beyond 4 kB, as on a disk that is full."""
    resource.setrlimit(resource.RLIMIT_FSIZE, (4096, 4096))


@pytest.mark.parametrize('end, status, told', [
    (signal.SIGKILL, -signal.SIGKILL, ''), (signal.SIGINT, 130, 'stopped'),
    ('full disk', 1, 'File too large')])
def test_a_sweep_that_ends_early_keeps_what_is_finished_and_goes_on_there(
        folder, end, status, told):
    Path('campaign.yaml').write_text(CAMPAIGN.replace('samples: 2', 'samples: 10'))
    limits = {'preexec_fn': limit_file_size} if end == 'full disk' else {}
    process = start(*SWEEP, '--jobs', '2', start_new_session=True, **limits)
    if end != 'full disk':
        wait_for(lambda: written(3), process)
        os.killpg(process.pid, end)  # As a terminal does.
    _, errors = process.communicate(timeout=PATIENCE)  # The end of the workers, too.
    assert process.returncode == status and told in errors and 'Traceback' not in errors
    *whole, _ = Path('out/results.jsonl').read_bytes().split(b'\n')
    kept = {json.loads(line)['key'] for line in whole}
    if end == signal.SIGKILL:  # As if in the middle of a line.
        with open('out/results.jsonl', 'a') as file:
            file.write('{"key": "half')
    assert main([*SWEEP, '--jobs', '1']) == 0
    keys = [row['key'] for row in journal()]
    assert len(keys) == len(set(keys)) == 160 and kept == {*keys[:len(kept)]} and kept


def test_two_sweeps_do_not_write_to_one_folder(folder, command):
    Path('out').mkdir()
    with open('out/results.jsonl', 'ab') as file:
        fcntl.flock(file, fcntl.LOCK_EX)
        assert 'another sweep' in command(*SWEEP, status=2).err


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
    arguments = *SWEEP, '--scheduler', address
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


def test_a_fault_of_the_program_is_told_as_one_and_not_planned_again(
        folder, command, monkeypatch):
    def break_down(*arguments, **options):
        return [][5]
    monkeypatch.setattr('secure_uav_planner.apps.tasks.assess', break_down)
    Path('campaign.yaml').write_text(CAMPAIGN.replace('samples: 2', 'samples: 1')
                                     + 'assess: {draws: 2}\n')
    for _ in range(2):
        _, errors = command(*SWEEP, '--jobs', '1', status=1)
        assert re.search('8 missions met a fault of the program, .* please report it: IndexError: '
                         r'list index out of range \(test_sweep.py, line \d+\)', errors), errors
    rows = journal()
    assert len(rows) == 16
    assert [row['outcome'] for row in rows].count('fault') == 8


def test_an_own_planner_that_exits_fails_in_its_mission_only():
    row = run_task(make_task(Scenario.paper(110.0, slots=11).to_dict(), 'sys:exit', 'worst_case',
                             {'time_limit': None, 'bound_time_limit': None}, {}))
    assert row['outcome'] == 'fault' and row['reason'].startswith('SystemExit: ')


@pytest.mark.slow
@pytest.mark.parametrize(
    'cluster', [{'DASK_DISTRIBUTED__SCHEDULER__ALLOWED_FAILURES': '0'}], indirect=True)
def test_a_mission_that_lost_its_worker_is_reported_and_retried(folder, cluster):
    address, (_, victim, _) = cluster
    Path('campaign.yaml').write_text(CAMPAIGN.replace('samples: 2', 'samples: 10'))
    with pytest.importorskip('distributed').Client(address) as client:
        client.wait_for_workers(2, PATIENCE)
    victim.send_signal(signal.SIGSTOP)  # So it gets missions, and finishes none.
    arguments = *SWEEP, '--scheduler', address
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
    page = (Path(__file__).parents[1] / 'docs' / 'command.md').read_text()
    [code] = re.findall('```python\n(from dask_jobqueue.*?)```', page, re.DOTALL)
    assert len(code.splitlines()) == 6
    names = {}
    try:
        exec(code, names)
        assert names['rows'].outcome.value_counts().to_dict() == {'ok': 16, 'infeasible': 16}
    finally:
        names['client'].close()
        names['cluster'].close()


def test_a_scheduler_that_cannot_be_reached_is_status_2(folder, command, monkeypatch):
    pytest.importorskip('distributed')
    monkeypatch.setattr('secure_uav_planner.apps.tasks._CONNECT_TIMEOUT', 1.0)
    _, err = command(*SWEEP, '--scheduler', 'tcp://127.0.0.1:1', status=2)
    assert 'cannot be reached' in err
