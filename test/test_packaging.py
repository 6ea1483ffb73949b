"""What the package says it needs is what it needs, and installing it harms nothing."""

import ast
from functools import cache
from itertools import chain
import os
from pathlib import Path
import re
import subprocess
import sys
from xml.etree import ElementTree

from conftest import OPTIONAL
from environments import OUTSIDE
from packaging.requirements import Requirement
from processes import ROOT
import pytest
from secure_uav_planner import __version__
import yaml

PACKAGE = ElementTree.parse(ROOT / 'package.xml').getroot()

# The keys of rosdep for modules that are not called by it.
KEYS = {name: f'python3-{name}' for name in (
    'argcomplete', 'hypothesis', 'joblib', 'matplotlib', 'numpy', 'packaging', 'pandas',
    'pybind11', 'pytest', 'scipy', 'setuptools', 'shapely')}
KEYS.update({'pyyaml': 'python3-yaml', 'yaml': 'python3-yaml'})
# The README's pip line brings Clarabel. rosdep has no key of the others, or only one that installs
# by pip and would bring NumPy 2; the nodes, their tests and the library do without them.
FROM_PYPI = {'atheris', 'casadi', 'clarabel', 'cvxpy', 'distributed', 'flask', 'mcap', 'plotly',
             'pyarrow', 'werkzeug',
             *(name for names in OPTIONAL.values() for name in names)}

COLLECT = """
import sys
import pytest

class Absent:
    def find_spec(name, path, target=None):
        if name.partition('.')[0] in sys.argv[1].split():
            raise ModuleNotFoundError(f'No module named {name!r}', name=name)

sys.meta_path.insert(0, Absent)
sys.exit(pytest.main(['--collect-only', '-q', *sys.argv[2:]]))
"""
"""Collects tests as if some modules were not installed."""


def depends(*kinds):
    """Return the keys that package.xml names, by the kinds of dependency."""
    return {entry.text for kind in kinds for entry in PACKAGE.iter(kind)}


@cache
def imported(folder):
    """Return the modules that the Python files of a folder import, each with one of the files."""
    files = sorted((ROOT / folder).rglob('*.py'))
    own = {file.stem for file in files} | {
        'benchmarks', 'docs', 'examples', 'secure_uav_planner', 'studies'}
    modules = {}
    for file in files:
        for node in ast.walk(ast.parse(file.read_text())):
            names = []
            if isinstance(node, ast.Import):
                names = [alias.name for alias in node.names]
            elif isinstance(node, ast.ImportFrom) and not node.level:
                names = [node.module]
            for name in (name.partition('.')[0] for name in names):
                if name not in own and name not in sys.stdlib_module_names:
                    modules.setdefault(name, file.name)
    return modules


@pytest.mark.parametrize('folder, kinds', [
    ('secure_uav_planner', ['exec_depend']), ('launch', ['exec_depend']),
    ('test', ['exec_depend', 'test_depend'])])
def test_package_xml_names_whatever_is_imported(folder, kinds):
    named = depends(*kinds)
    missing = {name: file for name, file in imported(folder).items()
               if name not in FROM_PYPI
               and KEYS.get(name, name) not in named}
    assert not missing


def test_package_xml_names_nothing_else():
    used = {name: file for folder in ('secure_uav_planner', 'launch', 'test')
            for name, file in imported(folder).items()}
    keys = {KEYS.get(name, name) for name in used}
    # frames.py imports tf2_ros by its name when it is needed; setup.py may ask for what no module
    # imports yet.
    assert depends('exec_depend', 'test_depend') - keys <= {'python3-shapely', 'tf2_ros_py'}


def test_setup_py_package_xml_citation_and_package_agree(packaging):
    citation = yaml.safe_load((ROOT / 'CITATION.cff').read_text())
    assert citation['cff-version'] == '1.2.0' and citation['title'] == packaging['name']
    assert f'{citation["version"]} ({citation["date-released"]})' in (
        ROOT / 'CHANGELOG.rst').read_text()
    assert PACKAGE.find('version').text == packaging['version'] == citation['version']
    assert __version__ == packaging['version']
    for role in ('maintainer', 'author'):
        assert PACKAGE.find(role).text == packaging[role]
        assert PACKAGE.find(role).get('email') == packaging[f'{role}_email']
    assert PACKAGE.find('url').text == packaging['url'] == citation['repository-code']
    assert PACKAGE.find('license').text == packaging['license'] == citation['license']
    assert (ROOT / PACKAGE.find('license').get('file')).exists()
    for requirement in packaging['install_requires']:
        name = re.split('[<>=]', requirement)[0]
        if name not in FROM_PYPI:
            assert KEYS[name] in depends('exec_depend', 'test_depend'), name


def test_the_oldest_versions_that_are_tested_are_the_oldest_that_are_allowed(packaging):
    text = (ROOT / 'test' / 'compat' / 'oldest.txt').read_text()
    tested = dict(re.findall('^(.+)==(.+)$', text, re.MULTILINE))
    allowed = dict(text.split('>=') for text in packaging['install_requires'] if '>=' in text)
    assert set(tested) == set(allowed)
    for name, version in allowed.items():
        assert f'{tested[name]}.'.startswith(f'{version}.'), name


@pytest.mark.slow
def test_the_tests_of_make_compat_load_with_what_it_installs(packaging):
    shown = subprocess.run(['make', '-n', 'compat-newest'], cwd=ROOT, env=OUTSIDE, text=True,
                           capture_output=True, check=True).stdout
    tests = re.findall(r'test/test_\w+\.py', shown)
    listed = (ROOT / 'test' / 'compat' / 'requirements.txt').read_text()
    extras = chain(*(packaging['extras_require'][extra] for extra in (
        'view', 'explore', 'campaign', 'logs')))
    others = {Requirement(text).name for text in extras} | {'casadi', 'selenium'}
    absent = [name for name in others if name not in listed]
    done = subprocess.run([sys.executable, '-c', COLLECT, ' '.join(absent), *tests], cwd=ROOT,
                          env=OUTSIDE, text=True, capture_output=True)
    assert len(tests) > 20 and done.returncode == 0, done.stdout


# Machines for which PyPI has no ROS


def test_only_where_pypi_has_ros_is_it_asked_for(packaging):
    named = [*packaging['install_requires'], *chain(*packaging['extras_require'].values())]
    for system, machine, has_ros in (
            ('linux', 'x86_64', True), ('linux', 'aarch64', False), ('darwin', 'arm64', False)):
        asked = [requirement.name for requirement in map(Requirement, named)
                 if not requirement.marker or requirement.marker.evaluate({
                     'sys_platform': system, 'platform_machine': machine})]
        assert 'numpy' in asked and ('ros-jazzy-rclpy' in asked) == has_ros


def test_make_says_at_once_what_works_on_a_machine_without_wheels_of_ros(tmp_path):
    (tmp_path / 'sitecustomize.py').write_text(
        "import platform\nplatform.machine = lambda: 'aarch64'\n")
    command = ['make', f'PYTHON={sys.executable}', f'VENV={tmp_path}/venv']
    for target, status in (('demo', 2), ('without-ros', 0)):
        done = subprocess.run([*command, target], cwd=ROOT, text=True, capture_output=True,
                              env={**OUTSIDE, 'PYTHONPATH': str(tmp_path)})
        assert done.returncode == status and 'linux-aarch64' in done.stdout
        assert 'docs/install.md' in done.stdout and 'pip install ".[view]"' in done.stdout
    assert not (tmp_path / 'venv').exists()
    plan = subprocess.run([*command, '-n', 'test'], cwd=ROOT, text=True, capture_output=True,
                          env={**OUTSIDE, 'PYTHONPATH': str(tmp_path)}).stdout
    assert plan.index('PyPI has no ROS') < plan.index('-m venv')


# What others read of the package


def test_the_changelog_is_what_bloom_reads_and_has_this_version(packaging):
    changelog = pytest.importorskip('catkin_pkg.changelog').get_changelog_from_path(str(ROOT))
    versions = [version for version, _, _ in changelog.foreach_version()]
    assert versions[-1] == packaging['version']
    for _, _, (*_, entries) in changelog.foreach_version():
        assert str(entries.bullets[-1]).removeprefix('* ').startswith('Contributors: ')


def test_on_path_is_one_command_and_the_executables_are_where_ros2_run_looks(packaging):
    # An entry point, whose script pip writes such that it starts in a folder with a space.
    assert packaging['entry_points'] == {'console_scripts': [
        'secure_uav_planner = secure_uav_planner.__main__:main']} and 'scripts' not in packaging
    files = dict(packaging['data_files'])['lib/secure_uav_planner']
    assert {Path(file).name for file in files} == {'planner', 'relay', 'replay'}
    for file in files:
        assert os.access(ROOT / file, os.X_OK), file
        assert (ROOT / file).read_text().startswith('#!/usr/bin/env python3\n'), file
