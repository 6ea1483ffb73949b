"""
Whatever a planner receives, it answers and lives, and no plan breaks a limit that it was given.

The long form has the marker `soak`.
"""

from itertools import count
from random import Random
import time

from fuzzing import (
    ANY, check_abnormal, fuzz, HEADER, parameter_sets, PLACE, POSE, reached, STAMP, STAMPED,
    Target, TEXT, UAVS)
from geometry_msgs.msg import (
    PoseStamped, PoseWithCovariance, PoseWithCovarianceStamped, Twist, TwistWithCovariance,
    Vector3)
from hypothesis import strategies as st
from nav_msgs.msg import Odometry
import numpy as np
import pytest
from rcl_interfaces.msg import Parameter, ParameterValue
from rcl_interfaces.srv import SetParameters
import rclpy
from ros_client import Client, memory_settles, node_process, output_of, pose_message, wait_for
from secure_uav_planner.ros.parameters import PLANNER, read_specs
from secure_uav_planner.ros.topics import TOPICS
from std_msgs.msg import Header


def covariance(xx, yy, xy):
    values = [0.0] * 36
    values[0], values[7], values[1], values[6] = xx, yy, xy, xy
    return values


COVARIANCE = st.one_of(
    st.just([0.0] * 36), st.builds(covariance, st.floats(0, 400), st.floats(0, 400), st.just(0.0)),
    st.builds(covariance, ANY, ANY, ANY), ANY.map(lambda value: [value] * 36),
    st.lists(ANY, min_size=36, max_size=36))
ESTIMATE = st.builds(PoseWithCovarianceStamped, header=HEADER, pose=st.builds(
    PoseWithCovariance, pose=POSE, covariance=COVARIANCE))
SPEED = st.one_of(st.floats(-20, 20), ANY)
ODOMETRY = st.builds(
    Odometry, header=HEADER, child_frame_id=TEXT, pose=st.builds(PoseWithCovariance, pose=POSE),
    twist=st.builds(TwistWithCovariance, twist=st.builds(
        Twist, linear=st.builds(Vector3, x=SPEED, y=SPEED, z=SPEED))))
POSES = st.one_of(
    st.tuples(st.just('ground_node/pose'), STAMPED, STAMP),
    st.tuples(st.just('eavesdropper/pose'), ESTIMATE, STAMP),
    st.tuples(st.sampled_from([f'{name}/pose' for name in UAVS]), STAMPED, STAMP),
    st.tuples(st.sampled_from([f'{name}/odom' for name in UAVS]), ODOMETRY, STAMP))

NEAR = {
    'duration': st.floats(50, 400), 'slots': st.integers(1, 60), 'time_limit': st.floats(0.01, 2),
    'reference_snr_db': st.floats(20, 120), 'method': st.sampled_from(['joint', 'alternating']),
    'confidence': st.floats(0.01, 0.99), 'pose_timeout': st.floats(0, 20),
    'eavesdropper.error_radius': st.floats(0, 500), 'frame_id': st.sampled_from(['map', 'odom']),
    'replan_period': st.sampled_from([0.0, 0.3]), 'replan_distance': st.sampled_from([0.0, 5.0]),
    'replan_deviation': st.sampled_from([0.0, 2.0]), 'track_tolerance': st.floats(0.01, 20)}
for name in UAVS:
    NEAR.update({f'{name}.start': PLACE, f'{name}.goal': PLACE,
                 f'{name}.altitude': st.floats(1, 1e4), f'{name}.max_speed': st.floats(0.1, 100),
                 f'{name}.average_power': st.floats(1e-3, 4),
                 f'{name}.peak_power': st.floats(1e-3, 100)})
NAMES = [*PLANNER, *NEAR, *read_specs('uav', 'uav3', 2), 'use_sim_time', 'nobody', '']
ACTIONS = st.one_of(
    *[st.tuples(st.just('burst'), st.lists(POSES, min_size=5, max_size=30))] * 2,
    *[st.tuples(st.just('set'), parameter_sets(NEAR, NAMES), st.booleans())] * 2,
    st.sampled_from([('plan',), ('plan',), ('ask',), ('cancel',), ('good',), ('restore',)]))


class Planner(Target):
    """The planner under test: checks the plans that it publishes."""

    def __init__(self, client, process):
        super().__init__(client, 'planner', process)
        self.sent_good = 0

    def send_good(self):
        """Send what a plan needs, so that there is something to break."""
        self.sent_good += 1
        frame, = self.client.get_parameters('planner', 'frame_id')
        self.client.send_pose('ground_node/pose', self.sent_good % 7, 0, frame)
        self.client.send_estimate('eavesdropper/pose', 200, self.sent_good % 5, frame, variance=9)
        for name in UAVS:
            self.send(f'{name}/pose', pose_message(PoseStamped, 100, 500, 0, frame), 0.0)

    def restore(self):
        """Give all parameters values of a mission that can be flown."""
        values = {'duration': 120.0, 'slots': 30, 'frame_id': 'map', 'reference_snr_db': 80.0,
                  'pose_timeout': 10.0, 'time_limit': 2.0, 'method': 'joint',
                  'replan_lead': 2.0}
        for name in UAVS:
            values.update({f'{name}.start': [100.0, 500.0], f'{name}.goal': [100.0, -500.0],
                           f'{name}.altitude': 100.0, f'{name}.max_speed': 10.0,
                           f'{name}.average_power': 1.0, f'{name}.peak_power': 4.0})
        self.change([rclpy.Parameter(key, value=value).to_parameter_msg()
                     for key, value in values.items()], atomically=True)

    def ask_for_plan(self):
        """Ask for a plan, which arrives whole and keeps the limits of now."""
        values = self.client.all_parameters('planner')
        if values['slots'] > 100 or values['duration'] > 1e4:
            self.restore()  # A long solve is no better as a test than a short one.
            values = self.client.all_parameters('planner')
        if not self.call('plan').success:
            return
        plan = wait_for(lambda: self.client.last_plan is not None and (
            self.client.last_plan.identity == self.client.status.get('plan.identity')) and (
                self.client.last_plan), what='the plan')
        assert plan.scenario.slots == values['slots']
        for uav, points, watts in zip(plan.scenario.uavs, plan.positions, plan.powers):
            def limit(field):
                return values[f'{uav.name}.{field}']
            assert np.isfinite(points).all() and np.isfinite(watts).all()
            assert (np.hypot(*np.diff(points, axis=0).T) <= (
                limit('max_speed') * plan.scenario.slot_duration + 2e-6)).all()
            assert abs(uav.altitude - limit('altitude')) <= 1e-6
            assert np.abs(points[-1] - limit('goal')).max() <= 2e-6
            assert watts.min() >= -1e-9 and watts.max() <= limit('peak_power') + 1e-9
            assert watts.mean() <= limit('average_power') + 1e-9


def fuzz_planner(examples, chance, **least):
    """Throw actions at a planner until the counts are reached; return what happened."""
    with Client() as client, node_process('planner', slots=30, duration=120.0) as process:
        planner = Planner(client, process)
        planner.send_good()
        planner.ask_for_plan()

        def act(actions):
            for kind, *what in actions:
                if kind == 'burst':
                    for message in what[0]:
                        planner.send(*message)
                elif kind == 'set':
                    planner.change(*what)
                elif kind == 'plan':
                    planner.ask_for_plan()
                elif kind == 'ask':
                    client.ask('planner/plan')  # Without waiting.
                elif kind == 'cancel':
                    planner.call('cancel')
                elif kind == 'good':
                    planner.send_good()
                    planner.ask_for_plan()
                else:
                    planner.restore()
            planner.check_alive()

        fuzz(ACTIONS, act, examples, chance, reached(planner.counts, least))
        planner.restore()
        planner.send_good()
        wait_for(lambda: planner.call('plan').success, what='a plan after all that')
        planner.check_alive()
    assert process.returncode == 0, output_of(process)[-3000:]
    return planner.counts


def test_whatever_it_receives_the_planner_runs_on_and_no_plan_breaks_a_limit():
    fuzz_planner(8, Random(1), **{'plan done': 1, 'plan refused': 1, 'parameters refused': 1})


@pytest.mark.soak
def test_thousands_of_messages_to_the_planner():
    counts = fuzz_planner(40, Random(), **{
        'messages': 2000, 'parameter sets': 300, 'plan done': 1, 'plan refused': 1})
    print(f'\nplanner: {dict(counts)}')


def test_abnormal_messages_on_any_topic_are_told_once_and_calls_are_answered(client, planner):
    topics = {topic.replace('<uav>', 'uav1').translate({ord('<'): '', ord('>'): ''}): entry.kind
              for topic, entry in TOPICS['planner', 'sub'].items()}

    def publish(topic, message):
        client.publisher(type(message), topic).publish(message)

    client.send_paper()
    check_abnormal(planner, publish, topics, lambda: client.call('planner/plan'))
    client.set_parameters('planner', uav1__use_pose=False)
    client.plan_paper()


@pytest.mark.parametrize('node, name, value', [('planner', 'frame_id', 'map'),
                                               ('replay', 'speed', 1.0)])
def test_a_malformed_request_to_the_parameter_services_does_not_end_the_node(node, name, value):
    """No value of the type 200 is known to rclpy, whose own service raises."""
    with Client() as client, node_process(node) as process:
        request = SetParameters.Request(parameters=[
            Parameter(name=name, value=ParameterValue(type=200))])
        for _ in range(3):
            client.ask(f'{node}/set_parameters', SetParameters, request)
        target = Target(client, node, process)
        for _ in range(3):
            target.change([rclpy.Parameter(name, value=value).to_parameter_msg()])
            time.sleep(0.3)
        assert target.counts['parameters set'] == 3


def test_endless_new_frames_neither_flood_the_log_nor_fill_the_memory():
    with Client() as client, node_process('planner') as process:
        publisher = client.publisher(PoseStamped, 'ground_node/pose')
        names = count()

        def send_frames():
            for _ in range(1000):
                publisher.publish(PoseStamped(
                    header=Header(frame_id=f'{next(names)}' + 1000 * 'x')))
                time.sleep(0.0005)
            assert client.get_parameters('planner', 'frame_id') == ['map']  # it answers

        memory_settles(process, send_frames)
        client.send_pose('ground_node/pose', 0, 0)
        assert sum('not used' in line for line in process.lines) <= 10
        assert max(map(len, process.lines)) < 500
