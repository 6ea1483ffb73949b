"""Every limit, checked against its own definition; each test covers all limits."""

from dataclasses import replace

from hypothesis import assume, given, settings
from hypothesis import strategies as st
import numpy as np
import oracle
import pytest
from random_cities import random_city_mission
from secure_uav_planner import fly_hover_fly, PlanningError, Scenario, solve
from secure_uav_planner.errors import PlanError, ScenarioError
from secure_uav_planner.model import limits
from secure_uav_planner.model.limits import build_limits
from secure_uav_planner.model.limits.base import Limit
from secure_uav_planner.model.limits.lines import LineLimit
from secure_uav_planner.model.problem import Problem
from secure_uav_planner.optimize.initial import fly_hover_fly_positions
from strategies import find_interior, random_powers, scenarios, SEEDS


@st.composite
def cities(draw):
    """Return missions with zones, fence, separation and perhaps a margin that can be flown."""
    try:
        scenario = replace(
            random_city_mission(draw(st.integers(0, 10**6)), draw(st.integers(6, 14))),
            tracking_margin=draw(st.sampled_from([0.0, 2.0])))
        fly_hover_fly_positions(Problem(scenario))
    except ScenarioError:
        assume(False)
    return scenario


MISSIONS = st.one_of(scenarios(), cities())


def evaluate_limits(scenario, seed, size):
    """Yield for each limit of positions c as a function of a step, and the kernel's answers."""
    rng = np.random.default_rng(seed)
    grid, x = find_interior(scenario, share=0.3)
    path = np.ascontiguousarray(oracle.path_of(grid, x))
    moves = np.zeros((grid.slots + 2, len(grid.fixed), 2))  # In units.
    moves[1:-1] = size * rng.normal(size=moves[1:-1].shape) * ~grid.fixed[:, None]
    for limit in build_limits(grid):
        if limit.compiled is not None:
            lines = limit.choose_lines(path) if isinstance(limit, LineLimit) else None
            yield (lambda by: oracle.slacks(limit, path + by * moves, lines).ravel(),
                   differentiate_along(moves, limit.compiled.evaluate(path, moves)))


def differentiate_along(moves, answers):
    """Return the kernel's answers with the derivatives of -sum log c along moves."""
    x = np.pad(moves[1:-1], ((0, 0), (0, 0), (1, 0))).ravel()
    height = answers['height']
    band = np.reshape(answers['band'], (-1, height))[:len(x)]
    ahead = np.append(x, np.zeros(height))
    products = [band[:, down] @ (x * ahead[down:down + len(x)]) for down in range(height)]
    return answers | {'slope': x @ answers['gradient'],
                      'curvature': 2 * sum(products) - products[0]}


@settings(max_examples=40)
@given(MISSIONS, SEEDS)
def test_slacks_and_their_derivatives_match_the_definition(scenario, seed):
    for slacks, answers in evaluate_limits(scenario, seed, 1.0):
        here = slacks(0.0)
        slopes, bends = (slacks(1.0) - slacks(-1.0)) / 2, slacks(1.0) - 2 * here + slacks(-1.0)
        scale = np.abs([slopes, bends]).max()
        np.testing.assert_allclose(answers['slacks'], here, atol=1e-12)
        np.testing.assert_allclose(answers['slopes'], slopes, atol=1e-10 * scale)
        here = np.array(answers['slacks'])  # Where there is all but no slack, rounding matters.
        shares = np.array(answers['slopes']) / here
        assert answers['slope'] == pytest.approx(
            -shares.sum(), rel=1e-7, abs=1e-7 * np.abs(shares).sum())
        # With duals 1 / c, the primal-dual Hessian is that of -sum log c.
        parts = shares**2 - bends / here
        assert answers['curvature'] == pytest.approx(
            parts.sum(), rel=1e-7, abs=1e-7 * np.abs(parts).sum())


@settings(max_examples=40)
@given(MISSIONS, SEEDS)
def test_the_longest_step_stays_inside_and_is_not_needlessly_short(scenario, seed):
    for slacks, answers in evaluate_limits(scenario, seed, 10.0):
        by = min(answers['lengths'])
        assert 0 < by <= 1
        assert (slacks(by) >= 0.0049 * slacks(0.0) - 1e-9).all()
        if by < 1 and not answers['limits_moves']:  # Obstacles without a line stop it, too.
            assert slacks(1.02 * by).min() < 0.006 * slacks(0.0).max()


@settings(max_examples=40)
@given(MISSIONS, SEEDS)
def test_a_retracted_plan_passes_the_checks_that_it_failed_before(scenario, seed):
    rng = np.random.default_rng(seed)
    positions = fly_hover_fly_positions(Problem(scenario))
    positions[:, 1:-1] += rng.normal(0, 100, positions[:, 1:-1].shape)
    powers = 3 * random_powers(scenario, rng)
    powers[0, 0] = -0.1
    broken = 0
    limits = Problem(scenario).limits
    for limit in limits:
        try:
            limit.validate(positions, powers)
        except PlanningError:
            broken += 1
        positions, powers = limit.retract(positions), limit.retract_powers(powers)
    assert broken
    for limit in limits:
        limit.validate(positions, powers)


class LeastSpeed(Limit):
    """No UAV hovers: each flies at 4 m/s at least, which is not convex."""

    def speeds(self, positions):
        """Return the speeds between points, (U, N+1) in m/s."""
        return np.linalg.norm(np.diff(positions, axis=1), axis=-1) / self.scenario.slot_duration

    def validate(self, positions, powers):
        """Raise a PlanError where a UAV is slower."""
        if self.speeds(positions).min() < 4.0:
            raise PlanError('a UAV is too slow')

    def retract(self, positions):
        """Blend with the flight of least utilisation until it is fast enough."""
        blends = (positions + share * (self.grid.reference_flight - positions)
                  for share in np.linspace(0.0, 1.0, 21))
        return next(blend for blend in blends if self.speeds(blend).min() >= 4.0)

    def shape_start(self, positions):
        """Fly a circle at 6 m/s in place of hovering."""
        positions = positions.copy()
        for path, speeds in zip(positions, self.speeds(positions)):
            slow = np.flatnonzero(speeds < 6.0)
            if len(slow):
                angles = np.linspace(0.0, 2 * np.pi, len(slow) + 1)
                radius = 6.0 * self.scenario.slot_duration * len(slow) / (2 * np.pi)
                path[slow[0]:slow[-1] + 2] += radius * np.stack(
                    [np.cos(angles) - 1, np.sin(angles)], axis=-1)
        return positions


def test_a_limit_that_is_not_convex_gives_the_methods_first_flights(monkeypatch):
    mission = Scenario.paper(150.0, slots=50)
    monkeypatch.setattr(limits, 'LIMITS', (*limits.LIMITS, LeastSpeed))
    plan = solve(mission, objective='guaranteed', time_limit=5.0)
    circle = plan.history[0].rate
    assert plan.rate >= circle > 0.0
    assert LeastSpeed(Problem(mission).grid).speeds(plan.positions).min() >= 4.0
    monkeypatch.setattr(LeastSpeed, 'shape_start', Limit.shape_start)
    with pytest.raises(PlanError, match='too slow'):
        fly_hover_fly(mission)
