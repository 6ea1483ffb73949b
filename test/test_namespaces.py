"""Two teams side by side: planners in two namespaces neither hear nor disturb each other."""

from diagnostic_msgs.msg import DiagnosticArray
from nav_msgs.msg import Path
from ros_client import Client, node_process, values_of, wait_for

SLOTS = {'/north': 20, '/south': 30}
EAST = {'/north': 0.0, '/south': 1000.0}  # m, of the whole mission


def planner(team):
    east = EAST[team]
    return node_process(
        'planner', namespace=team, duration=120.0, slots=SLOTS[team], pose_timeout=0.0,
        **{f'{uav}__{end}': f'[{100.0 + east}, {y}]' for uav in ('uav1', 'uav2')
           for end, y in (('start', 500.0), ('goal', -500.0))})


def test_two_planners_plan_at_once_each_its_own_mission_and_are_told_apart():
    with Client('/north') as north, Client('/south') as south, \
            planner('/north'), planner('/south'):
        teams = {'/north': north, '/south': south}
        diagnostics = north.listen(DiagnosticArray, '/diagnostics', 10)
        paths = {team: client.listen(Path, 'uav1/path') for team, client in teams.items()}
        for team, client in teams.items():
            client.send_pose('ground_node/pose', EAST[team], 0.0)
        # What one team has heard, the other has not.
        north.send_estimate('eavesdropper/pose', 200.0 + EAST['/north'], 0.0)
        answer = south.call('planner/plan')
        assert not answer.success and 'no pose has come on eavesdropper/pose' in answer.message
        south.send_estimate('eavesdropper/pose', 200.0 + EAST['/south'], 0.0)
        futures = {team: client.ask('planner/plan') for team, client in teams.items()}
        for team, future in futures.items():
            wait_for(future.done, what=f'the answer of {team}')
            assert future.result().success, future.result().message
            assert f'plan of {SLOTS[team]} slots' in future.result().message
            wait_for(lambda path=paths[team]: path, what=f'the path of {team}')
            points = paths[team][-1].poses
            assert len(points) == SLOTS[team] + 2
            # Both missions are the same but for where they are.
            start = points[0].pose.position
            assert (start.x, start.y) == (100.0 + EAST[team], 500.0)
        # A second plan of one team is none of the other.
        assert north.call('planner/plan').success

        def plans(team):
            return [int(values_of(status)['plans']) for message in list(diagnostics)
                    for status in message.status if status.name == f'{team[1:]}/planner: plan']
        wait_for(lambda: [max(plans(team), default=0) for team in teams] == [2, 1])
