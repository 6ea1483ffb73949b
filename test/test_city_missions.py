"""Random missions with all limits at once, checked by dense sampling of the flown curves."""

from dataclasses import replace
from itertools import combinations
import math
import re

import clarabel
import numpy as np
import pytest
from random_cities import random_city_mission
from secure_uav_planner import (
    Eavesdropper, fly_hover_fly, NoFlyZone, Scenario, solve, Uav)
from secure_uav_planner.errors import InfeasibleMissionError, StoppedError, TimeLimitError
from secure_uav_planner.model.problem import Problem
from secure_uav_planner.optimize.initial import fly_hover_fly_positions, projection
from secure_uav_planner.plan.splice import continue_plan, cut_tail
import shapely
from strategies import with_uavs

SAMPLES = 40  # In a slot.
TOLERANCE = 1e-4  # m


def curve(uav, path, step):
    """Return the places that a UAV flies through at many times from -1/2 to N+3/2 slots."""
    last = len(path) - 1
    times = np.linspace(-0.5, last + 0.5, SAMPLES * (last + 1) + 1)
    if uav.max_acceleration is None:
        inside = np.clip(times, 0, last)
        return np.stack([np.interp(inside, np.arange(last + 1), x) for x in path.T], axis=-1)
    first = path[0] - (path[1] - path[0] if uav.start_velocity is None
                       else np.array(uav.start_velocity) * step)
    beyond = path[-1] + (path[-1] - path[-2] if uav.goal_velocity is None
                         else np.array(uav.goal_velocity) * step)
    points = np.concatenate([[first], path, [beyond]])
    node = np.clip(np.round(times), 0, last).astype(int)
    by = (times - node)[:, None]
    # The three basis functions of a uniform quadratic B-spline.
    return (0.5 * (0.5 - by)**2 * points[node] + (0.75 - by**2) * points[node + 1]
            + 0.5 * (0.5 + by)**2 * points[node + 2])


def check_flight(plan):
    """Assert all limits of a plan: of its flights at many times, with their margin, and powers."""
    scenario = plan.scenario
    margin = scenario.tracking_margin
    for ends, points in ((scenario.starts, plan.positions[:, 0]),
                         (scenario.goals, plan.positions[:, -1])):
        assert np.abs(points - ends).max() <= 1e-6
    for uav, watts in zip(scenario.uavs, plan.powers, strict=True):
        assert 0.0 <= watts.min() and watts.max() <= uav.peak_power + 1e-9
        assert watts.mean() <= uav.average_power + 1e-9
    step = scenario.slot_duration
    curves = [curve(uav, path, step) for uav, path in zip(scenario.uavs, plan.positions)]
    seconds = step / SAMPLES
    for uav, places in zip(scenario.uavs, curves):
        speed = np.linalg.norm(np.diff(places, axis=0), axis=1) / seconds
        assert speed.max() <= uav.max_speed * (1 + 1e-6) + TOLERANCE / seconds * 1e-3
        if uav.max_acceleration is not None:
            change = np.linalg.norm(np.diff(places, n=2, axis=0), axis=1) / seconds**2
            assert change.max() <= uav.max_acceleration * 1.001 + 1e-6 / seconds**2
        points = shapely.points(places)
        for zone in scenario.no_fly_zones:
            if zone.floor - margin <= uav.altitude <= zone.ceiling + margin:
                grown = shapely.Polygon(zone.vertices).buffer(margin - TOLERANCE, quad_segs=64)
                assert not shapely.contains(grown, points).any(), f'{uav.name} enters {zone.name}'
        if scenario.geofence is not None:
            fence = shapely.Polygon(scenario.geofence).buffer(TOLERANCE - margin)
            assert shapely.contains(fence, points).all(), f'{uav.name} leaves the fence'
    least = scenario.separation + 2 * margin if scenario.separation else 0.0
    for (uav, places), (neighbour, nearby) in combinations(zip(scenario.uavs, curves), 2):
        distances = np.hypot(np.linalg.norm(places - nearby, axis=1),
                             uav.altitude - neighbour.altitude)
        assert distances.min() >= least - TOLERANCE, f'{uav.name} and {neighbour.name}'


def fly(scenario, objective='guaranteed'):
    """Return the plan of a mission and its baseline, both checked; the plan is not below it."""
    baseline = fly_hover_fly(scenario, 'optimised')
    check_flight(baseline)
    plan = solve(scenario, objective=objective)
    check_flight(plan)
    assert plan.rate >= getattr(baseline, f'{objective}_rate') - 1e-6
    return plan, baseline


@pytest.mark.parametrize('seed, slots, margin, objective', [
    *((seed, 60, 0.0, 'guaranteed') for seed in range(6)), (8, 20, 0.0, 'worst_case'),
    (4, 40, 8.0, 'guaranteed'), (5, 40, 3.0, 'guaranteed'),
    (160, None, 0.0, 'guaranteed')])  # The last is too tight for few slots, and starts on more.
def test_a_plan_keeps_all_limits_all_the_time_and_is_not_below_its_baseline(
        seed, slots, margin, objective):
    plan, _ = fly(replace(random_city_mission(seed, slots), tracking_margin=margin), objective)
    assert plan.status == 'converged' and plan.clearance.zones_beyond_margin > -TOLERANCE


@pytest.mark.parametrize('scenario, points', [
    (random_city_mission(1, slots=60), (1, 25, 59)),
    (with_uavs(Scenario.paper(120.0), max_acceleration=2.0), (0, 1, 57, 118))],
    ids=['city', 'limit of acceleration'])
def test_a_tail_goes_on_with_the_velocity_it_has_around_obstacles(scenario, points):
    plan, _ = fly(scenario)
    for point in points:
        tail = cut_tail(plan, point)
        again = solve(tail.scenario, initial=tail, objective='guaranteed')
        check_flight(again)
        assert again.guaranteed_rate >= tail.guaranteed_rate - 1e-6, point
        whole = continue_plan(plan, point, again)  # It checks the acceleration where they meet.
        check_flight(whole)
        assert whole.guaranteed_rate >= plan.guaranteed_rate - 1e-6, point


def test_a_plan_for_another_mission_is_bent_around_obstacles():
    scenario = random_city_mission(3, slots=60)
    before = solve(replace(scenario, no_fly_zones=(), geofence=None, separation=0.0),
                   objective='guaranteed')
    plan = solve(scenario, initial=before, objective='guaranteed')
    check_flight(plan)
    assert plan.guaranteed_rate >= 0.9 * fly(scenario)[0].guaranteed_rate


def circle(centre, radius, corners=48):
    """Return a zone around a circle."""
    angles = 2 * np.pi * np.arange(corners) / corners
    radius /= np.cos(np.pi / corners)
    return NoFlyZone(tuple((centre[0] + radius * x, centre[1] + radius * y) for x, y in zip(
        np.cos(angles).tolist(), np.sin(angles).tolist())), name='circle')


@pytest.mark.parametrize('duration, centre, best_known', [
    (102, (23.0, 252.0), 1.1704), (120, (-28.0, 252.0), 1.9441), (200, (-28.0, 252.0), 2.9926)])
def test_the_best_known_rates_around_a_circle_are_reached(duration, centre, best_known):
    scenario = replace(Scenario.paper(float(duration)), no_fly_zones=(circle(centre, 80.0),))
    plan = solve(scenario, objective='guaranteed')
    check_flight(plan)
    assert plan.guaranteed_rate >= 0.998 * best_known


@pytest.mark.parametrize('duration, best_known', [(102, 1.5053), (120, 2.0810), (200, 3.1444)])
def test_the_best_known_rates_with_a_separation_are_reached(duration, best_known):
    scenario = Scenario.paper(float(duration))
    uavs = tuple(replace(uav, start=(x, 500.0), goal=(x, -500.0), altitude=100.0)
                 for uav, x in zip(scenario.uavs, (90.0, 110.0)))
    plan = solve(replace(scenario, uavs=uavs, separation=20.0), objective='guaranteed')
    check_flight(plan)
    assert plan.guaranteed_rate >= 0.9999 * best_known


@pytest.mark.parametrize('acceleration', [None, 3.0])
def test_uavs_on_crossing_ways_pass_each_other(acceleration):
    scenario = Scenario.paper(150.0, slots=75)
    uavs = tuple(replace(uav, start=start, goal=goal, altitude=100.0,
                         max_acceleration=acceleration)
                 for uav, start, goal in zip(scenario.uavs, ((-400.0, 0.0), (0.0, -400.0)),
                                             ((400.0, 0.0), (0.0, 400.0))))
    fly(replace(scenario, uavs=uavs, separation=30.0))


def walled(duration, gap):
    """Return the paper's scenario with a wall across the way of the first UAV."""
    scenario = Scenario.paper(float(duration))
    wall = NoFlyZone(((-300.0, 240.0), (400.0, 240.0), (400.0, 260.0), (-300.0, 260.0)),
                     ceiling=105.0, name='wall')
    fence = ((-400.0, -600.0), (gap, -600.0), (gap, 600.0), (-400.0, 600.0))
    return replace(scenario, no_fly_zones=(wall,), geofence=fence)


def test_an_obstacle_is_named_with_the_shortest_duration_that_can_be_flown():
    with pytest.raises(InfeasibleMissionError, match=(
            'duration is 102 s; uav1 needs at least .* s from start to goal around wall')
            ) as error:
        solve(walled(102, 450.0))
    shortest = float(str(error.value).split('at least ')[1].split(' s')[0])
    way = math.hypot(300, 240) + 20 + math.hypot(300, 740)  # around the corners of the wall
    assert way / 10 * 102 / 103 <= shortest <= 1.003 * way / 10 * 102 / 103
    check_flight(solve(replace(walled(200, 450.0), duration=shortest, slots=102)))


def check_named_duration(scenario, text):
    """Assert that flights keep all limits in the duration that a refusal names."""
    duration = float(re.search(r'(?:at least|duration of) ([0-9.]+) s', text)[1])
    assert duration > scenario.duration
    check_flight(fly_hover_fly(replace(scenario, duration=duration)))


@pytest.mark.parametrize('seed, text', [
    (9, 'duration is .* uav1 needs at least .* s from start to goal around zone 1'),
    # Each UAV alone needs less than both.
    (10, 'no flights of uav1 and uav2 were found .* with a duration of .* s, some were')])
def test_the_duration_that_the_refusal_of_a_city_names_is_enough_for_all(seed, text):
    scenario = random_city_mission(seed, slots=40, slack=0.0)
    scenario = replace(scenario, duration=0.99 * scenario.duration)
    with pytest.raises(InfeasibleMissionError, match=text) as error:
        fly_hover_fly(scenario)
    check_named_duration(scenario, str(error.value))


@pytest.mark.parametrize('start, limit, gap, half, duration, slots', [
    ((239.66, 280.95), 2.0, -72.28, 2.0, 210.89, 34),  # However long.
    ((-20.0, 500.0), None, 0.0, 20.0, 1250.0, 20)])  # No way.
def test_a_narrow_gap_that_long_slots_cannot_pass_is_refused_with_slots_that_can(
        start, limit, gap, half, duration, slots):
    west, east = ([(gap + side * x, y)
                   for x, y in ((2.5, -half), (900, -half), (900, half), (2.5, half))]
                  for side in (-1, 1))
    scenario = Scenario(
        (0.0, 0.0), (Eavesdropper((200.0, 0.0)),),
        (Uav('uav1', start, (100.0, -500.0), 100.0, 10.0, max_acceleration=limit),),
        duration, slots, no_fly_zones=(NoFlyZone(west), NoFlyZone(east)),
        geofence=((-800, -800), (800, -800), (800, 800), (-800, 800)))
    with pytest.raises(InfeasibleMissionError, match='slots are .* s long, and with') as error:
        fly_hover_fly(scenario)
    slots = int(re.search(r'with (\d+) slots such flights', str(error.value))[1])
    check_flight(fly_hover_fly(replace(scenario, slots=slots)))


class Clock:
    """A check that raises an error from some call on."""

    def __init__(self, error=None, calls=math.inf):
        self.error, self.most, self.calls = error, calls, 0

    def __call__(self):
        self.calls += 1
        if self.calls >= self.most:
            raise self.error


def count_checks(scenario):
    """Return the number of checks in the search for first flights."""
    clock = Clock()
    try:
        fly_hover_fly_positions(Problem(scenario), clock)
    except InfeasibleMissionError:
        pass
    return clock.calls


def test_a_search_for_first_flights_ends_as_soon_as_a_check_says_so():
    scenario = random_city_mission(2, slots=60)
    for calls in range(1, count_checks(scenario) + 1):
        clock = Clock(StoppedError('stop'), calls)
        with pytest.raises(StoppedError):
            fly_hover_fly_positions(Problem(scenario), clock)
        assert clock.calls == calls


def test_a_mission_without_flights_is_only_infeasible_when_they_were_searched_in_vain():
    scenario = walled(102, 450.0)
    # The jammer's flights are searched, too, but the answer for the transmitter stands by then.
    scenario = replace(scenario, uavs=scenario.uavs[:1])
    whole, outcomes = count_checks(scenario), []
    for calls in np.linspace(1, whole, 5).round().tolist():
        with pytest.raises((InfeasibleMissionError, TimeLimitError)) as caught:
            fly_hover_fly_positions(Problem(scenario), Clock(TimeLimitError('late'), calls))
        outcomes.append(type(caught.value))
        if caught.type is InfeasibleMissionError:
            assert re.search('in the time for the search$|uav1 needs longer', str(caught.value))
    assert outcomes[0] is TimeLimitError and outcomes[-1] is InfeasibleMissionError
    assert outcomes == sorted(outcomes, key=[TimeLimitError, InfeasibleMissionError].index)


def test_a_deadline_before_first_flights_says_so_and_a_cancel_likewise():
    scenario = random_city_mission(4, slots=60)
    with pytest.raises(TimeLimitError, match=r'time_limit is 1e-06 s; it was over before'):
        solve(scenario, time_limit=1e-6)
    iterations = []
    with pytest.raises(StoppedError, match='cancelled before flights'):
        solve(scenario, on_iteration=lambda iteration: iterations.append(iteration) or True)
    assert [(iteration.number, iteration.rate) for iteration in iterations] == [(0, 0.0)]


def barred(slots, acceleration):
    """Return a mission whose straight ways are barred by zones."""
    scenario = Scenario.paper(400.0, slots=slots)
    uavs = tuple(replace(uav, start=(x, 500.0), goal=(x, -500.0), altitude=100.0,
                         max_acceleration=acceleration)
                 for uav, x in zip(scenario.uavs, (100.0, 130.0)))
    zones = tuple(circle((60.0 * column, 300.0 - 300.0 * row), 40.0, 8)
                  for row in range(2) for column in range(4))
    return replace(scenario, uavs=uavs, separation=20.0, no_fly_zones=zones)


@pytest.fixture
def sizes(monkeypatch):
    """Return the numbers of variables of the problems that Clarabel gets."""
    variables, healthy = [], clarabel.DefaultSolver
    monkeypatch.setattr(clarabel, 'DefaultSolver', lambda *problem: (
        variables.append(problem[2].shape[1]) or healthy(*problem)))
    return variables


@pytest.mark.parametrize('acceleration', [None, 3.0])
def test_first_flights_of_many_slots_are_found_with_few_steps_of_clarabel(
        acceleration, sizes):
    plan = fly_hover_fly(barred(20000, acceleration))  # A Plan checks all its limits.
    few = fly_hover_fly(barred(400, acceleration))
    assert max(sizes) <= 2 * 2 * 500 + 2
    assert plan.guaranteed_rate == pytest.approx(few.guaranteed_rate, rel=0.03)


def test_many_uavs_are_moved_a_few_at_a_time(monkeypatch, sizes):
    monkeypatch.setattr(projection, '_MOST_MOVED', 120)
    scenario = barred(80, 3.0)
    uavs = tuple(replace(scenario.uavs[0], name=f'uav{index}', start=(30.0 * index, 500.0),
                         goal=(30.0 * (index ^ 1), -500.0)) for index in range(6))
    fly_hover_fly(replace(scenario, uavs=uavs))
    assert max(sizes) <= 2 * 120 + 2 and len(sizes) > 1


@pytest.mark.parametrize('fields', [
    {}, {'max_speed': 1e5}, {'max_speed': 1e5, 'max_acceleration': 2.0}])
@pytest.mark.parametrize('duration', [200.0, 1e6])
def test_a_zone_that_is_far_away_changes_nothing(duration, fields):
    scenario = with_uavs(Scenario.paper(duration, slots=100), **fields)
    zone = NoFlyZone(((2000.0, 2000.0), (2100.0, 2000.0), (2050.0, 2100.0)))
    alone = solve(scenario, objective='guaranteed')
    beside = solve(replace(scenario, no_fly_zones=(zone,)), objective='guaranteed')
    assert beside.guaranteed_rate == pytest.approx(alone.guaranteed_rate, rel=1e-6)


def test_a_flight_through_a_zone_that_is_far_away_is_refused():
    scenario = Scenario.paper(1000.0, slots=100)
    zone = NoFlyZone(((1500.0, -50.0), (1600.0, -50.0), (1600.0, 50.0), (1500.0, 50.0)))
    positions = fly_hover_fly_positions(Problem(scenario))
    assert Problem(replace(scenario, no_fly_zones=(zone,))).is_clear(positions)
    positions[0, 40:60] = 1550.0, 0.0
    assert not Problem(replace(scenario, no_fly_zones=(zone,))).is_clear(positions)


@pytest.mark.soak
def test_two_hundred_random_missions_with_all_limits():
    refused, gains = [], []
    for seed in range(200):
        try:
            plan, baseline = fly(random_city_mission(seed))
        except InfeasibleMissionError as error:
            refused.append((seed, str(error)))
            continue
        gains.append(plan.guaranteed_rate - baseline.guaranteed_rate)
    print(f'\n{len(gains)} flown, {np.median(gains):.3f} bit/s/Hz above the baseline in the '
          f'median; {len(refused)} refused: {refused}')
    for seed, text in refused:
        check_named_duration(random_city_mission(seed), text)
