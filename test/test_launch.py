"""The launch file: what it names exists, and it starts the nodes where `launch` is installed."""

import ast
from importlib.util import find_spec
import os
import shutil
import signal
import subprocess
import sys

from processes import ROOT
import pytest
from ros_client import Client
from ros_nodes import PATIENCE
from secure_uav_planner.output.autopilots import STACKS
from secure_uav_planner.ros.parameters import PLANNER
from std_srvs.srv import Trigger

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
            yield (entry.args and getattr(entry.args[0], 'value', None),
                   {word.arg: ast.unparse(word.value) for word in entry.keywords})


def test_every_argument_has_a_default_and_a_description_and_is_used():
    arguments = dict(calls('DeclareLaunchArgument'))
    assert len(arguments) >= 6
    for name, options in arguments.items():
        assert options['description'].endswith(".'") and 'default_value' in options, name
    words = [entry.value for entry in ast.walk(TREE) if isinstance(entry, ast.Constant)]
    assert not [name for name in arguments if words.count(name) < 2]
    assert {name for name, _ in calls('LaunchConfiguration') if name} <= set(arguments)
    assert ast.literal_eval(arguments['stack']['choices']) == ['', *STACKS]


def launched(folder, *arguments):
    """Start the launch file in a process group of its own."""
    if find_spec('launch_ros') is None:
        pytest.skip('needs launch_ros, which an installed ROS has')
    return subprocess.Popen(
        [sys.executable, '-c', RUN, str(FILE), *arguments], text=True, start_new_session=True,
        stdout=subprocess.PIPE, stderr=subprocess.STDOUT,
        env={**os.environ, 'ROS_LOG_DIR': str(folder)})


def test_it_starts_the_nodes_in_a_namespace_and_ends_with_them(tmp_path):
    process = launched(tmp_path, 'namespace:=fleet')
    try:
        with Client(namespace='/fleet') as member:
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


@pytest.mark.parametrize('arguments, reason', [
    (['rviz:=true', 'rviz_config:=none.rviz'], "No such file or directory: 'none.rviz'"),
    (['params_file:=none.yaml'], 'params_file is none.yaml; there is no such file'),
    (['rviz:=true'], 'rviz2')])
def test_a_launch_that_fails_leaves_no_node_running(tmp_path, arguments, reason):
    if arguments == ['rviz:=true'] and shutil.which('rviz2'):
        pytest.skip('RViz is installed')
    process = launched(tmp_path, *arguments)
    try:
        printed, _ = process.communicate(timeout=PATIENCE)
        assert process.returncode == 1 and reason in printed, printed
        assert 'process started' not in printed
    finally:
        with pytest.raises(ProcessLookupError):  # Nobody is left in its process group.
            os.killpg(process.pid, signal.SIGKILL)
