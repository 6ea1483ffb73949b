"""
Have the replay fly the plan of another planner, which publishes a path and powers for each UAV.

The parameter mission_file gives what these lack: limits and receivers. All paths have the same,
equally spaced stamps.
"""

from dataclasses import replace
import functools

from nav_msgs.msg import Path
import numpy as np
import rclpy
from secure_uav_planner import Plan, PlanningError, Scenario
from secure_uav_planner.ros import messages
from secure_uav_planner.ros.topics import LATCHED
from std_msgs.msg import Float64MultiArray, String


def make_plan(mission, paths, powers):
    """Return the Plan of a nav_msgs/Path and the powers in W of the slots for each UAV."""
    if not all(path.poses for path in paths):
        raise PlanningError('a path has no poses')
    places = [[(at.pose.position.x, at.pose.position.y) for at in path.poses] for path in paths]
    stamps = [[messages.nanoseconds(at.header.stamp) for at in path.poses] for path in paths]
    first, last = stamps[0][0], stamps[0][-1]
    even = np.linspace(first, last, len(stamps[0]))
    if not all(len(line) == len(even) and np.allclose(line, even, rtol=0.0, atol=1e6)
               for line in stamps):
        raise PlanningError('the poses of all paths must have the same stamps, equally spaced')
    slots = len(powers[0])
    uavs = [replace(uav, start=line[0], goal=line[-1]) for uav, line in zip(mission.uavs, places)]
    return Plan(replace(mission, uavs=tuple(uavs), slots=slots,
                        duration=(last - first) * 1e-9 * slots / (slots + 1)),
                places, powers, start_ns=first)


def main():
    """Publish the plan of all paths and powers, whenever each has come."""
    rclpy.init()
    node = rclpy.create_node('plan_from_path')
    mission = Scenario.load(node.declare_parameter('mission_file', '').value)
    arrived = {}
    publisher = node.create_publisher(String, 'plan', LATCHED)

    def take(key, message):
        arrived[key] = message
        if len(arrived) == 2 * len(mission.uavs):
            paths, powers = ([arrived.pop((uav.name, part)) for uav in mission.uavs]
                             for part in ('path', 'power'))
            try:
                plan = make_plan(mission, paths, [power.data for power in powers])
                publisher.publish(messages.plan_text(plan, paths[0].header.frame_id))
            except PlanningError as error:
                node.get_logger().error(f'no plan: {error}')

    for uav in mission.uavs:
        for part, kind in (('path', Path), ('power', Float64MultiArray)):
            node.create_subscription(kind, f'{uav.name}/{part}', functools.partial(
                take, (uav.name, part)), LATCHED)
    rclpy.spin(node)


if __name__ == '__main__':
    main()
