"""
Whatever a replay node receives, it answers and lives, and its setpoints are finite.

The long form has the marker `soak`.
"""

import array
from dataclasses import replace
import math
from random import Random
import time

from fuzzing import (
    ANY, COORDINATE, fuzz, HEADER, parameter_sets, PLACE, reached, STAMP, STAMPED, Target, UAVS)
from geometry_msgs.msg import PoseStamped, Transform, Twist, Vector3
from hypothesis import strategies as st
from nav_msgs.msg import Odometry, Path
import pytest
import rclpy
from ros_client import Client, node_process, output_of, wait_for
from secure_uav_planner import fly_hover_fly, Scenario
from secure_uav_planner.ros import messages
from secure_uav_planner.ros.parameters import REPLAY
from secure_uav_planner.ros.topics import LATCHED
from std_msgs.msg import Float64, Float64MultiArray
from trajectory_msgs.msg import MultiDOFJointTrajectory, MultiDOFJointTrajectoryPoint

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

NEAR = {'speed': st.floats(0.001, 1e4), 'loop': st.booleans(), 'autostart': st.booleans(),
        'ground_node': PLACE, 'reference_snr_db': st.floats(20, 120),
        'true_eavesdropper': st.one_of(PLACE, st.just([0.0]))}
ACTIONS = st.one_of(
    *[st.tuples(st.just('burst'), st.lists(PLANS, min_size=1, max_size=20))] * 2,
    st.tuples(st.just('set'), parameter_sets(NEAR, [*REPLAY, 'nobody']), st.booleans()),
    st.sampled_from([('start',), ('pause',), ('reset',), ('good',)]))


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
        for topic, message in messages.plan_messages(plan, 'map'):
            if not topic.startswith('~'):
                self.client.publisher(type(message), topic, LATCHED).publish(message)

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

        fuzz(ACTIONS, act, examples, chance, reached(replay.counts, least))
        replay.call('reset')
        replay.change([rclpy.Parameter(key, value=value).to_parameter_msg() for key, value in {
            'speed': 100.0, 'loop': False, 'autostart': False}.items()], atomically=True)
        replay.send_good(replace(plan, start_ns=time.time_ns()))  # No other plan begins later.
        received = replay.setpoints[0]

        def arrived():
            replay.call('start')
            return any(message.pose.position.y == -500.0 for message in received)
        wait_for(arrived, what='the end of a good plan after all that')
        replay.check_alive()
    assert process.returncode == 0, output_of(process)[-3000:]
    return replay.counts


def test_whatever_it_receives_the_replay_node_runs_on_and_its_setpoints_are_finite():
    fuzz_replay(8, Random(1), **{'setpoints': 1, 'start done': 1, 'parameters refused': 1})


@pytest.mark.soak
def test_thousands_of_messages_to_the_replay_node():
    counts = fuzz_replay(60, Random(), **{'messages': 2000, 'setpoints': 1, 'start done': 1})
    print(f'\nreplay: {dict(counts)}')
