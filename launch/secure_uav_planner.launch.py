"""
Start the planner and the replay, and on request the relay to an autopilot's stack and RViz.

`ros2 launch secure_uav_planner secure_uav_planner.launch.py --show-args` lists the arguments.
"""

from pathlib import Path
import re

from ament_index_python.packages import get_package_share_path
from launch import LaunchContext, LaunchDescription
from launch.actions import DeclareLaunchArgument, OpaqueFunction
from launch.conditions import IfCondition
from launch.substitutions import (
    EqualsSubstitution, LaunchConfiguration, NotEqualsSubstitution)
from launch_ros.actions import Node

PACKAGE = 'secure_uav_planner'
CONFIG = get_package_share_path(PACKAGE) / 'config'


def generate_launch_description() -> LaunchDescription:
    """Return the description of all nodes."""
    stack = LaunchConfiguration('stack')
    return LaunchDescription([
        DeclareLaunchArgument(
            'mission_file', default_value='',
            description='Mission (YAML or JSON) for all nodes; empty for that of the paper.'),
        DeclareLaunchArgument(
            'params_file', default_value='',
            description='File with parameters of the nodes, which count before the mission; empty '
                        'for none.'),
        DeclareLaunchArgument(
            'namespace', default_value='',
            description='Namespace of all nodes, so that several teams can fly side by side.'),
        DeclareLaunchArgument(
            'use_sim_time', default_value='false', choices=['true', 'false'],
            description='Take the time from /clock, as with a simulator or a bag.'),
        DeclareLaunchArgument(
            'replay', default_value='true', choices=['true', 'false'],
            description='Start the replay, which streams setpoints after a call of ~/start.'),
        DeclareLaunchArgument(
            'stack', default_value='', choices=['', 'mavros', 'px4', 'aerostack2'],
            description='Start the relay, for the message types of this stack; empty for none.'),
        DeclareLaunchArgument(
            'replay_odometry', default_value=EqualsSubstitution(stack, ''),
            description='true: the replay reports the odometry of UAVs that follow it exactly; '
                        'false: it waits for that of real ones. By default false with a stack.'),
        DeclareLaunchArgument(
            'rviz', default_value='false', choices=['true', 'false'],
            description='Show plan and replay in RViz; needs the package rviz2.'),
        DeclareLaunchArgument(
            'rviz_config', default_value=str(CONFIG / 'planner.rviz'),
            description='Configuration of RViz, its topics as without a namespace.'),
        # What can fail comes first: launch forgets nodes that it has started before a failure.
        OpaqueFunction(function=check_files),
        OpaqueFunction(
            function=rviz, condition=IfCondition(LaunchConfiguration('rviz'))),
        OpaqueFunction(function=lambda context: [node('planner', context)]),
        OpaqueFunction(
            function=lambda context: [node('replay', context, {
                'vehicle_odometry': NotEqualsSubstitution(
                    LaunchConfiguration('replay_odometry'), 'true')})],
            condition=IfCondition(LaunchConfiguration('replay'))),
        OpaqueFunction(
            function=lambda context: [node('relay', context, {'stack': stack})],
            condition=IfCondition(NotEqualsSubstitution(stack, '')))])


def node(executable: str, context: LaunchContext, parameters: dict | None = None) -> Node:
    """Return one node of this package, with the parameters of the file and others beside them."""
    mission, file = (LaunchConfiguration(name).perform(context)
                     for name in ('mission_file', 'params_file'))
    # The arguments are in one mapping after the file: of two settings, the later one counts.
    arguments = {'use_sim_time': LaunchConfiguration('use_sim_time'), **(parameters or {})}
    if mission:
        arguments['mission_file'] = mission
    return Node(
        package=PACKAGE, executable=executable, namespace=LaunchConfiguration('namespace'),
        parameters=[*([file] if file else []), arguments], output='screen')


def check_files(context: LaunchContext) -> None:
    """Raise an error where a file is missing; launch would only warn of that."""
    for name in ('mission_file', 'params_file'):
        file = LaunchConfiguration(name).perform(context)
        if file and not Path(file).is_file():
            raise FileNotFoundError(f'{name} is {file}; there is no such file')


def rviz(context: LaunchContext) -> list[Node]:
    """Return RViz, with the topics of its configuration moved into the namespace."""
    file = LaunchConfiguration('rviz_config').perform(context)
    topics = re.findall(r'^ *Value: /(\S+)$', Path(file).read_text(), re.MULTILINE)
    return [Node(
        package='rviz2', executable='rviz2', namespace=LaunchConfiguration('namespace'),
        arguments=['-d', file], remappings=[(f'/{topic}', topic) for topic in topics],
        parameters=[{'use_sim_time': LaunchConfiguration('use_sim_time')}], output='screen')]
