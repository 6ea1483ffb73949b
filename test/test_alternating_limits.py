"""The alternating method has the limits of the paper, and no others."""

import ast
from dataclasses import replace
from pathlib import Path

import pytest
from secure_uav_planner import NoFlyZone, Scenario, solve
from secure_uav_planner.errors import OptionError
from secure_uav_planner.optimize import alternating

ZONE = NoFlyZone(((800.0, 0.0), (810.0, 0.0), (810.0, 10.0)))
FENCE = ((-900.0, -900.0), (900.0, -900.0), (0.0, 5000.0))


@pytest.mark.parametrize('field, change', [
    ('no_fly_zones', {'no_fly_zones': (ZONE,)}), ('separation', {'separation': 5.0}),
    ('geofence', {'geofence': FENCE}),
    ('uavs[1].max_acceleration', {})])
def test_a_limit_that_the_paper_does_not_have_is_refused_by_its_field(field, change):
    scenario = Scenario.paper(120.0, slots=10)
    change = change or {'uavs': (scenario.uavs[0], replace(
        scenario.uavs[1], max_acceleration=3.0))}
    with pytest.raises(OptionError, match="use 'joint'") as caught:
        solve(replace(scenario, **change), method='alternating')
    assert caught.value.field == field


def test_it_knows_nothing_of_the_joint_method():
    for source in Path(alternating.__file__).parent.glob('*.py'):
        for node in ast.walk(ast.parse(source.read_text())):
            if isinstance(node, ast.ImportFrom):
                names = {*(node.module or '').split('.'), *(alias.name for alias in node.names)}
                assert not names & {'joint', 'starts', 'barrier', 'derivatives', 'newton'}
