"""The package in a colcon workspace, as `ros2 run` finds it and `colcon test` tests it."""

import os
import shutil
import subprocess
import sys

from processes import ROOT
import pytest
from ros_nodes import stopped

pytestmark = pytest.mark.slow


def colcon(*arguments, cwd, **variables):
    """Run colcon in a folder and return what it prints."""
    environment = {name: value for name, value in os.environ.items()
                   if not name.startswith('PYTEST_')}
    result = subprocess.run(
        [sys.executable, '-m', 'colcon', *arguments], cwd=cwd, text=True, capture_output=True,
        timeout=900, env={**environment, 'COLCON_LOG_PATH': str(cwd / 'log'), **variables})
    assert result.returncode == 0, result.stdout + result.stderr
    return result.stdout


@pytest.fixture(scope='module')
def workspace(tmp_path_factory):
    workspace = tmp_path_factory.mktemp('workspace')
    source = workspace / 'src' / 'secure_uav_planner'
    shutil.copytree(ROOT, source, ignore=shutil.ignore_patterns(
        '.*', 'build', 'install', 'log', 'out', '__pycache__', '*.egg-info'))
    colcon('build', cwd=workspace)
    return workspace


def test_colcon_lists_an_ament_python_package(workspace):
    assert colcon('list', cwd=workspace).split() == [
        'secure_uav_planner', os.path.join('src', 'secure_uav_planner'), '(ros.ament_python)']


def test_everything_is_installed_where_ros_looks_for_it(workspace):
    prefix = workspace / 'install' / 'secure_uav_planner'
    index = prefix / 'share' / 'ament_index' / 'resource_index' / 'packages'
    assert (index / 'secure_uav_planner').exists()
    share = prefix / 'share' / 'secure_uav_planner'
    assert (share / 'package.xml').exists()
    assert {path.name for path in (ROOT / 'config').iterdir()} == {
        path.name for path in (share / 'config').iterdir()}
    for name in ('planner', 'relay', 'replay', 'secure_uav_planner'):
        assert os.access(prefix / 'lib' / 'secure_uav_planner' / name, os.X_OK)
    subprocess.run(['sh', '-c', f'. {workspace}/install/setup.sh && '
                    f'{prefix}/lib/secure_uav_planner/secure_uav_planner --version'], check=True)


@pytest.mark.parametrize('name', ['planner', 'replay'])
def test_the_installed_executables_run_with_the_installed_parameters(workspace, name):
    prefix = workspace / 'install' / 'secure_uav_planner'
    parameters = prefix / 'share' / 'secure_uav_planner' / 'config' / 'paper.yaml'
    script = f'. {workspace}/install/setup.sh && exec {prefix}/lib/secure_uav_planner/{name} ' \
             f'--ros-args --params-file {parameters} -r __ns:=/fleet'
    # They take python3 from PATH, as it is in an environment that is active.
    path = os.pathsep.join([os.path.dirname(sys.executable), os.environ['PATH']])
    process = subprocess.Popen(['sh', '-c', script], stdout=subprocess.PIPE, text=True,
                               stderr=subprocess.STDOUT, env={**os.environ, 'PATH': path})
    try:
        line = process.stdout.readline()
        assert 'ready' in line
        assert stopped(process) == 0, process.stdout.read()
    finally:
        process.kill()
        process.wait()
