"""What the planner makes of the file that keeps its last plan."""

from dataclasses import replace
import json
import time

from diagnostic_msgs.msg import DiagnosticStatus
from nav_msgs.msg import Path
import pytest
from ros_client import node_here, values_of, wait_for
from secure_uav_planner import fly_hover_fly, Scenario
from secure_uav_planner.ros.messages import plan_time
from sensor_msgs.msg import TimeReference

PLAN = replace(fly_hover_fly(Scenario.paper(104, slots=8)), start_ns=10**18)


@pytest.fixture
def file(tmp_path):
    return tmp_path / 'plan.json'


@pytest.mark.parametrize('change', [
    {'status': 'cancelled'}, {'status': 'given'}, {'method': 'x' * 10**5}],
    ids=['cancelled', 'given', 'long name'])
def test_a_plan_that_is_valid_is_restored_whatever_it_says_of_its_origin(client, file, change):
    replace(PLAN, **change).save(file)
    with node_here('planner', plan_file=file) as process:
        paths = client.listen(Path, 'uav2/path')
        status = client.listen(DiagnosticStatus, 'planner/status')
        wait_for(lambda: paths and status, what='the restored plan')
        assert values_of(status[-1])['plan.status'] == change.get('status', PLAN.status)
        wait_for(lambda: any('ready' in line for line in process.lines))
        assert not any('plan_file' in line for line in process.lines)
        assert max(map(len, process.lines)) < 1000 and len(status[-1].message) < 1000


def test_a_request_just_after_a_restart_in_flight_waits_for_who_flies_the_plan(client, file):
    scenario = Scenario.paper(400.0, slots=40)
    plan = replace(fly_hover_fly(scenario), start_ns=time.time_ns() - 60 * 10**9)
    plan.save(file)
    with node_here('planner', plan_file=file, duration=400.0, slots=40, start_delay=10.0):
        client.send_paper()
        answer = client.ask('planner/plan')
        reports = client.publisher(TimeReference, 'plan_time')

        def reported():
            now = client.node.get_clock().now()
            time_of_plan = (now.nanoseconds - plan.start_ns) * 1e-9
            reports.publish(plan_time(plan, time_of_plan, now.to_msg()))
            return answer.done()
        wait_for(reported)
    assert answer.result().success
    assert f'goes on from plan {plan.identity}, which is flying' in answer.result().message


def digits(value):
    """Return a whole number as JSON writes it; Python refuses to write those of 400 digits."""
    return '1' + 400 * '0' if value == 10**400 else json.dumps(value)


@pytest.mark.parametrize('field, value', [
    ('start_ns', 10**30), ('start_ns', 2**63 - 1), ('start_ns', -5), ('start_ns', None),
    ('slots', 10**400), ('status', 'finished'), ('history', 7), ('positions', 'x' * 10**5)],
    ids=lambda value: str(value)[:8] if value != 10**400 else '10**400')
def test_a_plan_that_cannot_be_published_is_one_short_warning(client, file, field, value):
    PLAN.save(file)
    values = json.loads(file.read_text())
    (values['scenario'] if field == 'slots' else values)[field] = '@'
    file.write_text(json.dumps(values).replace('"@"', digits(value)))
    check_one_warning(client, file)


@pytest.mark.parametrize('file', ['/dev/full', '/dev/zero', '/tmp', 'x' * 5000],
                         ids=['full', 'zero', 'folder', 'long name'])
def test_a_plan_file_that_is_no_regular_file_is_one_short_warning(client, file):
    check_one_warning(client, file)


def check_one_warning(client, file):
    """Check that the planner has warned once, has published nothing and can plan."""
    paths = client.listen(Path, 'uav1/path')
    with node_here('planner', plan_file=file, duration=120.0, slots=20) as process:
        warnings = [line for line in process.lines if 'plan_file' in line]
        assert len(warnings) == 1 and '[WARN]' in warnings[0], process.lines
        client.send_paper()
        assert client.call('planner/plan').success
        wait_for(lambda: paths)
        assert [len(path.poses) for path in paths] == [22]
    assert max(map(len, process.lines)) < 1000
    assert not any('Traceback' in line for line in process.lines)
