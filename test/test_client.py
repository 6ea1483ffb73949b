"""The client for programs in Python, and the examples that use it, with real nodes."""

import os
import subprocess
import sys
import threading

from processes import environment, ROOT
import pytest
from ros_client import node_here, node_process, wait_for
from secure_uav_planner import Scenario
from secure_uav_planner.ros.client import ClientError, SecurePlanner


@pytest.fixture
def planner():
    with node_here('planner', duration=120.0, slots=40, pose_timeout=0.0), \
            SecurePlanner(Scenario.paper(120.0, slots=40)) as planner:
        yield planner


def test_the_last_plan_is_the_one_that_the_planner_has_published(planner):
    with pytest.raises(ClientError, match='no pose has come on ground_node/pose'):
        planner.plan()
    planner.wait_until(planner.knows_poses, repeat=planner.send_poses)
    plan = planner.plan()
    wait_for(lambda: planner.status.get('plan.identity') == plan.identity)
    assert plan.guaranteed_rate == pytest.approx(
        float(planner.status['plan.guaranteed_rate']), rel=1e-5)
    assert planner.plan() is planner.last_plan is not plan


def test_an_estimate_has_its_place_and_deviation(planner):
    planner.wait_until(planner.knows_poses, repeat=planner.send_poses)
    first = planner.plan()
    planner.send_estimate('eavesdropper', (150.0, 50.0), deviation=20.0)
    wait_for(lambda: float(planner.status['pose_age.eavesdropper/pose']) < 1.0)
    assert not (planner.plan().positions == first.positions).all()


def test_a_solve_is_cancelled_from_another_thread_or_at_the_timeout():
    long = {'duration': 900.0, 'slots': 20000, 'time_limit': 0.0, 'pose_timeout': 0.0}
    with node_here('planner', **long), SecurePlanner() as planner:
        planner.wait_until(planner.knows_poses, repeat=planner.send_poses)

        def cancel():
            planner.wait_until(lambda: planner.status.get('state') == 'solving')
            planner.cancel()
        thread = threading.Thread(target=cancel)
        thread.start()
        with pytest.raises(ClientError, match='cancelled'):
            planner.plan()
        thread.join()
        with pytest.raises(TimeoutError):
            planner.plan(timeout=0.5)
        wait_for(lambda: planner.status['state'] == 'idle', what='the end of the solve')


def test_it_works_in_a_namespace():
    with node_process('planner', namespace='/fleet', pose_timeout=0.0):
        with SecurePlanner(namespace='/fleet') as planner:
            planner.wait_until(planner.knows_poses, repeat=planner.send_poses)
            assert planner.plan().scenario.slots == 200


EXAMPLES = {'plan_and_fly': 'the flight has ended', 'moving_estimate': 'replan 1 at',
            'pause_and_resume': 'going on at', 'show_in_rviz': 'playing'}


@pytest.mark.parametrize('name', EXAMPLES)
def test_an_example_runs(name):
    ended = subprocess.run([sys.executable, str(ROOT / 'examples' / 'ros' / f'{name}.py')],
                           capture_output=True, text=True, timeout=600,
                           env=environment(**{key: os.environ[key] for key in os.environ
                                              if key.startswith('ROS_')}))
    assert ended.returncode == 0, ended.stderr
    assert EXAMPLES[name] in ended.stdout, ended.stdout
