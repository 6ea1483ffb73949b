"""
Whatever a planner receives, it answers and lives, and no plan breaks a limit that it was given.

The long form has the marker `soak`.
"""

from collections import Counter
from itertools import count
import math
from random import Random
import time

from diagnostic_msgs.msg import DiagnosticStatus
from fuzzing import (
    ANY, fuzz, HEADER, parameter_sets, PLACE, POSE, reached, STAMP, STAMPED, Target, TEXT, UAVS)
from geometry_msgs.msg import (
    PoseStamped, PoseWithCovariance, PoseWithCovarianceStamped, Twist, TwistWithCovariance,
    Vector3)
from hypothesis import strategies as st
from nav_msgs.msg import Odometry, Path
import numpy as np
import pytest
from rcl_interfaces.msg import Parameter, ParameterValue
from rcl_interfaces.srv import SetParameters
import rclpy
from ros_client import (
    Client, memory_settles, node_process, output_of, pose_message, seconds, values_of, wait_for)
from secure_uav_planner.ros.parameters import PLANNER, uav_parameters
from secure_uav_planner.ros.topics import TOPICS
from sensor_msgs.msg import TimeReference
from simulation import DEEP
from std_msgs.msg import Float64MultiArray, Header
from trajectory_msgs.msg import MultiDOFJointTrajectory


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
NAMES = [*PLANNER, *NEAR, *uav_parameters('uav3', 2), 'use_sim_time', 'nobody', '']
ACTIONS = st.one_of(
    *[st.tuples(st.just('burst'), st.lists(POSES, min_size=5, max_size=30))] * 2,
    *[st.tuples(st.just('set'), parameter_sets(NEAR, NAMES), st.booleans())] * 2,
    st.sampled_from([('plan',), ('plan',), ('ask',), ('cancel',), ('good',), ('restore',)]))


class Planner(Target):
    """The planner under test: checks every plan that it publishes."""

    def __init__(self, client, process):
        super().__init__(client, 'planner', process)
        self.limits = []  # That were in force, newest last.
        self.kept = {}  # The limits that the last message of a name and topic keeps.
        self.starts = {name: set() for name in UAVS}
        self.flies = dict.fromkeys(UAVS, False)  # Whether it has had a plan.
        self.sent_good = 0
        kinds = {'path': Path, 'power': Float64MultiArray, 'trajectory': MultiDOFJointTrajectory}
        self.got = {(name, topic): client.listen(kind, f'{name}/{topic}', DEEP)
                    for name in UAVS for topic, kind in kinds.items()}
        self.status = client.listen(DiagnosticStatus, 'planner/status', DEEP)
        self.checked = Counter()

    def send(self, topic, message, stamp, qos=10):
        name = topic.split('/')[0]
        if name in self.starts:
            pose = getattr(message.pose, 'pose', message.pose)
            self.starts[name].add((pose.position.x, pose.position.y))
        super().send(topic, message, stamp, qos)

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

    def change(self, parameters, atomically=False):
        super().change(parameters, atomically)
        self.note_limits()

    def note_limits(self):
        """Note the limits of now: a plan that is replanned may be by those of long before."""
        names = ['duration', 'slots'] + [
            f'{name}.{field}' for name in UAVS for field in (
                'start', 'goal', 'altitude', 'max_speed', 'average_power', 'peak_power')]
        now = dict(zip(names, self.client.get_parameters('planner', *names)))
        if self.limits[-1:] != [now]:
            self.limits.append(now)

    def ask_for_plan(self, wait=True):
        self.note_limits()
        if self.limits[-1]['slots'] > 100 or self.limits[-1]['duration'] > 1e4:
            self.restore()  # A long solve is no better as a test than a short one.
        if wait:
            self.call('plan')
        else:
            self.counts['plan without waiting'] += 1
            self.client.ask('planner/plan')

    def check_plans(self):
        """
        Check whatever was published since the last time.

        A planner with a short replan_period may publish while this goes on: that is for the next
        time. Nearly all plans keep the newest limits, or those of the last plan.
        """
        for (name, topic), received in self.got.items():
            new = received[self.checked[name, topic]:]
            self.checked[name, topic] += len(new)
            for message in new:
                latest = self.limits[-1]
                last = self.kept.get((name, topic), latest)
                kept = next((limits for limits in (latest, last, *reversed(self.limits))
                             if self.broken(name, topic, message, limits) is None), None)
                assert kept, [(name, topic, self.broken(name, topic, message, limits), limits)
                              for limits in (latest, last)]
                self.kept[name, topic] = kept

    def broken(self, name, topic, message, limits):
        """Return which limit a message breaks, or None."""
        def limit(field):
            return limits[f'{name}.{field}']

        if topic == 'power':
            watts = np.array(message.data)
            bad = {'slots': len(watts) != limits['slots'],
                   'finite': not np.isfinite(watts).all(),
                   'negative': watts.min() < -1e-9,
                   'peak': watts.max() > limit('peak_power') + 1e-9,
                   'average': watts.mean() > limit('average_power') + 1e-9}
        else:
            if topic == 'path':
                points = np.array([[getattr(pose.pose.position, axis) for axis in 'xyz']
                                   for pose in message.poses])
            else:
                points = np.array([[getattr(point.transforms[0].translation, axis)
                                    for axis in 'xyz'] for point in message.points])
            steps = np.hypot(*np.diff(points[:, :2], axis=0).T)
            farthest = limit('max_speed') * limits['duration'] / limits['slots']
            starts = self.starts[name] | {tuple(limit('start'))}
            bad = {'slots': len(points) != limits['slots'] + 2,
                   'finite': not np.isfinite(points).all(),
                   'speed': steps.max() > farthest + 2e-6,
                   'altitude': np.abs(points[:, 2] - limit('altitude')).max() > 1e-6,
                   'goal': np.abs(points[-1, :2] - limit('goal')).max() > 2e-6,
                   # A plan that is made in flight begins where the UAV will be then.
                   'start': not self.flies[name] and min(
                       math.dist(points[0, :2], start) for start in starts
                       if np.isfinite(start).all()) > 2e-6}
            self.flies[name] |= topic == 'trajectory' and not any(bad.values())
        return next((what for what, is_so in bad.items() if is_so), None)

    def check_last_plan_is_kept(self):
        """Check that a new subscriber receives one whole plan, the one of the status."""
        with Client() as late:
            paths = [late.listen(Path, f'{name}/path') for name in UAVS]
            powers = [late.listen(Float64MultiArray, f'{name}/power') for name in UAVS]
            status = late.listen(DiagnosticStatus, 'planner/status')

            def whole():
                if not (status and all(paths) and all(powers)):
                    return False
                stamp = float(values_of(status[-1])['plan.stamp'])
                apart = [seconds(path[-1].header.stamp) - stamp for path in paths]
                return max(map(abs, apart)) < 1e-5 and {
                    len(path[-1].poses) - 2 for path in paths} == {
                    len(power[-1].data) for power in powers}
            wait_for(whole, what='one whole plan, the one that the status names')


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
                elif kind in ('plan', 'ask'):
                    planner.ask_for_plan(wait=kind == 'plan')
                elif kind == 'cancel':
                    planner.call('cancel')
                elif kind == 'good':
                    planner.send_good()
                    planner.ask_for_plan()
                else:
                    planner.restore()
            planner.check_alive()
            planner.check_plans()

        fuzz(ACTIONS, act, examples, chance, reached(planner.counts, least))
        planner.restore()
        planner.send_good()
        wait_for(lambda: planner.call('plan').success, what='a plan after all that')
        planner.check_plans()
        planner.check_last_plan_is_kept()
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


def fill(message, number, text):
    """Set all floats and texts of a message, and all stamps to the earliest; return it."""
    for field, kind in message.get_fields_and_field_types().items():
        if kind == 'string':
            setattr(message, field, text)
        elif kind.startswith('double'):
            setattr(message, field, 36 * [number] if kind.endswith(']') else number)
        elif kind in ('int32', 'uint32'):
            setattr(message, field, -2**31 if kind == 'int32' else 2**32 - 1)
        else:
            fill(getattr(message, field), number, text)
    return message


SUBSCRIBED = {topic.replace('<uav>', 'uav1').replace('<eavesdropper>', 'eavesdropper'): entry.kind
              for (node, direction), topics in TOPICS.items()
              if (node, direction) == ('planner', 'sub') for topic, entry in topics.items()}


@pytest.mark.parametrize('topic', SUBSCRIBED)
def test_abnormal_messages_of_a_topic_are_a_warning_each_and_every_call_is_answered(
        client, planner, topic):
    kind = SUBSCRIBED[topic]
    client.send_paper()
    publisher = client.publisher(kind, topic)
    for message in (kind(), *(fill(kind(), number, text) for number, text in (
            (1.7e308, 'map'), (math.nan, 'map'), (-math.inf, 'map'), (0.0, 'x' * 10**5)))):
        before = len(planner.lines)

        def refused():
            publisher.publish(message)
            time.sleep(0.02)
            return kind is TimeReference or len(planner.lines) > before
        wait_for(refused, what=f'a warning of {message}'[:500])
        for _ in range(5):
            refused()
        answer = client.call('planner/plan')
        assert answer.message and len(answer.message) < 2000
        lines = [line for line in planner.lines[before:] if f'{topic}: ' in line]
        assert len(lines) == (kind is not TimeReference), lines
        assert all('[WARN]' in line and line.endswith('it is not used\n') and len(line) < 600
                   for line in lines)
    assert not any('Traceback' in line or '[ERROR]' in line for line in planner.lines)
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
