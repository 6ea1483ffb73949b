from dataclasses import replace
from functools import partial
import gc
from itertools import count
import weakref

from benchmarks.missions import random_mission
from hypothesis import given, settings
from hypothesis import strategies as st
import numpy as np
import oracle
from processes import run_python
import pytest
from random_cities import random_city_mission
from secure_uav_planner import Eavesdropper, fly_hover_fly, optimize, Plan, Scenario, Uav
from secure_uav_planner.errors import NumericalError, TimeLimitError
from secure_uav_planner.model.problem import Problem
from secure_uav_planner.optimize.deadline import Deadline
from secure_uav_planner.optimize.incumbent import Incumbent
from secure_uav_planner.optimize.initial import adapt_plan, fly_hover_fly_positions
from secure_uav_planner.optimize.joint.interior_point import InteriorPointSolver, SolverDriver
from secure_uav_planner.optimize.joint.starts import generate_starts
from strategies import PLACE, rotate_map, scenarios, with_uavs
from test_city_missions import check_flight

solve = partial(optimize.solve, objective='guaranteed')  # (P2), which has reference values.


def team(**changes):
    """Return a mission with two jammers and two eavesdroppers of different radii."""
    return replace(Scenario(
        ground_node=(0.0, 0.0),
        eavesdroppers=(Eavesdropper((200.0, 0.0), 30.0), Eavesdropper((-80.0, 150.0), 10.0)),
        uavs=(Uav('a', (100.0, 400.0), (50.0, -400.0), 100.0, 12.0),
              Uav('b', (100.0, 300.0), (150.0, -300.0), 110.0, 12.0),
              Uav('c', (-100.0, 300.0), (-150.0, -300.0), 80.0, 12.0)),
        duration=100.0, slots=50), **changes)


@pytest.mark.parametrize('duration, radius, at_least, worst_case', [
    (102, 10, 1.3694, 1.458634), (104, 10, 1.5601, None), (120, 10, 1.9875, 2.049430),
    (150, 10, 2.5035, None), (200, 10, 3.0187, 3.055482), (200, 0, 3.1917, None)])
def test_the_papers_scenario_reaches_the_best_known_rate(duration, radius, at_least, worst_case):
    """The worst-case rates are those that a search found for these plans."""
    plan = solve(Scenario.paper(duration, radius), method='joint')
    assert plan.status == 'converged'
    assert plan.guaranteed_rate >= at_least
    assert plan.worst_case_rate >= plan.guaranteed_rate - 1e-9
    assert worst_case is None or plan.worst_case_rate == pytest.approx(worst_case, abs=1e-5)


@settings(max_examples=25)
@given(scenarios())
def test_objectives_never_fall_and_beat_the_baseline_and_the_formula_within_all_limits(scenario):
    plan = solve(scenario, method='joint')
    check_flight(plan)
    oracle.check_rates(plan)
    assert plan.status == 'converged'
    baseline = fly_hover_fly(scenario, 'optimised').guaranteed_rate
    assert plan.guaranteed_rate >= baseline - 1e-6
    worst_case = solve(scenario, objective='worst_case')
    oracle.check_rates(worst_case)
    assert worst_case.worst_case_rate >= plan.worst_case_rate - 1e-12


@pytest.mark.parametrize('seed, slots, most, least', [
    (4, 60, 9, 1.80), (3028, 60, 9, 0.113), (3063, 60, 9, 0.985), (3068, 60, 9, 0.415),
    (6, None, 2, 0.57)])  # The last is won in few good slots.
def test_missions_with_many_optima_end_near_the_best_known(seed, slots, most, least):
    """Starts that hover in regular patterns, with more jamming, or fewer end 4 to 30% lower."""
    scenario = random_mission(seed, slots)
    scenario = replace(scenario, uavs=scenario.uavs[:most],
                       eavesdroppers=scenario.eavesdroppers[:most])
    assert solve(scenario).guaranteed_rate > least


@pytest.mark.parametrize('x, y, leaves, takes, guaranteed, worst_case', [
    (-249.5, 86.6, 52.2, 27.5, 1.2505, 1.2859), (-245.8, -55.8, 46.5, 26.3, 1.3966, 1.4169)])
def test_jammers_of_an_eavesdropper_that_crosses_choose_their_side(
        x, y, leaves, takes, guaranteed, worst_case):
    """Where all starts hover where it is at half time, plans are up to 17% worse."""
    track = (leaves, x, y, 10.0), (leaves + takes, -x, -y, 10.0)
    scenario = replace(Scenario.paper(110.0, slots=48),
                       eavesdroppers=(Eavesdropper((x, y), track=track),))
    assert solve(scenario).rate >= guaranteed
    assert solve(scenario, objective='worst_case').rate >= worst_case


def test_starts_keep_all_limits_and_are_the_same_every_time():
    for scenario in (team(), random_city_mission(3001, 40), random_city_mission(3007, 40)):
        problem = Problem(scenario)
        grid, baseline = problem.grid, fly_hover_fly_positions(problem)
        batches, again = (list(generate_starts(grid, problem, baseline)) for _ in range(2))
        for (x, mu), (repeated, _) in zip(batches, again, strict=True):
            assert len(x) == len(mu) and (x == repeated).all()
            for start in x:
                Plan(scenario, grid.positions(start), grid.powers(start))


@pytest.mark.parametrize('failing', [2, 3, 4, 6, 7])
def test_a_numerical_failure_of_a_part_does_not_spoil_the_plan(monkeypatch, failing):
    """The parts are two batches of starts, two polishes, the finish and two polishes."""
    calls = []

    def barrier(*arguments):
        calls.append(arguments)
        if len(calls) == failing:
            raise NumericalError('no Newton step could be computed')
        return make(*arguments)

    make = SolverDriver.build_solver
    monkeypatch.setattr(SolverDriver, 'build_solver', barrier)
    scenario = random_mission(4, slots=40)
    plan = solve(scenario)
    assert len(calls) >= failing and plan.status == 'converged'
    assert plan.guaranteed_rate > fly_hover_fly(scenario, 'optimised').guaranteed_rate


@pytest.mark.parametrize('slots', [39, 41, 700])
def test_any_number_of_slots_is_planned(slots):
    plan = solve(Scenario.paper(200, slots=slots), method='joint')
    assert plan.status == 'converged'
    assert plan.guaranteed_rate > 2.5


def test_the_worst_eavesdropper_counts_and_not_their_average():
    scenario = team()
    both = solve(scenario, method='joint')
    doubled = replace(scenario, eavesdroppers=scenario.eavesdroppers * 2)
    assert replace(both, scenario=doubled).guaranteed_rate == both.guaranteed_rate
    assert solve(doubled, method='joint', initial=both).guaranteed_rate >= both.guaranteed_rate
    for eve in scenario.eavesdroppers:
        alone = solve(replace(scenario, eavesdroppers=(eve,)), method='joint')
        assert alone.guaranteed_rate > both.guaranteed_rate


@settings(max_examples=8)
@given(st.floats(0, 2 * np.pi), PLACE)
def test_turning_and_shifting_the_map_changes_nothing(angle, shift):
    scenario = Scenario.paper(120, slots=60)
    assert solve(rotate_map(scenario, angle, shift)[0], method='joint').guaranteed_rate == (
        pytest.approx(solve(scenario, method='joint').guaranteed_rate, rel=1e-5))


@pytest.mark.parametrize('method, objective, calls', [
    ('joint', 'guaranteed', 1), ('joint', 'guaranteed', 5), ('joint', 'guaranteed', 45),
    ('joint', 'worst_case', 1), ('joint', 'worst_case', 60), ('joint', 'worst_case', 75),
    ('alternating', 'guaranteed', 3)])
def test_the_callback_stops_the_run_with_the_best_plan_so_far(method, objective, calls):
    iterations = []
    plan = optimize.solve(
        team(), method, objective=objective,
        on_iteration=lambda iteration: iterations.append(iteration) or len(iterations) == calls)
    assert plan.status == 'cancelled' and len(iterations) <= calls + 1
    assert list(plan.history) == iterations
    assert [iteration.number for iteration in iterations] == list(range(len(iterations)))
    # An iterate for (P2) may be better for (P1) before it is reported as that.
    assert plan.rate >= max(iteration.rate for iteration in iterations) - 5e-6


@pytest.mark.parametrize('steps', [0, 10, 36, 45])
def test_where_the_solver_fails_the_best_iterate_counts(monkeypatch, steps):
    """Fly-hover-fly has 2.13, and the first start 2.5 after ten steps."""
    advance, numbers = InteriorPointSolver.advance, count(1)

    def fail_later(solver, most, final):
        if next(numbers) > steps:
            raise NumericalError('no Newton step could be computed')
        return advance(solver, 1, final)

    monkeypatch.setattr(InteriorPointSolver, 'advance', fail_later)
    plan = solve(Scenario.paper(1000.0, 10.0, slots=1000))
    assert plan.status == 'numerical_trouble'
    assert plan.rate > (4.2 if steps > 30 else 2.5 if steps else 2.1)
    assert plan.history[-1].rate == pytest.approx(plan.rate, rel=1e-9)


def test_a_solved_mission_keeps_no_callback_alive():
    class Callback:

        def __call__(self, _):
            pass

    scenario = with_uavs(Scenario.paper(120.0, slots=40), max_acceleration=3.0,
                         start_velocity=(3.0, 4.0))
    callback = Callback()
    kept = weakref.ref(callback)
    plan = solve(scenario, on_iteration=callback)
    del callback
    gc.collect()
    assert plan.rate > 0 and kept() is None


def test_the_default_method_does_not_import_cvxpy():
    script = ('import sys; from secure_uav_planner import Scenario, solve; '
              'solve(Scenario.paper(102.0, slots=8)); sys.exit("cvxpy" in sys.modules)')
    run_python('-c', script)


def test_a_warm_start_is_polished_first_and_as_good_as_one_from_scratch():
    plan = solve(random_mission(6126, 60))
    assert len(solve(plan.scenario, initial=plan).history) < 0.4 * len(plan.history)
    first, *others = plan.scenario.eavesdroppers
    place = first.position[0], first.position[1] + 30.0
    moved = replace(plan.scenario, duration=1.1 * plan.scenario.duration,
                    eavesdroppers=(replace(first, position=place), *others))
    cold, warm = solve(moved), solve(moved, initial=plan)
    assert warm.rate >= cold.rate and warm.status == 'converged'
    # As after a time limit, the rate of the warm start is there when the rest is stopped.
    polished = len(warm.history) - len(cold.history)
    stopped = solve(moved, initial=plan,
                    on_iteration=lambda iteration: iteration.number == polished + 5)
    assert stopped.status == 'cancelled'
    assert cold.rate > stopped.rate >= warm.history[polished - 1].rate > warm.history[0].rate


@pytest.mark.parametrize('slots, least', [(30, 0.99), (75, 0.97), (120, 0.96), (180, 0.95)])
def test_a_plan_keeps_its_rate_in_other_slots_within_limits_of_acceleration(slots, least):
    scenario = with_uavs(random_mission(6010, 60), max_acceleration=3.0)
    plan = solve(scenario)
    other = replace(scenario, slots=slots,
                    duration=scenario.times[-1] * slots / (slots + 1))
    positions, powers = adapt_plan(Problem(other), plan)
    assert Plan(other, positions, powers).guaranteed_rate >= least * plan.rate
    assert solve(other, initial=plan).rate >= 0.999 * solve(other).rate


def test_tolerances_are_relative_where_the_signal_is_weak():
    """Then rates are proportional to the SNR."""
    scenario = Scenario.paper(200.0)
    for snr, near in ((0.0, 1e-3), (-37.0, 1e-6), (-150.0, 1e-6)):
        weak = replace(scenario, reference_snr_db=snr)
        for plan in (solve(weak), solve(weak, objective='worst_case')):
            assert plan.rate / weak.reference_snr == pytest.approx(1.140324e-4, rel=near)
        assert fly_hover_fly(weak, 'optimised').rate / weak.reference_snr == pytest.approx(
            1.1297e-4, rel=1e-3)


def test_jammers_that_may_have_too_much_power_do_as_well_as_with_less():
    scenario, rates = random_mission(6205, 60), []
    for power in (1e-4, 1.0, 1e4):
        transmitter, *jammers = scenario.uavs
        uavs = (replace(transmitter, average_power=1e-4, peak_power=4e-4), *(
            replace(uav, average_power=power, peak_power=4 * power) for uav in jammers))
        rates.append(solve(replace(scenario, uavs=uavs)).rate)
    assert min(rates) >= 0.98 * max(rates)  # With 1e4 W it was 0.82.


def test_slots_without_power_can_transmit_again():
    scenario = Scenario.paper(120)
    silent = fly_hover_fly(scenario)
    powers = silent.powers.copy()
    powers[0] = 0.0
    plan = solve(scenario, method='joint', initial=replace(silent, powers=powers))
    assert plan.history[0].guaranteed_rate == 0.0
    assert plan.guaranteed_rate > fly_hover_fly(scenario, 'optimised').guaranteed_rate


@pytest.mark.parametrize('objective', ['guaranteed', 'worst_case'])
def test_slots_that_a_local_optimum_has_lost_carry_again_or_are_silent(objective):
    plan = optimize.solve(Scenario.paper(200.0, 60.0, slots=50), objective=objective)
    powers = plan.powers.copy()
    powers[:, [10, 25]] = 0.0
    powers[:, 40] = 1e-4, 0.5  # So much jamming that nothing arrives.
    spoiled = Incumbent(Problem(plan.scenario), plan.positions, powers, objective=objective)
    lost, carrying = spoiled.rate, np.count_nonzero(plan.powers[0])
    mended = spoiled.to_plan('joint', 'converged')
    rates = getattr(mended, f'{objective}_rates')
    assert mended.rate > lost and mended.rate == pytest.approx(plan.rate, rel=1e-3)
    idle = rates <= 1e-3 * rates.mean()
    assert np.count_nonzero(~idle) == carrying and not mended.powers[:, idle].any()


def test_a_search_ends_with_time_left_for_its_last_proposals():
    """An incumbent's deadline is over when less time is left than a proposal has taken."""
    class NearlyOver(Deadline):
        """A deadline 1 ns ahead."""

        time_left = 1e-9

    deadline = NearlyOver()
    deadline.raise_if_over()
    plan = fly_hover_fly(Scenario.paper(100))
    incumbent = Incumbent(Problem(plan.scenario), plan.positions, plan.powers, deadline)
    with pytest.raises(TimeLimitError):
        incumbent.raise_if_over()
