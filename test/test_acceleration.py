"""Vehicles with a limit of acceleration, which fly the curve that the points control."""

from dataclasses import replace
from functools import partial

from hypothesis import given, settings
from hypothesis import strategies as st
import numpy as np
import pytest
from secure_uav_planner import Eavesdropper, fly_hover_fly, NoFlyZone, optimize, Scenario, Uav
from secure_uav_planner.errors import InfeasibleMissionError, PlanError, TimeLimitError
from secure_uav_planner.mission.kinematics import Vehicle
from secure_uav_planner.model.cone_program import minimise_utilisation
from secure_uav_planner.model.problem import Problem
from secure_uav_planner.optimize.initial.trajectories import check_durations
from strategies import scenarios, with_uavs

solve = partial(optimize.solve, objective='guaranteed')  # (P2), which has reference values.


def limit_paper(duration, acceleration, **changes):
    """Return the paper's scenario with an acceleration limit of both UAVs."""
    return with_uavs(Scenario.paper(float(duration)), max_acceleration=acceleration, **changes)


FREE = {'start_velocity': None, 'goal_velocity': None}


@pytest.mark.parametrize('acceleration, ends, duration, best_known', [
    (5.0, {}, 102, 1.1707), (5.0, {}, 120, 1.9497), (5.0, {}, 200, 2.9961),
    (3.0, {}, 102, 0.6339), (3.0, {}, 120, 1.8967), (3.0, {}, 200, 2.9644),
    (2.0, {}, 120, 1.8360), (2.0, {}, 200, 2.9281), (1.0, {}, 120, 1.6452),
    (1.0, {}, 200, 2.8142),
    # Nearly the rates without a limit.
    (1.0, FREE, 102, 1.3695), (1.0, FREE, 120, 1.9855), (1.0, FREE, 200, 3.0176)])
def test_the_best_known_rates_with_a_limit_are_reached(acceleration, ends, duration, best_known):
    plan = solve(limit_paper(duration, acceleration, **ends))
    assert plan.status == 'converged'
    assert plan.guaranteed_rate >= 0.999 * best_known


def find_largest_acceleration(vehicle, path, step):
    """Return the largest of the flown curve, by differences of its control points."""
    start, goal = vehicle.start_velocity, vehicle.goal_velocity
    before = [] if start is None else [path[0] - step * np.array(start)]
    after = [] if goal is None else [path[-1] + step * np.array(goal)]
    points = np.array([*before, *path, *after])
    return np.linalg.norm(np.diff(points, n=2, axis=0), axis=-1).max(initial=0.0) / step**2


@settings(max_examples=60)
@given(scenarios(max_uavs=1), st.floats(0, 1))
def test_the_flight_of_least_utilisation_uses_no_more_than_another(scenario, share):
    plan = fly_hover_fly(scenario)
    utilisation, flight = minimise_utilisation(
        scenario.uavs[0].vehicle, scenario.slots, scenario.slot_duration)
    positions = scenario.starts[0] + flight
    assert np.allclose(positions[-1], scenario.goals[0])
    replace(plan, positions=np.concatenate(
        [positions[None, :-1], scenario.goals[None, None, 0]], axis=1))
    moves = np.linalg.norm(np.diff(plan.positions[0], axis=0), axis=-1).max()
    most = [moves / scenario.max_step[0]]
    if scenario.uavs[0].max_acceleration is not None:
        most.append(find_largest_acceleration(
            scenario.uavs[0], plan.positions[0], scenario.slot_duration)
            / scenario.uavs[0].max_acceleration)
    assert utilisation <= max(most) * (1 + 1e-6) + 1e-9


def test_an_infeasible_mission_names_the_uav_its_limits_and_the_shortest_duration():
    with pytest.raises(InfeasibleMissionError, match=(
            r'uav1 needs at least 102\.99 s from start to goal at 10 m/s and 2 m/s\^2')):
        limit_paper(102, 2.0)
    replace(limit_paper(200, 2.0), duration=102.99, slots=102)
    slow = Uav('a', (0.0, 0.0), (300.0, 0.0), 100.0, 10.0, max_acceleration=0.5,
               start_velocity=(-9.0, 3.0), goal_velocity=None)
    scenario = replace(Scenario.paper(), uavs=(slow,), duration=30.0, slots=50)
    with pytest.raises(InfeasibleMissionError) as error:
        fly_hover_fly(scenario)
    shortest = float(str(error.value).split('at least ')[1].split(' s')[0])
    assert fly_hover_fly(replace(scenario, duration=shortest))
    with pytest.raises(InfeasibleMissionError):
        fly_hover_fly(replace(scenario, duration=shortest - 0.01))


def random_vehicles(rng):
    """Return UAVs of very different speeds, accelerations, distances and end velocities."""
    def velocity(speed):
        angle, share = rng.uniform(0, 2 * np.pi), rng.choice([1.0, 10**rng.uniform(-6, 0)])
        moving = float(share * speed * np.cos(angle)), float(share * speed * np.sin(angle))
        return [None, (0.0, 0.0), moving, moving][rng.integers(4)]

    limited = rng.random() < 0.8
    for number in range(rng.integers(1, 4)):
        speed, size = 10**rng.uniform(-2, 4), 10**rng.uniform(-1, 5)
        yield Uav(f'uav{number}', tuple(rng.normal(0, size, 2)), tuple(rng.normal(0, size, 2)),
                  100.0, speed, start_velocity=velocity(speed), goal_velocity=velocity(speed),
                  max_acceleration=10**rng.uniform(-5, 4) if limited else None)


def test_the_duration_that_a_refusal_names_suffices_for_all_uavs_of_any_legal_mission():
    rng, refused = np.random.default_rng(7), 0
    for _ in range(150):
        fields = {'uavs': tuple(random_vehicles(rng)), 'duration': 10**rng.uniform(-2, 5),
                  'slots': int(rng.choice([1, 2, 5, 20, 150]))}
        try:
            fly_hover_fly(replace(Scenario.paper(1e4), **fields))
        except InfeasibleMissionError as error:
            texts = [str(item) for item in (error, *error.further)]
            if 'none of up to' in texts[0]:
                continue
            named = [float(text.split('at least ')[1].split(' s')[0]) for text in texts]
            assert named[0] > fields['duration'] and max(named) == named[0]
            assert fly_hover_fly(replace(Scenario.paper(1e4), **{**fields, 'duration': named[0]}))
            refused += 1
    assert refused > 90


def test_slots_of_half_a_millisecond_do_not_hide_an_acceleration():
    uavs = tuple(Uav(f'uav{x}', (x, 500.0), (x, 500.0), 100.0, 10.0, max_acceleration=2.0)
                 for x in (0.0, 30.0))
    plan = fly_hover_fly(Scenario((0.0, 0.0), (Eavesdropper((200.0, 0.0)),), uavs, 10.0, 20000))
    turn = 2 * np.pi / plan.times[-1]

    def swing(acceleration):
        positions = np.repeat(plan.positions[:, :1], len(plan.times), axis=1)
        positions[0, :, 1] += acceleration / turn**2 * (1 - np.cos(turn * plan.times))
        return replace(plan, positions=positions)

    swing(1.9)
    with pytest.raises(PlanError, match='uav0.0 accelerates by 3.0'):
        swing(3.0)


def test_a_search_for_the_time_that_a_uav_needs_ends_with_the_time_limit():
    def check():
        calls.append(None)
        if len(calls) == most:
            raise TimeLimitError('late')

    scenario = replace(limit_paper(200, 2.0, start_velocity=(0.0, -5.0)), duration=102.0)
    calls, most = [], None
    with pytest.raises(InfeasibleMissionError, match='uav1 needs at least .* s'):
        check_durations(Problem(scenario), check)
    for last, error, text in ((1, TimeLimitError, 'late'),
                              (len(calls) // 2, InfeasibleMissionError, 'uav1 needs longer')):
        calls, most = [], last
        with pytest.raises(error, match=text):
            check_durations(Problem(scenario), check)


@settings(max_examples=60)
@given(scenarios(max_uavs=2), st.integers(0, 190))
def test_between_its_ends_a_curve_with_more_slots_nearly_keeps_its_acceleration(scenario, more):
    coarse, plan = Problem(scenario).grid, fly_hover_fly(scenario)
    fine = coarse.with_slots(scenario.slots + more)
    x = coarse.refine(coarse.variables(plan.positions[:, 1:-1], plan.powers), fine.slots)
    for uav, path in zip(scenario.uavs, fine.positions(x)):
        inside = replace(uav, start_velocity=None, goal_velocity=None)
        assert find_largest_acceleration(inside, path, fine.slot_duration) <= 3 * (
            uav.max_acceleration or np.inf)


def test_a_hundred_times_as_many_slots_change_a_smooth_flight_by_little():
    vehicle = Vehicle((0.0, -1000.0), 10.0, 2.0, (0.0, 0.0), (0.0, 0.0))
    coarse, fine = (minimise_utilisation(vehicle, slots, 200.0 / slots)[0]
                    for slots in (200, 20000))
    assert coarse == pytest.approx(fine, rel=0.02)


def fly_across(ends, geofence=((-100, -100), (100, -100), (100, 100), (-100, 100)), **fields):
    """Return a mission of long slots whose UAVs fly from west to east within a fence."""
    return Scenario((0.0, 0.0), (Eavesdropper((50.0, 50.0)),), tuple(
        Uav(f'uav{number}', (-80.0, 30.0 * number), (80.0, 30.0 * number), 50.0, 10.0,
            max_acceleration=1.0, **velocities) for number, velocities in enumerate(ends)),
        geofence=geofence, **{'duration': 60.0, 'slots': 5, **fields})


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
