"""Receivers that move, in the planner: odometry, the largest speed, the horizon, and replans."""

import math
import re
import time

from geometry_msgs.msg import PoseWithCovarianceStamped
from nav_msgs.msg import Odometry
import numpy as np
import pytest
from rclpy.serialization import deserialize_message
from ros_client import (
    DEFAULTS, node_here, node_process, odometry_message, PATIENCE, stamp_at, wait_for)
from secure_uav_planner import Plan, Scenario, solve
from secure_uav_planner.errors import PoseError
from secure_uav_planner.model import channel
from secure_uav_planner.ros.messages import markers
from secure_uav_planner.ros.poses import PoseBook
from secure_uav_planner.ros.recording import record
from simulation import Simulation
from test_tracks import drive

NOISE = 5.0  # m along each axis, of measurements
PERIOD = 0.5  # s apart.


def send_odometry(client, *values, **options):
    """Send odometry of the eavesdropper until the planner knows it."""
    publisher, topic = client.publisher(Odometry, 'eavesdropper/odom'), 'eavesdropper/odom'

    def is_known():
        publisher.publish(odometry_message(*values, stamp=client.now(), **options))
        time.sleep(0.1)
        return client.status.get(f'pose_age.{topic}', 'none') != 'none'
    wait_for(is_known, what=topic)


class Filter:
    """A Kalman filter of a receiver that drives straight on: measurements at PERIOD."""

    def __init__(self, first):
        self.state = np.array([first, np.zeros(2)])  # Position and velocity, axes in columns.
        self.covariance = np.diag([NOISE**2, 15.0**2])

    def add(self, measured):
        step = np.array([[1.0, PERIOD], [0.0, 1.0]])
        self.state = step @ self.state
        self.covariance = step @ self.covariance @ step.T
        gain = self.covariance[:, 0] / (self.covariance[0, 0] + NOISE**2)
        self.state = self.state + np.outer(gain, measured - self.state[0])
        self.covariance = self.covariance - np.outer(gain, self.covariance[0])


def test_a_driving_eavesdropper_never_learns_more_than_was_promised(client, tmp_path):
    duration, file, rng = 120.0, tmp_path / 'plan.json', np.random.default_rng(1)
    speed, begin, lead = 10.0, 20.0, 3.0
    plans, publishers = [], []

    def place(now):
        """Return where it is; the flight begins when it has been observed for a while."""
        return np.array([200.0, speed * (now - 1000.0 - begin - duration / 2)])

    filtered, sent = Filter(place(1000.0) + NOISE * rng.standard_normal(2)), [1000.0]

    def observe(now):
        while publishers and (at := sent[-1] + PERIOD) < now:
            filtered.add(place(at) + NOISE * rng.standard_normal(2))
            sent.append(at)
            (x, y), velocity = filtered.state
            variance, velocity_variance = np.diag(filtered.covariance)
            publishers[0].publish(odometry_message(
                x, y, velocity, stamp=stamp_at(at), variance=variance,
                velocity_variance=velocity_variance))
            client.send_pose('ground_node/pose', 0, 0, stamp=stamp_at(at), until_known=False)

    def keep_plan():
        if file.exists():
            plan = Plan.load(file)
            if not plans or plan.identity != plans[-1].identity:
                plans.append(plan)

    with node_process(
            'planner', use_sim_time='true', duration=duration, slots=120, confidence=0.9999,
            replan_period=5.0, replan_lead=lead, plan_file=str(file), objective='guaranteed',
            **{f'{uav}.max_acceleration': 2.0 for uav in ('uav1', 'uav2')}), \
            Simulation(client, observe, speedup=6) as simulation:
        publishers.append(client.publisher(Odometry, 'eavesdropper/odom'))
        wait_for(lambda: simulation.now > 1000.0 + begin, what='the estimate')
        wait_for(lambda: client.call('planner/plan').success)
        client.follow(lambda: simulation.now)

        def has_ended():
            keep_plan()
            return float(client.status.get('track.time', 0.0)) > duration
        wait_for(has_ended, patience=10 * PATIENCE, what='the end of the mission')
        values = client.status

    first, last = plans[0], plans[-1]
    times = first.start_ns * 1e-9 + first.times[1:-1]
    truth = np.array([place(at) for at in times])
    # A slot is flown by the last plan, and promised for by the plan that settled it.
    settled = np.full(len(times), 0)
    for number, (before, after) in enumerate(zip(plans, plans[1:]), start=1):
        changed = np.flatnonzero((before.positions != after.positions).any(axis=(0, 2))[1:-1]
                                 | (before.powers != after.powers).any(axis=0))
        if changed.size:
            settled[changed[0]:] = number
    # Only from the measurement to the horizon is anything promised.
    tracked = [plan.scenario.eavesdroppers[0].track for plan in plans]
    covered = np.array([track[0][0] <= time <= track[-1][0] for track, time in zip(
        (tracked[number] for number in settled), first.times[1:-1])])
    promised = np.where(covered, [plans[number].guaranteed_rates[slot]
                                  for slot, number in enumerate(settled)], 0.0)
    achieved = np.maximum(channel.secrecy_rates(
        last.scenario, last.positions, last.powers, truth), 0.0)
    print(f'promised {promised.mean():.3f}, achieved {achieved.mean():.3f} bit/s/Hz, '
          f'{values["replans"]} replans, {np.count_nonzero(covered)} slots with a promise')
    assert int(values['replans']) >= 5
    assert (achieved >= promised - 1e-9).all()
    assert covered.mean() > 0.5 and promised.mean() > 0
    assert float(values['plan.promised_until']) <= 121.0


def test_odometry_gives_a_track_and_the_status_says_until_when_it_holds(client, tmp_path):
    file = tmp_path / 'plan.json'
    with node_here('planner', duration=120.0, slots=60, plan_file=str(file),
                   prediction_horizon=30.0):
        client.send_pose('ground_node/pose', 0, 0)
        send_odometry(client, 200, -100, (0.0, 3.0), variance=4.0, velocity_variance=0.04)
        assert client.call('planner/plan').success
        wait_for(file.exists)
        wait_for(lambda: 'plan.promised_until' in client.status)
    (t0, x0, y0, r0), (t1, x1, y1, r1) = Plan.load(file).scenario.eavesdroppers[0].track
    scale = math.sqrt(-2 * math.log(0.05))
    assert (x0, y0, x1) == (200.0, -100.0, 200.0)
    assert (y1 - y0) / (t1 - t0) == pytest.approx(3.0)
    assert r0 == pytest.approx(2 * scale) and (r1 - r0) / (t1 - t0) == pytest.approx(0.2 * scale)
    # On a busy machine the odometry is older than the plan.
    assert t0 <= 0 and 30.0 - t1 == pytest.approx(0.0, abs=9.0)
    # The status has six digits.
    assert float(client.status['plan.promised_until']) == pytest.approx(t1, rel=1e-5)


def test_a_largest_speed_lets_the_disc_of_a_pose_grow(client, tmp_path):
    file = tmp_path / 'plan.json'
    with node_here('planner', duration=120.0, slots=60, plan_file=str(file),
                   **{'eavesdropper.max_speed': 0.5}):
        client.send_pose('ground_node/pose', 0, 0)
        client.send_estimate('eavesdropper/pose', 200, 0)
        assert client.call('planner/plan').success
        wait_for(file.exists)
        (t0, x0, y0, r0), (t1, x1, y1, r1) = Plan.load(file).scenario.eavesdroppers[0].track
    assert (x0, y0) == (x1, y1) == (200.0, 0.0) and r0 == 10.0
    assert r1 - r0 == pytest.approx(0.5 * (t1 - t0)) and t1 > 120.0


def test_an_eavesdropper_that_turns_leaves_its_disc_and_is_planned_for_again(client):
    with node_here('planner', duration=120.0, slots=60, replan_period=1000.0, replan_lead=3.0,
                   prediction_horizon=200.0):
        client.send_pose('ground_node/pose', 0, 0)
        send_odometry(client, 200, -100, (0.0, 3.0), variance=1.0)
        assert client.call('planner/plan').success
        client.follow()
        wait_for(lambda: client.status.get('track.state') == 'flying')
        assert client.status['replans'] == '0'
        send_odometry(client, 230, -100, (3.0, 0.0), variance=1.0)
        wait_for(lambda: client.status['replans'] != '0', what='a replan')


@pytest.mark.parametrize('fields, reason', [
    ({'velocity': (0.0, 2000.0)}, 'twist.linear is 2000 m/s; it must be at most 1000 m/s'),
    ({'velocity': (0.0, math.nan)}, 'twist.linear.y is nan'),
    ({'velocity_variance': math.inf}, 'the covariance of the velocity is [[inf, 0.0]')])
def test_bad_odometry_of_a_receiver_is_refused_and_the_last_estimate_stands(fields, reason):
    book = PoseBook()
    good, wrong = (odometry_message(x, 0, stamp=stamp_at(100.0), **options)
                   for x, options in ((200, {}), (100, fields)))
    book.take('eavesdropper/odom', good, DEFAULTS, 100.0)
    with pytest.raises(PoseError, match=re.escape(reason)):
        book.take('eavesdropper/odom', wrong, DEFAULTS, 100.0)
    assert book.usable_pose('eavesdropper', DEFAULTS, 100.0).position == (200.0, 0.0)


def test_recordings_move_the_receivers_and_markers_show_their_ways(tmp_path):
    reader = pytest.importorskip('mcap.reader')
    scenario = drive(Scenario.paper(120, slots=30))
    plan = solve(scenario, objective='guaranteed')
    ways = [marker for marker in markers(plan, 'map').markers if marker.ns == 'track']
    assert [(way.points[0].y, way.points[-1].y) for way in ways] == [(-300.0, 300.0)]
    record(plan, tmp_path / 'plan.mcap')
    with (tmp_path / 'plan.mcap').open('rb') as file:
        places = [(message.log_time, deserialize_message(
            message.data, PoseWithCovarianceStamped).pose.pose.position.y)
            for _, channel, message in reader.make_reader(file).iter_messages()
            if channel.topic == '/eavesdropper/pose']
    assert len(places) == 32
    assert places[15][1] == pytest.approx(0.0) and places[-1][1] == 300.0
