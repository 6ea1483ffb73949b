"""
Random stories of a mission over DDS: whatever is asked for, no setpoint jumps.

Planner, replay and relay are processes of their own; vehicles follow what is relayed with a lag.
In a story somebody asks for plans (also twice at once), cancels, starts (also late), pauses,
resets, changes parameters, pushes a vehicle, kills a node, or stops the clock and makes it jump;
receivers drive, turn, vanish and lie. Set STORIES to the number of stories, and STORY to the first
seed.
"""

from collections import Counter
from contextlib import ExitStack
import math
import os
from random import Random
import threading
import time

from diagnostic_msgs.msg import DiagnosticStatus
from nav_msgs.msg import Odometry
import numpy as np
import pytest
from ros_client import Client, seconds, stamp_at
from ros_nodes import node_process, wait_for, wait_for_line
from rosgraph_msgs.msg import Clock
from secure_uav_planner.ros import messages
from secure_uav_planner.ros.messages import read_plan_time
from sensor_msgs.msg import TimeReference
from simulation import ACCELERATION, ALLOWANCE, explain_jump, Receiver, Setpoints, SPEED

ACTIONS = 12  # In a story.
LAG = 0.4  # s, of the vehicles
TIMEOUT, MAX_JUMP, START_TOLERANCE = 1.0, 1.0, 5.0  # The relay's defaults, in s and m.
DEADLINE = 60.0  # s for the answer of a service
START = {'uav1': (100.0, 500.0, 100.0), 'uav2': (100.0, 500.0, 110.0),
         'uav3': (100.0, 500.0, 110.0)}  # The planner's defaults, in m.
ZONE = {'no_fly_zones': '[mast]', 'mast__vertices': '[20.0, 240.0, 40.0, 240.0, 30.0, 260.0]'}


class Story:
    """The nodes of one story, and all setpoints that they send."""

    def __init__(self, client, stack, rng, target):
        self._client, self._stack, self._rng = client, stack, rng
        self.smooth, self.vehicles, self.simulated = (rng.random() < p for p in (0.7, 0.6, 0.3))
        self.names = [f'uav{number + 1}' for number in range(rng.choice([2, 2, 3]))]
        self.now, self._rate, self._relayed_epoch = 1000.0, 1.0, 0
        self._setpoints = Setpoints(client, self.names)
        self.rows = self._setpoints.rows
        # As well, with the time since which it stands, its arrival, and how far the vehicle is.
        self.relayed = {name: [] for name in self.names}
        self._checked, self._backs, self._calls = Counter(), Counter(), []
        self.places, self._push = {name: [] for name in self.names}, {}
        self.sources = client.listen(TimeReference, 'plan_time', 100)
        self._statuses = client.statuses
        for name in self.names:
            client.node.create_subscription(
                target, f'{name}/mavros/setpoint_raw/local',
                lambda message, name=name: self._take_relayed(name, message), 1000)
        publisher = client.node.create_publisher
        self._odometry = {name: publisher(Odometry, f'{name}/mavros/local_position/odom', 10)
                          for name in self.names} if self.vehicles else {}
        self._clock = publisher(Clock, '/clock', 10)
        self._receivers = [Receiver(client, name, place) for name, place in (
            ('ground_node', (0.0, 0.0)), ('eavesdropper', (200.0, 0.0)))]
        self.nodes, self.ended = {}, []
        for name in ('planner', 'relay', 'replay'):
            self.start_node(name)
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def start_node(self, name):
        shared = {'uavs': f'[{", ".join(self.names)}]', 'use_sim_time': self.simulated}
        accelerations = {f'{uav}__max_acceleration': ACCELERATION for uav in self.names
                         } if self.smooth else {}
        own = {'replay': {'vehicle_odometry': self.vehicles}, 'relay': {
            'stack': 'mavros', 'publish_odometry': self.vehicles, **accelerations,
            'start_tolerance': START_TOLERANCE if self.vehicles else 0.0}, 'planner': {
            'duration': 130.0, 'slots': 65, 'replan_deviation': 6.0, 'replan_lead': 3.0,
            'replan_distance': self._rng.choice([0.0, 8.0]),
            'replan_period': self._rng.choice([0.0, 5.0]), 'time_limit': 20.0,
            'start_delay': self._rng.choice([0.0, 4.0]),
            'pose_timeout': 5.0 if self.vehicles else 0.0,  # After ~/reset nobody sends odometry.
            **(ZONE if self._rng.random() < 0.5 else {}), **accelerations}}[name]
        self.nodes[name] = self._stack.enter_context(node_process(name, **shared, **own))
        wait_for_line(self.nodes[name], 'ready')

    def _take_relayed(self, name, message):
        at, velocity, acceleration = (
            message.position, message.velocity, message.acceleration_or_force)
        stamp, place = seconds(message.header.stamp), (at.x, at.y, at.z)
        last = self.relayed[name][-1:]
        stands = last and (last[0][0], last[0][3:6], velocity.x, velocity.y) == (
            self._relayed_epoch, place, 0.0, 0.0)
        self.relayed[name].append((
            self._relayed_epoch, stamp, last[0][2] if stands else stamp, *place, velocity.x,
            velocity.y, acceleration.x, acceleration.y, time.monotonic(),
            min((math.dist(place, was) for was in self.places[name][-40:]), default=math.inf)))

    def _run(self):
        """Let time go on, and the vehicles follow their setpoints."""
        tick, step = 0, 0.05
        while not self._stop.wait(step):
            tick, self.now = tick + 1, self.now + step * self._rate
            now = self.now if self.simulated else time.time()
            stamp = stamp_at(now)
            if self.simulated:
                self._clock.publish(Clock(clock=stamp))
            for name, publisher in self._odometry.items():
                # A pilot flies a vehicle to the stream that is not relayed to it.
                rows = self.relayed[name]
                if not rows or abs(now - rows[-1][1]) > 2 * TIMEOUT:
                    rows = self.rows[name]
                goal = np.array(rows[-1][2:5] if rows else START[name])
                place = self.places[name][-1] if self.places[name] else goal
                velocity = (goal - place) / LAG
                velocity *= min(1.0, 2.5 * SPEED / max(1e-9, np.linalg.norm(velocity)))
                velocity += self._push.get(name, 0.0)
                self.places[name].append(place := place + velocity * step)
                publisher.publish(messages.odometry(
                    'map', f'{name}/base_link', stamp, tuple(place.tolist()), 0.0,
                    velocity[:2].tolist()))
            if tick % 5 == 0:
                for receiver in self._receivers:
                    receiver.go_on(stamp, 5 * step * self._rate)

    def close(self):
        self._stop.set()
        self._thread.join(10.0)

    # What happens

    def call(self, service):
        """Call a service, and expect an answer in time."""
        node, answer = service.partition('/')[0], self._client.ask(service)
        self._calls.append((service, self.nodes[node], time.monotonic(), answer))
        return answer

    def act(self):
        action = self._rng.choice([
            'planner/plan', 'planner/plan', 'planner/plan', 'two plans', 'plan and cancel',
            'replay/start', 'replay/start', 'replay/start', 'late start', 'replay/pause',
            'replay/pause', 'reset', 'parameter', 'speed', 'receiver', 'receiver', 'receiver',
            'push', 'kill', 'kill', 'clock'])
        if '/' in action:
            self.call(action)
        else:
            getattr(self, action.replace(' ', '_'))()
        return action

    def two_plans(self):
        self.call('planner/plan')
        self.call('planner/plan')

    def plan_and_cancel(self):
        self.call('planner/plan')
        time.sleep(self._rng.random() * 0.3)
        self.call('planner/cancel')

    def late_start(self):
        time.sleep(self._rng.uniform(3.0, 12.0))
        self.call('replay/start')

    def reset(self):
        self._setpoints.epoch += 1
        answer = self.call('replay/reset')
        wait_for(answer.done)
        time.sleep(0.3)
        self._setpoints.epoch += 1

    def parameter(self):
        self._client.set_parameters('planner', duration=self._rng.choice([130.0, 150.0]),
                                    start_delay=self._rng.choice([0.0, 2.0, 5.0]))

    def speed(self):
        self._client.set_parameters('replay', speed=self._rng.choice([0.5, 0.8, 1.0]))

    def receiver(self):
        rng = self._rng
        rng.choice(self._receivers).drive(
            rng.choice([0.0, 4.0, 12.0]), rng.uniform(-3.2, 3.2), rng.choice([0.0, 0.0, 0.3]),
            rng.choice(Receiver.lies))

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
        if name == 'relay':
            self._relayed_epoch += 1
        else:
            self._setpoints.epoch += 1
        self.start_node(name)

    def clock(self):
        """Stop the clock for a while, or let it jump; a real one is left alone."""
        if self.simulated:
            self._rate = 0.0
            time.sleep(1.0)
            change = self._rng.choice([0.0, 3.0, -3.0])
            self._backs['the clock'] += change < 0.0
            self.now += change
            self._rate = 1.0

    # What must hold

    def fly(self):
        """Ask for a plan until there is one, and start it until the replay says what it does."""
        for receiver in self._receivers:
            receiver.drive()
        answers = []

        def answered():
            if not answers or answers[-1].done() and not answers[-1].result().success:
                answers.append(self.call('planner/plan'))
                time.sleep(1.0)
            return answers[-1].done() and answers[-1].result().success
        wait_for(answered, what='a plan')
        identity = wait_for(lambda: self._statuses[-1].plan.identity, what='it')
        said = []

        def known():
            if not said or said[-1].done():
                said.append(self.call('replay/start'))
                time.sleep(0.5)
            text = ' '.join([*self.nodes['replay'].lines, *self.nodes['planner'].lines])
            return self.sources and read_plan_time(self.sources[-1])[0] == identity or (
                f'plan {identity} is not flown' in text or 'not played' in text)
        wait_for(known, what=f'a word on plan {identity}')

    def findings(self):
        """Yield what must not be, in words, since the last time."""
        for lists, problems in ((self.rows, self._jumps), (self.relayed, self._guards)):
            for name, rows in lists.items():
                for before, after in self._new(rows):
                    yield from problems(name, before, after)
                    if before[0] == after[0] and after[1] < before[1]:
                        self._backs[id(rows)] += 1
                        if self._backs[id(rows)] > self._backs['the clock']:
                            yield f'stamps for {name} go back: {before}, {after}'
        for _, status in self._new(self._statuses):
            plan, track, until = status.plan, status.track, status.plan.promised_until
            if status.level == DiagnosticStatus.OK and until is not None and (
                    track.plan == plan.identity and 'ended' not in track.state
                    and until < track.time - 0.1):
                yield f'level OK, and the promise has ended: {status}'
        now = time.monotonic()
        self._calls = [call for call in self._calls
                       if not call[-1].done() and call[1].poll() is None]
        yield from (f'no answer of {call[0]}' for call in self._calls if now - call[2] > DEADLINE)
        for process in (*self.nodes.values(), *self.ended):
            if process.poll() not in (None, 0, -9):
                yield f'{process.name} has ended with {process.poll()}'
            yield from (f'{process.name}: {line}' for line in list(process.lines)
                        if 'Traceback' in line or 'a callback failed' in line)

    def _new(self, items):
        """Yield pairs of the items of a list that grows, since the last time."""
        first, count = self._checked[id(items)], len(items)
        self._checked[id(items)] = max(0, count - 1)
        yield from zip(items[first:count], items[first + 1:count])

    def _jumps(self, name, before, after):
        jump = explain_jump(before, after, self.smooth)
        if jump:
            yield f'{name} {jump}'

    def _guards(self, name, before, after):
        """Yield why the relay had to refuse a setpoint that it has passed on."""
        gap, distance = after[10] - before[10], math.dist(before[3:6], after[3:6])
        is_new = before[0] != after[0] or gap > TIMEOUT
        most = MAX_JUMP + SPEED * min(max(0.0, after[1] - before[2]), TIMEOUT) + ALLOWANCE
        # A simulated clock may have stood for longer than the stream seems to have rested.
        if distance > ALLOWANCE and after[-1] > START_TOLERANCE + 1.0 and (
                self.vehicles if is_new else distance > most):
            yield f'relayed to {name}: {before}, {after}'
        if math.hypot(*after[6:8]) > SPEED + MAX_JUMP / 0.25 + ALLOWANCE or self.smooth and (
                math.hypot(*after[8:10]) > ACCELERATION + ALLOWANCE):
            yield f'too fast for {name}: {after}'


@pytest.mark.soak
def test_in_random_stories_no_setpoint_jumps_and_no_plan_is_lost_without_a_word(packages):
    first, actions, setpoints = int(os.environ.get('STORY', 0)), Counter(), Counter()
    target = packages('mavros_msgs', 'PositionTarget')
    for seed in range(first, first + int(os.environ.get('STORIES', 6))):
        rng, said = Random(seed), []
        with Client() as client, ExitStack() as stack:
            story = Story(client, stack, rng, target)

            def check():
                found = [*story.findings()]
                assert not found, f'story {seed}, {said}: {found[:5]}'
            try:
                story.fly()
                for _ in range(ACTIONS):
                    said.append(story.act())
                    time.sleep(rng.uniform(0.1, 3.0))
                    check()
                story.reset()
                story.fly()
                time.sleep(3.0)
            finally:
                story.close()
            actions.update(said)
            assert all(story.rows.values()), (seed, said)
            setpoints.update(sent=sum(map(len, story.rows.values())),
                             relayed=sum(map(len, story.relayed.values())))
        check()  # The ends of the nodes, too.
        print(f'story {seed}: {sum(actions.values())} actions {dict(actions)}, {dict(setpoints)}')
