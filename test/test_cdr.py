"""Plans from serialized messages, against rclpy's own reading of them."""

from dataclasses import replace
from functools import cache
import math
import sys

import clarabel
from geometry_msgs.msg import PoseStamped, Transform, Twist
from hypothesis import given
from hypothesis import strategies as st
from nav_msgs.msg import Path
import numpy as np
import pytest
from rclpy.serialization import serialize_message
from secure_uav_planner import fly_hover_fly, GroundNode, Plan, Scenario
from secure_uav_planner.errors import PlanError
from secure_uav_planner.ros import messages
from secure_uav_planner.ros.assembly import Assembly
from secure_uav_planner.ros.cdr import read_path, read_power, read_trajectory
from secure_uav_planner.ros.topics import SCHEDULE
from std_msgs.msg import Float64MultiArray, MultiArrayDimension
from strategies import with_uavs
from trajectory_msgs.msg import MultiDOFJointTrajectory, MultiDOFJointTrajectoryPoint

NAMES = st.text(st.characters(codec='utf-8', exclude_characters='\0'), max_size=9)
ROWS = st.lists(st.lists(st.floats(allow_nan=False), min_size=6, max_size=6), max_size=5)
READERS = (read_path, read_power, read_trajectory)


def path_of(frame, pose_frames, rows=None):
    message = Path()
    message.header.frame_id, message.header.stamp.sec = frame, 7
    for index, (pose_frame, row) in enumerate(zip(pose_frames, rows or [[0.0] * 6] * 9)):
        pose = PoseStamped()
        pose.header.frame_id, pose.header.stamp.nanosec = pose_frame, index + 1
        pose.pose.position.x, pose.pose.position.y, pose.pose.position.z = row[:3]
        message.poses.append(pose)
    return message


def trajectory_of(frame, joint, rows):
    message = MultiDOFJointTrajectory(joint_names=[joint])
    message.header.frame_id = frame
    for row in rows:
        transform, velocity, acceleration = Transform(), Twist(), Twist()
        for vector, (x, y) in ((transform.translation, row[:2]), (velocity.linear, row[2:4]),
                               (acceleration.linear, row[4:])):
            vector.x, vector.y = x, y
        message.points.append(MultiDOFJointTrajectoryPoint(
            transforms=[transform], velocities=[velocity], accelerations=[acceleration]))
    return message


@given(NAMES, st.lists(NAMES, max_size=2), st.data())
def test_a_path_has_its_stamps_and_places_its_frame_and_the_first_other_one(frame, frames, data):
    rows = data.draw(ROWS)
    pose_frames = [data.draw(st.sampled_from(frames or [frame])) for _ in rows]
    content = read_path(serialize_message(path_of(frame, pose_frames, rows)))
    assert (content.stamp_ns, content.frame) == (7 * 10**9, frame)
    assert content.pose_frames == [*dict.fromkeys(pose_frames)]
    if len(content.pose_frames) < 2:
        assert content.times_ns.tolist() == [*range(1, len(rows) + 1)]
        assert content.places.tolist() == [row[:3] for row in rows]


@given(NAMES, st.lists(st.floats(allow_nan=False)))
def test_a_power_has_its_numbers_behind_any_layout(label, levels):
    message = Float64MultiArray(data=levels)
    message.layout.dim = [MultiArrayDimension(label=label)] * len(label)
    assert read_power(serialize_message(message)).levels.tolist() == levels


@given(NAMES, NAMES, ROWS)
def test_a_trajectory_has_its_motion(frame, joint, rows):
    message = trajectory_of(frame, joint, rows)
    content = read_trajectory(serialize_message(message))
    assert (content.frame, content.size) == (frame, len(rows))
    assert (content.motion is None) == (not rows)
    if rows:
        assert np.concatenate(content.motion, axis=1).tolist() == rows


@given(st.sampled_from(['transforms', 'velocities', 'accelerations']), st.sampled_from([0, 2]),
       st.integers(0, 2))
def test_a_trajectory_without_one_of_each_part_has_no_motion(part, count, point):
    message = trajectory_of('map', 'uav1', [[1.0] * 6] * 3)
    setattr(message.points[point], part, getattr(message.points[point], part) * count)
    assert read_trajectory(serialize_message(message)).motion is None


@given(st.binary(max_size=300), st.booleans())
def test_bytes_that_are_no_message_are_refused_or_read(data, is_cdr):
    for read in READERS:
        try:
            read(b'\0\1\0\0' * is_cdr + data)
        except PlanError:
            pass


@pytest.mark.parametrize('read, message', [
    (read_path, path_of('map', ['map'] * 5)), (read_power, Float64MultiArray(data=[1.0] * 5))])
def test_a_message_that_ends_early_is_refused(read, message):
    data = bytes(serialize_message(message))
    for end in range(len(data) - 3):  # It is filled up to a multiple of four.
        with pytest.raises(PlanError):
            read(data[:end])


UAVS = ['uav1', 'uav2']
FIELDS = {'ground_node': (0.0, 0.0), 'eavesdroppers': Scenario.paper().eavesdroppers}
STRANGER = replace(fly_hover_fly(with_uavs(
    Scenario.paper(120.0, slots=30), max_acceleration=1.5, goal_velocity=None)), start_ns=10**18)


def send(assembly, plan, kinds, change=lambda topic, message: None):
    """Give an assembly the messages of another planner, which name nothing; return its answers."""
    answers, parts = [], dict(messages.plan_messages(plan, 'earth'))
    for kind in kinds:
        for name in UAVS:
            topic = f'{name}/{kind}'
            change(topic, parts[topic])
            if kind == 'power':
                del parts[topic].layout.dim[1]
            try:
                received = assembly.take(topic, bytes(serialize_message(parts[topic])), FIELDS)
                answers.append(received and received[0])
            except PlanError as error:
                answers.append(error)
    return answers


def set_field(topic, path, value):
    """
    Return a change for send.

    :param path: the name of a field after those of what it is in, such as 'poses.7.header.stamp'.
    :param value: the new one, or a function of the old one.
    """
    def change(sent, message):
        if sent == topic:
            *way, name = path.split('.')
            for part in way:
                message = message[int(part)] if part.isdigit() else getattr(message, part)
            setattr(message, name, value(getattr(message, name)) if callable(value) else value)
    return change


def set_long_frames(topic, message):
    if topic.endswith('path'):
        message.header.frame_id = 'x' * 10_000
        for pose in message.poses:
            pose.header.frame_id = ''


@pytest.mark.filterwarnings('error::RuntimeWarning')
@pytest.mark.parametrize('change, reason', [
    (set_field('uav1/power', 'data', lambda data: data[:5]), 'uav1 has 32 points and 5 powers'),
    (set_field('uav2/path', 'header.frame_id', 'odom'),
     "uav1/path in 'earth', uav2/path in 'odom'"),
    (set_long_frames, 'frame_id of the paths has 10000 characters'),
    (set_field('uav2/path', 'poses.3.header.frame_id', 'odom'), "has a pose in frame 'odom'"),
    (set_field('uav2/path', 'header.stamp.sec', lambda sec: sec + 5), 'their stamps differ'),
    (set_field('uav1/path', 'poses.7.header.stamp.sec', lambda sec: sec + 1), 'equally spaced'),
    (set_field('uav2/path', 'poses.9.pose.position.z', 115.0), 'the altitude must be constant'),
    (set_field('uav1/path', 'poses.2.pose.position.x', 1e300), 'coordinates beyond'),
    (set_field('uav2/power', 'data', lambda data: [1e308, *data[1:]]), 'values beyond'),
    (set_field('uav1/trajectory', 'points.7.transforms.0.translation.x', lambda x: x + 0.5),
     'uav1/trajectory is not the curve of uav1/path: at point 7'),
    (set_field('uav1/trajectory', 'points.0.accelerations.0.linear.x', math.nan),
     'uav1/trajectory has values beyond'),
    (set_field('uav1/trajectory', 'points', lambda points: points[:-1]),
     'uav1/trajectory has 31 points and uav1/path 32'),
    (set_field('uav2/trajectory', 'points.3.accelerations', []),
     'uav1/trajectory has accelerations, uav2/trajectory is missing or has none'),
    (set_field('uav1/trajectory', 'header.frame_id', 'odom'),
     "uav1/path is in frame 'earth', uav1/trajectory in 'odom'")])
def test_messages_that_do_not_make_a_plan_are_refused_with_the_reason(change, reason):
    kinds = ('path', 'power', 'trajectory') if 'trajectory' in reason else ('path', 'power')
    assembly = Assembly(UAVS, lambda topic: 'trajectory' in kinds)
    *_, refused = send(assembly, STRANGER, kinds, change)
    assert isinstance(refused, PlanError) and reason in str(refused)
    assert 'np.' not in str(refused)
    made, = (answer for answer in send(assembly, STRANGER, kinds) if isinstance(answer, Plan))
    assert np.array_equal(made.positions, STRANGER.positions)


def test_trajectories_come_in_any_order_and_are_waited_for_where_somebody_publishes_them():
    publishes = False
    assembly = Assembly(UAVS, lambda topic: publishes)
    *_, plan = send(assembly, STRANGER, ('path', 'power'))
    assert plan.scenario.uavs[0].max_acceleration is None
    publishes = True
    assert not any(send(assembly, STRANGER, ('path', 'power')))
    assert assembly.problem == 'no new message on uav1/trajectory, uav2/trajectory'
    *_, plan = send(assembly, STRANGER, ('trajectory',))
    assert plan.scenario.uavs[0].max_acceleration is not None
    assert send(assembly, STRANGER, ('trajectory', 'power', 'path'))[-1]


def test_a_power_that_comes_alone_is_not_joined_to_an_old_path():
    assembly = Assembly(UAVS, lambda topic: False)
    assert send(assembly, STRANGER, ('path', 'power'))[-1]
    assert not any(send(assembly, STRANGER, ('power',)))
    assert assembly.problem == 'no new message on uav1/path, uav2/path'


def test_a_plan_of_constant_power_is_used_although_its_mean_is_rounded_up():
    powers = np.full_like(STRANGER.powers, 0.38)
    assert powers[0].mean() > 0.38
    assembly = Assembly(UAVS, lambda topic: False)
    *_, plan = send(assembly, replace(STRANGER, powers=powers), ('path', 'power'))
    assert np.array_equal(plan.powers, powers)


def sent_by_planner(plan):
    """Return the serialized messages of a plan by topic."""
    return {topic.replace('~', 'planner'): bytes(serialize_message(message))
            for topic, message in messages.plan_messages(plan, 'map')
            if not topic.endswith('markers')}


def assembled(plan):
    """Return a plan after its messages, and how many functions were called to assemble it."""
    assembly, calls = Assembly(UAVS, lambda topic: True), []
    sent = sent_by_planner(plan).items()
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(clarabel, 'DefaultSolver', None)
        sys.setprofile(lambda frame, event, argument: calls.append(event))
        try:
            made, _ = [*filter(None, (assembly.take(topic, message, FIELDS)
                                      for topic, message in sent))][-1]
        finally:
            sys.setprofile(None)
    return made, len(calls)


def test_more_slots_take_no_more_calls_so_that_the_stream_goes_on_and_no_solver():
    counts = []
    for slots in (100, 100, 1000):  # Modules may be imported at first.
        plan = replace(fly_hover_fly(with_uavs(
            Scenario.paper(150.0, slots=slots), max_acceleration=2.0,
            start_velocity=(0.0, -5.0))), start_ns=10**18)
        made, count = assembled(plan)
        assert made.identity == plan.identity
        counts.append(count)
    assert counts[2] < 1.2 * counts[1]


NODES = tuple(GroundNode((0.0, y), name) for name, y in (('barn', 150.0), ('cart', -150.0)))


@cache
def revisions(is_farm):
    """Return plans of one flight for a ground node or two, and the messages of each by topic."""
    scenario = with_uavs(Scenario.paper(150.0, slots=20), max_acceleration=2.0)
    shares = None
    if is_farm:
        scenario = replace(scenario, ground_node=None, ground_nodes=NODES)
        shares = np.full((2, 20), 0.5)
    plan = fly_hover_fly(scenario)
    inner = np.pad(np.ones((2, 20, 2)), ((0, 0), (1, 1), (0, 0)))
    plans = [Plan(scenario, plan.positions + 1e-7 * inner * (number > 1),
                  plan.powers * (1.0 if number < 1 else 0.9), shares=shares, start_ns=10**18)
             for number in range(3)]
    return plans, [sent_by_planner(plan) for plan in plans]


@given(st.data(), st.booleans())
def test_in_any_order_and_with_any_loss_only_whole_plans_are_assembled_and_the_last_one_is(
        data, is_farm):
    plans, sent = revisions(is_farm)
    assembly, made = Assembly(UAVS, lambda topic: True), []
    fields = {'eavesdroppers': FIELDS['eavesdroppers'], 'ground_nodes': tuple(
        replace(node, name=f'node{number}')
        for number, node in enumerate(plans[0].scenario.ground_nodes))}
    # Each topic keeps its order; all but the last message of each may be lost.
    queues = {topic: [parts[topic] for number, parts in enumerate(sent)
                      if number == 2 or data.draw(st.booleans())] for topic in sent[0]}
    while queues:
        topic = data.draw(st.sampled_from(sorted(queues)))
        if received := assembly.take(topic, queues[topic].pop(0), fields):
            made.append(received[0])
        if not queues[topic]:
            del queues[topic]
    identities = [plan.identity for plan in plans]
    order = [identities.index(plan.identity) for plan in made]
    assert order[-1] == 2 and order == sorted(order) and not assembly.missing
    if is_farm:
        assert made[-1].scenario.ground_node_names == ('barn', 'cart')
        assert made[-1].node_rates == pytest.approx(plans[-1].node_rates)
    # Published again by a planner that has been restarted, it is no new plan.
    assert not any(assembly.take(topic, message, fields) for topic, message in sent[-1].items())


def test_a_schedule_of_other_nodes_and_one_of_a_single_node_make_no_plan():
    assembly = Assembly(UAVS, lambda topic: True)
    with pytest.raises(PlanError, match='plan serves barn, cart, and there are positions of 1 '):
        for topic, message in revisions(True)[1][-1].items():
            assembly.take(topic, message, {**FIELDS, 'ground_nodes': NODES[:1]})
    plans, sent = revisions(False)
    schedule = dict(messages.plan_messages(plans[0], 'map'))['~/schedule']
    assert [dim.label for dim in schedule.layout.dim] == [
        'ground_node', 'slot', f'{plans[0].identity} ground_node']
    assembly = Assembly(UAVS, lambda topic: True)
    assert not assembly.take(SCHEDULE, sent[0][SCHEDULE], FIELDS) and not assembly.problem
