"""Missions from parameter files, without a node."""

import city
import pytest
from secure_uav_planner import Scenario
from secure_uav_planner.errors import PlanningError
from secure_uav_planner.ros.mission_files import scenario_of_file


def test_the_city_is_the_mission_that_the_planner_makes_of_its_parameters():
    assert scenario_of_file(city.FILE, (0.0, 0.0), city.PLACES) == city.scenario()


def test_the_paper_is_the_papers():
    path = city.FILE.with_name('paper.yaml')
    assert scenario_of_file(path, (0.0, 0.0), {'eavesdropper': (200.0, 0.0)}) == Scenario.paper()


@pytest.mark.parametrize('text, reason', [
    ('[1, 2', 'is not a parameter file'), ('a: 1', 'is not a parameter file'),
    ('/**/planner: {ros__parameters: {hat: 1}}', "there is no parameter 'hat'"),
    ('/**/planner: {ros__parameters: {duration: -5.0}}', 'duration is -5.0'),
    ('/**/planner: {ros__parameters: {uavs: 3}}', 'uavs is 3'),
    ('/**/planner: {ros__parameters: {}}', 'places lacks eavesdropper')])
def test_a_file_that_describes_no_mission_is_refused_with_the_reason(tmp_path, text, reason):
    path = tmp_path / 'mission.yaml'
    path.write_text(text)
    with pytest.raises(PlanningError, match=reason):
        scenario_of_file(path, (0.0, 0.0), {})
