"""Separation, no-fly zones and geofence in the planner node, over DDS."""

from diagnostic_msgs.msg import DiagnosticStatus
import pytest
from ros_client import node_process, refusal, wait_for
from visualization_msgs.msg import MarkerArray

# Beside every path of the paper's mission.
FAR = {'no_fly_zones': '[tower]', 'tower__vertices': '[900.0, 0.0, 950.0, 0.0, 950.0, 50.0]'}


def planner(**parameters):
    return node_process('planner', **{'duration': 120.0, 'slots': 20, **parameters})


def test_a_planner_with_a_zone_and_a_fence_shows_them_and_says_how_close_it_comes(client):
    with planner(**FAR, geofence='[-900.0, -900.0, 990.0, -900.0, 990.0, 900.0, -900.0, 900.0]',
                 separation=8.0) as process:
        markers = client.listen(MarkerArray, 'planner/markers')
        answer = client.plan_paper()
        assert 'uav1 and uav2 come within 10.0 m of each other' in answer.message
        assert ' m of tower' in answer.message and '; along the curve ' in answer.message
        wait_for(lambda: markers and 'plan.zone_distance' in client.status)
        names = {marker.ns for marker in markers[-1].markers}
        assert {'no_fly_zone', 'no_fly_zone_edges', 'geofence'} <= names
        values = client.status
        assert float(values['plan.uav_distance']) == pytest.approx(10.0, abs=1e-3)
        assert values['plan.uav_distance.between'] == 'uav1, uav2'
        assert values['plan.zone_distance.between'].endswith(', tower')
        assert float(values['plan.zone_distance']) > 500
        assert float(values['plan.curve_rate']) == pytest.approx(
            float(values['plan.guaranteed_rate']), abs=0.05)
        assert client.statuses[-1].level == DiagnosticStatus.OK
    assert not any('there is no parameter' in line for line in process.lines)


def test_a_mission_that_begins_in_a_zone_is_refused_by_name_and_the_last_plan_stands(client):
    with planner(**FAR):
        client.plan_paper()
        for name, value, undo, reason in (
                ('tower.vertices', [50.0, 450.0, 150.0, 450.0, 150.0, 550.0, 50.0, 550.0],
                 [900.0, 0.0, 950.0, 0.0, 950.0, 50.0], 'inside tower; it must be outside'),
                ('tracking_margin', 5000.0, 0.0, 'with the tracking_margin of 5000 m')):
            assert client.set_parameters('planner', **{name: value})[0].successful
            answer = client.call('planner/plan')
            assert not answer.success and answer.message.endswith('; the last plan stands')
            assert reason in answer.message
            assert client.set_parameters('planner', **{name: undo})[0].successful
        assert client.call('planner/plan').success


def test_uavs_that_come_close_without_a_separation_are_warned_of(client):
    with planner(uav2__altitude=101.0):
        answer = client.plan_paper()
        assert 'come within 1.0 m of each other at ' in answer.message
        assert 'less than 5 m; set separation to keep them apart' in answer.message
        wait_for(lambda: 'plan.uav_distance' in client.status)
        assert client.statuses[-1].level == DiagnosticStatus.WARN


@pytest.mark.parametrize('parameters, reason', [
    ({'no_fly_zones': '[tower]'}, 'parameter tower.vertices is []; it must be a list of 6'),
    ({'no_fly_zones': '[uav1]'}, 'no_fly_zones give the names')])
def test_a_planner_does_not_start_with_a_wrong_airspace(capfd, parameters, reason):
    assert reason in refusal(capfd, 'planner', **parameters)
