"""The large messages, made without objects of Python, against those made of them."""

from dataclasses import replace

from builtin_interfaces.msg import Duration
from geometry_msgs.msg import Transform, Twist, Vector3
from nav_msgs.msg import Path
import numpy as np
import pytest
from rclpy.serialization import deserialize_message, serialize_message
from secure_uav_planner import fly_hover_fly, Scenario
from secure_uav_planner.model.curve import Curve
from secure_uav_planner.ros import cdr, messages
from trajectory_msgs.msg import MultiDOFJointTrajectory, MultiDOFJointTrajectoryPoint


def plan_of(slots, name='uav2'):
    scenario = Scenario.paper(300.0, slots=slots)
    scenario = replace(scenario, uavs=(
        scenario.uavs[0], replace(scenario.uavs[1], name=name, max_acceleration=2.0)))
    return replace(fly_hover_fly(scenario), start_ns=1763727000123456789)


def motion_of(plan):
    return Curve(plan.scenario, plan.positions).at(plan.times)


def path(plan, uav, frame_id):
    """Return the path as objects."""
    message = Path()
    message.header.frame_id, message.header.stamp = frame_id, messages.stamp_at(plan)
    message.poses = [
        messages.pose_stamped(frame_id, messages.stamp_at(plan, time), x, y,
                              plan.scenario.uavs[uav].altitude, yaw)
        for time, (x, y), yaw in zip(
            plan.times, plan.positions[uav], motion_of(plan).headings[uav])]
    return message


def trajectory(plan, uav, frame_id):
    """Return the trajectory as objects."""
    message = MultiDOFJointTrajectory(joint_names=[plan.scenario.uavs[uav].name])
    message.header.frame_id, message.header.stamp = frame_id, messages.stamp_at(plan)
    motion = motion_of(plan)
    for time, (x, y), (vx, vy), (ax, ay), yaw in zip(
            plan.times, *(of[uav] for of in motion[:3]), motion.headings[uav]):
        at = messages.pose(x, y, plan.scenario.uavs[uav].altitude, yaw)
        nanoseconds = round(float(time) * 1e9)
        message.points.append(MultiDOFJointTrajectoryPoint(
            transforms=[Transform(translation=Vector3(
                x=at.position.x, y=at.position.y, z=at.position.z), rotation=at.orientation)],
            velocities=[Twist(linear=Vector3(x=float(vx), y=float(vy)))],
            accelerations=[Twist(linear=Vector3(x=float(ax), y=float(ay)))],
            time_from_start=Duration(sec=nanoseconds // 10**9, nanosec=nanoseconds % 10**9)))
    return message


def numbers(message):
    """Return all numbers of a message in order, and its texts."""
    if isinstance(message, (int, float)):
        return [message], []
    if isinstance(message, str):
        return [], [message]
    parts = message if isinstance(message, (list, tuple)) else [
        getattr(message, field) for field in message.get_fields_and_field_types()]
    found = [numbers(part) for part in parts]
    return sum((one for one, _ in found), []), sum((one for _, one in found), [])


@pytest.mark.parametrize('slots', [1, 2, 9])
@pytest.mark.parametrize('name', ['u', 'uav', 'uav44', 'uav_8888'])
@pytest.mark.parametrize('frame_id', ['', 'm', 'map', 'earth', 'Erde_ö', 'x' * 64])
def test_a_message_is_laid_out_as_rclpy_lays_it_out(slots, name, frame_id):
    plan = plan_of(slots, name)
    for make, by_objects in ((cdr.path, path), (cdr.trajectory, trajectory)):
        expected = by_objects(plan, 1, frame_id)
        made = make(plan, 1, frame_id)
        # What lies between fields is of no meaning, and in rclpy's form left to chance.
        assert len(made) == len(serialize_message(expected))
        found, texts = numbers(deserialize_message(made, type(expected)))
        wanted, wanted_texts = numbers(expected)
        assert found == pytest.approx(wanted, rel=1e-12, abs=1e-12) and texts == wanted_texts


def test_markers_of_very_many_points_are_thinned_out():
    plan = plan_of(20000)
    lines = [one for one in messages.markers(plan, 'map').markers if one.ns == 'path']
    assert all(len(line.points) == 1000 for line in lines)
    for line, positions in zip(lines, plan.positions):
        ends = np.array([[line.points[at].x, line.points[at].y] for at in (0, -1)])
        assert (ends == positions[[0, -1]]).all()
