"""Vehicles with a limit of acceleration, which fly the curve that the points control."""

from dataclasses import replace
from functools import partial

from hypothesis import given, settings
from hypothesis import strategies as st
import numpy as np
import pytest
from secure_uav_planner import (
    Eavesdropper, fly_hover_fly, NoFlyZone, optimize, Plan, Scenario, Uav)
from secure_uav_planner.errors import InfeasibleMissionError, PlanError
from secure_uav_planner.mission.kinematics import Vehicle
from secure_uav_planner.model.grid import Grid
from strategies import scenarios, with_uavs

solve = partial(optimize.solve, objective='guaranteed')  # (P2), which has reference values.


def limit_paper(duration, acceleration, **changes):
    """Return the paper's scenario with an acceleration limit of both UAVs."""
    return with_uavs(Scenario.paper(float(duration)), max_acceleration=acceleration, **changes)


@pytest.mark.parametrize('acceleration, duration, best_known', [
    (5.0, 102, 1.1707), (5.0, 120, 1.9497), (5.0, 200, 2.9961), (3.0, 102, 0.6339),
    (3.0, 120, 1.8967), (3.0, 200, 2.9644), (2.0, 120, 1.8360), (2.0, 200, 2.9281),
    (1.0, 120, 1.6452), (1.0, 200, 2.8142)])
def test_the_best_known_rates_with_a_limit_are_reached(acceleration, duration, best_known):
    plan = solve(limit_paper(duration, acceleration))
    assert plan.status == 'converged'
    assert plan.guaranteed_rate >= 0.999 * best_known


@pytest.mark.parametrize('duration, best_known', [(102, 1.3695), (120, 1.9855), (200, 3.0176)])
def test_free_ends_cost_next_to_nothing(duration, best_known):
    scenario = limit_paper(duration, 1.0, start_velocity=None, goal_velocity=None)
    assert solve(scenario).guaranteed_rate >= 0.999 * best_known


def accelerations(plan, uav):
    """Return the accelerations of the flown curve, by differences of its control points."""
    scenario = plan.scenario
    step = scenario.slot_duration
    path = plan.positions[uav]
    vehicle = scenario.uavs[uav]
    begin = path[0] - np.array(vehicle.start_velocity or (path[1] - path[0]) / step) * step
    end = path[-1] + np.array(vehicle.goal_velocity or (path[-1] - path[-2]) / step) * step
    points = np.concatenate([[begin], path, [end]])
    return np.linalg.norm(np.diff(points, n=2, axis=0), axis=-1) / step**2


@settings(max_examples=25)
@given(scenarios(max_uavs=2, max_eavesdroppers=1))
def test_every_plan_keeps_its_limits_by_an_independent_measure(scenario):
    for plan in (solve(scenario), fly_hover_fly(scenario)):
        for number, uav in enumerate(scenario.uavs):
            if uav.max_acceleration is not None:
                assert accelerations(plan, number).max() <= (
                    uav.max_acceleration + 2e-6 / scenario.slot_duration**2)


@settings(max_examples=60)
@given(scenarios(max_uavs=1), st.floats(0, 1))
def test_the_flight_of_least_effort_uses_no_more_than_another(scenario, share):
    plan = fly_hover_fly(scenario)
    effort, flight = scenario.uavs[0].vehicle.least_effort(
        scenario.slots, scenario.slot_duration)
    positions = scenario.starts[0] + flight
    assert np.allclose(positions[-1], scenario.goals[0])
    replace(plan, positions=np.concatenate(
        [positions[None, :-1], scenario.goals[None, None, 0]], axis=1))
    moves = np.linalg.norm(np.diff(plan.positions[0], axis=0), axis=-1).max()
    most = [moves / scenario.max_step[0]]
    if scenario.uavs[0].max_acceleration is not None:
        counted = slice(scenario.uavs[0].start_velocity is None,
                        None if scenario.uavs[0].goal_velocity is not None else -1)
        most.append(accelerations(plan, 0)[counted].max() / scenario.uavs[0].max_acceleration)
    assert effort <= max(most) * (1 + 1e-6) + 1e-9


def test_an_infeasible_mission_names_the_uav_its_limits_and_the_shortest_duration():
    with pytest.raises(InfeasibleMissionError, match=(
            r'uav1 needs at least 102\.99 s from start to goal at 10 m/s and 2 m/s\^2')):
        limit_paper(102, 2.0)
    replace(limit_paper(200, 2.0), duration=102.99, slots=102)
    slow = Uav('a', (0.0, 0.0), (300.0, 0.0), 100.0, 10.0, max_acceleration=0.5,
               start_velocity=(-9.0, 3.0), goal_velocity=None)
    scenario = replace(Scenario.paper(), uavs=(slow,), duration=200.0, slots=50)
    with pytest.raises(InfeasibleMissionError) as error:
        replace(scenario, duration=30.0)
    shortest = float(str(error.value).split('at least ')[1].split(' s')[0])
    assert replace(scenario, duration=shortest).efforts[0] <= 1 + 1e-9
    with pytest.raises(InfeasibleMissionError):
        replace(scenario, duration=shortest - 0.01)


def test_a_plan_that_accelerates_too_much_is_refused_with_the_place():
    scenario = limit_paper(200, 2.0)
    plan = solve(Scenario.paper(200.0))
    with pytest.raises(PlanError, match=r'uav1 accelerates by .* m/s\^2 at point \d+; at most 2'):
        Plan(scenario, plan.positions, plan.powers)


@pytest.mark.parametrize('point', [0, 1, 57, 118])
def test_the_tail_of_a_plan_goes_on_with_the_velocity_it_has(point):
    plan = solve(limit_paper(120, 2.0))
    tail = plan.tail(point)
    again = solve(tail.scenario, initial=tail)
    assert again.guaranteed_rate >= tail.guaranteed_rate - 1e-6
    whole = plan.continued(point, again)  # which checks the acceleration where they meet
    assert whole.guaranteed_rate >= plan.guaranteed_rate - 1e-6


@settings(max_examples=60)
@given(scenarios(max_uavs=2), st.integers(1, 200))
def test_a_curve_with_other_slots_keeps_its_ends_and_nearly_its_acceleration(scenario, slots):
    coarse = Grid.of(scenario)
    positions = fly_hover_fly(scenario).positions[:, 1:-1]
    x = coarse.variables(positions, np.ones(positions.shape[:2]))
    fine = coarse.with_slots(slots)
    path = fine.positions(coarse.refine(x, slots))
    assert np.isfinite(path).all()
    assert np.allclose(path[:, 0], scenario.starts) and np.allclose(path[:, -1], scenario.goals)


def test_a_hundred_times_as_many_slots_change_a_smooth_flight_by_little():
    vehicle = Vehicle((0.0, -1000.0), 10.0, 2.0, (0.0, 0.0), (0.0, 0.0))
    coarse, fine = (vehicle.least_effort(slots, 200.0 / slots)[0] for slots in (200, 20000))
    assert coarse == pytest.approx(fine, rel=0.02)


def fly_across(ends, geofence=((-100, -100), (100, -100), (100, 100), (-100, 100)), **fields):
    """Return a mission of long slots whose UAVs fly from west to east within a fence."""
    return Scenario((0.0, 0.0), (Eavesdropper((50.0, 50.0)),), tuple(
        Uav(f'uav{number}', (-80.0, 30.0 * number), (80.0, 30.0 * number), 50.0, 10.0,
            max_acceleration=1.0, **velocities) for number, velocities in enumerate(ends)),
        geofence=geofence, **{'duration': 60.0, 'slots': 5, **fields})


FREE = {'start_velocity': None, 'goal_velocity': None}
ZONES = tuple(NoFlyZone(((x, -300), (x + 20, -300), (x + 20, 300), (x, 300)))
              for x in (-110, 90))


@pytest.mark.parametrize('scenario', [
    fly_across([FREE]), fly_across([{'goal_velocity': None}, {}]),
    fly_across([{'goal_velocity': (3.0, 0.0)}]),
    fly_across([FREE], geofence=None, no_fly_zones=ZONES),
    fly_across([FREE, FREE], separation=25.0)])
def test_a_plan_is_found_whose_curve_keeps_clear_beyond_its_points(scenario):
    # A Plan checks its limits itself.
    assert solve(scenario).guaranteed_rate > 1.0


@pytest.mark.parametrize('ends, fields, field, message', [
    ([{'goal_velocity': (5.0, 0.0)}], {}, 'uavs[0]', 'takes uav0 .* goal inside the geofence at'),
    ([{'start_velocity': (0.0, 5.0)}],  # With slots of minutes it could not even begin inside.
     {'geofence': ((-100, -100), (100, -100), (100, 14), (-100, 14)), 'duration': 27.0,
      'slots': 60}, 'duration',
     'uav0 needs at least .* from start to goal inside the geofence at'),
    ([{'goal_velocity': (5.0, 0.0)}], {'geofence': None, 'no_fly_zones': ZONES}, 'uavs[0]',
     'goal around zone 1 or zone 2 at'),
    ([{'goal_velocity': (5.0, 0.0)}], {'no_fly_zones': ZONES}, 'uavs[0]',
     'goal around zone 1 or zone 2 inside the geofence at'),
    ([{'goal_velocity': (0.0, 2.0)}, {'goal_velocity': (0.0, -2.0)}], {'separation': 25.0},
     'separation', 'uav0 and uav1 were found that keep the separation of 25 m and stay inside')])
def test_ends_whose_velocity_leads_beyond_a_limit_are_refused(ends, fields, field, message):
    with pytest.raises(InfeasibleMissionError, match=message) as error:
        solve(fly_across(ends, **fields))
    assert error.value.field == field
