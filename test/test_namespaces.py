"""Two teams side by side: planners in two namespaces neither hear nor disturb each other."""

from diagnostic_msgs.msg import DiagnosticArray
from nav_msgs.msg import Path
import pytest
from ros_client import Client, node_process, values_of, wait_for

SLOTS = {'/north': 20, '/south': 30}
EAST = {'/north': 0.0, '/south': 1000.0}  # m, of the whole mission


@pytest.fixture
def teams():
    """Yield a client in each of two namespaces, in which planners run."""
    with Client(namespace='/north') as north, Client(
            namespace='/south') as south:
        clients = {'/north': north, '/south': south}

        def planner(team):
            east = EAST[team]
            return node_process(
                'planner', namespace=team, duration=120.0, slots=SLOTS[team],
                **{f'{uav}__{end}': f'[{100.0 + east}, {y}]' for uav in ('uav1', 'uav2')
                   for end, y in (('start', 500.0), ('goal', -500.0))})
        with planner('/north'), planner('/south'):
            yield clients


def test_two_planners_plan_at_once_each_its_own_mission(teams):
    paths, futures = {}, {}
    for team, client in teams.items():
        paths[team] = client.listen(Path, 'uav1/path')
        client.send_pose('ground_node/pose', EAST[team], 0.0)
    # What one team has heard, the other has not.
    teams['/north'].send_estimate('eavesdropper/pose', 200.0 + EAST['/north'], 0.0)
    answer = teams['/south'].call('planner/plan')
    assert not answer.success and 'no pose has come on eavesdropper/pose' in answer.message
    teams['/south'].send_estimate('eavesdropper/pose', 200.0 + EAST['/south'], 0.0)
    for team, client in teams.items():
        client.call('planner/plan')  # Now its service is known to answer.
        futures[team] = client.ask('planner/plan')
    for team, future in futures.items():
        wait_for(future.done, what=f'the answer of {team}')
        assert future.result().success, future.result().message
        assert f'plan of {SLOTS[team]} slots' in future.result().message
    for team, path in paths.items():
        wait_for(lambda path=path: len(path) >= 2, what=f'the paths of {team}')
        assert {len(one.poses) for one in path} == {SLOTS[team] + 2}
        # Both missions are the same but for where they are; the second plan begins in flight.
        first = path[0].poses[0].pose.position
        assert (first.x, first.y) == (100.0 + EAST[team], 500.0)


def test_diagnostics_of_both_are_told_apart_by_their_names(teams):
    client = teams['/north']
    received = client.listen(DiagnosticArray, '/diagnostics', 10)

    def plans(team):
        return [int(values_of(status)['plans']) for message in list(received)
                for status in message.status if status.name == f'{team}/planner: plan']
    client.plan_paper()
    wait_for(lambda: max(plans('north'), default=0) and plans('south'))
    assert max(plans('south')) == 0
