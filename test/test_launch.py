"""The launch file: what it names exists, and it starts the nodes where `launch` is installed."""

import ast
from importlib.util import find_spec
import os
from pathlib import Path
import signal
import subprocess
import sys

import pytest
from ros_client import Client, PATIENCE
from secure_uav_planner.autopilots import STACKS
from secure_uav_planner.ros.parameters import PLANNER
from std_srvs.srv import Trigger
import yaml

ROOT = Path(__file__).resolve().parents[1]
FILE = ROOT / 'launch' / 'secure_uav_planner.launch.py'
TREE = ast.parse(FILE.read_text())

RUN = """
import sys

from launch import LaunchDescription, LaunchService
from launch.actions import IncludeLaunchDescription
from launch.launch_description_sources import PythonLaunchDescriptionSource

service = LaunchService()
service.include_launch_description(LaunchDescription([IncludeLaunchDescription(
    PythonLaunchDescriptionSource(sys.argv[1]),
    launch_arguments=[word.split(':=') for word in sys.argv[2:]])]))
sys.exit(service.run())
"""


def calls(name):
    """Return the first argument and the keyword arguments of every call of a function."""
    for entry in ast.walk(TREE):
        if isinstance(entry, ast.Call) and getattr(entry.func, 'id', '') == name:
            yield (entry.args and entry.args[0].value,
                   {word.arg: ast.unparse(word.value) for word in entry.keywords})


def executables(packaging):
    """Return the names that `ros2 run` knows."""
    scripts = [script.split(' = ')[0] for script in packaging['entry_points']['console_scripts']]
    files = dict(packaging['data_files']).get('lib/secure_uav_planner', [])
    return {*scripts, *(Path(file).name for file in files)}


def test_it_starts_only_executables_that_are_installed(packaging):
    started = {executable for executable, _ in calls('node')}
    assert started == {'planner', 'replay', 'relay'} <= executables(packaging)


def test_it_is_installed_with_the_files_that_its_arguments_name(packaging):
    installed = dict(packaging['data_files'])
    assert 'launch/secure_uav_planner.launch.py' in installed['share/secure_uav_planner/launch']
    named = {entry.right.value for entry in ast.walk(TREE) if isinstance(entry, ast.BinOp)
             and ast.unparse(entry.left) == 'CONFIG'}
    assert named == {'paper.yaml', 'planner.rviz'}
    for name in named:
        assert f'config/{name}' in installed['share/secure_uav_planner/config']


def test_every_argument_has_a_default_and_a_description_and_is_used():
    arguments = dict(calls('DeclareLaunchArgument'))
    assert len(arguments) >= 6
    for name, options in arguments.items():
        assert options['description'].endswith(".'") and 'default_value' in options, name
    assert {name for name, _ in calls('LaunchConfiguration')} == set(arguments)
    assert ast.literal_eval(arguments['stack']['choices']) == ['', *STACKS]


@pytest.mark.parametrize('text, names', [
    ((ROOT / 'config' / 'paper.yaml').read_text(), ['uav1', 'uav2']),
    ((ROOT / 'config' / 'city.yaml').read_text(), ['courier', 'escort1', 'escort2']),
    ('/fleet:\n  replay:\n    ros__parameters: {uavs: [b, a]}\n', ['a', 'b']),
    ('/**:\n  ros__parameters: {duration: 120.0}\n', PLANNER['uavs'].default),
    ('', ['uav1', 'uav2'])])
def test_the_odometry_of_all_uavs_of_a_parameter_file_can_be_moved_away(tmp_path, text, names):
    (tmp_path / 'params.yaml').write_text(text)
    # The function itself, without the imports of launch.
    function, = (entry for entry in TREE.body if getattr(entry, 'name', '') == 'uavs_of')
    space = {'Path': Path, 'yaml': yaml}
    exec(compile(ast.Module([function], []), str(FILE), 'exec'), space)
    assert space['uavs_of'](tmp_path / 'params.yaml') == names


def test_it_starts_the_nodes_in_a_namespace_and_ends_with_them(tmp_path):
    if find_spec('launch_ros') is None:
        pytest.skip('needs launch_ros, which an installed ROS has')
    process = subprocess.Popen(
        [sys.executable, '-c', RUN, str(FILE), 'namespace:=fleet'], text=True,
        stdout=subprocess.PIPE, stderr=subprocess.STDOUT,
        env={**os.environ, 'ROS_LOG_DIR': str(tmp_path)})
    try:
        with Client('member', namespace='/fleet') as member:
            assert member.call('replay/reset', Trigger).success
            answer = member.call('planner/plan')
            assert not answer.success and 'ground_node/pose' in answer.message
            found = member.get_parameters('planner', 'duration', 'use_sim_time')
            assert found == [PLANNER['duration'].default, False]
        process.send_signal(signal.SIGINT)
        printed, _ = process.communicate(timeout=PATIENCE)
        assert process.returncode == 0, printed
        assert printed.count('finished cleanly') == 2, printed
    finally:
        process.kill()
        process.wait()
