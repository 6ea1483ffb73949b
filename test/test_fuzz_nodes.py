"""
Messages, parameters and calls of every kind, thrown at the running nodes.

The nodes may refuse anything, but they answer, they live, and no plan that leaves them breaks a
limit that they were given. The long forms have the marker `soak`.
"""

import array
from collections import Counter
from dataclasses import replace
from itertools import count
import math
from random import Random
import time

from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import (
    Point, Pose, PoseStamped, PoseWithCovariance, PoseWithCovarianceStamped, Quaternion,
    Transform, Twist, TwistWithCovariance, Vector3)
from hypothesis import given, HealthCheck, Phase, seed, settings
from hypothesis import strategies as st
from nav_msgs.msg import Odometry, Path
import numpy as np
import pytest
from rcl_interfaces.msg import Parameter, ParameterValue
from rcl_interfaces.srv import SetParameters, SetParametersAtomically
import rclpy
from rclpy.qos import DurabilityPolicy, QoSProfile
from ros_client import Client, memory_settles, node_process, output_of, values_of, wait_for
from secure_uav_planner import fly_hover_fly, Scenario
from secure_uav_planner.ros import messages
from secure_uav_planner.ros.parameters import PLANNER, REPLAY, uav_parameters
from secure_uav_planner.ros.qos import LATCHED
from std_msgs.msg import Float64, Float64MultiArray, Header
from trajectory_msgs.msg import MultiDOFJointTrajectory, MultiDOFJointTrajectoryPoint

UAVS = ('uav1', 'uav2')
DEEP = QoSProfile(depth=1000, durability=DurabilityPolicy.TRANSIENT_LOCAL)

# Messages of every kind; a stamp is a Time, or seconds from when it is sent.

ANY = st.floats()
COORDINATE = st.one_of(st.floats(-1000, 1000), st.floats(-1000, 1000), ANY)
TEXT = st.one_of(
    st.sampled_from(['map'] * 6 + ['', 'odom', '/map', 'map ', 'x' * 5000]),
    st.text(st.characters(exclude_characters='\0', exclude_categories=['Cs']), max_size=20))
STAMP = st.one_of(
    st.sampled_from([0.0, 0.0, 0.0, -5.0, 5.0, -100.0, 1e6]),
    st.builds(Time, sec=st.sampled_from([0, 1, -1, -2**31, 2**31 - 1]),
              nanosec=st.sampled_from([0, 1, 10**9, 2**32 - 1])))
POSE = st.builds(
    Pose, position=st.builds(Point, x=COORDINATE, y=COORDINATE, z=COORDINATE),
    orientation=st.one_of(st.just(Quaternion(w=1.0)),
                          st.builds(Quaternion, x=ANY, y=ANY, z=ANY, w=ANY)))


def covariance(xx, yy, xy):
    values = [0.0] * 36
    values[0], values[7], values[1], values[6] = xx, yy, xy, xy
    return values


COVARIANCE = st.one_of(
    st.just([0.0] * 36), st.builds(covariance, st.floats(0, 400), st.floats(0, 400), st.just(0.0)),
    st.builds(covariance, ANY, ANY, ANY), ANY.map(lambda value: [value] * 36),
    st.lists(ANY, min_size=36, max_size=36))
HEADER = st.builds(Header, frame_id=TEXT)
STAMPED = st.builds(PoseStamped, header=HEADER, pose=POSE)
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
PATH = st.builds(Path, header=HEADER, poses=st.lists(STAMPED, max_size=5))
POWER = st.builds(
    Float64MultiArray, data=st.one_of(
        st.lists(st.one_of(st.floats(0, 4), ANY), max_size=5).map(lambda x: array.array('d', x)),
        st.integers(0, 50).map(lambda count: array.array('d', [1.0] * count))))
VECTOR = st.builds(Vector3, x=COORDINATE, y=COORDINATE, z=COORDINATE)
TWISTS = st.lists(st.builds(Twist, linear=VECTOR), max_size=2)
TRAJECTORY = st.builds(
    MultiDOFJointTrajectory, header=HEADER, points=st.lists(st.builds(
        MultiDOFJointTrajectoryPoint, velocities=TWISTS, accelerations=TWISTS,
        transforms=st.lists(st.builds(Transform, translation=VECTOR), max_size=2)), max_size=5))
PLANS = st.one_of(
    st.tuples(st.sampled_from([f'{name}/trajectory' for name in UAVS]), TRAJECTORY, STAMP),
    st.tuples(st.sampled_from([f'{name}/path' for name in UAVS]), PATH, STAMP),
    st.tuples(st.sampled_from([f'{name}/power' for name in UAVS]), POWER, STAMP))

# Parameters of every kind: (name, ParameterValue).

WILD = st.one_of(
    st.one_of(st.none(), st.booleans(), st.integers(-2**63, 2**63 - 1), ANY, TEXT,
              st.lists(ANY, max_size=4), st.lists(st.integers(-9, 9), max_size=3),
              st.lists(TEXT, max_size=3), st.lists(st.booleans(), max_size=3),
              st.binary(max_size=3).map(lambda text: [bytes([one]) for one in text])
              ).map(lambda value: rclpy.Parameter('any', value=value).get_parameter_value()),
    st.builds(ParameterValue, type=st.integers(0, 9)))
PLACE = st.lists(st.floats(-500, 500), min_size=2, max_size=2)
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


def parameter_sets(near, names):
    """Return strategies of lists of Parameters, most of one, some of several."""
    good = st.sampled_from(sorted(near)).flatmap(lambda name: near[name].map(
        lambda value: Parameter(
            name=name, value=rclpy.Parameter(name, value=value).get_parameter_value())))
    wild = st.builds(Parameter, name=st.one_of(st.sampled_from(names), TEXT), value=WILD)
    one = st.one_of(good, good, wild).filter(
        # Simulated time would stop the clock that the fuzz itself reads; with a delay plans start
        # where nobody has been.
        lambda made: made.name not in ('use_sim_time', 'plan_file', 'start_delay'))
    return st.lists(one, min_size=1, max_size=3)


class Target:
    """
    A node under test: sends messages, asks services and checks that the node still runs.

    :ivar counts: of what was sent and how it was answered.
    """

    def __init__(self, client, node, process):
        self.client, self.node, self.process = client, node, process
        self.counts = Counter()

    def send(self, topic, message, stamp, qos=None):
        if not isinstance(stamp, Time):
            now = self.client.node.get_clock().now().nanoseconds + round(stamp * 1e9)
            stamp = Time(sec=now // 10**9, nanosec=now % 10**9)
        for header in [getattr(message, 'header', None),
                       *(pose.header for pose in getattr(message, 'poses', []))]:
            if header is not None:
                header.stamp = stamp
        self.client.publisher(type(message), topic, qos).publish(message)
        self.counts['messages'] += 1

    def ask(self, service, *kind_and_request):
        self.check_alive()
        answer = self.client.call(f'{self.node}/{service}', *kind_and_request,
                                  lost=lambda: self.process.poll() is not None)
        self.check_alive()
        return answer

    def call(self, service):
        answer = self.ask(service)
        assert answer.message
        self.counts[f'{service} {"done" if answer.success else "refused"}'] += 1
        return answer

    def change(self, parameters, atomically=False):
        kind, service = ((SetParametersAtomically, 'set_parameters_atomically') if atomically
                         else (SetParameters, 'set_parameters'))
        answer = self.ask(service, kind, kind.Request(parameters=parameters))
        results = [answer.result] if atomically else answer.results
        assert atomically or len(results) == len(parameters)
        for result in results:
            assert result.successful or result.reason
            self.counts['parameters set' if result.successful else 'parameters refused'] += 1
        self.counts['parameter sets'] += 1

    def check_alive(self):
        assert self.process.poll() is None, ''.join(self.process.lines[-30:])
        assert not any('Traceback' in line for line in self.process.lines), ''.join(
            self.process.lines[-30:])


class Planner(Target):
    """The planner under test: checks every plan that it publishes."""

    def __init__(self, client, process):
        super().__init__(client, 'planner', process)
        self.limits = []  # That were in force, newest last.
        self.starts = {name: set() for name in UAVS}
        self.sent_good = 0
        kinds = {'path': Path, 'power': Float64MultiArray, 'trajectory': MultiDOFJointTrajectory}
        self.got = {(name, topic): client.listen(kind, f'{name}/{topic}', DEEP)
                    for name in UAVS for topic, kind in kinds.items()}
        self.status = client.listen(DiagnosticStatus, 'planner/status', DEEP)
        self.checked = Counter()

    def send(self, topic, message, stamp, qos=None):
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
            message = PoseStamped(header=Header(frame_id=frame))
            message.pose.position.x, message.pose.position.y = 100.0, 500.0
            message.pose.orientation.w = 1.0
            self.send(f'{name}/pose', message, 0.0)

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
        """Note the limits of now: a plan under way, or its replan, may be by those of before."""
        names = ['duration', 'slots'] + [
            f'{name}.{field}' for name in UAVS for field in (
                'start', 'goal', 'altitude', 'max_speed', 'average_power', 'peak_power')]
        self.limits = self.limits[-200:] + [dict(zip(
            names, self.client.get_parameters('planner', *names)))]

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
        time. Nearly all plans keep the newest limits, which are asked first.
        """
        for (name, topic), received in self.got.items():
            new = received[self.checked[name, topic]:]
            self.checked[name, topic] += len(new)
            for message in new:
                kept = any(self.broken(name, topic, message, limits) is None
                           for limits in reversed(self.limits))
                latest = self.limits[-1]
                assert kept, (name, topic, self.broken(name, topic, message, latest), latest)

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
                   'start': min(math.dist(points[0, :2], start) for start in starts
                                if np.isfinite(start).all()) > 2e-6}
        return next((what for what, is_so in bad.items() if is_so), None)

    def check_last_plan_is_kept(self):
        """Check that a new subscriber receives one whole plan, the one of the status."""
        with Client('latecomer') as late:
            paths = [late.listen(Path, f'{name}/path') for name in UAVS]
            powers = [late.listen(Float64MultiArray, f'{name}/power') for name in UAVS]
            status = late.listen(DiagnosticStatus, 'planner/status')

            def whole():
                if not (status and all(paths) and all(powers)):
                    return False
                stamp = float(values_of(status[-1])['plan.stamp'])
                apart = [path[-1].header.stamp.sec - stamp + path[-1].header.stamp.nanosec * 1e-9
                         for path in paths]
                return max(map(abs, apart)) < 1e-5 and {
                    len(path[-1].poses) - 2 for path in paths} == {
                    len(power[-1].data) for power in powers}
            wait_for(whole, what='one whole plan, the one that the status names')


class Replay(Target):
    """The replay node under test: checks the setpoints that it sends to the UAVs."""

    def __init__(self, client, process):
        super().__init__(client, 'replay', process)
        self.setpoints = [client.listen(PoseStamped, f'{name}/setpoint/pose', 1000)
                          for name in UAVS]
        self.watts = [client.listen(Float64, f'{name}/setpoint/power', 1000) for name in UAVS]
        self.odometry = [client.listen(Odometry, f'{name}/odom', 1000) for name in UAVS]

    def send_good(self, plan):
        self.counts['good plans'] += 1
        for index, name in enumerate(UAVS):
            path, power = messages.path(plan, index, 'map'), messages.power(plan, index)
            self.client.publisher(Path, f'{name}/path', LATCHED).publish(path)
            self.client.publisher(Float64MultiArray, f'{name}/power', LATCHED).publish(power)
            self.client.publisher(
                MultiDOFJointTrajectory, f'{name}/trajectory', LATCHED).publish(
                    messages.trajectory(plan, index, 'map'))

    def check_setpoints(self):
        for received in self.setpoints + self.odometry:
            for message in received:
                pose = getattr(message.pose, 'pose', message.pose)
                places = [getattr(pose.position, axis) for axis in 'xyz'] + [
                    getattr(pose.orientation, axis) for axis in 'xyzw']
                assert all(map(math.isfinite, places))
        for received in self.watts:
            assert all(math.isfinite(message.data) and message.data >= -1e-9
                       for message in received)
        self.counts['setpoints'] += sum(map(len, self.setpoints))
        for received in self.setpoints + self.odometry + self.watts:
            received.clear()


PLANNER_ACTIONS = st.one_of(
    *[st.tuples(st.just('burst'), st.lists(POSES, min_size=5, max_size=30))] * 2,
    *[st.tuples(st.just('set'), parameter_sets(NEAR, NAMES), st.booleans())] * 2,
    st.sampled_from([('plan',), ('plan',), ('ask',), ('cancel',), ('good',), ('restore',)]))
REPLAY_NEAR = {'speed': st.floats(0.001, 1e4), 'loop': st.booleans(), 'autostart': st.booleans(),
               'ground_node': PLACE, 'reference_snr_db': st.floats(20, 120),
               'true_eavesdropper': st.one_of(PLACE, st.just([0.0]))}
REPLAY_ACTIONS = st.one_of(
    *[st.tuples(st.just('burst'), st.lists(PLANS, min_size=1, max_size=20))] * 2,
    st.tuples(st.just('set'), parameter_sets(REPLAY_NEAR, [*REPLAY, 'nobody']), st.booleans()),
    st.sampled_from([('start',), ('pause',), ('reset',), ('good',)]))


ROUNDS = 40  # At most, for a node that refuses everything.


def fuzz(actions, act, examples, chance, is_enough):
    """
    Do lists of actions, round after round until it is enough.

    A running node has a history, so examples are not shrunk.

    :param examples: how many lists a round has.
    :param chance: a random.Random that the actions come from.
    :param is_enough: asked after each round.
    """
    for _ in range(ROUNDS):
        @seed(chance.getrandbits(64))
        @settings(max_examples=examples, deadline=None, database=None,
                  phases=[Phase.explicit, Phase.generate],
                  suppress_health_check=list(HealthCheck))
        @given(st.lists(actions, min_size=4, max_size=12))
        def run(found):
            act(found)
        run()
        if is_enough():
            return
    raise AssertionError(f'it was not enough after {ROUNDS} rounds of {examples} lists of actions')


def reached(counts, least):
    """Return what tells whether all counts have reached what is the least."""
    return lambda: all(counts[what] >= number for what, number in least.items())


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

        fuzz(PLANNER_ACTIONS, act, examples, chance, reached(planner.counts, least))
        planner.restore()
        planner.send_good()
        wait_for(lambda: planner.call('plan').success, what='a plan after all that')
        planner.check_plans()
        planner.check_last_plan_is_kept()
        planner.check_alive()
    assert process.returncode == 0, output_of(process)[-3000:]
    return planner.counts


def fuzz_replay(examples, chance, **least):
    """Throw actions at a replay node until the counts are reached; return what happened."""
    plan = fly_hover_fly(Scenario.paper(104, slots=26))
    with Client() as client, node_process('replay', true_eavesdropper='[200.0, 0.0]') as process:
        replay = Replay(client, process)
        replay.send_good(replace(plan, start_ns=10**18))
        wait_for(lambda: replay.call('start').success, what='a first plan')

        def act(actions):
            for kind, *what in actions:
                if kind == 'burst':
                    for message in what[0]:
                        replay.send(*message, qos=LATCHED)
                elif kind == 'set':
                    replay.change(*what)
                elif kind == 'good':
                    replay.send_good(
                        replace(plan, start_ns=10**18 + 10**9 * replay.counts['good plans']))
                else:
                    replay.call(kind)
            replay.call('pause')  # also waits until it has seen to what came before
            replay.check_alive()
            replay.check_setpoints()

        fuzz(REPLAY_ACTIONS, act, examples, chance, reached(replay.counts, least))
        replay.call('reset')
        replay.change([rclpy.Parameter(key, value=value).to_parameter_msg() for key, value in {
            'speed': 100.0, 'loop': False, 'autostart': False}.items()], atomically=True)
        replay.send_good(replace(plan, start_ns=2 * 10**18))
        received = replay.setpoints[0]

        def arrived():
            replay.call('start')
            return any(message.pose.position.y == -500.0 for message in received)
        wait_for(arrived, what='the end of a good plan after all that')
        replay.check_alive()
    assert process.returncode == 0, output_of(process)[-3000:]
    return replay.counts


def test_whatever_it_receives_the_planner_runs_on_and_no_plan_breaks_a_limit():
    fuzz_planner(8, Random(1), **{'plan done': 1, 'plan refused': 1, 'parameters refused': 1})


def test_whatever_it_receives_the_replay_node_runs_on_and_its_setpoints_are_finite():
    fuzz_replay(8, Random(1), **{'setpoints': 1, 'start done': 1, 'parameters refused': 1})


@pytest.mark.soak
def test_thousands_of_messages_to_the_planner():
    counts = fuzz_planner(40, Random(), **{
        'messages': 2000, 'parameter sets': 300, 'plan done': 1, 'plan refused': 1})
    print(f'\nplanner: {dict(counts)}')


@pytest.mark.soak
def test_thousands_of_messages_to_the_replay_node():
    counts = fuzz_replay(60, Random(), **{'messages': 2000, 'setpoints': 1, 'start done': 1})
    print(f'\nreplay: {dict(counts)}')


@pytest.mark.parametrize('node', ['planner', 'replay'])
def test_a_malformed_request_to_the_parameter_services_does_not_end_the_node(node):
    """No value of the type 200 is known to rclpy, whose own service raises."""
    with Client() as client, node_process(node) as process:
        request = SetParameters.Request(parameters=[
            Parameter(name='frame_id', value=ParameterValue(type=200))])
        for _ in range(3):
            client.ask(f'{node}/set_parameters', SetParameters, request)
        target = Target(client, node, process)
        for _ in range(3):
            target.change([rclpy.Parameter('frame_id', value='map').to_parameter_msg()])
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
