"""
Flights over DDS past a car that really moves: which slots were promised, and were they kept.

Planner and replay are processes of their own, by a simulated clock. A slot counts as promised if
the plan that the replay flew at its point promises it, for the receivers of that time. It is
broken if the car then learns more than the plan guarantees. An unpromised slot is told if the
replay or the planner's status says so.
"""

from contextlib import ExitStack
import math
import re
import time
from typing import NamedTuple

from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import PoseStamped
from nav_msgs.msg import Odometry
import numpy as np
import pytest
from ros_client import odometry_message, seconds, stamp_at
from ros_nodes import node_process, wait_for, wait_for_line
from secure_uav_planner import Plan
from secure_uav_planner.model import channel
from secure_uav_planner.plan.file import parse_text
from secure_uav_planner.plan.flight import Flight
from secure_uav_planner.plan.playback import Playback
from secure_uav_planner.plan.tracking import PUNCTUAL
from secure_uav_planner.ros.messages import read_plan_time
from sensor_msgs.msg import TimeReference
from simulation import DEEP, Simulation
from std_msgs.msg import String
from test_tracks_node import Filter

SLOTS = 110  # Of 1 s.
NOISE = 5.0, 1.0  # m along each axis, of positions that are filtered, and that are not.
TOLD_S = 2.0  # Real time in which the status tells of a slot.
SPEEDUP = 4.0
SAYS_UNPROMISED = re.compile(r'the promise (of plan|ended)|no slot is promised')


class Case(NamedTuple):
    """
    A flight and what happens in it.

    :param way: of the car, 'straight' or 'turn'.
    :param period: between two measurements in s.
    :param events: method of the Story and time in s by the clock, from point 0.
    :param settings: of the planner.
    """

    way: str = 'straight'
    is_filtered: bool = False
    period: float = 0.5
    events: tuple = ()
    settings: dict = {}


CASES = {
    'Kalman filter': Case(is_filtered=True),
    'raw odometry': Case(settings={'replan_period': 0.0, 'replan_distance': 15.0}),
    'full turn': Case('turn', settings={'eavesdropper__max_speed': 9.0}),
    'late start': Case(events=(('start', 6.0),)),
    'pauses': Case(events=(('pause', 20.0), ('start', 27.0), ('pause', 60.0), ('start', 63.0))),
    'poses at 0.2 Hz': Case(period=5.0),
    'planner killed twice': Case(events=(('kill_planner', 25.0), ('kill_planner', 60.0))),
    'planner killed in a gap': Case(events=(('pause', 20.0), ('start', 25.0),
                                            ('kill_planner', 26.0))),
    'replay killed': Case(events=(('kill_replay', 30.0), ('start', 34.0))),
    'clock jumps ahead': Case(events=(('jump_ahead', 30.0), ('jump_ahead', 70.0))),
    'clock jumps back': Case(events=(('jump_back', 30.0), ('jump_back', 70.0)))}


class Record(NamedTuple):
    """A report on plan_time, with the time of the car in s, and whether slots are told."""

    clock: float
    car: float
    plan: str
    time_ns: int
    arrival: float
    is_told: bool


class FlownCase:
    """The nodes of a Case, the car, and what was heard."""

    def __init__(self, client, stack, case, file):
        self._client, self._stack, self._case, self._file = client, stack, case, file
        self.plans, self.records, self.statuses = [], [], []  # Plans with their arrival.
        self._shifts = [0.0]  # By which the clock has jumped in all, in s, after each jump.
        self._rng, self._lines = np.random.default_rng(1), 0
        self._is_unpromised, self._filter, self._sent = False, None, 0.0
        node = client.node
        node.create_subscription(String, 'plan', self._take_plan, DEEP)
        node.create_subscription(TimeReference, 'plan_time', self._take_time, 1000)
        node.create_subscription(DiagnosticStatus, 'planner/status', lambda status: (
            self.statuses.append((time.monotonic(), status.message))), 1000)
        for name in ('uav1', 'uav2'):  # The replay waits for somebody who flies.
            client.listen(PoseStamped, f'{name}/setpoint/pose', 10)
        self.nodes = {}
        self._start('planner')
        self._start('replay')

    def _start(self, name):
        own = {'duration': float(SLOTS), 'slots': SLOTS, 'start_delay': 4.0, 'replan_lead': 2.0,
               'replan_period': 5.0, 'objective': 'guaranteed', 'confidence': 0.9999,
               'plan_file': self._file, 'uav1__max_acceleration': 2.0,
               'uav2__max_acceleration': 2.0, **self._case.settings}
        self.nodes[name] = self._stack.enter_context(node_process(
            name, use_sim_time=True, **own if name == 'planner' else {}))
        self._lines = 0 if name == 'replay' else self._lines

    def car_at(self, now):
        """Return position and velocity of the car at a time of its own in s."""
        if self._case.way == 'turn':
            angle = 8.0 / 60.0 * (now - 1000.0)
            return (np.array([200.0 + 60.0 * math.cos(angle), 60.0 * math.sin(angle)]),
                    8.0 * np.array([-math.sin(angle), math.cos(angle)]))
        return np.array([200.0, 8.0 * (now - 1000.0 - 75.0)]), np.array([0.0, 8.0])

    def observe(self, now):
        """Measure the car, and report."""
        car = now - self._shifts[-1]
        while self._sent + self._case.period <= car:
            self._sent = max(self._sent + self._case.period, car - self._case.period)
            (place, velocity), stamp = self.car_at(self._sent), stamp_at(
                self._sent + self._shifts[-1])
            noise = self._rng.standard_normal((2, 2))
            if self._case.is_filtered:
                measured = place + NOISE[0] * noise[0]
                self._filter = self._filter or Filter(measured)
                self._filter.add(measured)
                place, velocity = self._filter.state
                variances = np.diag(self._filter.covariance)
            else:
                place, velocity = place + NOISE[1] * noise[0], velocity + 0.2 * noise[1]
                variances = NOISE[1]**2, 0.04
            self._odometry.publish(odometry_message(
                *place, velocity, stamp=stamp, variance=variances[0],
                velocity_variance=variances[1]))
            self._client.send_pose('ground_node/pose', 0, 0, stamp=stamp, until_known=False)

    def _take_plan(self, message):
        plan, _ = parse_text(message.data, Plan)
        self.plans.append((time.monotonic(), plan))

    def _take_time(self, message):
        lines = self.nodes['replay'].lines
        for line in lines[self._lines:]:
            self._lines += 1
            if 'is not promised' in line:
                self._is_unpromised = True
            elif 'are promised again' in line:
                self._is_unpromised = False
        clock, (identity, _) = seconds(message.header.stamp), read_plan_time(message)
        at = message.time_ref.sec * 10**9 + message.time_ref.nanosec
        # A report from before a jump may come after it.
        present = self.simulation.now - self._shifts[-1]
        car = min((clock - shift for shift in self._shifts), key=lambda car: abs(car - present))
        self.records.append(Record(
            clock, car, identity, at, time.monotonic(), self._is_unpromised))

    # What happens

    def start(self):
        # A replay that has just been started may not have the plan yet.
        wait_for(lambda: self._client.call('replay/start').success, what='a start')

    def pause(self):
        self._client.call('replay/pause')

    def kill_planner(self):
        self._kill('planner')
        self.simulation.forget_solve()

    def kill_replay(self):
        self._kill('replay')

    def _kill(self, name):
        self.nodes[name].kill()
        self.nodes[name].wait()
        self._start(name)
        wait_for_line(self.nodes[name], 'ready')

    def jump_ahead(self):
        self._jump(3.0)

    def jump_back(self):
        self._jump(-3.0)

    def _jump(self, change):
        self._shifts.append(self._shifts[-1] + change)
        self.simulation.jump(self.simulation.now + change)

    def fly(self):
        """Fly from a plan to its end."""
        client, case = self._client, self._case
        self._odometry = client.publisher(Odometry, 'eavesdropper/odom')
        client.publisher(PoseStamped, 'ground_node/pose')
        self._sent = 1000.0
        with Simulation(client, self.observe, SPEEDUP) as self.simulation:
            wait_for(lambda: self.simulation.now > 1015.0, what='the estimate')
            wait_for(lambda: client.call('planner/plan').success, what='a plan')
            _, first = wait_for(lambda: self.plans and self.plans[0], what='its message')
            origin = first.start_ns * 1e-9
            events = list(case.events)
            if not events or events[0][0] != 'start':
                self.start()
            while not self._has_ended():
                if events and self.simulation.now - self._shifts[-1] >= origin + events[0][1]:
                    getattr(self, events.pop(0)[0])()
                time.sleep(0.01)
            time.sleep(1.0)

    def _has_ended(self):
        last = self.records[-1] if self.records else None
        plan = last and {plan.identity: plan for _, plan in self.plans}.get(last.plan)
        return plan is not None and (
            (last.time_ns - plan.start_ns) * 1e-9 >= Playback(plan).duration - 0.01)

    # What became of the slots

    def count(self):
        """Return counts of the flown slots by what was promised and told of them."""
        known, slots, plans = {}, [], list(self.plans)
        counts = dict.fromkeys(('flown', 'promised', 'broken', 'told', 'untold'), 0)
        for number, (before, after) in enumerate(zip(self.records, self.records[1:])):
            # A plan may come again, with another promise.
            while plans and plans[0][0] <= after.arrival:
                plan = plans.pop(0)[1]
                known[plan.identity] = plan
            plan = known.get(after.plan)
            if plan is None or before.plan not in known:
                continue
            begin, end = ((record.time_ns - plan.start_ns) * 1e-9 for record in (before, after))
            flight = Flight(Playback(plan), end, 1.0)
            if flight.state != 'ended' and plan.promised_until is not None and (
                    abs(flight.lateness(after.clock)) > PUNCTUAL):
                plan = known[after.plan] = plan.end_promise(end)
            if not 0.0 < end - begin < 2.0 or known[before.plan].start_ns != plan.start_ns:
                continue
            for slot in range(max(1, math.floor(begin) + 1), min(SLOTS, math.floor(end)) + 1):
                car = before.car + (slot - begin) / (end - begin) * (after.car - before.car)
                slots.append((slot, plan, car, number))
        promised_last = {}
        for slot, plan, car, number in slots:
            is_promised = bool(plan.promised_slots[slot - 1])
            promised_last[slot] = is_promised
            counts['flown'] += 1
            if is_promised:
                counts['promised'] += 1
                truth = np.tile(self.car_at(car)[0], (SLOTS, 1))
                achieved = channel.secrecy_rates(
                    plan.scenario, plan.positions, plan.powers, truth)[slot - 1]
                counts['broken'] += achieved < plan.guaranteed_rates[slot - 1] - 1e-6
            else:
                # The replay logs it after its report, and while the slot is flown.
                record, slot_ns = self.records[number + 1], plan.start_ns + (slot + 1) * 10**9
                is_told = any(
                    later.is_told for later in self.records[number + 1:]
                    if later.time_ns <= slot_ns or later.arrival < record.arrival + TOLD_S) or any(
                    abs(at - record.arrival) < TOLD_S and SAYS_UNPROMISED.search(text)
                    for at, text in self.statuses)
                counts['told' if is_told else 'untold'] += 1
        final = Plan.load(self._file).promised_slots
        counts['final, not promised'] = [
            slot for slot, is_promised in promised_last.items()
            if final[slot - 1] and not is_promised]
        return counts | {'plans': len(self.plans)}


@pytest.mark.soak
@pytest.mark.parametrize('name', CASES)
def test_what_is_promised_in_flight_is_kept_and_what_is_not_promised_is_told(
        client, tmp_path, name):
    with ExitStack() as stack:
        flown = FlownCase(client, stack, CASES[name], tmp_path / 'plan.json')
        flown.fly()
        counts = flown.count()
    print(f'| {name} | ' + ' | '.join(map(str, counts.values())) + f' | {list(counts)}')
    assert counts['promised'] > SLOTS / 4
    assert not counts['broken'] and not counts['untold'] and not counts['final, not promised']
