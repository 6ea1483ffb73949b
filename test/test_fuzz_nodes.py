"""
Whatever nodes receive, they answer and live, and what they publish keeps its limits.

The long forms have the marker `soak`.
"""

from dataclasses import replace
from itertools import count
import math
from random import Random
import time

from fuzzing import fuzz, parameter, parameter_sets, PLACE, Target
from geometry_msgs.msg import PoseStamped
from hypothesis import strategies as st
from nav_msgs.msg import Odometry
import numpy as np
import pytest
from rcl_interfaces.msg import Parameter, ParameterValue
from rcl_interfaces.srv import SetParameters
from ros_client import Client, pose_message
from ros_nodes import has_said, memory_settles, node_process, output_of, wait_for
from secure_uav_planner import fly_hover_fly, Scenario
from secure_uav_planner.ros import messages
from secure_uav_planner.ros.parameters import PLANNER, read_specs, REPLAY
from secure_uav_planner.ros.topics import LATCHED, TOPICS
from std_msgs.msg import Float64, Header, String

UAVS = ('uav1', 'uav2')
# rclpy knows no value of the type 200, so its own service raises.
UNKNOWN_TYPE = SetParameters.Request(parameters=[
    Parameter(name='use_sim_time', value=ParameterValue(type=200))])
RESTORED = {'duration': 120.0, 'slots': 30, 'reference_snr_db': 80.0, 'pose_timeout': 10.0,
            'time_limit': 2.0, 'method': 'joint', 'replan_lead': 2.0}
NEAR_PLANNER = {
    'duration': st.floats(50, 400), 'slots': st.integers(1, 60), 'time_limit': st.floats(0.01, 2),
    'reference_snr_db': st.floats(20, 120), 'method': st.sampled_from(['joint', 'alternating']),
    'confidence': st.floats(0.01, 0.99), 'pose_timeout': st.floats(0, 20),
    'eavesdropper.error_radius': st.floats(0, 500),
    'replan_period': st.sampled_from([0.0, 0.3]), 'replan_distance': st.sampled_from([0.0, 5.0]),
    'replan_deviation': st.sampled_from([0.0, 2.0]), 'track_tolerance': st.floats(0.01, 20)}
for name in UAVS:
    RESTORED |= {f'{name}.start': [100.0, 500.0], f'{name}.goal': [100.0, -500.0],
                 f'{name}.altitude': 100.0, f'{name}.max_speed': 10.0,
                 f'{name}.average_power': 1.0, f'{name}.peak_power': 4.0}
    NEAR_PLANNER |= {f'{name}.start': PLACE, f'{name}.goal': PLACE,
                     f'{name}.altitude': st.floats(1, 1e4),
                     f'{name}.max_speed': st.floats(0.1, 100),
                     f'{name}.average_power': st.floats(1e-3, 4),
                     f'{name}.peak_power': st.floats(1e-3, 100)}
NEAR_REPLAY = {
    'speed': st.floats(0.001, 1e4), 'loop': st.booleans(), 'autostart': st.booleans(),
    'true_eavesdropper': st.one_of(PLACE, st.just([0.0]))}


def topics_of(node):
    """Return the kinds of the messages that a node receives, by topic."""
    topics = {topic.replace('<ground_node>', 'ground_node').replace(
        '<eavesdropper>', 'eavesdropper'): entry.kind
        for topic, entry in TOPICS[node, 'sub'].items()}
    return {topic.replace('<uav>', name): kind for topic, kind in topics.items() for name in UAVS}


class Planner(Target):
    """The planner under test: checks the plans that it publishes."""

    calls = ('good', 'plan', 'plan', 'ask_again', 'cancel', 'restore')
    parameters = parameter_sets(
        NEAR_PLANNER, [*PLANNER, *NEAR_PLANNER, *read_specs('uav', 'uav3', 2), 'use_sim_time',
                       'nobody', ''])

    def __init__(self, client, process):
        super().__init__(client, 'planner', process, topics_of('planner'))
        self._sent = 0

    def good(self):
        """Send what a plan needs, so that there is something to break, and ask for it."""
        self._sent += 1
        self.client.send_pose('ground_node/pose', self._sent % 7, 0)
        self.client.send_estimate('eavesdropper/pose', 200, self._sent % 5, variance=9)
        for name in UAVS:
            self.send(f'{name}/pose', pose_message(PoseStamped, 100, 500, 0), 0.0)
        self.plan()

    def restore(self):
        """Give all parameters values of a mission that can be flown."""
        self.change([parameter(*item) for item in RESTORED.items()], atomically=True)

    def ask_again(self):
        self.client.ask('planner/plan')  # Without waiting.

    def cancel(self):
        self.call('cancel')

    def plan(self):
        """Ask for a plan, which arrives whole and keeps the limits of now."""
        values = self.client.all_parameters('planner')
        if values['slots'] > 100 or values['duration'] > 1e4:
            self.restore()  # A long solve is no better as a test than a short one.
            values = self.client.all_parameters('planner')
        if not self.call('plan').success:
            return
        plan = wait_for(lambda: self.client.last_plan is not None and (
            self.client.last_plan.identity == self.client.status.plan.identity) and (
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

    check = Target.check_alive

    def finish(self):
        """Plan after all that."""
        self.restore()
        self.good()
        wait_for(lambda: self.call('plan').success, what='a plan after all that')


class Replay(Target):
    """The replay node under test: checks the setpoints that it sends to the UAVs."""

    calls = ('good', 'start', 'pause', 'reset')
    parameters = parameter_sets(NEAR_REPLAY, [*REPLAY, 'nobody'])

    def __init__(self, client, process):
        super().__init__(client, 'replay', process, topics_of('replay'), LATCHED)
        self._plan = replace(fly_hover_fly(Scenario.paper(104, slots=26)), start_ns=10**18)
        self._text = messages.plan_text(self._plan, 'map').data
        self._poses = [client.listen(kind, f'{name}/{topic}', 1000) for name in UAVS
                       for kind, topic in ((PoseStamped, 'setpoint/pose'), (Odometry, 'odom'))]
        self._watts = [client.listen(Float64, f'{name}/setpoint/power', 1000) for name in UAVS]

    def good(self, start_ns=None):
        """Send a plan that is newer than those before."""
        self.counts['good plans'] += 1
        plan = replace(
            self._plan, start_ns=start_ns or 10**18 + 10**9 * self.counts['good plans'])
        self.publish_with_rest('plan', messages.plan_text(plan, 'map'))

    publish_with_rest = Target.publish

    def publish(self, topic, message):
        """Publish a message, or a plan in which the text of a message has replaced a piece."""
        if topic != 'plan':
            super().publish(topic, message)
            return
        text, count = self._text, len(message.data)
        at = sum(message.data.encode()) * 997 % len(text)
        super().publish(topic, String(data=text[:at] + message.data + text[at + count:]))

    def start(self):
        return self.call('start')

    def pause(self):
        self.call('pause')

    def reset(self):
        self.call('reset')

    def check(self):
        """Fail if setpoints are not finite."""
        self.call('pause')  # It waits until it has seen to what came before, too.
        self.check_alive()
        for received in self._poses:
            for message in received:
                pose = getattr(message.pose, 'pose', message.pose)
                assert all(math.isfinite(getattr(part, axis)) for part, axes in (
                    (pose.position, 'xyz'), (pose.orientation, 'xyzw')) for axis in axes)
        for received in self._watts:
            assert all(math.isfinite(message.data) and message.data >= -1e-9
                       for message in received)
        self.counts['setpoints'] += len(self._poses[0])
        for received in self._poses + self._watts:
            received.clear()

    def finish(self):
        """Fly to the end of a plan after all that."""
        self.call('reset')
        self.change([parameter(*item) for item in {
            'speed': 100.0, 'loop': False, 'autostart': False}.items()], atomically=True)
        self.good(time.time_ns())  # No other plan begins later.
        wait_for(lambda: self.start() and any(
            message.pose.position.y == -500.0 for message in self._poses[0]), what='the end')


@pytest.mark.parametrize('kind, examples, seed, least', [
    (Planner, 8, 1, {'plan done': 1, 'plan refused': 1, 'parameters refused': 1}),
    (Replay, 8, 1, {'setpoints': 1, 'start done': 1, 'parameters refused': 1}),
    pytest.param(Planner, 40, None, {
        'messages': 2000, 'parameter sets': 300, 'plan done': 1, 'plan refused': 1},
        marks=pytest.mark.soak),
    pytest.param(Replay, 60, None, {'messages': 2000, 'setpoints': 1, 'start done': 1},
                 marks=pytest.mark.soak)])
def test_whatever_it_receives_a_node_runs_on_and_breaks_no_limit(kind, examples, seed, least):
    """Actions are thrown at the node until the counts are reached."""
    own = {Planner: {'slots': 30, 'duration': 120.0},
           Replay: {'true_eavesdropper': '[200.0, 0.0]'}}[kind]
    with Client() as client, node_process(kind.__name__.lower(), **own) as process:
        target = kind(client, process)
        target.good()
        fuzz(target, kind.calls, kind.parameters, examples, Random(seed), **least)
        target.check_abnormal(['plan' if kind is Planner else 'start'])
        for _ in range(3):
            client.ask(f'{target.node}/set_parameters', SetParameters, UNKNOWN_TYPE)
            target.change([parameter('use_sim_time', False)])
        target.finish()
        target.check_alive()
    assert process.returncode == 0, output_of(process)[-3000:]
    print(f'\n{kind.__name__}: {dict(target.counts)}')


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
        assert not has_said(process, 'not used', 11)
        assert max(map(len, process.lines)) < 500
