"""How the nodes stop."""

import signal
import time

from diagnostic_msgs.msg import DiagnosticStatus
import pytest
from ros_client import Client, node_process, output_of, values_of, wait_for
from secure_uav_planner import METHODS


@pytest.mark.parametrize('number', [signal.SIGINT, signal.SIGTERM])
@pytest.mark.parametrize('method', METHODS)
def test_a_signal_in_the_middle_of_a_solve_ends_the_node_within_two_seconds(number, method):
    with Client() as client, node_process(
            'planner', duration=900.0, slots=3000, method=method) as process:
        status = client.listen(DiagnosticStatus, 'planner/status')
        client.send_paper()
        answer = client.ask('planner/plan')
        wait_for(lambda: status and values_of(status[-1])['state'] == 'solving')
        time.sleep(0.3)
        assert not answer.done()
        process.send_signal(number)
        process.send_signal(number)  # an impatient user's second one changes nothing
        stopped = time.monotonic()
        assert process.wait(timeout=10) == 0
        assert time.monotonic() - stopped < 2.0
        assert 'Traceback' not in output_of(process) and 'exception' not in output_of(process)
        wait_for(answer.done)
        assert not answer.result().success


@pytest.mark.parametrize('node', ['planner', 'replay'])
def test_an_idle_node_stops_cleanly_every_time(node):
    for _ in range(4):
        with node_process(node) as process:
            wait_for(lambda: process.lines, what='the first line')
            process.send_signal(signal.SIGINT)
            assert process.wait(timeout=10) == 0
            assert 'ready' in output_of(process) and len(process.lines) == 1


def test_a_wrong_command_line_is_named():
    with node_process('planner', '--params-file', 'no/such/file.yaml') as process:
        assert process.wait(timeout=30) == 1
    assert '/such/file.yaml' in output_of(process)  # rcl shortens long texts
    assert process.lines[-1].startswith('cannot start: ') and len(process.lines) <= 2
