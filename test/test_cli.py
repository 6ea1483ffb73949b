"""The command, as a person or a script runs it."""

import argparse
from dataclasses import replace
import io
import os
from pathlib import Path
import re
import shutil
import signal
import subprocess
import sys

from conftest import is_there
from processes import environment, ROOT
import pytest
from secure_uav_planner import Channel, Eavesdropper, Origin, Plan, Scenario
from secure_uav_planner.apps.cli import EXIT_STATUSES, main, make_parser
from strategies import make_crowd

MODULE = [sys.executable, '-m', 'secure_uav_planner']
PATIENCE = 300.0
PLAN = ('plan', 'mission.yaml', '--bound-time-limit', '0')


def run(folder, *arguments, **options):
    """Run the command in a folder; return what it did."""
    return subprocess.run([*MODULE, *arguments], cwd=folder, text=True, timeout=PATIENCE, **{
        'stdout': subprocess.PIPE, 'stderr': subprocess.PIPE, 'env': environment(), **options})


@pytest.fixture(scope='module')
def planned(tmp_path_factory):
    """Return a folder with a mission and with what `plan` makes of it, and what it printed."""
    folder = tmp_path_factory.mktemp('planned')
    Scenario.paper(120.0, slots=30).save(folder / 'mission.yaml')
    done = run(folder, 'plan', 'mission.yaml', '-o', 'a/b', '--bound-time-limit', '3')
    assert done.returncode == 0, done.stdout + done.stderr
    return folder, done.stdout


def test_a_plan_is_written_with_all_that_belongs_to_it(planned):
    folder, printed = planned
    out = folder / 'a' / 'b'
    plan = Plan.load(out / 'plan.json')
    assert plan.scenario == Scenario.paper(120.0, slots=30)
    assert (out / 'plan.png').read_bytes().startswith(b'\x89PNG')
    assert '<html' in (out / 'plan.html').read_text()[:100]
    assert {path.name for path in out.iterdir()} == {
        'plan.json', 'plan.csv', 'plan.png', 'plan.html'}
    for name in out.iterdir():
        assert f'{Path("a/b") / name.name}' in printed
    pandas = pytest.importorskip('pandas')
    pandas.testing.assert_frame_equal(
        pandas.read_csv(out / 'plan.csv'), plan.to_dataframe(), check_exact=True)


def test_the_table_has_the_baselines_the_plan_and_a_bound_above_it(planned):
    folder, printed = planned
    plan = Plan.load(folder / 'a' / 'b' / 'plan.json')
    rows = {line.split('  ')[0]: line.split()[-3:] for line in printed.splitlines() if line}
    assert rows['joint'][:2] == [f'{plan.guaranteed_rate:.4f}', f'{plan.worst_case_rate:.4f}']
    constant, optimised = (float(rows[f'fly_hover_fly_{power}'][0])
                           for power in ('constant', 'optimised'))
    bound = float(rows['bound of any plan'][1])
    assert constant < optimised < plan.guaranteed_rate <= bound
    # The same one is in the file, and its claim is what is printed.
    assert plan.bound.rate == pytest.approx(bound, abs=1e-4)
    assert f'; {plan.claim}\nproven in ' in printed
    [percent] = re.findall(r'at most (.*)% below the best possible', printed)
    assert 0 <= float(percent) - 100 * (1 - plan.worst_case_rate / plan.bound.rate) < 0.1 + 1e-9


def test_a_bound_that_its_time_limit_ended_says_how_to_ask_for_more(tmp_path, command):
    Scenario.paper(120.0, slots=20).save(tmp_path / 'mission.yaml')
    out, _ = command('plan', tmp_path / 'mission.yaml', '-o', tmp_path, '--no-baselines',
                     '--bound-time-limit', '0.01')
    assert re.search(r'\nproven in .* s, when its time limit was over; a larger '
                     r'--bound-time-limit may prove more\n', out)


@pytest.mark.parametrize('scenario, reason', [
    (replace(Scenario.paper(120.0, slots=10), channel=Channel(los='urban')), 'free space'),
    (make_crowd(3, 1, 10), '2 jammers')], ids=['channel', 'jammers'])
def test_a_mission_without_a_proof_is_planned_and_its_plan_says_so(
        scenario, reason, tmp_path, command):
    scenario.save(tmp_path / 'mission.yaml')
    out, err = command('plan', tmp_path / 'mission.yaml', '-o', tmp_path, '--no-baselines')
    assert 'no bound: ' in out and reason in out and 'bound' not in err
    assert 'fly_hover_fly' not in out
    assert Plan.load(tmp_path / 'plan.json').bound is None


def test_a_plan_with_an_origin_is_written_as_a_map_in_degrees(planned, tmp_path, command):
    scenario = replace(Scenario.paper(120.0, slots=10), origin=Origin(47.4, 8.5))
    scenario.save(tmp_path / 'mission.yaml')
    out, _ = command('plan', tmp_path / 'mission.yaml', '-o', tmp_path, '--bound-time-limit', '0',
                     '--no-baselines')
    file = tmp_path / 'plan.geojson'
    assert str(file) in out
    command('show', tmp_path / 'plan.json', '-o', tmp_path / 'x.GeoJSON')
    assert (tmp_path / 'x.GeoJSON').read_text() == file.read_text()
    Plan.load(tmp_path / 'plan.json').to_geojson(tmp_path / 'y.geojson')
    assert (tmp_path / 'y.geojson').read_text() == file.read_text()
    plain = planned[0] / 'a' / 'b' / 'plan.json'
    out, err = command('show', plain, '-o', tmp_path / 'z.geojson', status=2)
    assert out == '' and 'plan.json has no places in degrees; give its mission an origin' in err
    assert not (tmp_path / 'z.geojson').exists()


def test_a_place_that_no_degrees_describe_costs_the_map_alone(tmp_path, command):
    ship = Eavesdropper(track=((0.0, 200.0, 0.0, 10.0), (7200.0, 1.2e5, 0.0, 10.0)))
    scenario = replace(Scenario.paper(120.0, slots=10), origin=Origin(47.4, 8.5))
    replace(scenario, eavesdroppers=(ship,)).save(tmp_path / 'mission.yaml')
    _, err = command('plan', tmp_path / 'mission.yaml', '-o', tmp_path, '--bound-time-limit', '0',
                     '--no-baselines')
    assert err.startswith('a place is 120 km from the origin') and err.count('\n') == 1
    assert 'plan.geojson is not drawn' in err and (tmp_path / 'plan.html').exists()


def test_a_plan_is_kept_when_its_bound_fails(tmp_path, monkeypatch, command):
    def fail(*_, **__):
        raise MemoryError
    monkeypatch.setattr('secure_uav_planner.apps.planning.upper_bound', fail)
    Scenario.paper(120.0, slots=10).save(tmp_path / 'mission.yaml')
    _, err = command('plan', tmp_path / 'mission.yaml', '-o', tmp_path, status=1)
    file = tmp_path / 'plan.json'
    assert f'written: {file}\n' in err
    assert Plan.load(file).bound is None


def test_show_draws_a_plan_and_prints_its_rates(planned, command):
    folder, _ = planned
    file = folder / 'a' / 'b' / 'plan.json'
    for name, start in (('x.svg', b'<?xml'), ('x.PNG', b'\x89PNG'), ('x.html', b'<')):
        out, _ = command('show', file, '-o', folder / name)
        assert (folder / name).read_bytes().startswith(start)
        assert f'{Plan.load(file).guaranteed_rate:.4f}' in out
    _, err = command('show', file, '-o', folder / 'x.doc', status=2)
    assert '.png, .svg, .pdf, .html, .geojson' in err


@pytest.mark.parametrize('arguments, reason', [
    (['check', 'none.yaml'], 'none.yaml cannot be read: No such file'),
    (['check', '.'], 'not a regular file'),
    (['show', 'mission.json'], 'mission.json is not a plan'),
    (['show', __file__], 'is not a plan: line 1 is not JSON'),
    (['sweep', 'mission.json'], 'it is a mission; a campaign names one by its field mission'),
    (['plan', 'mission.json', '-o', 'mission.json'], 'cannot be written to: it is a file'),
    (['plan', 'mission.json', '-o', 'lost'], 'it is a link to /no/disk, which is not there'),
    (['plan', 'plan.json', '-o', '.'], 'would replace the mission plan.json; choose another'),
    (['new', 'lost'], 'it is a link to /no/disk, which is not there'),
    (['plan', 'mission.json', '-o', '/proc/nothing'], '/proc/nothing cannot be written to'),
    (['plan', 'mission.json', '--method', 'alternating', '--objective', 'worst_case'],
     "'alternating' has only 'guaranteed'"),
    (['new', 'no/folder/mission.yaml'], 'cannot be written: No such file'),
    (['new', 'new.json'], 'cannot have comments'),
    (['new', '.', '--force'], '. is a folder; name a file in it, such as mission.yaml'),
    (['show', str(ROOT / 'docs' / 'plan.png')], 'plan.png is not a plan: it is not text in UTF-8'),
    (['node', 'flyer'], "there is no node 'flyer'; there are planner, relay, replay"),
    (['node', 'planer'], "there is no node 'planer'; did you mean planner?"),
    (['node', 'planner', 'mission.yaml'], "the node planner has no argument 'mission.yaml'; did "
     'you mean --ros-args -p mission_file:=mission.yaml?'),
    (['node', 'replay', 'rate:=5'], 'did you mean --ros-args -p rate:=5?'),
    (['node', 'relay', '-p', 'stack:=px4'], 'did you mean --ros-args -p stack:=px4?'),
    (['fly'], "there is no command 'fly'; there are plan, check, new")])
def test_bad_input_is_one_line_and_status_2(tmp_path, monkeypatch, command, arguments, reason):
    monkeypatch.chdir(tmp_path)
    Scenario.paper(120.0, slots=10).save('mission.json')
    Path('plan.json').write_text(Path('mission.json').read_text())
    Path('lost').symlink_to('/no/disk')
    out, err = command(*arguments, status=2)
    assert out == '' and len(err.splitlines()) == 1 and reason in err
    assert {path.name for path in tmp_path.iterdir()} <= {
        'mission.json', 'plan.json', 'out', 'lost'}


@pytest.mark.parametrize('arguments, reason', [
    ([], 'required: command'), (['plan', 'a', '--method', 'magic'], "invalid choice: 'magic'"),
    (['check', 'a', 'b'], 'unrecognized arguments: b'), (['node', '--x'], 'required: node'),
    (['plan', 'a', '--time-limit', '0'], "'0' must be a number above 0, in s"),
    (['plan', 'a', '--time-limit', '1m'], "'1m' must be a number above 0, in s and without a un"),
    (['plan', 'a', '--bound-time-limit', '-1'], "'-1' must be 0 or a number above 0, in s and"),
    (['assess', 'a', '--draws', '10.5'], "--draws: '10.5' must be a whole number"),
    (['link-budget', '--carrier-hz', '2.4GHz', '--bandwidth-hz', '1e6'],
     "--carrier-hz: '2.4GHz' must be a number, without its unit")])
def test_a_wrong_option_is_one_line_with_the_allowed_values_and_status_2(
        arguments, reason, capsys):
    with pytest.raises(SystemExit) as error:
        main(arguments)
    [line] = capsys.readouterr().err.splitlines()
    assert error.value.code == 2 and reason in line and line.endswith(' --help')


def test_pictures_do_not_depend_on_the_settings_of_the_user(planned, tmp_path):
    """Of a notebook whose environment this is not, and of LaTeX, which is not on the path."""
    shutil.copy(planned[0] / 'a' / 'b' / 'plan.json', tmp_path)
    pictures, settings = set(), tmp_path / 'matplotlibrc'
    for text, backend in (('', 'agg'), ('text.usetex: True\nlines.linewidth: 9', 'no'),
                          ('', 'module://matplotlib_none.backend_inline')):
        settings.write_text(text)
        done = run(tmp_path, 'show', 'plan.json', env=environment(
            PATH='', MATPLOTLIBRC=str(settings), MPLBACKEND=backend))
        assert done.returncode == 0 and done.stderr == '', done.stderr
        pictures.add((tmp_path / 'plan.png').read_bytes())
    assert len(pictures) == 1


def test_what_cannot_be_drawn_is_a_line_and_the_rest_is_written(tmp_path, monkeypatch, command):
    def fail(*_):
        raise RuntimeError('no font')
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr('secure_uav_planner.output.picture.save_picture', fail)
    monkeypatch.setattr('secure_uav_planner.output.figures.save_assessment', fail)
    Scenario.paper(120.0, slots=10).save('mission.yaml')
    out, err = command('plan', 'mission.yaml', '--no-baselines', '--bound-time-limit', '0')
    [line] = err.splitlines()
    assert line == 'out/plan.png cannot be drawn: RuntimeError: no font'
    assert 'plan.html' in out and 'plan.png' not in out and Path('out/plan.html').exists()
    for words, status in ((['assess', 'out/plan.json', '--draws', '10'], 0),
                          (['show', 'out/plan.json'], 1)):
        _, err = command(*words, status=status)
        assert err.count('cannot be drawn: RuntimeError: no font') == 1


@pytest.mark.parametrize('part', ['show', 'assess'])
def test_a_picture_that_cannot_be_written_is_told_before_all_else(
        planned, tmp_path, command, part):
    (tmp_path / 'folder.png').mkdir()
    for file, reason in (('none/x.png', 'No such file or directory'),
                         ('folder.png', 'it is a folder')):
        out, err = command(part, planned[0] / 'a' / 'b' / 'plan.json', '-o', tmp_path / file,
                           status=2)
        assert out == '' and f'{tmp_path / file} cannot be written: {reason}' in err


def test_the_command_needs_no_output_and_tells_of_one_that_is_full(tmp_path):
    Scenario.paper(120.0, slots=10).save(tmp_path / 'mission.yaml')

    def check(end, **variables):
        return subprocess.run(
            ['sh', '-c', f'exec "$@" {end}', 'sh', *MODULE, 'check', 'mission.yaml'], cwd=tmp_path,
            capture_output=True, text=True, timeout=PATIENCE, env=environment(**variables))

    for end in ('>&-', '2>&-', '>&- 2>&-'):
        assert check(end).returncode == 0, end
    for unbuffered in ('', '1'):
        done = check('>/dev/full', PYTHONUNBUFFERED=unbuffered)
        assert (done.returncode, done.stderr) == (1, (
            'secure_uav_planner: standard output cannot be written: No space left on device; what '
            'was written before is kept\n'))


def test_all_files_are_written_though_nobody_reads_what_is_printed(tmp_path):
    Scenario.paper(120.0, slots=10).save(tmp_path / 'mission.yaml')
    ours, theirs = os.pipe()
    os.close(ours)
    done = run(tmp_path, *PLAN, stdout=theirs)
    os.close(theirs)
    assert (done.returncode, done.stderr) == (1, '')
    assert {path.name for path in (tmp_path / 'out').iterdir()} == {
        'plan.json', 'plan.csv', 'plan.png', 'plan.html'}


class Terminal(io.StringIO):
    """A terminal that sends a signal to this process once it shows a text."""

    def __init__(self, text, number):
        super().__init__()
        self.text, self.number = text, number

    def isatty(self):
        return True

    def write(self, shown):
        if self.text and self.text in shown:
            self.text = None
            signal.raise_signal(self.number)
        return super().write(shown)


SEARCH = '(power)', ('--method', 'alternating', '--no-baselines', '--bound-time-limit', '0')
PROOF = 'no plan has more', ('--bound-time-limit', '600')


@pytest.mark.parametrize('number, stage', [
    (signal.SIGINT, SEARCH), (signal.SIGTERM, SEARCH), (signal.SIGINT, PROOF)])
def test_a_signal_keeps_the_best_plan_and_what_is_proven_so_far_and_says_so(
        tmp_path, monkeypatch, capsys, number, stage):
    monkeypatch.chdir(tmp_path)
    Scenario.paper(200.0, slots=500).save('mission.yaml')  # The proof takes long.
    text, options = stage
    terminal = Terminal(text, number)
    monkeypatch.setattr(sys, 'stderr', terminal)
    assert main(['plan', 'mission.yaml', *options]) == 130
    printed = capsys.readouterr().out
    assert 'secure_uav_planner: stopped; ' in terminal.getvalue()
    assert 'written: out/plan.json' in printed
    plan = Plan.load('out/plan.json')
    if stage is SEARCH:
        assert plan.status == 'cancelled' and plan.message in printed
        return
    assert plan.status == 'converged' and plan.bound.status == 'cancelled'
    assert ', when it was stopped\n' in printed
    for scheme in ('fly_hover_fly_constant', 'fly_hover_fly_optimised', 'bound of any plan'):
        assert scheme in printed


ROS = 'rclpy', 'rcl_interfaces', 'std_msgs'
NEEDS_ROS = pytest.mark.skipif(not is_there('rclpy'), reason='loads ROS')


@pytest.mark.parametrize('hidden, arguments, status, extra', [
    (['matplotlib'], PLAN, 0, 'view'), (['plotly'], PLAN, 0, 'view'),
    pytest.param(['mcap'], [*PLAN, '--mcap'], 2, 'view', marks=NEEDS_ROS),
    (ROS, [*PLAN, '--mcap'], 2, 'ros'),
    (ROS, ['node', 'planner'], 2, 'ros'), (['matplotlib'], ['show', 'a/b/plan.json'], 2, 'view'),
    (['plotly'], ['show', 'a/b/plan.json', '-o', 'plan.html'], 2, 'view'),
    (['matplotlib'], ['assess', 'a/b/plan.json', '--draws', '10'], 0, 'view'),
    (['dash'], ['explore', 'mission.yaml'], 2, 'explore'),
    (['joblib'], ['sweep', 'campaign.yaml'], 2, 'campaign'),
    (['distributed'], ['sweep', 'campaign.yaml', '--scheduler', 'tcp://127.0.0.1:1'], 2,
     'campaign')])
def test_of_a_package_that_is_missing_a_line_says_what_to_install(
        planned, tmp_path, hidden, arguments, status, extra):
    (tmp_path / 'sitecustomize.py').write_text(f"""
import sys


class Absent:
    def find_spec(self, name, path=None, target=None):
        if name.partition('.')[0] in {hidden!r}:
            raise ModuleNotFoundError(f'No module named {{name!r}}', name=name)


sys.meta_path.insert(0, Absent())
""")
    shutil.copytree(planned[0], tmp_path, dirs_exist_ok=True)
    (tmp_path / 'campaign.yaml').write_text('mission: mission.yaml')
    done = run(tmp_path, *arguments, env=environment(str(tmp_path)))
    [line] = done.stderr.splitlines()
    assert f'{hidden[0]} is not installed' in line or hidden is ROS
    assert f'pip install "secure_uav_planner[{extra}]"' in line
    assert done.returncode == status


SCRIPT = [sys.executable, str(ROOT / 'scripts' / 'relay')]
BLOCKER = """
import sys, time
class Blocker:
    def find_spec(self, name, *_):
        if name == {name!r}:
            print('loading', flush=True)
            try:  # A signal right before a sleep is answered after it: sleeps are short.
                for _ in range(round(20 * {patience})):
                    time.sleep(0.05)
            except BaseException:
                raise ImportError('an extension turns an interrupt into this')
sys.meta_path.insert(0, Blocker())
"""


@pytest.mark.parametrize('number', [signal.SIGINT, signal.SIGTERM])
@pytest.mark.parametrize('words, module', [
    ([*MODULE, 'check', 'a.yaml'], 'numpy'), ([*MODULE, 'plan', 'a.yaml'], 'argparse'),
    ([*MODULE, 'plan', 'a.yaml'], 'scipy'),
    pytest.param([*MODULE, 'node', 'planner'], 'rclpy', marks=NEEDS_ROS),
    pytest.param(SCRIPT, 'rclpy', marks=NEEDS_ROS)])
def test_a_signal_while_modules_load_ends_the_command_in_a_line(
        tmp_path, words, module, number):
    (tmp_path / 'sitecustomize.py').write_text(BLOCKER.format(name=module, patience=PATIENCE))
    with subprocess.Popen(words, cwd=tmp_path, env=environment(str(tmp_path)), text=True,
                          stdout=subprocess.PIPE, stderr=subprocess.PIPE) as process:
        assert process.stdout.readline() == 'loading\n'
        process.send_signal(number)
        assert process.communicate(timeout=PATIENCE) == ('', 'secure_uav_planner: stopped\n')
    assert process.returncode == 130


@pytest.mark.parametrize('line, expected', [
    ('secure_uav_planner ', {'plan', 'check', 'new', 'show', 'node'}),
    ('secure_uav_planner pl', {'plan'}),
    ('secure_uav_planner plan m.yaml --me', {'--method'}),
    ('secure_uav_planner plan m.yaml --method ', {'joint', 'alternating'})])
def test_a_shell_completes_commands_and_options(tmp_path, line, expected):
    words = ' '.join(f"'{word}'" for word in MODULE)
    subprocess.run(
        ['bash', '-c', f'exec {words} 8>{tmp_path / "completions"} 9>/dev/null'], timeout=PATIENCE,
        env=environment(_ARGCOMPLETE='1', COMP_LINE=line, COMP_POINT=str(len(line)),
                        _ARGCOMPLETE_IFS='\n', _ARGCOMPLETE_SUPPRESS_SPACE='1'))
    words = (tmp_path / 'completions').read_text().split('\n')
    assert expected <= {word.strip() for word in words}


def list_parsers():
    """Return the parser of each part of the command by its name."""
    [action] = [action for action in make_parser()._actions
                if isinstance(action, argparse._SubParsersAction)]
    return action.choices


def test_the_reference_has_each_part_option_and_status_of_the_command():
    text = (ROOT / 'docs' / 'command.md').read_text()
    section = text.split('\n## Command\n')[1].split('\n## ')[0]
    for name, parser in list_parsers().items():
        assert f'| `{name}' in section, name
        for action in parser._actions:
            for option in action.option_strings:
                assert option in ('-h', '--help', '-o') or f'`{option}' in section, option
    for status, meaning in EXIT_STATUSES.items():
        assert f'| {status} | {meaning} |' in section
    assert not set(re.findall(r'`(--[\w-]+)', section)) - {
        option for parser in [make_parser(), *list_parsers().values()]
        for option in parser._option_string_actions}
