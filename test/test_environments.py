"""Targets of the Makefile have all that they import in their own environments; a wheel is new."""

from importlib.metadata import distribution
import signal
import subprocess
import venv
from zipfile import ZipFile

from environments import build_wheel, make_environment, OUTSIDE
from packaging.requirements import Requirement
from processes import ROOT
import pytest
from secure_uav_planner import Scenario

pytestmark = pytest.mark.slow

IMPORTS = """
import ast
from importlib import import_module
from pathlib import Path
import sys

for file in Path(sys.argv[1]).rglob('*.py'):
    if file.parent.name == 'typed':  # Scripts for other environments.
        continue
    import_module('.'.join(file.with_suffix('').parts))
folder = str(Path.cwd())
own = 'secure_uav_planner/apps', 'secure_uav_planner/assessment/flown'
for module in [*sys.modules.values()]:
    path = getattr(module, '__file__', None) or ''
    if (path.startswith(folder) and path.endswith('.py') and 'site-packages' not in path
            and not any(room in path for room in own)):
        nodes = [ast.parse(Path(path).read_text())]
        for node in nodes:
            if not (isinstance(node, ast.If) and 'TYPE_CHECKING' in ast.dump(node.test)):
                nodes += ast.iter_child_nodes(node)
            if isinstance(node, ast.Import):
                for alias in node.names:
                    import_module(alias.name)
            elif isinstance(node, ast.ImportFrom) and not node.level:
                import_module(node.module)
"""
"""
Imports all modules of a folder, and what these and all that they load import anywhere.

The command and the readers of logs, which are always loaded, name themselves what is missing.
"""


@pytest.fixture(scope='module')
def wheel(tmp_path_factory):
    stale = ROOT / 'build' / 'lib' / 'secure_uav_planner' / 'stale.py'
    stale.parent.mkdir(parents=True, exist_ok=True)
    stale.touch()
    return build_wheel(tmp_path_factory.mktemp('wheel'))


@pytest.mark.parametrize('name, folder', [
    ('benchmarks', 'benchmarks'), ('examples', 'examples'), ('docs', 'docs/tools'),
    *(pytest.param(name, f'studies/{name}', marks=pytest.mark.soak)
      for name in ('flown', 'paper'))])
def test_a_target_needs_no_package_of_another_target(name, folder, wheel, tmp_path):
    python = make_environment(name, wheel, tmp_path / 'venv')
    done = subprocess.run([python, '-c', IMPORTS, folder], cwd=ROOT, env=OUTSIDE, text=True,
                          capture_output=True, timeout=600)
    assert done.returncode == 0, done.stderr


def test_without_cvxpy_only_the_papers_algorithm_is_missing(wheel, tmp_path, client):
    venv.create(tmp_path, with_pip=True)
    python = tmp_path / 'bin' / 'python'
    needed = [str(requirement).partition(';')[0] for requirement in map(
        Requirement, distribution('secure_uav_planner').requires)
        if requirement.name != 'cvxpy' and (not requirement.marker or any(
            requirement.marker.evaluate({'extra': extra}) for extra in ('ros', 'view')))]
    outside = {**OUTSIDE, 'AMENT_PREFIX_PATH': str(tmp_path)}

    def run(*arguments):
        return subprocess.run([python, '-m', *arguments], cwd=tmp_path, env=outside, text=True,
                              capture_output=True, timeout=600)

    for arguments in ([*needed], ['--no-deps', wheel]):
        assert run('pip', 'install', '--quiet', *arguments).returncode == 0
    assert 'cvxpy' not in run('pip', 'list').stdout
    city = ['secure_uav_planner', 'plan', ROOT / 'config' / 'city.yaml']
    assert run(*city).returncode == 0
    paper = ['secure_uav_planner', 'plan', 'paper.yaml', '--method', 'alternating']
    Scenario.paper(120.0, slots=20).save(tmp_path / 'paper.yaml')
    refused = run(*paper)
    assert refused.returncode == 2 and 'pip install cvxpy' in refused.stderr
    node = subprocess.Popen([python, '-m', 'secure_uav_planner', 'node', 'planner', '--ros-args',
                             '-p', 'slots:=20'], cwd=tmp_path, env=outside)
    client.plan_paper()
    [changed] = client.set_parameters('planner', method='alternating')
    assert changed.successful
    answer = client.call('planner/plan')
    assert not answer.success and 'pip install cvxpy' in answer.message
    node.send_signal(signal.SIGINT)
    assert node.wait(timeout=60) == 0


def test_a_wheel_has_no_module_that_is_gone_since_the_last_build(wheel):
    with ZipFile(wheel) as file:
        names = file.namelist()
    assert 'secure_uav_planner/__init__.py' in names
    assert not [name for name in names if 'stale' in name]
