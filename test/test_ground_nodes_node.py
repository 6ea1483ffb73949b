"""Several ground nodes in the planner, the replay and the client: poses, schedule, replans."""

from dataclasses import replace

from diagnostic_msgs.msg import DiagnosticArray
import numpy as np
import pytest
from ros_client import stamp_at
from ros_nodes import node_here, PATIENCE, wait_for, wait_for_line
from secure_uav_planner import GroundNode, Plan, solve
from secure_uav_planner.plan.playback import Playback
from secure_uav_planner.ros import messages
from secure_uav_planner.ros.client import SecurePlanner
from secure_uav_planner.ros.topics import LATCHED
from simulation import Simulation
from std_msgs.msg import Float64MultiArray, String
from test_ground_nodes import distrust, make_mission

NAMES = ['barn', 'cart']
SPEED = 0.5  # m/s, of the cart towards +x


def make_farm(duration=120.0, **fields):
    return make_mission([GroundNode((0.0, 150.0), 'barn'), GroundNode((0.0, -150.0), 'cart', 1.5)],
                        duration, **fields)


def test_replans_in_flight_serve_each_node_by_what_it_has_got(client, tmp_path):
    scenario = distrust(make_farm(), 1)
    mission, file = tmp_path / 'mission.yaml', tmp_path / 'plan.json'
    scenario.save(mission)
    plans, served = [], client.listen(String, 'setpoint/served', 1000)
    clocks = client.listen(DiagnosticArray, '/diagnostics', 10)

    with node_here('planner', use_sim_time=True, mission_file=mission, plan_file=file,
                   start_delay=5.0, replan_lead=3.0, replan_period=20.0,
                   objective='guaranteed'), \
            node_here('replay', use_sim_time=True, mission_file=mission, autostart=True), \
            SecurePlanner(scenario) as planner:

        def send(now):
            stamp, plan = stamp_at(now), planner.last_plan
            planner.send_odometry('cart', cart_at(now), (SPEED, 0.0), stamp=stamp)
            planner.send_pose('barn', (0.0, 150.0), stamp)
            planner.send_estimate('eavesdropper', (200.0, 0.0), stamp=stamp)
            if plan is not None and (not plans or plan.identity != plans[-1].identity):
                plans.append(plan)

        with Simulation(client, send, 6.0):
            wait_for(lambda: clocks and clocks[-1].header.stamp.sec >= 1000, what='the clock')
            planner.wait_until(planner.knows_poses)
            planner.plan()
            planner.wait_until(lambda: planner.status.track.state == 'ended',
                               'the end of the flight', timeout=10 * PATIENCE)
        status = planner.status
        wait_for(lambda: file.exists() and Plan.load(file).identity == plans[-1].identity,
                 what='the last plan in the file')
    saved = Plan.load(file)
    assert saved.scenario.ground_node_names == (*NAMES,) and len(plans) > 3
    assert saved.scenario.listeners == (1,)
    for field in ('positions', 'powers', 'shares'):
        np.testing.assert_array_equal(getattr(plans[-1], field), getattr(saved, field))
    for name, rate in zip(NAMES, saved.node_rates):
        assert status.plan.node_rate[name] == pytest.approx(rate, rel=1e-5)
    assert {message.data for message in served} == {*NAMES, ''}
    track = tuple((time, *cart_at(saved.start_ns * 1e-9 + time)) for time in (0.0, 121.0))
    barn, cart = scenario.ground_nodes
    hindsight = replace(scenario, ground_nodes=(barn, replace(cart, position=None, track=track)))
    flown = Plan(hindsight, saved.positions, saved.powers, shares=saved.shares)
    best = solve(hindsight, objective='guaranteed').rate
    print(f'{status.replans} replans: {flown.rate:.4f}, in hindsight {best:.4f}; '
          f'{flown.node_rates}')
    assert flown.rate > 0.95 * best


def cart_at(now):
    """Return the place of the cart at a time of the clock in s."""
    return SPEED * (now - 1000.0), -150.0


@pytest.fixture(scope='module')
def plan():
    return replace(solve(make_farm(slots=30), objective='guaranteed'), start_ns=10**18)


def test_the_node_with_the_largest_share_is_served_while_anything_is_transmitted(plan):
    playback, step = Playback(plan), plan.scenario.slot_duration
    for time in np.arange(-1.0, plan.times[-1] + 2.0, step / 2):
        slot = int(time / step + 1e-9) - 1
        sent = dict(messages.setpoint_messages(
            plan.scenario, playback.at(time), 'map', stamp_at(max(time, 0.0))))
        expected = ''
        if 0 <= slot < plan.scenario.slots and plan.powers[0, slot] > 0:
            expected = NAMES[plan.shares[:, slot].argmax()]
        assert sent['setpoint/served'].data == expected


def test_a_plan_for_other_nodes_is_not_restored_and_one_for_these_is(client, plan, tmp_path):
    file = tmp_path / 'plan.json'
    plan.save(file)
    schedules = client.listen(Float64MultiArray, 'planner/schedule', LATCHED)
    with node_here('planner', plan_file=file) as planner:
        wait_for_line(planner, 'is not a plan for uav1, uav2, ground_node')
    with node_here('planner', plan_file=file, ground_nodes="['barn', 'cart']"):
        wait_for(lambda: schedules)
    assert not np.any(np.reshape(schedules[0].data, plan.shares.shape) - plan.shares)
