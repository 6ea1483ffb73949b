"""Limits of energy: plans keep them by circling, and replans have what is left."""

from dataclasses import replace
import re

import numpy as np
import pytest
from ros_nodes import node_here, wait_for
from secure_uav_planner import (
    Eavesdropper, fly_hover_fly, NoFlyZone, Plan, Propulsion, Scenario, shortest_duration, solve,
    Uav, upper_bound)
from secure_uav_planner.errors import (
    InfeasibleMissionError, OptionError, PlanError, ScenarioError)
from secure_uav_planner.model.limits.energy import (
    compile_energies, lift_limits, measure_energies)
from secure_uav_planner.model.problem import Problem
from secure_uav_planner.optimize.joint import energy, method
from secure_uav_planner.optimize.joint.interior_point import InteriorPointSolver
from secure_uav_planner.optimize.joint.starts import make_strictly_feasible
from secure_uav_planner.plan.splice import continue_plan, cut_tail
from simulation import plan_of, received
from strategies import with_uavs


def make_paper(duration, max_energy=None, **fields):
    """Return the paper's scenario with 3 m/s^2 and a budget for both UAVs."""
    return with_uavs(Scenario.paper(duration), max_acceleration=3.0, max_energy=max_energy,
                     propulsion=Propulsion(), **fields)


def integrate(plan):
    """Return the energies of a plan by many velocities along its curve, (U,) in J."""
    curve = plan.curve
    times = np.linspace(curve.begin, curve.end, 20 * plan.scenario.slots + 1)
    speeds = np.linalg.norm(curve.at(times).velocities, axis=-1)
    return np.array([np.trapezoid(uav.propulsion.power(speed), times)
                     for uav, speed in zip(plan.scenario.uavs, speeds)])


# As found by another program.
@pytest.mark.parametrize('duration, budget, reference, share', [
    (120.0, 15600.0, 1.8896, 0.99), (150.0, 20500.0, 2.4302, 0.99),
    (200.0, 25900.0, 2.9253, 0.99), (150.0, 19300.0, 2.3846, 0.98)])
def test_the_paper_s_plans_keep_budgets_and_reach_the_best_known_rates(
        duration, budget, reference, share):
    plan = solve(make_paper(duration, budget), objective='guaranteed')
    assert plan.guaranteed_rate >= share * reference
    assert (integrate(plan) <= 1.001 * budget).all()
    assert all(taken.total <= 1.001 * budget for taken in plan.energies)


def test_a_budget_that_is_not_used_up_changes_nothing():
    free, limited = (solve(make_paper(120.0, budget)) for budget in (None, 16e3))
    assert np.array_equal(free.positions, limited.positions)
    assert free.worst_case_rate == limited.worst_case_rate


def make_mission(seed):
    """Return a random mission with jammers, and with a zone or a separation, and limits."""
    rng = np.random.default_rng(seed)
    uavs = tuple(Uav(
        f'uav{index}', tuple(rng.uniform(-300, -200, 2)), tuple(rng.uniform(200, 300, 2)),
        rng.uniform(60, 90), 10.0, max_acceleration=2.5, propulsion=Propulsion())
        for index in range(1 + seed % 3))
    corners = 150.0 + 30.0 * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
    extra = [{'no_fly_zones': (NoFlyZone(tuple(map(tuple, corners))),)}, {'separation': 15.0},
             {'eavesdroppers': (Eavesdropper(
                 track=((0.0, 150.0, -100.0, 10.0), (100.0, 150.0, 100.0, 20.0))),)}][seed % 3]
    return replace(Scenario((0.0, 0.0), (Eavesdropper((150.0, 50.0), 10.0),), uavs, 140.0, 70,
                            separation=0.0), **extra)


@pytest.mark.parametrize('objective', ['guaranteed', 'worst_case'])
@pytest.mark.parametrize('place', [(method, '_improve_guaranteed'),
                                   (energy, '_advance')])
def test_a_solve_that_ends_early_has_a_plan_within_the_budget(monkeypatch, place, objective):
    whole = getattr(*place)

    def call_and_cancel(driver, *arguments):
        # The first search is not begun: then there is no plan without the budget.
        answer = 'cancelled' if place[0] is method else whole(driver, *arguments)
        driver.incumbent.deadline.is_cancelled = True
        return answer

    monkeypatch.setattr(*place, call_and_cancel)
    plan = solve(make_paper(150.0, 20e3), objective=objective, time_limit=1000.0)
    assert plan.status == 'cancelled' and plan.rate > 2.3
    assert (integrate(plan) <= 1.001 * 20e3).all()


@pytest.mark.parametrize('seed', range(3))
@pytest.mark.parametrize('objective', ['guaranteed', 'worst_case'])
def test_zones_separation_and_receivers_that_move_are_kept_within_budgets(seed, objective):
    scenario = make_mission(seed)
    free = solve(scenario, objective=objective)
    budgets = 0.9 * integrate(free)
    limited = replace(scenario, uavs=tuple(replace(uav, max_energy=budget) for uav, budget in zip(
        scenario.uavs, budgets.tolist())))
    plan = solve(limited, objective=objective)  # A Plan checks its zones and separations.
    assert (integrate(plan) <= 1.001 * budgets).all()
    assert 0.9 * free.rate < plan.rate <= free.rate


def test_a_budget_below_the_least_energy_is_refused_with_that():
    scenario = make_paper(120.0, 15e3)
    with pytest.raises(InfeasibleMissionError, match='max_energy is 15000 J; no flight of 120 s '
                       'was found that takes less than') as refusal:
        solve(scenario)
    assert re.fullmatch(r'uavs\[[01]\].max_energy', refusal.value.field)
    least = float(re.search('less than ([0-9.]+) J', str(refusal.value))[1])
    # From rest to rest, at the least power in between: no flight of 122 s takes less.
    power, ramp = Propulsion().power, np.linspace(0.0, 10.0, 200)
    below = 2 * np.trapezoid(power(ramp), ramp) / 3.0 + power(10.0) * (122.0 - 20.0 / 3.0)
    assert below < least < 1.005 * below
    plan = solve(with_uavs(scenario, max_energy=1.005 * least), objective='guaranteed')
    assert plan.rate > 1.8


def test_a_plan_beyond_a_budget_and_a_budget_without_its_limit_are_refused():
    with pytest.raises(ScenarioError, match='uav1.max_energy is 20000.0 J; it must be None '
                       'without max_acceleration: such a UAV would hop'):
        with_uavs(Scenario.paper(120.0), max_energy=20000.0)
    assert make_paper(120.0, 20e3, ).uavs[0].propulsion == Propulsion()
    scenario = make_paper(200.0, 27500.0)
    for power in ('constant', 'optimised'):
        with pytest.raises(PlanError, match='uav1 takes 29.* J by the model of its propulsion; '
                           'at most 27500 J are allowed'):
            fly_hover_fly(scenario, power)
    with pytest.raises(OptionError, match='alternating'):
        solve(scenario, 'alternating')


def test_the_bound_is_valid_and_says_that_it_ignores_energy():
    plan = solve(make_paper(120.0, 15600.0), objective='guaranteed')
    bound = upper_bound(plan.scenario, objective='guaranteed', plan=plan)
    assert 'max_energy' in bound.ignored and 'without max_energy' in bound.claim(plan)
    assert plan.rate <= bound.rate <= 1.01 * plan.rate


def test_a_rest_of_a_plan_has_the_rest_of_its_budget():
    plan = solve(make_paper(150.0, 20e3), objective='guaranteed')
    for point in (0, 1, 60, 149):
        tail = cut_tail(plan, point)
        spent = integrate(plan) - integrate(tail)
        assert 20e3 - spent == pytest.approx(tail.scenario.max_energies, abs=1.0)
    tail = cut_tail(plan, 60)
    moved = replace(tail.scenario, eavesdroppers=(Eavesdropper((180.0, 60.0), 10.0),))
    replan = solve(moved, objective='guaranteed', initial=tail)
    whole = continue_plan(plan, 60, replan)
    assert (integrate(whole) <= 1.001 * 20e3).all()
    stay = Plan(moved, tail.positions, tail.powers, objective='guaranteed')
    assert replan.rate > stay.rate


@pytest.mark.parametrize('seed', range(4))
def test_the_worst_case_is_never_below_that_of_the_guaranteed_plan_within_budgets(seed):
    rng, slots = np.random.default_rng(seed), 30
    scenario = replace(make_mission(seed), slots=slots, no_fly_zones=(), separation=0.0)
    free, direct = (measure_energies(scenario, positions) for positions in (
        solve(scenario).positions, Problem(scenario).grid.reference_flight))
    budgets = np.minimum(free, direct) - rng.uniform(0.0, 0.03) * free
    limited = replace(scenario, uavs=tuple(
        replace(uav, max_energy=None if index and seed == 1 else budget)
        for index, (uav, budget) in enumerate(zip(scenario.uavs, budgets.tolist()))))
    guaranteed = solve(limited, objective='guaranteed')
    assert solve(limited).rate >= guaranteed.worst_case_rate


def test_a_budget_little_above_the_least_energy_in_long_slots_is_planned():
    """Both UAVs have budgets 0.6 and 1.6% above the least known energies, in slots of 4.9 s."""
    uavs = [Uav(name, start, goal, altitude, 7.57, 3.0, 6.0, max_acceleration=acceleration,
                propulsion=Propulsion(), max_energy=budget)
            for name, start, goal, altitude, acceleration, budget in (
                ('u0', (-140.9, -201.2), (39.8, -78.8), 97.9, 1.28, 22111.0),
                ('u1', (212.0, 290.1), (33.7, -123.3), 71.7, 3.5, 22245.0))]
    scenario = Scenario((35.1, 87.6), (Eavesdropper((90.0, 115.0), 60.0),), uavs, 156.68, 32)
    plan = solve(scenario, objective='guaranteed')
    assert plan.rate > 0 and (integrate(plan) <= [22111.0, 22245.0]).all()


def test_a_flight_in_slots_longer_than_a_circle_is_planned_or_refused():
    scenario = with_uavs(make_paper(150.0, 23e3), max_acceleration=3.0)
    with pytest.raises(InfeasibleMissionError, match='was found that takes less than'):
        solve(replace(scenario, slots=10))
    plan = solve(replace(scenario, slots=10, uavs=with_uavs(scenario, max_energy=25e3).uavs))
    assert plan.rate > 0


def test_the_shortest_flight_that_delivers_keeps_budgets():
    plan = shortest_duration(make_paper(150.0, 20e3), 250.0, objective='guaranteed')
    assert 'this suffices for 250 bit/Hz' in plan.message
    assert (integrate(plan) <= 1.001 * 20e3).all()
    with pytest.raises(InfeasibleMissionError, match='bits is 500 bit/Hz'):
        shortest_duration(make_paper(150.0, 20e3), 500.0, objective='guaranteed')


@pytest.mark.parametrize('budget', [15e3, 30e3])
@pytest.mark.parametrize('velocity', [(0.0, 0.0), (3.0, -4.0), None])
def test_the_kernel_s_energies_are_those_of_the_model_with_their_gradient(velocity, budget):
    """A budget below the energies has a price, and one above them has a barrier term."""
    scenario = make_paper(150.0, budget, start_velocity=velocity, goal_velocity=velocity)
    grid, rng = Problem(scenario).grid, np.random.default_rng(0)
    flight = fly_hover_fly(lift_limits(scenario))
    x = make_strictly_feasible(grid, flight.positions, flight.powers, 0.1)
    step = 1e-4 * rng.normal(size=x.shape)
    energies = compile_energies(grid, grid.positions(x))
    for variables, tolerance in ((x, 1e-12), (x + 10 * step, 1e-4)):
        shares, positions = np.empty(2), grid.positions(variables)
        path = (positions.swapaxes(0, 1) - grid.origin) / grid.length
        energies.find(np.ascontiguousarray(path), shares)
        assert shares == pytest.approx(
            measure_energies(scenario, positions) / budget, rel=tolerance)
    solver = InteriorPointSolver(grid, x[None], 1e-3, prices=np.array([0.3, 1.0]))
    assert (solver.over == (budget < 20e3)).all()

    def evaluate(variables):
        value, gradient = np.empty(1), np.empty((1, *x.shape))
        solver.x[0] = variables
        solver._core.evaluate(value, gradient, np.empty((1, grid.slots, 6, 6)))
        return value[0], gradient[0]

    step[..., 0] = 0.0
    change = evaluate(x + step)[0] - evaluate(x - step)[0]
    assert change == pytest.approx(2 * (evaluate(x)[1] * step).sum(), rel=1e-3)


def test_check_says_what_share_of_the_battery_is_needed(tmp_path, command):
    file = tmp_path / 'mission.yaml'
    make_paper(200.0, 25900.0).save(file)
    hovering = 202.0 * float(Propulsion().power(0.0)) / 25900.0
    assert (f'uav1: by the model, hovering all the time takes {hovering:.0%} of max_energy, and '
            'the straight way ') in command('check', file).out
    make_paper(200.0, 20000.0).save(file)
    assert 'max_energy is 20000 J; no flight of 200 s' in command('check', file, status=2).err


def test_a_mission_with_a_battery_is_planned_again_in_flight_with_what_is_left(client, tmp_path):
    file = tmp_path / 'mission.yaml'
    scenario = make_paper(150.0, 20000.0)
    scenario.save(file)
    with node_here('planner', mission_file=str(file), replan_distance=5.0, replan_lead=40.0):
        paths, powers = received(client)
        client.plan_paper()
        client.follow()
        wait_for(lambda: all(paths + powers))
        client.send_estimate('eavesdropper/pose', 170, 30)
        wait_for(lambda: all(len(got) == 2 for got in paths + powers), what='the new plan')
        wait_for(lambda: client.status.replans == 1)
        told = client.status.plan.energy['uav1'].total
        [result] = client.set_parameters('planner', uav2__max_acceleration=0.0)
        assert not result.successful and 'uav2.max_energy is 20000' in result.reason
    old, new = (plan_of(scenario, paths, powers, index) for index in (0, 1))
    assert not np.array_equal(old.positions, new.positions)
    assert (integrate(new) <= 20000.0 * 1.001).all()
    assert told == pytest.approx(integrate(new)[0], rel=1e-4)
