"""Planning again on the way, flown in simulated time against a moving eavesdropper."""

import time

from diagnostic_msgs.msg import DiagnosticStatus
import numpy as np
from ros_client import node_here, node_process, PATIENCE, seconds, values_of, wait_for
from secure_uav_planner import Scenario
from secure_uav_planner.model import channel
from simulation import plan_of, received, Simulation


def test_a_mission_replanned_twenty_times_is_one_flight_and_keeps_the_secret(client):
    began = []

    def where(now):
        # From beside the ground node to 250 m away in the course of the mission.
        share = (now - began[0]) / 200 if began else 0.0
        return 60.0 + 190.0 * min(1.0, max(0.0, share)), -120.0 * min(1.0, max(0.0, share))

    with node_process('planner', use_sim_time='true', replan_distance=4.0, replan_lead=4.0,
                      slots=100, pose_timeout=0.0):
        with Simulation(client, where, speedup=8) as simulation:
            paths, powers = received(client)
            status = client.listen(DiagnosticStatus, 'planner/status')
            client.send_pose('ground_node/pose', 0, 0, stamp=simulation.stamp())
            client.send_estimate('eavesdropper/pose', *where(0), stamp=simulation.stamp())
            assert client.call('planner/plan').success
            began.append(simulation.now)
            client.follow(lambda: simulation.now)

            def arrived():
                client.send_pose(
                    'ground_node/pose', 0, 0, stamp=simulation.stamp(), until_known=False)
                simulation.send_estimate()
                return simulation.now > began[0] + 200
            wait_for(arrived, patience=10 * PATIENCE, what='the end of the mission')
        values = values_of(status[-1])
        assert int(values['replans']) >= 20, values
        count = min(map(len, paths + powers))
        assert count >= 21

    scenario = Scenario.paper(200.0, slots=100)
    start = paths[0][0].poses[0].header.stamp
    times = seconds(start) + 2.0 * np.arange(1, 101)
    truth = np.array([where(time) for time in times])

    def secrecy(plan):
        rates = channel.secrecy_rates(scenario, plan.positions, plan.powers, truth)
        return np.maximum(rates, 0).mean()

    plans = [plan_of(scenario, paths, powers, index) for index in range(count)]
    for before, after in zip(plans, plans[1:]):
        # The same up to the moment it takes effect, a feasible flight over all of the mission.
        same = (before.positions == after.positions).all(axis=(0, 2))
        assert same[0]
    flown, first = plans[-1], plans[0]
    print(f'secrecy rate without replanning {secrecy(first):.3f}, with '
          f'{values["replans"]} replans {secrecy(flown):.3f} bit/s/Hz')
    assert secrecy(flown) > 1.05 * secrecy(first)


def test_a_replan_leaves_what_has_been_flown_as_it_was(client):
    lead = 5.0
    with node_here('planner', replan_distance=5.0, replan_lead=lead, duration=120.0,
                   slots=120):
        paths, powers = received(client)
        client.plan_paper()
        client.follow()
        wait_for(lambda: all(paths + powers))
        sent = time.time()
        client.send_estimate('eavesdropper/pose', 170, 30)
        wait_for(lambda: all(len(got) == 2 for got in paths + powers), what='the new plan')
    scenario = Scenario.paper(120.0)
    old, new = (plan_of(scenario, paths, powers, index) for index in (0, 1))
    assert paths[0][0].header.stamp == paths[0][1].header.stamp
    # One slot a second: what is flown before a plan that began after this could take effect.
    flown = int(sent + lead - seconds(paths[0][0].header.stamp))
    assert (old.positions[:, :flown + 1] == new.positions[:, :flown + 1]).all()
    assert (old.powers[:, :flown] == new.powers[:, :flown]).all()
    assert not (old.positions == new.positions).all()


def test_a_replan_is_not_made_while_nothing_moves_and_is_made_every_period(client):
    with node_here('planner', replan_distance=5.0, duration=120.0, slots=60):
        paths, _ = received(client)
        client.plan_paper()
        client.follow()
        wait_for(lambda: paths[0])
        client.send_estimate('eavesdropper/pose', 203, 0)
        time.sleep(1.0)
        assert len(paths[0]) == 1
        assert client.set_parameters('planner', replan_period=0.5, replan_lead=3.0)[0].successful
        wait_for(lambda: len(paths[0]) >= 4)
        assert client.set_parameters('planner', replan_period=0.0)[0].successful


def test_a_changed_error_radius_is_a_reason_to_plan_again(client):
    with node_here('planner', replan_distance=5.0, replan_lead=5.0, duration=120.0,
                   slots=60):
        paths, _ = received(client)
        client.send_pose('ground_node/pose', 0, 0)
        client.send_estimate('eavesdropper/pose', 200, 0, variance=16.0)
        assert client.call('planner/plan').success
        client.follow()
        client.send_estimate('eavesdropper/pose', 200, 0, variance=100.0)
        wait_for(lambda: len(paths[0]) == 2)
