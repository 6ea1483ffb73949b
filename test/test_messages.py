"""The messages of a plan against its points, its curve and its powers."""

from dataclasses import replace

from builtin_interfaces.msg import Time
from hypothesis import example, given
from hypothesis import strategies as st
import numpy as np
import pytest
from rclpy.serialization import deserialize_message, serialize_message
from secure_uav_planner import Bound, fly_hover_fly, Plan, PlanningError, Scenario
from secure_uav_planner.errors import PlanFileError
from secure_uav_planner.plan.file import parse_text
from secure_uav_planner.plan.playback import Playback
from secure_uav_planner.ros import messages
from sensor_msgs.msg import TimeReference
from strategies import missions, with_uavs
from test_mission_file import RICH

START_NS = 1763727000123456789


def plan_of(slots, acceleration=None):
    scenario = with_uavs(Scenario.paper(300.0, slots=slots), max_acceleration=acceleration)
    return replace(fly_hover_fly(scenario), start_ns=START_NS)


def sent(message):
    """Return the message after its way over DDS, on which wrong types become wrong values."""
    return deserialize_message(serialize_message(message), type(message))


def nanoseconds(stamp):
    return stamp.sec * 10**9 + stamp.nanosec


def numbers(vector):
    return [getattr(vector, axis) for axis in vector.get_fields_and_field_types()]


def yaw_of(turn):
    assert turn.x == turn.y == 0.0 and turn.z**2 + turn.w**2 == pytest.approx(1.0)
    return 2 * np.arctan2(turn.z, turn.w)


@pytest.mark.parametrize('slots', [1, 2, 9])
@pytest.mark.parametrize('uav, acceleration', [(0, None), (1, 2.0)])
@pytest.mark.parametrize('frame_id', ['', 'map', 'Erde_ö'])
def test_path_and_trajectory_are_the_points_and_the_curve_of_the_plan(
        slots, uav, acceleration, frame_id):
    plan = plan_of(slots, acceleration)
    member, motion = plan.scenario.uavs[uav], plan.curve.at(plan.times)
    path = sent(messages.path(plan, uav, frame_id))
    trajectory = sent(messages.trajectory(plan, uav, frame_id))
    assert trajectory.joint_names == [member.name]
    for message in (path, trajectory):
        assert message.header.frame_id == frame_id
        assert nanoseconds(message.header.stamp) == START_NS
    assert len(path.poses) == len(trajectory.points) == slots + 2
    for n, (pose, point) in enumerate(zip(path.poses, trajectory.points)):
        elapsed = round(plan.times[n] * 1e9)
        assert pose.header.frame_id == frame_id
        assert nanoseconds(pose.header.stamp) == START_NS + elapsed
        assert nanoseconds(point.time_from_start) == elapsed
        assert numbers(pose.pose.position) == [*plan.positions[uav, n], member.altitude]
        transform, = point.transforms
        assert numbers(transform.translation) == [*motion.positions[uav, n], member.altitude]
        for turn in (pose.pose.orientation, transform.rotation):
            assert yaw_of(turn) == pytest.approx(motion.headings[uav, n])
        for twists, expected in ((point.velocities, motion.velocities),
                                 (point.accelerations, motion.accelerations)):
            twist, = twists
            assert numbers(twist.linear) == [*expected[uav, n], 0.0]
            assert numbers(twist.angular) == [0.0] * 3


@given(missions(), st.sampled_from(['', 'map', 'Erde_ö']), st.data())
@example(RICH, 'map', None)
def test_what_is_read_equals_the_plan_that_was_sent(scenario, frame_id, data):
    plan = replace(fly_hover_fly(scenario), start_ns=START_NS, solve_time=0.25)
    if data is not None:
        plan = replace(plan.with_bound(Bound(scenario, 99.0, plan.objective)),
                       shares=np.full((1, scenario.slots), data.draw(st.sampled_from([1.0, 0.5]))),
                       promised_until=data.draw(st.one_of(st.none(), st.floats(0, 300))))
    assert parse_text(sent(messages.plan_text(plan, frame_id)).data, Plan) == (plan, frame_id)


@pytest.mark.parametrize('change, reason', [
    (lambda text: text[:-1], 'line 1 is not JSON'), (lambda text: '5', 'it is not a secure_uav_'),
    (lambda text: text.replace('"map"', '5'), 'frame_id is 5; it must be a string of at most 255'),
    (lambda text: text.replace('"map"', f'"{"x" * 256}"'), 'frame_id is'),
    (lambda text: text.replace(str(START_NS), 'null'), 'start_ns is null; it must be the time'),
    (lambda text: text.replace('"version": 2', '"version": 3'), 'a newer secure_uav_planner'),
    (lambda text: text.replace('"peak_power": 4.0', '"peak_power": -4.0'), 'peak_power is -4')])
def test_a_text_that_is_no_plan_is_refused_with_the_reason(change, reason):
    text = change(messages.plan_text(plan_of(9), 'map').data)
    with pytest.raises(PlanFileError) as error:
        parse_text(text, Plan)
    assert str(error.value).startswith('the message is not a plan: ')
    assert reason in str(error.value)


def test_setpoints_are_the_moment_of_the_playback():
    plan = plan_of(9, 2.0)
    moment = Playback(plan).at(70.0)
    made = dict(messages.setpoint_messages(plan.scenario, moment, 'map', Time(sec=5)))
    for index, uav in enumerate(plan.scenario.uavs):
        pose, odom = sent(made[f'{uav.name}/setpoint/pose']), sent(made[f'{uav.name}/odom'])
        setpoint = messages.read_setpoint(sent(made[f'{uav.name}/setpoint/trajectory']))
        place = (*moment.positions[index], uav.altitude)
        assert numbers(pose.pose.position) == numbers(odom.pose.pose.position) == [*place]
        assert setpoint.position == place and setpoint.time_ns == 5 * 10**9
        assert setpoint.velocity == (*moment.velocities[index], 0.0)
        assert setpoint.acceleration == (*moment.accelerations[index], 0.0)
        assert setpoint.yaw == pytest.approx(moment.headings[index])
        assert made[f'{uav.name}/setpoint/power'].data == moment.powers[index]
        for message in (pose, odom):
            assert (message.header.frame_id, message.header.stamp.sec) == ('map', 5)


@pytest.mark.parametrize('count, length, reason', [
    (0, 1.0, 'it has 0 points; it must have one'), (2, 1.0, 'it has 2 points; it must have one'),
    (1, 5.0, 'it must be a quaternion of length 1')])
def test_what_is_no_setpoint_is_refused_with_the_reason(count, length, reason):
    message = messages.trajectory_setpoint(
        'uav1', 'map', Time(), ((10.0, 20.0, 30.0), 0.0, (0.0, 0.0), (0.0, 0.0)))
    message.points[0].transforms[0].rotation.w = length
    message.points = count * [message.points[0]]
    with pytest.raises(PlanningError, match=reason):
        messages.read_setpoint(message)


def test_markers_of_very_many_points_are_thinned_out():
    plan = plan_of(20000)
    lines = [one for one in messages.markers(plan, 'map').markers if one.ns == 'path']
    assert all(len(line.points) == 1000 for line in lines)
    for line, positions in zip(lines, plan.positions):
        ends = np.array([[line.points[at].x, line.points[at].y] for at in (0, -1)])
        assert (ends == positions[[0, -1]]).all()


def test_the_name_of_a_plan_in_a_report_is_no_longer_than_60_characters():
    identity, follower = messages.read_plan_time(TimeReference(source=f'{"a" * 10**6} me'))
    assert len(identity) <= 60 and follower == 'me'
    assert messages.read_plan_time(TimeReference(source='0123abcd me')) == ('0123abcd', 'me')
