"""The documentation does what it says: its code runs, its names and links exist."""

import ast
from dataclasses import replace
from html import unescape
from pathlib import Path
import re
import shlex
import shutil
import signal
import subprocess
import sys
from typing import NamedTuple

from diagnostic_msgs.msg import DiagnosticStatus
from docs.tools import reference
from processes import environment, ROOT
import pytest
from ros_client import flat, values_of
from ros_nodes import node_here, wait_for
import secure_uav_planner
from secure_uav_planner import Scenario
from secure_uav_planner.ros.planner.node import Planner
from secure_uav_planner.ros.relay_reports import RelayState
from secure_uav_planner.ros.replay.node import Replay
from test_security import lone_node
import yaml

PAGES = sorted([ROOT / 'README.md', *(ROOT / 'docs').glob('*.md'),
                *(ROOT / 'studies').glob('*.md'),
                *(ROOT / 'docs' / 'gallery').glob('[!i]*.md')])
PATIENCE = 300.0

OF_ROS = ('rcl_interfaces', 'type_description_interfaces')
OF_OTHERS = {'catkin_generate_changelog', 'catkin_prepare_release', 'ref_alt', 'ref_lat',
             'ref_lon', 'xy_global', 'xy_valid'}
"""Names in pages that are of others."""


class Block(NamedTuple):
    """A fenced block: what it is in, the comment above, and where."""

    language: str
    text: str
    note: str
    line: int


def blocks_of(page):
    """Return the blocks of a page in their order."""
    found, note, lines = [], '', page.read_text().splitlines()
    number = 0
    while number < len(lines):
        line = lines[number]
        if line.startswith('```'):
            end = lines.index('```', number + 1)
            text = '\n'.join(lines[number + 1:end]) + '\n'
            found.append(Block(line[3:], text, note, number + 2))
            number = end
        if line.strip():
            note = re.sub('<!-- (.*) -->', r'\1', line) if line.startswith('<!-- ') else ''
        number += 1
    return found


def commands_of(block):
    """Return the commands of a shell block as lists of words, without comments."""
    lines = block.text.replace('\\\n', ' ').replace(' && ', '\n').splitlines()
    return [words for line in lines if (words := shlex.split(line, comments=True))]


@pytest.fixture(scope='module')
def interfaces():
    return reference.interfaces()


class Walkthrough:
    """A reader who does what a page says, in a folder of their own."""

    def __init__(self, folder):
        self.folder, self.namespace = folder, {'__name__': '__main__'}
        self.unused, self.nodes = set(), {}

    # Blocks

    def do(self, page):
        output = ''
        for block in blocks_of(page):
            where = f'{page.name}:{block.line}'
            if block.note.startswith('no-test:'):
                assert len(block.note) > len('no-test: ') + 10, f'{where}: no reason is given'
            elif block.note.startswith('file: '):
                (self.folder / block.note[6:]).write_text(block.text)
                self.unused.add(block.note[6:])
            elif block.language == 'python':
                if block.note != 'with a compiler' or shutil.which('c++'):
                    output = self._run_python(block, page)
            elif block.language in ('sh', 'bash', 'console'):
                for words in commands_of(block):
                    self._do_command(words, where)
            elif block.language == 'text':
                assert_same(output, block.text, where)
            else:
                raise AssertionError(f'{where}: a block in {block.language!r} is not tested')
        assert not self.unused, f'{page.name}: {self.unused} are written and never used'

    def _run_python(self, block, page):
        self.unused -= {name for name in self.unused if Path(name).stem in block.text}
        # Line numbers in a traceback are those of the page.
        code = compile('\n' * (block.line - 1) + block.text, str(page), 'exec')
        printed = []
        self.namespace['print'] = lambda *words, **options: (
            print(*words, **options) if 'file' in options
            else printed.append(' '.join(map(str, words))))
        exec(code, self.namespace)
        return '\n'.join(printed)

    # Commands

    def _do_command(self, words, where):
        told = f'{where}: {shlex.join(words)}'
        self.unused -= {name for name in self.unused if any(name in word for word in words)}
        if words[:2] == ['secure_uav_planner', 'node']:
            self._start(words[2], words[3:], told)
        elif words[0] == 'secure_uav_planner':
            self._run(['-m', *words], told)
        elif words[0] in ('python', 'python3'):
            self._run(words[1:], told)
        else:
            # What a reader installs and sets up is tried by test_packaging, CI and test_security.
            assert words[0] in ('cd', 'colcon', 'export', 'git', 'make', 'mkdir', 'pip', 'ros2',
                                'rosdep', '.', 'source'), f'{told}: nobody has tested this'

    def _start(self, name, arguments, told):
        """Start a node and wait until it is ready; the one of that name before is stopped."""
        self.stop(name)
        log = self.folder / f'{name}.log'
        with log.open('w') as file:
            self.nodes[name] = subprocess.Popen(
                [sys.executable, '-m', 'secure_uav_planner', 'node', name, *arguments],
                stdout=file, stderr=subprocess.STDOUT, cwd=self.folder,
                env=environment(PYTHONUNBUFFERED='1'))
        # What starts by itself has done its work when it says so.
        word = 'end of the plan' if 'autostart:=true' in arguments else 'ready'
        wait_for(lambda: word in log.read_text(), patience=PATIENCE, what=told)
        assert 'there is no parameter' not in log.read_text(), told

    def stop(self, name):
        """Stop a node as Ctrl-C does; it must end well."""
        process = self.nodes.pop(name, None)
        if process is None:
            return
        process.send_signal(signal.SIGINT)
        try:
            assert process.wait(timeout=PATIENCE) == 0, (self.folder / f'{name}.log').read_text()
        finally:
            process.kill()

    def _run(self, arguments, told):
        result = subprocess.run(
            [sys.executable, *arguments], cwd=self.folder, capture_output=True, text=True,
            timeout=PATIENCE, env=environment())
        assert result.returncode == 0, f'{told}: {result.stdout}{result.stderr}'


def assert_same(printed, written, where):
    """Compare words exactly and numbers to what rounding and another machine may change."""
    number = re.compile(r'-?\d+\.\d+')
    assert number.sub('#', printed).split() == number.sub('#', written).split(), where
    for is_now, was in zip(number.findall(printed), number.findall(written)):
        last_digit = 10.0 ** -len(was.split('.')[1])
        tolerance = max(1.5 * last_digit, 1e-3)
        assert abs(float(is_now) - float(was)) <= tolerance, f'{where}: {is_now} is not {was}'


@pytest.mark.slow
@pytest.mark.parametrize('page', PAGES, ids=lambda page: page.name)
def test_every_block_of_a_page_does_what_it_says(
        page, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    reader = Walkthrough(tmp_path)
    try:
        reader.do(page)
        for name in list(reader.nodes):
            reader.stop(name)
    finally:
        for process in reader.nodes.values():
            process.kill()
            process.wait()


def find_spec(name):
    """Return the Spec of a parameter of any node and member by its name."""
    specs = {key: spec for node in reference.specs().values() for key, spec in node.items()}
    members = {key.partition('>')[2]: spec for key, spec in specs.items() if key[0] == '<'}
    return specs.get(name) or members[f'.{name.partition(".")[2]}']


def check_names(block, interfaces):
    """Check the names of parameters, topics and services in a block."""
    given = re.findall(r'-p ([\w.]+):=("[^"]*"|\S+)', block.text)
    given += re.findall(r'^ros2 param set \S+ (\S+) (.+)$', block.text, re.MULTILINE)
    values = [(name, yaml.safe_load(yaml.safe_load(text) if text[0] == '"' else text))
              for name, text in given]
    if block.language == 'yaml':
        for content in yaml.safe_load(block.text).values():
            if isinstance(content, dict):
                values += flat(content.get('ros__parameters', {}))
    for name, value in values:
        find_spec(name).convert(name, value)
    for name, kind in re.findall(
            r'^ros2 (?:topic|service) [^/\n]+/\w+/(\S+) ?(\S*)', block.text, re.MULTILINE):
        assert any(row.name.endswith(f'/{name}') and kind in ('', row.kind)
                   for row in interfaces), (name, kind)


@pytest.mark.parametrize('page', PAGES, ids=lambda page: page.name)
def test_each_parameter_topic_and_service_in_a_command_exists(page, interfaces):
    for block in blocks_of(page):
        check_names(block, interfaces)


def anchors_of(page):
    headings = re.findall(r'^#+ (.*)$', page.read_text(), re.MULTILINE)
    return {re.sub(r'[^\w\- ]', '', heading.lower()).replace(' ', '-') for heading in headings}


@pytest.mark.parametrize('page', PAGES, ids=lambda page: page.name)
def test_every_relative_link_leads_somewhere(page):
    for target in re.findall(r'\]\(([^)\s]+)\)', page.read_text()):
        if re.match('https?://', target):
            continue
        path, _, anchor = target.partition('#')
        other = page.parent / path if path else page
        if page.parent.name == 'gallery' and other.suffix == '.png':
            assert f"{path}'" in page.read_text(), f'{target} is not drawn by its page'
        assert other.exists(), target
        if anchor:
            assert anchor in anchors_of(other), target


def test_the_generated_reference_is_current():
    for node, text in reference.markdown().items():
        _, inside, _ = reference.split_page((ROOT / 'docs' / f'{node}.md').read_text())
        assert inside.strip() == text.strip(), (
            'run `python -m docs.tools.reference docs`')


def offered(node):
    """Return the topics and services of a node as Interfaces of any UAV, without a meaning."""
    of_any = {'uav1': '<uav>', 'uav2': '<uav>', 'ground_node': '<ground_node>',
              'eavesdropper': '<eavesdropper>', node.get_name(): '~'}
    found = [('sub', one.topic_name, one.msg_type, 'msg', one.qos_profile)
             for one in node.subscriptions]
    found += [('pub', one.topic_name, one.msg_type, 'msg', one.qos_profile)
              for one in node.publishers]
    found += [('srv', one.service_name, one.srv_type, 'srv', None) for one in node.services]
    for direction, name, kind, folder, qos in found:
        first, _, rest = name.removeprefix('/here/').partition('/')
        package = kind.__module__.split('.')[0]
        if package not in OF_ROS and name not in ('/clock', '/rosout'):
            yield (node.get_name(), direction, f'{of_any.get(first, first)}/{rest}'.rstrip('/'),
                   f'{package}/{folder}/{kind.__name__}',
                   reference.describe_qos(qos) if qos else '')


@pytest.mark.parametrize('kind', [Planner, Replay])
def test_the_nodes_have_the_topics_and_services_of_the_reference(kind, interfaces):
    with lone_node(kind, namespace='/here') as node:
        assert set(offered(node)) == {
            row[:5] for row in interfaces
            if row.node == node.get_name() and '<uav>.reference' not in row.meaning}


def test_the_reference_has_every_value_of_the_status(client, tmp_path):
    mission, tower = Scenario.paper(120.0, slots=20), ((900, 0), (950, 0), (950, 50))
    replace(mission, no_fly_zones=(secure_uav_planner.NoFlyZone(tower, name='tower'),), uavs=tuple(
        replace(uav, propulsion=secure_uav_planner.Propulsion()) for uav in mission.uavs)).save(
            tmp_path / 'mission.yaml')
    any_of = {'<uav>': 'uav.', '<ground_node>': 'ground_node',
              '<topic>': '[a-z0-9_]+/(pose|odom)'}
    _, _, table = (ROOT / 'docs' / 'planner.md').read_text().partition('\n## Status\n')
    documented = {*re.findall(r'^\| `(.*?)` \|', table, re.MULTILINE)}
    patterns = {key: re.sub('<.*?>', lambda kind: any_of[kind[0]], key.replace('.', r'\.'))
                for key in documented}

    def have_come(keys):
        """Return True once values of these keys have come; none may be without a meaning."""
        values = {key for status in statuses for key in values_of(status)}
        meant = {key: {value for value in values if re.fullmatch(pattern, value)}
                 for key, pattern in patterns.items()}
        assert values <= set().union(*meant.values())
        return all(meant[key] for key in keys)

    of_solves = {key for key in documented if key.startswith('progress.')}
    of_receivers = {'plan.promised_until'}
    with node_here('planner', mission_file=str(tmp_path / 'mission.yaml'), bound='after'):
        statuses = client.listen(DiagnosticStatus, 'planner/status')
        wait_for(lambda: client.plan_paper() and have_come(of_solves))
        client.follow()
        client.publisher(DiagnosticStatus, 'uav1/relay').publish(
            RelayState('/relay', 'passing', 1.0).to_message('uav1'))
        wait_for(lambda: have_come(documented - of_receivers))
        client.send_odometry('eavesdropper/odom', 200, 0, (1.0, 0.0))
        assert client.call('planner/plan').success
        wait_for(lambda: have_come(of_receivers))


@pytest.mark.parametrize('page', PAGES, ids=lambda page: page.name)
def test_each_name_in_the_prose_exists(page, interfaces):
    prose = re.sub('```.*?```', '', page.read_text(), flags=re.DOTALL)
    parameters = {name for specs in reference.specs().values() for name in specs}
    topics = {row.name for row in interfaces}
    words = {word for folder in ('secure_uav_planner', 'docs/tools', 'launch')
             for file in (ROOT / folder).rglob('*.py')
             for word in re.findall(r'\w+', file.read_text())} | OF_OTHERS
    for code in re.findall('`([^`\n]+)`', prose):
        if re.fullmatch(r'<(uav|ground_node|eavesdropper|zone)>\.\w+', code):
            assert code in parameters, code
        elif re.fullmatch(r'(<(uav|ground_node|eavesdropper|vehicle)>|~)/[\w/]+', code):
            assert code in topics, code
        elif re.fullmatch(r'[a-z]+(_[a-z]+)+', code):
            assert code in words, code
        elif re.fullmatch(
                r'(Scenario|Plan|Uav|Eavesdropper|NoFlyZone|Iteration)\.\w+(\(.*\))?', code):
            owner, name = code.partition('(')[0].split('.')
            kind = getattr(secure_uav_planner, owner)
            assert hasattr(kind, name) or name in kind.__dataclass_fields__, code


def test_the_plan_file_has_the_fields_of_the_reference(tmp_path):
    plan = secure_uav_planner.fly_hover_fly(Scenario.paper(120.0, slots=10))
    plan.save(tmp_path / 'plan.json')
    section = (ROOT / 'docs' / 'command.md').read_text().split('## Plan file')[1].split('## ')[0]
    rows = re.findall(r'^\| (`.*?) \|', section, re.MULTILINE)
    documented = {name for row in rows for name in re.findall('`(.*?)`', row)}
    assert documented == set(yaml.safe_load((tmp_path / 'plan.json').read_text()))


def test_the_figures_name_the_topics_services_and_states_that_there_are(interfaces):
    words = {name: re.findall('>([^<>]+)</text>', (ROOT / 'docs' / f'{name}.svg').read_text())
             for name in ('nodes', 'follower')}
    drawn = {word for text in words['nodes'] for word in unescape(text).split(', ')
             if re.fullmatch(r'[\w<>~/]*[~/_][\w/<>]*', word)}
    assert drawn <= {interface.name for interface in interfaces}
    assert len(drawn) == 18
    assert set(words['follower']) >= {'waiting', 'flying', 'held', 'ended', '~/start', '~/pause'}


def texts_of(tree):
    """Return each text in Python's source, with ... for the values in it."""
    parts = {part for node in ast.walk(tree) if isinstance(node, ast.JoinedStr)
             for part in node.values}
    for node in ast.walk(tree):
        if isinstance(node, ast.JoinedStr):
            yield ''.join(part.value if isinstance(part, ast.Constant) else '...'
                          for part in node.values)
        elif isinstance(node, ast.Constant) and isinstance(node.value, str) and node not in parts:
            yield node.value


def test_what_one_sees_when_it_does_not_work_is_what_the_package_says():
    said = {text for file in (ROOT / 'secure_uav_planner').rglob('*.py')
            for text in texts_of(ast.parse(file.read_text()))}
    page = (ROOT / 'docs' / 'trouble.md').read_text()
    seen = [*re.findall(r'^\| `(.*?)` \|', page, re.MULTILINE),
            *re.findall(r'`([^`]* (?:is not relayed|publishes \.\.\., too)[^`]*)`', page)]
    for text in seen:
        pattern = re.compile('.*'.join(map(re.escape, text.split('...'))))
        assert any(map(pattern.search, said)), text
    assert len(seen) > 30
