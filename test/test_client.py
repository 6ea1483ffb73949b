"""The client for programs in Python, and the examples that use it, with real nodes."""

from contextlib import contextmanager
import copy
from dataclasses import replace
import threading
import time

from nav_msgs.msg import Path
from processes import ROOT, run_python
import pytest
from ros_nodes import node_here, node_process, wait_for, wait_for_line
from secure_uav_planner import fly_hover_fly, GroundNode, Plan, Scenario
from secure_uav_planner.errors import ParameterError
from secure_uav_planner.ros import messages
from secure_uav_planner.ros.client import ClientError, SecurePlanner
from secure_uav_planner.ros.planner_status import PlannerStatus
from secure_uav_planner.ros.topics import LATCHED, REQUESTS
from std_msgs.msg import Float64MultiArray, String
from std_srvs.srv import Trigger
from strategies import with_uavs


PAPER = Scenario.paper(120.0, slots=40)
LONG = {'duration': 900.0, 'slots': 20000, 'time_limit': 0.0}


@contextmanager
def planner_with_poses(scenario=None, **parameters):
    """Run a planner in this process; yield its client once it knows all poses."""
    with node_here('planner', pose_timeout=0.0, **parameters), SecurePlanner(scenario) as planner:
        planner.wait_until(planner.knows_poses, repeat=planner.send_poses)
        yield planner


@pytest.fixture
def planner():
    with planner_with_poses(PAPER, duration=120.0, slots=40) as planner:
        yield planner


def test_the_last_plan_is_the_published_one_for_the_last_estimate_whatever_a_stranger_sends(
        planner):
    stranger = planner.node.create_publisher(String, 'plan', LATCHED)
    stranger.publish(String(data='[]'))  # It is not a plan, and ends no call.
    plan = planner.plan()
    wait_for(lambda: planner.status.plan.identity == plan.identity)
    assert plan.guaranteed_rate == pytest.approx(
        planner.status.plan.guaranteed_rate, rel=1e-5)
    assert planner.plan() is planner.last_plan is not plan

    def has_moved():
        planner.send_estimate('eavesdropper', (150.0, 50.0), deviation=20.0)
        return abs(planner.plan().positions - plan.positions).max() > 20.0
    wait_for(has_moved, what='a plan for the new estimate')


def test_the_plan_of_a_request_is_its_own_whatever_else_is_published_meanwhile(planner):
    other = replace(fly_hover_fly(PAPER), start_ns=1)
    stranger = planner.node.create_publisher(String, 'plan', LATCHED)
    planner.node.create_timer(0.01, lambda: stranger.publish(messages.plan_text(other, 'map')))
    wait_for(lambda: planner.last_plan is not None and planner.last_plan.start_ns == 1)
    plan = planner.plan()
    assert plan.start_ns > 1 and plan.method == 'joint'


def test_a_planner_of_other_uavs_is_named_at_once():
    with node_here('planner', uavs='[drone1, drone2]'), SecurePlanner() as planner:
        with pytest.raises(ClientError, match='has the UAVs uav1, uav2, and the planner has '
                                              'drone1, drone2; give both the same mission'):
            planner.plan()


def test_names_that_the_nodes_refuse_are_refused_by_the_client():
    scenario = replace(Scenario.paper(), ground_nodes=(GroundNode((0.0, 0.0), 'north farm'),))
    with pytest.raises(ParameterError, match="ground_nodes is .'north farm'.; it must be a list"):
        SecurePlanner(scenario)


def test_each_of_many_requests_at_once_gets_an_answer():
    """Before, 40 of 50."""
    with node_here('replay'), SecurePlanner() as planner:
        client = planner.node.create_client(Trigger, 'replay/pause', qos_profile=REQUESTS)
        assert client.wait_for_service(60.0)
        with pytest.raises(ClientError, match='nothing is playing'):  # Both have met by then.
            planner.pause()
        answers = [client.call_async(Trigger.Request()) for _ in range(200)]
        wait_for(lambda: all(answer.done() for answer in answers), what='200 answers')
        assert {answer.result().message for answer in answers} == {'nothing is playing'}


def test_a_solve_is_cancelled_from_another_thread_or_at_the_timeout():
    with planner_with_poses(**LONG) as planner:
        def cancel():
            planner.wait_until(lambda: planner.status.state == 'solving')
            planner.cancel()
        thread = threading.Thread(target=cancel)
        thread.start()
        with pytest.raises(ClientError, match='cancelled'):
            planner.plan()
        thread.join()
        with pytest.raises(TimeoutError, match='planner/plan did not .* within 0.5 s'):
            planner.plan(timeout=0.5)
        wait_for(lambda: planner.status.state == 'idle', what='the end of the solve')


def test_a_deadline_holds_where_no_planner_is_and_names_what_is_missing():
    with SecurePlanner() as planner:
        began = time.monotonic()
        with pytest.raises(TimeoutError, match='service planner/plan did not come within 0.5 s'):
            planner.plan(timeout=0.5)
        # However busy the machine: not the 120 s of other waits, nor a cancel after them.
        assert time.monotonic() - began < 60.0


def test_a_planner_that_is_killed_in_a_solve_ends_the_call_at_its_deadline_and_not_the_next_one():
    with SecurePlanner() as planner:
        with node_process('planner', **LONG) as process:
            planner.wait_until(planner.knows_poses, repeat=planner.send_poses)
            killer = threading.Thread(target=lambda: (
                planner.wait_until(lambda: planner.status.state == 'solving'),
                process.kill()))
            killer.start()
            with pytest.raises(TimeoutError, match='planner/plan did not .* within 5 s'):
                planner.plan(timeout=5.0)
            killer.join()
        with node_process('planner', duration=120.0, slots=40):
            planner.status = PlannerStatus()
            planner.wait_until(planner.knows_poses, repeat=planner.send_poses)
            assert planner.plan().scenario.slots == 40


def test_a_call_that_waits_is_refused_within_on_status_and_an_error_there_ends_one_call():
    refusals, errors = [], [ValueError('the first')]

    def on_status(_):
        if errors and planner.status.state == 'solving':
            raise errors.pop()
        try:
            planner.plan()
        except ClientError as error:
            refusals.append(str(error))

    with node_here('planner', duration=120.0, slots=40, pose_timeout=0.0), \
            SecurePlanner(PAPER, on_status=on_status) as planner:
        planner.wait_until(planner.knows_poses, repeat=planner.send_poses)
        assert refusals and 'it must be in another thread' in refusals[0]
        with pytest.raises(ClientError, match='a callback failed: ValueError: the first') as error:
            planner.plan()
        assert isinstance(error.value.__cause__, ValueError)
        planner.wait_until(lambda: planner.status.state == 'idle')
        assert planner.plan() is planner.last_plan


def test_outside_of_the_block_and_when_it_is_left_every_call_is_an_error_of_the_package():
    planner = SecurePlanner()
    calls = [planner.plan, planner.start, planner.send_poses, planner.cancel,
             lambda: planner.wait_until(lambda: True), lambda: planner.node,
             lambda: planner.send_odometry('uav1', (0.0, 0.0), (0.0, 0.0))]

    def check():
        for call in calls:
            with pytest.raises(ClientError, match='connected only within its block'):
                call()
    check()
    errors = []

    def wait():
        try:
            planner.plan()
        except Exception as error:
            errors.append(error)
    with planner:
        threads = [threading.Thread(target=wait) for _ in range(3)]
        for thread in threads:
            thread.start()
        time.sleep(0.2)
    for thread in threads:
        thread.join()
    assert [type(error) for error in errors] == [ClientError] * 3
    check()


def test_a_receiver_that_moves_is_planned_for_by_its_odometry_and_known_in_the_plan():
    track = ((0.0, -50.0, 0.0), (100.0, 50.0, 0.0))
    scenario = replace(PAPER, ground_node=None, ground_node_track=track)
    with node_here('planner', duration=120.0, slots=40, pose_timeout=0.0), \
            SecurePlanner(scenario) as planner:
        def send():
            planner.send_pose('ground_node', (0.0, 0.0))
            planner.send_odometry('eavesdropper', (200.0, 0.0), (0.0, 3.0), 2.0, 0.1)
            planner.send_pose('uav1', (90.0, 490.0))
            planner.send_odometry('uav2', (95.0, 495.0), (0.0, 0.0))
        planner.wait_until(lambda: planner.knows_poses('uav1/pose', 'uav2/odom'), repeat=send)
        plan = planner.plan()
        assert planner.status.plan.promised_until is not None
        assert plan.positions[:, 0].tolist() == [[90.0, 490.0], [95.0, 495.0]]
        with pytest.raises(ClientError, match="there is no member 'eve'; there are ground_node, "):
            planner.send_pose('eve', (0.0, 0.0))


def test_the_last_plan_is_the_plan_that_was_made_to_the_last_field(tmp_path):
    scenario = with_uavs(PAPER, max_acceleration=3.0)
    scenario.save(tmp_path / 'mission.yaml')
    with planner_with_poses(scenario, mission_file=tmp_path / 'mission.yaml',
                            plan_file=tmp_path / 'plan.json', objective='guaranteed') as planner:
        plan = planner.plan()
        wait_for((tmp_path / 'plan.json').exists)
    assert plan == Plan.load(tmp_path / 'plan.json')
    assert plan.scenario.uavs == scenario.uavs and plan.history and plan.method == 'joint'


def test_a_path_and_powers_of_another_planner_become_a_plan_that_the_replay_takes(
        client, tmp_path):
    PAPER.save(tmp_path / 'mission.yaml')
    plan = replace(fly_hover_fly(PAPER), start_ns=10**18)
    sent = {topic: message for topic, message in messages.plan_messages(plan, 'earth')
            if topic.endswith(('/path', '/power'))}
    with node_process(ROOT / 'examples/ros/plan_from_path.py',
                      mission_file=tmp_path / 'mission.yaml') as program, (
            node_here('replay')) as replay:
        # Without the poses of a path or the powers of a slot, or with a late pose, it goes on.
        late = copy.deepcopy(sent['uav2/path'])
        late.poses[5].header.stamp.sec += 1
        for bad, reason in (({'uav1/path': Path(), 'uav2/path': Path()}, 'a path has no poses'),
                            ({'uav2/path': late}, 'the same stamps, equally spaced'),
                            ({'uav1/power': Float64MultiArray()}, 'no plan: ')):
            before = len(program.lines)
            for topic, message in {**sent, **bad}.items():
                client.publisher(type(message), topic, LATCHED).publish(message)
            wait_for(lambda: any(reason in line for line in program.lines[before:]))
        for topic, message in sent.items():
            client.publisher(type(message), topic, LATCHED).publish(message)
        made = wait_for(lambda: client.last_plan)
        wait_for_line(replay, f'got a plan of 40 slots for uav1, uav2: {made.identity}')
    assert made.identity == plan.identity
    assert made.guaranteed_rate == pytest.approx(plan.guaranteed_rate)


EXAMPLES = {'plan_and_fly': 'the flight has ended', 'moving_estimate': 'replan 1 at',
            'pause_and_resume': 'going on at', 'show_in_rviz': 'playing'}


@pytest.mark.parametrize('name', EXAMPLES)
def test_an_example_runs(name):
    printed = run_python(ROOT / 'examples' / 'ros' / f'{name}.py').stdout
    assert EXAMPLES[name] in printed
