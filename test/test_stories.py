"""
Random stories of a mission over DDS: whatever is asked for, no setpoint jumps.

Planner and replay are processes of their own; vehicles follow the setpoints with a lag. In a story
somebody asks for plans (also twice at once), cancels, starts, pauses, resets, changes parameters,
moves the estimate, pushes a vehicle, kills a node, or stops the clock and makes it jump. Set
STORIES to the number of stories, and STORY to the first seed.
"""

from collections import Counter
from contextlib import ExitStack
import math
import os
from random import Random
import threading
import time

from builtin_interfaces.msg import Time
from nav_msgs.msg import Odometry
import numpy as np
import pytest
from ros_client import Client, node_process, output_of, values_of, wait_for
from rosgraph_msgs.msg import Clock
from secure_uav_planner.ros import messages
from secure_uav_planner.ros.messages import read_plan_time
from sensor_msgs.msg import TimeReference
from trajectory_msgs.msg import MultiDOFJointTrajectory

SPEED, ACCELERATION = 10.0, 2.0  # m/s, m/s^2
ALLOWANCE, VELOCITY_ALLOWANCE = 0.011, 0.02  # m, m/s
ACTIONS = 12  # In a story.
LAG = 0.4  # s, of the vehicles
START = {'uav1': (100.0, 500.0, 100.0), 'uav2': (100.0, 500.0, 110.0),
         'uav3': (100.0, 500.0, 110.0)}  # The planner's defaults, in m.
ZONE = {'no_fly_zones': '[mast]', 'mast__vertices': '[20.0, 240.0, 40.0, 240.0, 30.0, 260.0]'}


class Story:
    """The nodes of one story, and all setpoints that they send."""

    def __init__(self, client, stack, rng):
        self._client, self._stack, self._rng = client, stack, rng
        self.smooth, self.vehicles, self.simulated = (rng.random() < p for p in (0.7, 0.5, 0.3))
        self.names = [f'uav{number + 1}' for number in range(rng.choice([2, 2, 3]))]
        self.now, self._rate, self._epoch = 1000.0, 1.0, 0
        self.rows = {name: [] for name in self.names}  # Epoch, time and setpoint.
        self.places, self._push = {}, {}
        self.sources = client.listen(TimeReference, 'plan_time', 100)
        for name in self.names:
            client.node.create_subscription(
                MultiDOFJointTrajectory, f'{name}/setpoint/trajectory',
                lambda message, name=name: self._take(name, message), 1000)
        self._odometry = {name: client.node.create_publisher(Odometry, f'{name}/odom', 10)
                          for name in self.names} if self.vehicles else {}
        self._clock = client.node.create_publisher(Clock, '/clock', 10)
        self._eavesdropper = (200.0, 0.0)
        self.nodes, self.ended = {}, []
        for name in ('planner', 'replay'):
            self.start_node(name)
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def start_node(self, name):
        shared = {'uavs': f'[{", ".join(self.names)}]', 'use_sim_time': self.simulated}
        own = {'vehicle_odometry': self.vehicles} if name == 'replay' else {
            'duration': 130.0, 'slots': 65, 'replan_distance': 8.0, 'replan_deviation': 6.0,
            'replan_lead': 3.0, 'start_delay': self._rng.choice([0.0, 4.0]),
            'pose_timeout': 5.0 if self.vehicles else 0.0,  # After ~/reset nobody sends odometry.
            **(ZONE if self._rng.random() < 0.5 else {})}
        if name == 'planner' and self.smooth:
            own |= {f'{uav}__max_acceleration': ACCELERATION for uav in self.names}
        self.nodes[name] = self._stack.enter_context(node_process(name, **shared, **own))
        wait_for(lambda: any('ready' in line for line in self.nodes[name].lines), what=name)

    def _take(self, name, message):
        at, = message.points
        place, velocity = at.transforms[0].translation, at.velocities[0].linear
        stamp = message.header.stamp
        self.rows[name].append((self._epoch, stamp.sec + stamp.nanosec * 1e-9, place.x, place.y,
                                place.z, velocity.x, velocity.y))

    def stamp(self):
        now = self.now if self.simulated else time.time()
        return Time(sec=int(now), nanosec=int(now % 1 * 1e9))

    def _run(self):
        """Let time go on, and the vehicles follow their setpoints."""
        tick, step = 0, 0.05
        while not self._stop.wait(step):
            tick, self.now = tick + 1, self.now + step * self._rate
            if self.simulated:
                self._clock.publish(Clock(clock=self.stamp()))
            for name, publisher in self._odometry.items():
                rows, place = self.rows[name], self.places.get(name)
                goal = np.array(rows[-1][2:5] if rows else START[name])
                if place is None:
                    place = goal
                velocity = (goal - place) / LAG + self._push.get(name, 0.0)
                self.places[name] = place = place + velocity * step
                publisher.publish(messages.odometry(
                    'map', f'{name}/base_link', self.stamp(), tuple(place.tolist()), 0.0,
                    velocity[:2].tolist()))
            if tick % 10 == 0:
                for send, topic, place in (
                        (self._client.send_pose, 'ground_node/pose', (0.0, 0.0)),
                        (self._client.send_estimate, 'eavesdropper/pose', self._eavesdropper)):
                    try:
                        send(topic, *place, stamp=self.stamp(), until_known=False)
                    except AssertionError:
                        return  # The story ends.

    def close(self):
        self._stop.set()
        self._thread.join(10.0)

    # What happens

    def call(self, service):
        """Call a service, if its node lives."""
        if self.nodes[service.partition('/')[0]].poll() is None:
            return self._client.ask(service)

    def new_epoch(self):
        self._epoch += 1

    def act(self):
        action = self._rng.choice([
            'plan', 'plan', 'plan', 'two plans', 'plan and cancel', 'start', 'start', 'start',
            'pause', 'pause', 'reset', 'parameter', 'estimate', 'estimate', 'push', 'kill',
            'clock'])
        getattr(self, action.replace(' ', '_'))()
        return action

    def plan(self):
        self.call('planner/plan')

    def two_plans(self):
        self.call('planner/plan')
        self.call('planner/plan')

    def plan_and_cancel(self):
        self.call('planner/plan')
        time.sleep(self._rng.random() * 0.3)
        self.call('planner/cancel')

    def start(self):
        self.call('replay/start')

    def pause(self):
        self.call('replay/pause')

    def reset(self):
        self.new_epoch()
        answer = self.call('replay/reset')
        wait_for(answer.done)
        time.sleep(0.3)
        self.new_epoch()

    def parameter(self):
        self._client.set_parameters('planner', duration=self._rng.choice([130.0, 150.0]),
                                    start_delay=self._rng.choice([0.0, 2.0, 5.0]))

    def estimate(self):
        self._eavesdropper = (self._rng.uniform(100, 250), self._rng.uniform(-80, 80))

    def push(self):
        name, angle = self._rng.choice(self.names), self._rng.uniform(0, 2 * math.pi)
        self._push[name] = np.array([math.cos(angle), math.sin(angle), 0.0]) * 60.0
        time.sleep(2.0)
        self._push.clear()

    def kill(self):
        name = self._rng.choice([*self.nodes])
        process = self.nodes[name]
        process.send_signal(self._rng.choice([2, 9]))
        process.wait(10.0)
        self.ended.append(process)
        self.new_epoch()
        self.start_node(name)

    def clock(self):
        """Stop the clock for a while, or let it jump; a real one is left alone."""
        if self.simulated:
            self._rate = 0.0
            time.sleep(1.0)
            self.now += self._rng.choice([0.0, 3.0, -3.0])
            self._rate = 1.0

    # What must hold

    def fly(self):
        """Ask for a plan until there is one, and start it until the replay says what it does."""
        answers = []

        def answered():
            if not answers or answers[-1].done() and not answers[-1].result().success:
                answers.append(self.call('planner/plan'))
                time.sleep(1.0)
            return answers[-1].done() and answers[-1].result().success
        wait_for(answered, what='a plan')
        identity = values_of(self._client.status_of('planner')[-1])['plan.identity']
        said = []

        def known():
            if not said or said[-1].done():
                said.append(self.call('replay/start'))
                time.sleep(0.5)
            text = ' '.join([*self.nodes['replay'].lines, *self.nodes['planner'].lines])
            return self.sources and read_plan_time(self.sources[-1])[0] == identity or (
                f'plan {identity} is not flown' in text or 'not played' in text)
        wait_for(known, what=f'a word on plan {identity}')

    def jumps(self):
        """Yield every step of a setpoint beyond the limits, in words."""
        for name, rows in self.rows.items():
            for before, after in zip(rows, rows[1:]):
                if before[0] != after[0]:
                    continue
                step = max(0.0, after[1] - before[1])
                jump = math.dist(before[2:5], after[2:5]) - SPEED * step
                change = math.dist(before[5:], after[5:]) - ACCELERATION * step
                if jump > ALLOWANCE or self.smooth and change > VELOCITY_ALLOWANCE:
                    yield f'{name} at {after[1]:.3f} s: {jump:.3f} m, {change:.3f} m/s'


@pytest.mark.soak
def test_in_random_stories_no_setpoint_jumps_and_no_plan_is_lost_without_a_word():
    first, actions, setpoints = int(os.environ.get('STORY', 0)), Counter(), 0
    for seed in range(first, first + int(os.environ.get('STORIES', 6))):
        rng = Random(seed)
        with Client() as client, ExitStack() as stack:
            story = Story(client, stack, rng)
            try:
                story.fly()
                said = []
                for _ in range(ACTIONS):
                    said.append(story.act())
                    time.sleep(rng.uniform(0.1, 3.0))
                story.reset()
                story.fly()
                time.sleep(3.0)
            finally:
                story.close()
            actions.update(said)
            assert all(story.rows.values()), (seed, said)
            setpoints += sum(map(len, story.rows.values()))
            jumps = [*story.jumps()]
        processes = [*story.nodes.values(), *story.ended]
        text = ''.join(map(output_of, processes))
        assert not jumps, (seed, said, jumps[:5], text)
        assert 'Traceback' not in text and 'a callback failed' not in text, (seed, said, text)
    print(f'\n{sum(actions.values())} actions {dict(actions)}, {setpoints} setpoints')
