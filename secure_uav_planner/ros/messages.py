"""
From plans to messages and back.

Message fields are not checked by rclpy, and a wrong type is silently garbled on the wire: every
number that leaves goes through float() or int() here.
"""

import array
import math

from builtin_interfaces.msg import Duration
from diagnostic_msgs.msg import DiagnosticStatus, KeyValue
from geometry_msgs.msg import Point, Pose, PoseStamped, Quaternion, Transform, Twist, Vector3
from nav_msgs.msg import Odometry, Path
import numpy as np
from rclpy.time import Time
from std_msgs.msg import ColorRGBA, Float64, Float64MultiArray, MultiArrayDimension
from trajectory_msgs.msg import MultiDOFJointTrajectory, MultiDOFJointTrajectoryPoint
from visualization_msgs.msg import Marker, MarkerArray

from ..plan import Plan
from ..playback import headings, velocities
from ..scenario import Eavesdropper, LIMITS, Scenario, Uav
from ..view.colors import EAVESDROPPER, GROUND_NODE, uav_color


def stamp_at(plan, seconds=0.0):
    """Return the builtin_interfaces/Time some seconds after point 0 of a plan."""
    return Time(nanoseconds=plan.start_ns + round(seconds * 1e9)).to_msg()


def seconds_of(stamp):
    """Return a builtin_interfaces/Time in s."""
    return stamp.sec + stamp.nanosec * 1e-9


def pose(x, y, z, yaw):
    """Return a Pose from metres and radians, counter-clockwise from x (REP-103)."""
    return Pose(position=Point(x=float(x), y=float(y), z=float(z)), orientation=_facing(yaw))


def pose_stamped(frame_id, stamp, *place):
    """Return a PoseStamped; place as for pose."""
    message = PoseStamped(pose=pose(*place))
    message.header.frame_id, message.header.stamp = frame_id, stamp
    return message


def path(plan, uav, frame_id):
    """Return the nav_msgs/Path of a UAV by index."""
    message = Path()
    message.header.frame_id, message.header.stamp = frame_id, stamp_at(plan)
    altitude = plan.scenario.uavs[uav].altitude
    message.poses = [
        pose_stamped(frame_id, stamp_at(plan, time), x, y, altitude, yaw)
        for time, (x, y), yaw in zip(plan.times, plan.positions[uav], headings(plan)[uav])]
    return message


def power(plan, uav):
    """Return the Float64MultiArray of a UAV's watts per slot."""
    message = Float64MultiArray(data=array.array('d', plan.powers[uav].tobytes()))
    slots = plan.scenario.slots
    message.layout.dim = [MultiArrayDimension(label='slot', size=slots, stride=slots)]
    return message


def trajectory(plan, uav, frame_id):
    """Return the MultiDOFJointTrajectory of a UAV, its joint named as the UAV."""
    message = MultiDOFJointTrajectory(joint_names=[plan.scenario.uavs[uav].name])
    message.header.frame_id, message.header.stamp = frame_id, stamp_at(plan)
    altitude = float(plan.scenario.uavs[uav].altitude)
    for time, (x, y), (vx, vy), yaw in zip(
            plan.times, plan.positions[uav], velocities(plan)[uav], headings(plan)[uav]):
        message.points.append(MultiDOFJointTrajectoryPoint(
            transforms=[Transform(translation=Vector3(x=float(x), y=float(y), z=altitude),
                                  rotation=_facing(yaw))],
            velocities=[Twist(linear=Vector3(x=float(vx), y=float(vy)))],
            time_from_start=_duration(time)))
    return message


def odometry(frame_id, child_frame_id, stamp, place, yaw, velocity):
    """
    Return the Odometry of a UAV.

    :param place: (x, y, z) in m.
    :param velocity: (vx, vy) in m/s in frame_id; the message has it in the UAV's own frame.
    """
    message = Odometry(child_frame_id=child_frame_id)
    message.header.frame_id, message.header.stamp = frame_id, stamp
    message.pose.pose = pose(*place, yaw)
    ahead = np.array([math.cos(yaw), math.sin(yaw)])
    message.twist.twist.linear = Vector3(
        x=float(ahead @ velocity), y=float(ahead[0] * velocity[1] - ahead[1] * velocity[0]))
    return message


def float64(value):
    """Return a std_msgs/Float64."""
    return Float64(data=float(value))


def status(name, level, summary, values):
    """Return a DiagnosticStatus; values by key, numbers to six digits."""
    return DiagnosticStatus(
        level=level, name=name, message=summary, hardware_id='secure_uav_planner',
        values=[KeyValue(key=key, value=f'{value:.6g}' if isinstance(value, float) else str(value))
                for key, value in values.items()])


def markers(plan, frame_id):
    """Return a MarkerArray of the paths, the ground node and the eavesdroppers' discs."""
    scenario = plan.scenario
    found = [Marker(action=Marker.DELETEALL)]
    for index, uav in enumerate(scenario.uavs):
        line = _marker('path', index, Marker.LINE_STRIP, uav_color(index), (2.0, 0.0, 0.0))
        line.points = [Point(x=float(x), y=float(y), z=float(uav.altitude))
                       for x, y in plan.positions[index]]
        found.append(line)
        found.append(_label(index, uav.name, (*uav.start, uav.altitude), uav_color(index)))
    size = 0.1 * min(uav.altitude for uav in scenario.uavs)
    node = _marker('ground_node', 0, Marker.CYLINDER, GROUND_NODE, (size, size, size))
    node.pose = pose(*scenario.ground_node, size / 2, 0.0)
    found += [node, _label(100, 'ground node', (*scenario.ground_node, 2 * size), GROUND_NODE)]
    for index, eve in enumerate(scenario.eavesdroppers):
        across = 2 * max(eve.error_radius, size / 4)
        disc = _marker('eavesdropper', index, Marker.CYLINDER, EAVESDROPPER,
                       (across, across, 1.0), opacity=0.5)
        disc.pose = pose(*eve.position, 0.5, 0.0)
        found += [disc, _label(200 + index, 'eavesdropper', (*eve.position, 2 * size),
                               EAVESDROPPER)]
    for marker in found:
        marker.header.frame_id, marker.header.stamp = frame_id, stamp_at(plan)
    return MarkerArray(markers=found)


def slot_markers(frame_id, stamp, places, powers):
    """Return a MarkerArray of where the UAVs are: spheres that grow with their power."""
    found = []
    for index, ((x, y, z), watts) in enumerate(zip(places, powers)):
        size = 10.0 + 10.0 * math.sqrt(max(0.0, watts))
        sphere = _marker('uav', index, Marker.SPHERE, uav_color(index), (size, size, size))
        sphere.pose = pose(x, y, z, 0.0)
        sphere.header.frame_id, sphere.header.stamp = frame_id, stamp
        found.append(sphere)
    return MarkerArray(markers=found)


def plan_from(names, paths, powers, ground_node, reference_snr_db, eavesdropper):
    """
    Return the Plan that the topics' messages hold, with just the limits it needs.

    :param paths: a Path for every name.
    :param powers: a Float64MultiArray for every name.
    :param eavesdropper: (x, y) in m of an eavesdropper, or None for one on the ground node.
    :raises ValueError: when they do not fit together.
    """
    slots = len(powers[0].data)
    positions = []
    for name, one, watts in zip(names, paths, powers):
        if len(one.poses) != slots + 2 or len(watts.data) != slots or not slots:
            raise ValueError(f'{name} has {len(one.poses)} points and {len(watts.data)} powers; '
                             f'there must be two points more than powers, the same for all')
        positions.append([(at.pose.position.x, at.pose.position.y) for at in one.poses])
    first = [seconds_of(at.header.stamp) for at in paths[0].poses]
    slot_duration = (first[-1] - first[0]) / (slots + 1)
    positions, watts = np.array(positions), np.array([one.data for one in powers], dtype=float)
    speeds = np.linalg.norm(np.diff(positions, axis=1), axis=-1).max(axis=1) / slot_duration
    uavs = tuple(
        Uav(name, tuple(line[0]), tuple(line[-1]), one.poses[0].pose.position.z,
            max(speed * (1 + 1e-9), LIMITS['max_speed'][0]),
            max(level.mean() * (1 + 1e-9), LIMITS['average_power'][0]),
            max(level.max() * (1 + 1e-9), LIMITS['peak_power'][0]))
        for name, line, one, speed, level in zip(names, positions, paths, speeds, watts))
    scenario = Scenario(tuple(ground_node), (Eavesdropper(eavesdropper or tuple(ground_node)),),
                        uavs, slot_duration * slots, slots, reference_snr_db)
    start_ns = Time.from_msg(paths[0].header.stamp).nanoseconds
    return Plan(scenario, positions, watts, start_ns=start_ns)


def _facing(yaw):
    return Quaternion(z=math.sin(yaw / 2), w=math.cos(yaw / 2))


def _duration(seconds):
    nanoseconds = round(float(seconds) * 1e9)
    return Duration(sec=nanoseconds // 10**9, nanosec=nanoseconds % 10**9)


def _marker(namespace, index, kind, color, scale, opacity=1.0):
    marker = Marker(ns=namespace, id=index, type=kind, action=Marker.ADD)
    marker.scale = Vector3(x=float(scale[0]), y=float(scale[1]), z=float(scale[2]))
    marker.pose.orientation.w = 1.0
    red, green, blue = (int(color[at:at + 2], 16) / 255 for at in (1, 3, 5))
    marker.color = ColorRGBA(r=red, g=green, b=blue, a=float(opacity))
    return marker


def _label(index, text, place, color):
    marker = _marker('label', index, Marker.TEXT_VIEW_FACING, color, (0.0, 0.0, 20.0))
    marker.text = text
    marker.pose = pose(place[0], place[1], place[2] + 20.0, 0.0)
    return marker
