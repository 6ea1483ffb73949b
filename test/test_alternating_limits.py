"""The alternating method takes its limits from the limits of the scenario, old and new ones."""

import ast
from pathlib import Path

import cvxpy as cp
import numpy as np
import pytest
from secure_uav_planner import fly_hover_fly, Scenario
from secure_uav_planner.model import limits
from secure_uav_planner.optimize import alternating
from secure_uav_planner.optimize.alternating.powers import PowerProblem
from secure_uav_planner.optimize.alternating.trajectory import TrajectoryProblem


class Corridor(limits.SpeedLimit):
    """No UAV flies west of a line, or farther than some metres from where it was before."""

    WEST, REACH = -5.0, 30.0

    def convex_form(self, variables):
        """Return a plain bound in metres, and one that follows the local point."""
        if variables.paths is None:
            return [variables.powers[0] <= 0.5]
        middle = self.scenario.slots // 2
        return [constraint for local, path in zip(variables.local, variables.paths)
                for constraint in (path[:, 0] >= self.WEST * variables.scale,
                                   cp.norm(path[middle] - local[middle] * variables.scale)
                                   <= self.REACH * variables.scale)]


def test_a_new_limit_binds_both_problems_and_follows_the_local_point(monkeypatch):
    scenario = Scenario.paper(120, slots=40)
    start = fly_hover_fly(scenario, 'optimised')
    free, _ = TrajectoryProblem(scenario).solve(start.positions, start.powers)
    assert free[..., 0].min() < Corridor.WEST - 1.0

    monkeypatch.setattr(limits, 'LIMITS', (*limits.LIMITS, Corridor))
    trajectory = TrajectoryProblem(scenario)
    shifted = start.positions.copy()
    for local in (start.positions, shifted):
        positions, _ = trajectory.solve(local, start.powers)
        assert positions[..., 0].min() > Corridor.WEST - 1e-3
        moved = np.linalg.norm((positions - local)[:, 20], axis=-1)
        assert (moved < Corridor.REACH + 1e-3).all()
        shifted[:] = positions
    powers, _ = PowerProblem(scenario).solve(start.positions, start.powers)
    assert powers[0].max() < 0.5 + 1e-6


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
