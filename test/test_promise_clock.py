"""Promises about receivers that move end in time: late flights, horizons, files, and replans."""

from contextlib import contextmanager
from dataclasses import replace
import re

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from nav_msgs.msg import Odometry
import numpy as np
import pytest
from ros_client import node_here, odometry_message, values_of, wait_for
from secure_uav_planner import Eavesdropper, Plan, Scenario
from simulation import Simulation

SPEED = 12.0  # m/s, of the car towards +y


def car_at(now):
    """Return the place of the car at a time of the clock in s."""
    return 200.0, SPEED * (now - 1060.0)


@contextmanager
def planned(client, tmp_path, **parameters):
    """Run a planner in simulated time beside a car that sends odometry, and ask for a plan."""
    parameters = {'duration': 120.0, 'slots': 120, 'start_delay': 8.0, 'replan_lead': 3.0,
                  'objective': 'guaranteed', **parameters}
    publishers, sent = [], [0.0]

    def send(now):
        if publishers and now >= sent[0] + 0.5:
            sent[0] = now
            stamp = simulation.stamp()
            publishers[0].publish(odometry_message(
                *car_at(now), (0.0, SPEED), stamp=stamp, variance=4.0, velocity_variance=0.01))
            client.send_pose('ground_node/pose', 0, 0, stamp=stamp, until_known=False)

    with node_here('planner', use_sim_time=True, plan_file=str(tmp_path / 'plan.json'),
                   **parameters) as planner:
        simulation = Simulation(client, send, 6)
        with simulation:
            publishers.append(client.publisher(Odometry, 'eavesdropper/odom'))
            status = client.statuses
            clocks = client.listen(DiagnosticArray, '/diagnostics', 10)
            wait_for(lambda: clocks and clocks[-1].header.stamp.sec >= 1000, what='the clock')
            wait_for(lambda: all(
                client.status.get(f'pose_age.{topic}', 'none') != 'none'
                for topic in ('eavesdropper/odom', 'ground_node/pose')), what='the receivers')
            answer = client.call('planner/plan')
            assert answer.success, answer.message
            yield planner, simulation, status, answer.message


def promise_of(status):
    """Return the end of the promise in s, and what the status says if it has ended."""
    ended = re.search(r'the promise[^;]*', status.message)
    return float(values_of(status)['plan.promised_until']), ended and ended.group()


def test_a_late_flight_has_left_its_promise_until_it_is_planned_again(client, tmp_path):
    with planned(client, tmp_path) as (_, simulation, status, _):
        assert promise_of(status[-1])[0] == pytest.approx(121.0)
        client.follow(lambda: simulation.now, late=15.0)
        wait_for(lambda: promise_of(status[-1])[1], what='the end of the promise')
        until, text = promise_of(status[-1])
        assert status[-1].level == DiagnosticStatus.WARN and until < 1.0
        assert 'later than the receivers that move are predicted for' in text
        wait_for(lambda: float(values_of(status[-1]).get('track.time', 0)) > 5.0)
        assert 'the flight is 15.0 s later' in promise_of(status[-1])[1]
        assert client.set_parameters('planner', replan_distance=900.0)[0].successful
        wait_for(lambda: promise_of(status[-1])[1] is None, what='a new promise')

        # It is about the car where that is when the flight comes there.
        def find_saved():
            plan, values = Plan.load(tmp_path / 'plan.json'), values_of(status[-1])
            return plan.identity == values['plan.identity'] and (plan, values)
        plan, values = wait_for(find_saved, what='the plan of the status in the file')
        until, time = float(values['plan.promised_until']), float(values['track.time'])
        ahead = np.arange(np.ceil(time) + 1.0, until)  # Points of slots.
        _, (centres,), (radii,) = plan.scenario.receivers_at(ahead)
        truth = np.array([car_at(plan.start_ns * 1e-9 + 15.0 + at) for at in ahead])
        assert len(ahead) and (np.linalg.norm(centres - truth, axis=1) <= radii).all()
        # What was flown before keeps the discs that it was planned for.
        _, (centres,), _ = plan.scenario.receivers_at([1.0])
        assert centres[0] == pytest.approx(car_at(plan.start_ns * 1e-9 + 1.0), abs=0.5 * SPEED)


def test_a_horizon_that_has_passed_is_a_warning_and_a_replan_comes_before(client, tmp_path):
    with planned(client, tmp_path, prediction_horizon=10.0) as (_, simulation, status, answer):
        # The rate that is told is the mean of what is promised.
        wait_for((tmp_path / 'plan.json').exists)
        plan = Plan.load(tmp_path / 'plan.json')
        until = plan.promised_until
        assert until == pytest.approx(10.0, abs=0.2)
        assert promise_of(status[-1])[0] == pytest.approx(until, rel=1e-5)  # Six digits.
        promised = plan.guaranteed_rates[:int(until + 1e-6)].mean()
        assert f'guaranteed rate {promised:.4f}' in answer and f'until {until:.1f} s' in answer
        assert float(values_of(status[-1])['plan.guaranteed_rate']) == pytest.approx(
            promised, abs=1e-4)
        client.follow(lambda: simulation.now)
        wait_for(lambda: promise_of(status[-1])[1], what='the end of the promise')
        assert f'ended at {until:.1f} s' in promise_of(status[-1])[1]
        assert status[-1].level == DiagnosticStatus.WARN
        assert client.set_parameters(
            'planner', prediction_horizon=0.0, replan_distance=900.0)[0].successful
        wait_for(lambda: promise_of(status[-1])[1] is None, what='a new promise')
        status.clear()
        replans = int(values_of(wait_for(lambda: status and status[-1]))['replans'])
        wait_for(lambda: int(values_of(status[-1])['replans']) >= replans + 5)
        assert not [message.message for message in status if promise_of(message)[1]]


def test_a_plan_without_a_delay_counts_with_the_receivers_at_its_start(client, tmp_path):
    with planned(client, tmp_path, start_delay=0.0) as (_, simulation, status, _):
        client.follow(lambda: simulation.now)
        wait_for(lambda: float(values_of(status[-1]).get('track.time', 0)) > 5.0)
        assert promise_of(status[-1])[1] is None
        plan = Plan.load(tmp_path / 'plan.json')
        _, (centres,), (radii,) = plan.scenario.receivers_at([5.0])
        assert np.linalg.norm(centres[0] - car_at(plan.start_ns * 1e-9 + 5.0)) < radii[0]


def test_an_endless_horizon_ends_with_the_flight(client, tmp_path):
    with planned(client, tmp_path, prediction_horizon=3600.0) as (_, _, status, _):
        assert promise_of(status[-1])[0] == pytest.approx(121.0)


def test_odometry_beyond_the_largest_speed_counts_and_is_told(client, tmp_path):
    parameters = {'eavesdropper.max_speed': 5.0}
    with planned(client, tmp_path, **parameters) as (planner, _, _, _):
        wait_for((tmp_path / 'plan.json').exists)
        (t0, *_, r0), (t1, *_, r1) = Plan.load(
            tmp_path / 'plan.json').scenario.eavesdroppers[0].track
        assert (r1 - r0) / (t1 - t0) >= SPEED
        assert any('eavesdropper.max_speed is 5 m/s' in line for line in planner.lines)


def test_tracks_of_a_mission_file_count_until_an_estimate_comes(client, tmp_path):
    mission, file = tmp_path / 'mission.yaml', tmp_path / 'plan.json'
    track = ((0.0, 200.0, -300.0, 5.0), (120.0, 200.0, 300.0, 5.0))
    scenario = replace(Scenario.paper(120.0, slots=40), eavesdroppers=(
        Eavesdropper(track[0][1:3], 5.0, 'car', track=track),))
    scenario.save(mission)
    with node_here('planner', mission_file=str(mission), plan_file=str(file)) as planner:
        client.send_pose('ground_node/pose', 0, 0)
        assert client.call('planner/plan').success
        wait_for(file.exists)
        plan = Plan.load(file)
        assert plan.scenario.eavesdroppers[0].track == track and plan.promised_until is None
        assert any('car moves on its track in the mission file' in line for line in planner.lines)
        client.send_estimate('car/pose', 200, 50)
        assert client.call('planner/plan').success
        wait_for(lambda: Plan.load(file).identity != plan.identity)
        assert Plan.load(file).scenario.eavesdroppers[0].position == (200.0, 50.0)
        assert any('the estimate of car counts' in line for line in planner.lines)
