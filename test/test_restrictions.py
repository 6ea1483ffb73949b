"""The convex restrictions of Section III, checked without derivatives: the solver evaluates."""

from dataclasses import replace

import cvxpy as cp
from hypothesis import assume, given, settings
from hypothesis import strategies as st
import numpy as np
from secure_uav_planner import Eavesdropper, fly_hover_fly, Scenario
from secure_uav_planner.model.channel import guaranteed_rates
from secure_uav_planner.optimize.alternating import (
    restrict_powers, restrict_trajectories, solve_problem)
from strategies import random_powers, scenarios, with_uavs


def rate(scenario, positions, powers):
    """Return the sum over the slots in nats, as the restrictions have it."""
    return float(guaranteed_rates(scenario, positions, powers).sum() * np.log(2))


class Unsolved(Exception):
    """The solver has no value for a point: it is outside of the restriction, or numerics."""


def value(problem, fixed):
    """Return the restriction's value where its variables are fixed, in nats, to maximise."""
    pinned = cp.Problem(problem.objective, problem.constraints + [
        variable == point for variable, point in fixed])
    try:
        pinned.solve(solver=cp.CLARABEL, ignore_dpp=True)
    except cp.SolverError:
        raise Unsolved from None
    if pinned.status != cp.OPTIMAL:
        raise Unsolved
    sign = 1 if isinstance(problem.objective, cp.Maximize) else -1
    return sign * pinned.value


@settings(max_examples=20)
@given(scenarios(max_slots=3), st.integers(0, 2**32 - 1))
def test_the_power_restriction_never_promises_more_than_the_rate_gains(scenario, seed):
    rng = np.random.default_rng(seed)
    positions = rng.uniform(-400, 400, (len(scenario.uavs), scenario.slots + 2, 2))
    local = random_powers(scenario, rng)
    restriction = restrict_powers(scenario, positions, local)
    solved, _ = solve_problem(restriction.problem)
    best = [restriction.get_answer()] if solved else []
    unit = np.array([[uav.average_power] for uav in scenario.uavs])

    def promised(powers):
        try:
            return value(restriction.problem, [
                (restriction.variables[0], np.clip(powers, 0, None) / unit * (1 - 1e-9))])
        except Unsolved:
            assume(False)

    base = promised(local)
    for powers in [random_powers(scenario, rng) for _ in range(3)] + best:
        promise = promised(powers) - base
        gained = rate(scenario, positions, powers) - rate(scenario, positions, local)
        assert promise <= gained + 1e-5 * (1 + abs(promise))


@settings(max_examples=20)
@given(scenarios(max_slots=3), st.integers(0, 2**32 - 1), st.booleans())
def test_the_trajectory_restriction_never_promises_more_than_the_rate_gains(
        scenario, seed, inside):
    rng = np.random.default_rng(seed)
    count, slots = len(scenario.uavs), scenario.slots
    # Any place is within reach of any other, so that the restriction is seen everywhere.
    scenario = with_uavs(scenario, max_speed=1e4, max_acceleration=None)
    local = rng.uniform(-400, 400, (count, slots + 2, 2))
    if inside:  # the error disc, and one jammer exactly above its centre
        eve = scenario.eavesdroppers[0]
        local[:, 1:-1] = eve.position + rng.uniform(-1, 1, (count, slots, 2)) * max(
            1.0, eve.error_radius / 2)
        local[-1, 1] = eve.position
    powers = random_powers(scenario, rng)
    restriction = restrict_trajectories(scenario, local, powers)
    solve_problem(restriction.problem)  # Whether the solver succeeds or not, it is around here.

    def promised(positions):
        return value(restriction.problem, [
            (move, (path - start) / restriction.unit)
            for move, path, start in zip(restriction.variables, positions, local)])

    try:
        base = promised(local)
    except Unsolved:
        assume(False)
    for reach in (1.0, 30.0, 300.0):
        positions = local.copy()
        # Short enough for the linearised squares to be positive, as they must be.
        for _ in range(20):
            positions[:, 1:-1] = local[:, 1:-1] + rng.uniform(-reach, reach, (count, slots, 2))
            try:
                gain = promised(positions) - base
                break
            except Unsolved:
                reach /= 2
        else:
            assume(False)
        gained = rate(scenario, positions, powers) - rate(scenario, local, powers)
        assert gain <= gained + 1e-5 * (1 + abs(gain))


def test_a_jammer_above_the_estimate_leaves_it_when_that_pays():
    # (17c) divides zero by zero there, and with a careless subgradient the kink is a trap.
    scenario = replace(Scenario.paper(150, slots=30), eavesdroppers=(
        Eavesdropper((60.0, 0.0), 30.0),))
    start = fly_hover_fly(scenario, 'optimised')
    above = np.linalg.norm(start.positions[1] - (60.0, 0.0), axis=-1) == 0
    assert above.sum() > 3
    restriction = restrict_trajectories(scenario, start.positions, start.powers)
    assert solve_problem(restriction.problem)[0]
    answer = restriction.get_answer()
    away = answer[1, above] - (60.0, 0.0)
    assert (away[1:-1, 0] > 1.0).all()
    assert rate(scenario, answer, start.powers) > rate(scenario, start.positions, start.powers)
