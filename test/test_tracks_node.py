"""Receivers that move, in the planner: what it predicts of them, and until when it promises."""

from dataclasses import replace
from itertools import product
import math
import re
from time import sleep

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from geometry_msgs.msg import PoseStamped, PoseWithCovarianceStamped
from hypothesis import given, strategies as st
from nav_msgs.msg import Odometry
import numpy as np
import pytest
from ros_client import odometry_message, pose_message, SETTINGS, settings_with, stamp_at
from ros_nodes import has_said, node_here, node_process, PATIENCE, wait_for
from secure_uav_planner import Eavesdropper, fly_hover_fly, Plan, Scenario
from secure_uav_planner.errors import PoseStaleError
from secure_uav_planner.mission.tracks import interpolate
from secure_uav_planner.model import channel
from secure_uav_planner.plan.flight import Flight
from secure_uav_planner.plan.playback import Playback
from secure_uav_planner.plan.tracking import PlanClock
from secure_uav_planner.ros.planner.poses import error_radius, PoseBook
from secure_uav_planner.ros.planner.receivers import predict_receivers
from secure_uav_planner.ros.planner.replan import Remainder
from secure_uav_planner.ros.planner.request import make_request, StartTime
from secure_uav_planner.ros.planner.solver import Job
from simulation import SimulatedTime, Simulation
from studies.flown.missions import limit_acceleration

NOISE = 5.0  # m along each axis, of measurements
PERIOD = 0.5  # s apart.
CAR_SPEED = 12.0  # m/s towards +y
NOW = 1000.0  # s
RADIUS_PER_DEVIATION = error_radius(np.eye(2), SETTINGS.confidence)


def car_at(now):
    """Return the place of the car at a time of the clock in s."""
    return 200.0, CAR_SPEED * (now - NOW - 60.0)


def car_odometry(now):
    return odometry_message(*car_at(now), (0.0, CAR_SPEED), stamp=stamp_at(now), variance=4.0,
                            velocity_variance=0.04)


def book_with(message, **settings):
    """Return a PoseBook with a message of the eavesdropper, at NOW, and settings."""
    settings, book = settings_with(**settings), PoseBook()
    kind = 'odom' if isinstance(message, Odometry) else 'pose'
    for topic, sent in (('ground_node/pose', pose_message(PoseStamped, 0, 0)),
                        (f'eavesdropper/{kind}', message)):
        book.take(topic, sent, settings, NOW)
    return book, settings


@given(st.floats(0.0, 3.0), st.floats(-20.0, 60.0), st.floats(0.3, 3.0),
       st.sampled_from([(0.0, 0.0), (5.0, 13.0), (15.0, 15.0)]),
       st.sampled_from([({}, math.inf), ({'prediction_horizon': 20.0}, 20.0),
                        ({'replan_period': 20.0, 'replan_lead': 4.0}, 32.0)]),
       st.integers(0, 2**32 - 1))
def test_a_promise_has_the_least_discs_of_receivers_to_its_horizon_and_a_flight_on_time(
        age, time, time_scale, speeds, horizon, seed):
    """
    Check a flight that is flown on at its playback speed, and a receiver as far off as allowed.

    :param age: age of the estimate [s].
    :param speeds: max_speed of the receiver, and the speed at which it may go anywhere [m/s].
    :param horizon: parameters, and the time [s] for which they let a receiver be predicted.
    """
    rng, (max_speed, speed), (parameters, most) = np.random.default_rng(seed), speeds, horizon
    start, velocity = (200.0, -300.0), (-5.0, 12.0)
    book, settings = book_with(odometry_message(
        *start, velocity, stamp=stamp_at(NOW - age), variance=4.0, velocity_variance=0.04), **{
            'duration': 120.0, 'slots': 60, 'eavesdropper.max_speed': max_speed, **parameters})
    clock = PlanClock(time, NOW, time_scale)
    predicted = predict_receivers(settings, book, NOW, clock, 121.0)
    told = [note.partition(';')[0] for note in predicted.notes.values()]
    assert told == ['eavesdropper is faster than eavesdropper.max_speed, which is 5 m/s'] * (
        max_speed == 5.0)
    until = NOW + (predicted.promised_until - time) / time_scale
    assert until - NOW == pytest.approx(min(most, (121.0 - time) / time_scale))
    ages = np.append(rng.uniform(0.0, until - NOW + age, 50), [0.0, until - NOW + age])
    growth = speed + 0.2 * RADIUS_PER_DEVIATION * (max_speed < 13.0)
    direction = rng.normal(size=(52, 2))
    places = start + np.outer(ages, velocity) * (not max_speed) + direction * (
        (2 * RADIUS_PER_DEVIATION + growth * ages) / np.hypot(*direction.T))[:, None]
    times = time + (NOW - age + ages - NOW) * time_scale
    x, y, radius = interpolate(predicted.fields['eavesdroppers'][0].track, times).T
    assert np.hypot(*(places - np.stack([x, y], 1)).T) == pytest.approx(radius)
    plan = replace(fly_hover_fly(Scenario.paper(120.0, slots=60)), start_ns=round(NOW * 1e9))
    flight = Flight(Playback(plan), time, time_scale)
    plan = Remainder(None, flight, NOW, 0, (), None, predicted, settings).date(plan)
    assert plan.promised_until == predicted.promised_until
    playback = Playback(plan)
    for at, early in product(times, (0.0, 1.0)):
        flight = Flight(playback, at + early, time_scale)
        assert flight.lateness(NOW + (at - time) / time_scale) == pytest.approx(
            0.0 if flight.state == 'waiting' else -early, abs=1e-6)


@pytest.mark.parametrize('time_scale', [0.5, 1.0, 2.0])
def test_a_new_plan_is_promised_at_the_playback_speed_of_the_flight_that_it_continues(time_scale):
    moving = odometry_message(200.0, -300.0, (0.0, 5.0), stamp=stamp_at(NOW))
    book, settings = book_with(moving, **{
        'duration': 120.0, 'slots': 60, 'start_delay': 8.0,
        **dict.fromkeys(('uav1.max_acceleration', 'uav2.max_acceleration'), 3.0)})
    flown = fly_hover_fly(limit_acceleration(Scenario.paper(120.0, slots=60), 3.0))
    flight = Flight(Playback(replace(flown, start_ns=round(NOW * 1e9))), 20.0, time_scale)
    start = StartTime.from_settings(settings, round(NOW * 1e9), flight)
    request = make_request(settings, book, start, [None, None], flight)
    plan = Playback(request.date(fly_hover_fly(request.scenario), round(NOW * 1e9)))
    assert plan.begin_ns == start.effect_ns and plan.begin == -1.0
    for since in (0.1, 10.0, 30.0):  # Seconds since the first setpoint.
        flight = Flight(plan, plan.begin + time_scale * since, time_scale)
        assert flight.lateness(start.effect_ns * 1e-9 + since) == pytest.approx(0.0, abs=1e-5)


def test_that_a_receiver_is_faster_than_its_max_speed_is_told_once(client):
    """Before, it was told whenever its estimate went above that speed again."""
    with node_here('planner', duration=120.0, slots=20, method='joint', time_limit=1.0,
                   eavesdropper__max_speed=8.0) as planner:
        client.send_pose('ground_node/pose', 0, 0)
        for speed in (8.2, 7.8, 8.4):
            client.send_odometry('eavesdropper/odom', 200.0, 0.0, (0.0, speed))
            assert client.call('planner/plan').success
    assert sum('faster than eavesdropper.max_speed' in line for line in planner.lines) == 1


def test_a_pose_stands_unless_a_largest_speed_lets_its_disc_grow():
    for speed, track in ((0.0, None),
                         (0.5, ((-8.0, 200.0, 0.0, 10.0), (121.0, 200.0, 0.0, 74.5)))):
        book, settings = book_with(pose_message(PoseWithCovarianceStamped, 200, 0), **{
            'eavesdropper.max_speed': speed})
        predicted = predict_receivers(settings, book, NOW, PlanClock(0.0, NOW + 8.0), 121.0)
        eve, = predicted.fields['eavesdroppers']
        assert (eve.track, predicted.promised_until) == (track, track and 121.0)


def test_a_plan_without_a_delay_is_dated_with_the_receivers_at_its_start():
    book, settings = book_with(car_odometry(NOW), start_delay=0.0, prediction_horizon=60.0)
    start = StartTime.from_settings(settings, round(NOW * 1e9), None)
    request = make_request(settings, book, start, [None, None], None)
    solved = round((NOW + 7.0) * 1e9)
    plan = request.date(fly_hover_fly(request.scenario), solved)
    begin = plan.start_ns * 1e-9
    assert begin > NOW + 7.0
    assert begin + plan.promised_until == pytest.approx(
        request.clock.to_clock(request.receivers.promised_until))
    for time in (0.0, 5.0, 50.0):
        _, (centres,), _ = plan.scenario.receivers_at([time])
        assert centres[0] == pytest.approx(car_at(begin + time), abs=1e-3)


def test_receivers_are_not_predicted_again_from_poses_that_are_too_old_by_then():
    """Before, the answer was that the position of a receiver is None."""
    book, settings = book_with(car_odometry(NOW), prediction_horizon=1.0, pose_timeout=10.0)
    start = StartTime.from_settings(settings, round(NOW * 1e9), None)
    request = make_request(settings, book, start, [None, None], None)
    plan = request.date(fly_hover_fly(request.scenario), round((NOW + 9.0) * 1e9))
    assert request.is_outlasted_by(plan)
    assert request.predict_again(plan, book, round((NOW + 9.0) * 1e9)).solved
    with pytest.raises(PoseStaleError, match='the pose on .*eavesdropper/odom is 11.0 s old'):
        request.predict_again(plan, book, round((NOW + 11.0) * 1e9))


def test_a_track_of_the_mission_file_keeps_the_time_of_a_plan_that_is_dated_later():
    track, book = ((0.0, 200.0, -300.0, 5.0), (120.0, 200.0, 300.0, 5.0)), PoseBook()
    settings = settings_with(start_delay=0.0, tracks={'eavesdropper': track})
    book.take('ground_node/odom', odometry_message(0.0, 0.0, (1.0, 0.0), stamp=stamp_at(NOW)),
              settings, NOW)
    start = StartTime.from_settings(settings, round(NOW * 1e9), None)
    request = make_request(settings, book, start, [None, None], None)
    plan = request.date(fly_hover_fly(request.scenario), round((NOW + 7.0) * 1e9))
    assert plan.scenario.eavesdroppers[0].track == track
    before, after = request.scenario.ground_nodes[0].track, plan.scenario.ground_nodes[0].track
    assert before[0][0] - after[0][0] == pytest.approx(7.0)


def test_a_late_flight_has_left_its_promise_until_it_is_planned_again(client, tmp_path):
    file, status, sent = tmp_path / 'plan.json', client.statuses, [0.0]

    def send(now):
        if now >= sent[0] + 0.5:
            sent[0] = now
            cars.publish(car_odometry(now))
            client.send_pose('ground_node/pose', 0, 0, stamp=stamp_at(now), until_known=False)

    def promise():
        """Return its end in s, and what the status says if it has ended."""
        ended = re.search(r'the promise[^;]*', status[-1].text)
        return status[-1].plan.promised_until, ended and ended.group()

    with node_here('planner', use_sim_time=True, plan_file=file, duration=120.0, slots=120,
                   start_delay=8.0, replan_lead=3.0, objective='guaranteed',
                   prediction_horizon=60.0):
        cars = client.publisher(Odometry, 'eavesdropper/odom')
        clocks = client.listen(DiagnosticArray, '/diagnostics', 10)
        with Simulation(client, send, 6) as simulation:
            wait_for(lambda: clocks and clocks[-1].header.stamp.sec >= 1000, what='the clock')
            wait_for(lambda: all(map(client.status.has_pose, (
                'eavesdropper/odom', 'ground_node/pose'))), what='the receivers')
            answer = client.call('planner/plan')
            assert answer.success, answer.message
            wait_for(file.exists)
            # The rate that is told is the mean of what is promised.
            promised = Plan.load(file).guaranteed_rates[:60].mean()
            assert f'guaranteed rate {promised:.4f}' in answer.message
            assert 'until 60.0 s' in answer.message and promise()[0] == pytest.approx(60.0)
            assert client.status.plan.guaranteed_rate == pytest.approx(promised, abs=1e-4)
            client.follow(lambda: simulation.now, late=15.0)
            wait_for(lambda: promise()[1], what='the end of the promise')
            until, text = promise()
            assert status[-1].level == DiagnosticStatus.WARN and until < 1.0
            assert 'later than the receivers that move are predicted for' in text
            wait_for(lambda: client.status.track.time > 5.0)
            assert 'the flight is 15.0 s later' in promise()[1]
            assert client.set_parameters('planner', replan_distance=900.0)[0].successful
            wait_for(lambda: promise()[1] is None, what='a new promise')

            # It is about the car where that is when the flight comes there.
            def find_saved():
                plan, last = Plan.load(file), status[-1]
                return plan.identity == last.plan.identity and (plan, last)
            plan, last = wait_for(find_saved, what='the plan of the status in the file')
    until, time = last.plan.promised_until, last.track.time
    ahead = np.arange(np.ceil(time) + 1.0, until)  # Points of slots.
    _, (centres,), (radii,) = plan.scenario.receivers_at(ahead)
    truth = np.array([car_at(plan.start_ns * 1e-9 + 15.0 + at) for at in ahead])
    assert len(ahead) and (np.linalg.norm(centres - truth, axis=1) <= radii).all()
    # What was flown before keeps the discs that it was planned for.
    _, (centres,), _ = plan.scenario.receivers_at([1.0])
    assert centres[0] == pytest.approx(car_at(plan.start_ns * 1e-9 + 1.0), abs=0.5 * CAR_SPEED)


@pytest.mark.parametrize('change', [10.0, -10.0])
def test_a_jump_of_the_clock_ends_the_promise_of_a_plan_that_waits(client, tmp_path, change):
    """Before, it was flown as promised, for receivers that were elsewhere by then."""
    file = tmp_path / 'plan.json'

    def send(now):
        cars.publish(car_odometry(now))
        client.send_pose('ground_node/pose', 0, 0, stamp=stamp_at(now), until_known=False)

    with node_here('planner', use_sim_time=True, plan_file=file, duration=120.0, slots=120,
                   start_delay=30.0, method='joint', time_limit=1.0):
        cars = client.publisher(Odometry, 'eavesdropper/odom')
        with Simulation(client, send, 1.0) as simulation:
            wait_for(lambda: client.call('planner/plan').success, what='a plan')
            assert client.status.plan.promised_slots == 120
            simulation.jump(simulation.now + change)
            wait_for(lambda: client.statuses[-1].plan.promised_slots == 0, what='the end')
            assert client.statuses[-1].level == DiagnosticStatus.WARN
            assert 'no slot is promised: the promise ended before slot 1; plan again' in (
                client.statuses[-1].text)
            wait_for(lambda: not Plan.load(file).promised_slots.any(), what='the file')
            wait_for(lambda: client.call('planner/plan').success, what='a plan after the jump')
            assert client.status.plan.promised_slots == 120


@pytest.mark.parametrize('change, start_delay, velocity', [
    (900.0, 0.0, (0.0, 1.0)), (-900.0, 10.0, (0.0, 0.0))], ids=['predicted', 'delayed'])
def test_a_plan_for_the_clock_before_a_jump_in_its_solve_is_refused_for_that(
        client, monkeypatch, change, start_delay, velocity):
    """Before, the one had no place of a receiver, and the other began 910 s ahead."""
    solve, clocks = Job.solve, client.listen(DiagnosticArray, '/diagnostics', 10)

    def solve_in_a_jump(job, *arguments):
        plan, target = solve(job, *arguments), clock.now + change
        clock.jump(target)
        wait_for(lambda: abs(clocks[-1].header.stamp.sec - target) < 300.0, what='the jump')
        return plan

    monkeypatch.setattr(Job, 'solve', solve_in_a_jump)
    with node_here('planner', use_sim_time=True, duration=120.0, slots=20, pose_timeout=60.0,
                   start_delay=start_delay), SimulatedTime(client, 1000.0, 1.0) as clock:
        cars = client.publisher(Odometry, 'eavesdropper/odom')

        def is_told():
            cars.publish(odometry_message(200.0, 0.0, velocity, stamp=clock.stamp()))
            client.send_pose('ground_node/pose', 0, 0, stamp=clock.stamp(), until_known=False)
            answer = client.call('planner/plan')
            assert not answer.success and 'position is None' not in answer.message
            return 'the clock jumped while the plan was made; ask again' in answer.message
        wait_for(lambda: clocks and clocks[-1].header.stamp.sec >= 1000, what='the clock')
        wait_for(is_told)


def test_receivers_are_predicted_again_where_the_solve_outlasts_their_prediction(
        client, monkeypatch):
    """Before, such a plan without a promised slot was OK, with a guaranteed rate of 0."""
    solve, seconds = Job.solve, [5.0]

    def solve_slowly(job, *arguments):
        plan = solve(job, *arguments)
        sleep(seconds[0])
        return plan

    monkeypatch.setattr(Job, 'solve', solve_slowly)
    with node_here('planner', duration=120.0, slots=120, prediction_horizon=4.0,
                   pose_timeout=60.0):
        client.send_pose('ground_node/pose', 0, 0)
        client.send_odometry('eavesdropper/odom', 200.0, 0.0, (0.0, 1.0))
        answer = client.call('planner/plan')
        assert answer.success and re.search('[1-9] of 120 slots promised, until', answer.message)
        assert client.call('planner/plan').success
        assert client.set_parameters('planner', prediction_horizon=0.5)[0].successful
        seconds[0] = 1.0
        answer = client.call('planner/plan')
        assert answer.success and 'no slot is promised: receivers are predicted until' in (
            answer.message)
        wait_for(lambda: client.statuses[-1].level == DiagnosticStatus.WARN)
        assert math.isnan(client.status.plan.guaranteed_rate)


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
            return client.status.track.time > duration
        wait_for(has_ended, patience=10 * PATIENCE, what='the end of the mission')
        last_status = client.status

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
          f'{last_status.replans} replans, {np.count_nonzero(covered)} slots with a promise')
    assert last_status.replans >= 5
    assert {plan.start_ns for plan in plans} == {first.start_ns}  # One flight.
    assert (achieved >= promised - 1e-9).all()
    assert covered.mean() > 0.5 and promised.mean() > 0
    assert last_status.plan.promised_until <= 121.0


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
        assert has_said(planner, 'car moves on its track in the mission file')
        client.send_estimate('car/pose', 200, 50)
        assert client.call('planner/plan').success
        wait_for(lambda: Plan.load(file).identity != plan.identity)
        assert Plan.load(file).scenario.eavesdroppers[0].position == (200.0, 50.0)
        assert has_said(planner, 'using the estimate of car')
