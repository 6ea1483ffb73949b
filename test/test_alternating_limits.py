"""The alternating method has the limits of the paper, and no others."""

import ast
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from secure_uav_planner import fly_hover_fly, NoFlyZone, Scenario, solve
from secure_uav_planner.errors import OptionError
from secure_uav_planner.optimize import alternating
from secure_uav_planner.optimize.alternating.powers import PowerProblem
from secure_uav_planner.optimize.alternating.trajectory import TrajectoryProblem

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


@pytest.mark.parametrize('duration', [102, 200])
def test_answers_are_nearly_feasible_before_any_repair(duration):
    scenario = Scenario.paper(duration)
    start = fly_hover_fly(scenario)
    positions, _ = TrajectoryProblem(scenario).solve(start.positions, start.powers)
    steps = np.linalg.norm(np.diff(positions, axis=1), axis=-1)
    assert (steps.max(axis=1) < scenario.max_step * (1 + 1e-5)).all()
    assert positions[:, [0, -1]] == pytest.approx(start.positions[:, [0, -1]], abs=1e-4)
    powers, _ = PowerProblem(scenario).solve(start.positions, start.powers)
    assert powers.min() > -1e-5
    assert (powers.max(axis=1) < scenario.peak_powers + 1e-5).all()
    assert (powers.mean(axis=1) < scenario.average_powers + 1e-5).all()


def test_it_knows_nothing_of_the_joint_method():
    for source in Path(alternating.__file__).parent.glob('*.py'):
        for node in ast.walk(ast.parse(source.read_text())):
            if isinstance(node, ast.ImportFrom):
                names = {*(node.module or '').split('.'), *(alias.name for alias in node.names)}
                assert not names & {'joint', 'starts', 'barrier', 'derivatives', 'newton'}
