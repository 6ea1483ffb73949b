"""Followers of a plan over DDS: two that report at once, and one of somebody else."""

from nav_msgs.msg import Path
from processes import ROOT
from ros_client import node_process, places_of, values_of, wait_for

PARAMETERS = {'duration': 150.0, 'slots': 75, 'uav1__max_acceleration': 2.0,
              'uav2__max_acceleration': 2.0, 'replan_deviation': 8.0}
UAVS = ('uav1', 'uav2')


def check_on_plan(statuses, replans):
    """Check that the UAVs were on their plan in each status, and how often it was replanned."""
    for status in statuses:
        values = values_of(status)
        assert 'from its plan' not in status.message, status.message
        assert all(values[f'track.distance.{name}'] == 'none' or float(
            values[f'track.distance.{name}']) < 1.0 for name in UAVS), values
        assert values['replans'] in replans, values


def test_of_two_followers_the_planner_tracks_one_and_says_so(client):
    apart = [word for name in UAVS for word in ('-r', f'{name}/odom:=second/{name}/odom')]
    with node_process('planner', **PARAMETERS), \
            node_process('replay', '-r', '__node:=second', *apart), node_process('replay'):

        def time_of_plan():
            return float(client.status.get('track.time', -1))
        client.plan_paper()
        wait_for(lambda: client.call('replay/start').success, what='the plan at the replay')
        wait_for(lambda: time_of_plan() > 4.0)
        client.statuses.clear()
        wait_for(lambda: client.call('second/start').success)
        wait_for(lambda: any('followers' in status.message for status in client.statuses))
        wait_for(lambda: time_of_plan() > 14.0)
        times = [float(values_of(status)['track.time']) for status in client.statuses]
        assert times == sorted(times), times
        check_on_plan(client.statuses, '0')


def test_a_plan_is_flown_as_soon_as_somebody_reports_it_and_not_before(client):
    program = (ROOT / 'examples/ros/report_time.py').read_text()
    with node_process('planner', duration=120.0, slots=40, replan_period=0.5):
        client.plan_paper()
        # A passive subscriber, such as RViz, does not fly: the next plan begins at the start.
        path = client.listen(Path, 'uav1/path')
        assert client.call('planner/plan').success
        wait_for(lambda: path)
        assert places_of(path[-1])[0].tolist() == [100.0, 500.0]
        assert all('track.time' not in values_of(status) for status in client.statuses)
        with node_process('own_stack', program=program):
            wait_for(lambda: int(client.status['replans']) > 0, what='a replan')
            wait_for(lambda: client.status['track.state'] == 'flying')
        wait_for(lambda: 'is silent' in client.statuses[-1].message)
