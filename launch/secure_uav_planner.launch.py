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
from launch.substitutions import LaunchConfiguration, NotEqualsSubstitution
from launch_ros.actions import Node
import yaml

PACKAGE = 'secure_uav_planner'
CONFIG = get_package_share_path(PACKAGE) / 'config'


def generate_launch_description() -> LaunchDescription:
    """Return the description of all nodes."""
    stack = LaunchConfiguration('stack')
    return LaunchDescription([
        DeclareLaunchArgument(
            'params_file', default_value=str(CONFIG / 'paper.yaml'),
            description='File with the parameters of all nodes.'),
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
            'replay_odometry', default_value='true', choices=['true', 'false'],
            description='Let the planner take the odometry of the replay for that of the UAVs; '
                        'false where UAVs report their own: <uav>/replayed/odom then has it.'),
        DeclareLaunchArgument(
            'stack', default_value='', choices=['', 'mavros', 'px4', 'aerostack2'],
            description='Start the relay, for the message types of this stack; empty for none.'),
        DeclareLaunchArgument(
            'rviz', default_value='false', choices=['true', 'false'],
            description='Show plan and replay in RViz; needs the package rviz2.'),
        DeclareLaunchArgument(
            'rviz_config', default_value=str(CONFIG / 'planner.rviz'),
            description='Configuration of RViz, its topics as without a namespace.'),
        node('planner'),
        OpaqueFunction(
            function=replay, condition=IfCondition(LaunchConfiguration('replay'))),
        node('relay', {'stack': stack}, condition=IfCondition(NotEqualsSubstitution(stack, ''))),
        OpaqueFunction(
            function=rviz, condition=IfCondition(LaunchConfiguration('rviz')))])


def node(executable: str, parameters: dict | None = None, **options: object) -> Node:
    """Return one node of this package, with the parameters of the file and others beside them."""
    return Node(
        package=PACKAGE, executable=executable, namespace=LaunchConfiguration('namespace'),
        parameters=[LaunchConfiguration('params_file'),
                    {'use_sim_time': LaunchConfiguration('use_sim_time'), **(parameters or {})}],
        output='screen', **options)


def replay(context: LaunchContext) -> list[Node]:
    """Return the replay, whose odometry the planner hears on request only."""
    if LaunchConfiguration('replay_odometry').perform(context) == 'true':
        return [node('replay')]
    names = uavs_of(LaunchConfiguration('params_file').perform(context))
    return [node('replay', remappings=[
        (f'{name}/odom', f'{name}/replayed/odom') for name in names])]


def uavs_of(file: str) -> list[str]:
    """Return the names of all UAVs in a parameter file, or of the default ones."""
    found, waiting = [], [yaml.safe_load(Path(file).read_text())]
    while waiting:
        content = waiting.pop()
        if isinstance(content, dict):
            waiting += content.values()
            names = content.get('uavs')
            found += names if isinstance(names, list) else []
    return sorted(set(found)) or ['uav1', 'uav2']


def rviz(context: LaunchContext) -> list[Node]:
    """Return RViz, with the topics of its configuration moved into the namespace."""
    file = LaunchConfiguration('rviz_config').perform(context)
    topics = re.findall(r'^ *Value: /(\S+)$', Path(file).read_text(), re.MULTILINE)
    return [Node(
        package='rviz2', executable='rviz2', namespace=LaunchConfiguration('namespace'),
        arguments=['-d', file], remappings=[(f'/{topic}', topic) for topic in topics],
        parameters=[{'use_sim_time': LaunchConfiguration('use_sim_time')}], output='screen')]
