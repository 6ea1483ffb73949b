"""The shortest flight that delivers a number of bits."""

from dataclasses import replace
import math
import re

from benchmarks.missions import random_mission
from hypothesis import given, settings
from nav_msgs.msg import Path
import pytest
from ros_client import seconds
from ros_nodes import wait_for
from secure_uav_planner import (
    Eavesdropper, GroundNode, NoFlyZone, Plan, Scenario, shortest_duration, solve, Uav)
from secure_uav_planner.bound.shortest import check_bits
from secure_uav_planner.errors import InfeasibleMissionError, StoppedError, TimeLimitError
from secure_uav_planner.plan.splice import continue_plan, cut_tail
from strategies import scenarios, with_uavs


# As found by hand, in 150 slots.
@pytest.mark.parametrize('radius, bits, shortest', [
    (10.0, 150, 103.08), (10.0, 250, 122.72), (60.0, 150, 119.76), (60.0, 600, 246.38)])
def test_the_paper_s_flights_are_the_shortest_which_is_proven(radius, bits, shortest):
    scenario = Scenario.paper(math.ceil(shortest / 10) * 10.0, radius, slots=150)
    plan = shortest_duration(scenario, bits, objective='guaranteed')
    duration = plan.scenario.duration
    assert duration == pytest.approx(shortest, abs=0.3)
    assert plan.guaranteed_rate * duration >= bits
    assert plan.scenario.slot_duration == pytest.approx(scenario.slot_duration, rel=0.01)
    assert plan.message == (f'converged; this suffices for {bits} bit/Hz, and no flight of '
                            f'{math.floor(10 * duration - 10) / 10:.1f} s does, which is proven')


@pytest.mark.parametrize('seed', range(4))
def test_a_flight_that_is_found_suffices_and_solve_finds_none_that_is_shorter(seed):
    scenario = with_uavs(random_mission(seed, 75, jammers=seed % 3),
                         max_acceleration=2.0 if seed % 2 else None)
    bits = 0.8 * solve(scenario).rate * scenario.duration
    plan = shortest_duration(scenario, bits)
    duration = plan.scenario.duration
    assert plan.worst_case_rate * duration >= bits and duration <= scenario.duration
    shorter, longer = (replace(
        scenario, duration=share * duration, slots=round(share * plan.scenario.slots))
        for share in (0.98, 4.0))
    try:
        assert solve(shorter).rate * shorter.duration < bits
    except InfeasibleMissionError:
        pass
    # From another duration, it is the same.
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr('secure_uav_planner.bound.shortest.upper_bound', lambda *_, **__: bits)
        patch.setattr('secure_uav_planner.bound.shortest.explain_refusal', lambda _: 'not now')
        again = shortest_duration(longer, bits)
    assert again.scenario.duration == pytest.approx(duration, abs=0.005 * duration)


def test_slots_stay_exactly_as_long_where_a_uav_starts_in_motion():
    scenario = with_uavs(Scenario.paper(150.0, slots=90), max_acceleration=3.0,
                         start_velocity=(0.0, -8.0))
    plan = shortest_duration(scenario, 250.0)
    assert plan.scenario.slot_duration == pytest.approx(scenario.slot_duration, rel=1e-12)
    assert 250.0 <= plan.rate * plan.scenario.duration < 260.0


def test_a_plan_says_that_it_suffices_only_while_it_does(tmp_path):
    plan = shortest_duration(Scenario.paper(120.0, slots=40), 200.0)
    plan.save(tmp_path / 'plan.json')
    assert Plan.load(tmp_path / 'plan.json').message == plan.message
    assert 'suffices' in plan.message
    assert 'suffices' not in replace(plan, powers=0.5 * plan.powers).message
    assert 'suffices' not in cut_tail(plan, 3).message
    rest = replace(cut_tail(plan, 3), bits=1.0, too_short=60.0)  # As planned for by itself.
    assert 'suffices' in rest.message and 'suffices' not in continue_plan(plan, 3, rest).message


COVERED = replace(Scenario.paper(120.0, slots=6),
                  eavesdroppers=(Eavesdropper((0.0, 0.0), 50.0),))
SLOW = with_uavs(Scenario.paper(120.0), max_acceleration=3.0)


@pytest.mark.parametrize('scenario, bits, words', [
    (COVERED, 250.0, 'the disc of eavesdropper covers the ground node'),
    (Scenario.paper(120.0), 1e9, '20000 s in slots of 1 s, .* 305754 bit/Hz, .* longer slots'),
    (replace(Scenario.paper(120.0), reference_snr_db=-20.0), 9.0, r'at most 0\.115\d+ bit/Hz'),
    (with_uavs(SLOW, max_energy=1e8), 1e9, '20000 s in slots of 1 s, .* longer slots'),
    (with_uavs(SLOW, max_energy=1e5), 1e9, 'delivers at most .* a larger max_energy')])
def test_bits_that_no_flight_can_deliver_are_refused_without_a_search(
        scenario, bits, words, monkeypatch):
    monkeypatch.setattr('secure_uav_planner.bound.shortest.solve', None)
    with pytest.raises(InfeasibleMissionError, match=words) as error:
        shortest_duration(scenario, bits)
    assert error.value.field == 'bits' and str(error.value).startswith(f'bits is {bits:g} bit/Hz')


@given(scenarios())
@settings(max_examples=30, deadline=None)
def test_no_plan_delivers_what_is_refused_without_a_search(scenario):
    plan = solve(scenario)
    if plan.rate > 0:
        check_bits(scenario, plan.rate * scenario.duration)


def test_the_duration_where_the_search_begins_may_be_too_long_for_the_battery():
    scenario = Scenario.paper(400.0, slots=100)
    scenario = replace(scenario, uavs=tuple(
        replace(uav, max_acceleration=3.0, max_energy=22e3) for uav in scenario.uavs))
    plan = shortest_duration(scenario, 100.0)
    assert plan.rate * plan.scenario.duration >= 100.0 and plan.scenario.duration < 130.0
    starving = with_uavs(scenario, max_energy=10.0)
    with pytest.raises(InfeasibleMissionError):
        shortest_duration(starving, 100.0)
    # Faster flights take more here: a duration may be too short for the battery, too.
    racing = with_uavs(scenario, max_acceleration=10.0, max_speed=40.0, max_energy=11e3)
    plan = shortest_duration(replace(racing, duration=29.0, slots=29), 60.0,
                             objective='guaranteed')
    assert 38.0 < plan.scenario.duration < 41.0


def test_a_way_around_a_wall_takes_more_energy_in_less_time():
    wall = NoFlyZone(((-900.0, -20.0), (900.0, -20.0), (900.0, 20.0), (-900.0, 20.0)))
    scenario = with_uavs(replace(Scenario.paper(120.0, slots=16), no_fly_zones=(wall,)),
                         max_speed=40.0, max_acceleration=10.0, max_energy=25e3)
    plan = shortest_duration(replace(scenario, duration=65.0), 10.0, objective='guaranteed')
    assert plan.scenario.duration > 65.0


def test_a_tail_in_motion_that_no_battery_lasts_for_is_refused():
    uavs = [Uav(f'uav{x}', (x, 0.0), (x, 0.0), 100.0, 10.0, start_velocity=(1.0, 0.0),
                max_acceleration=3.0, max_energy=500.0) for x in (0.0, 50.0)]
    scenario = Scenario((0.0, 90.0), (Eavesdropper((200.0, 0.0)),), uavs, 100.0, 10)
    with pytest.raises(InfeasibleMissionError):
        shortest_duration(scenario, 1.0)


@pytest.mark.parametrize('fields', [
    # An eavesdropper that leaves the ground node after the duration where the search begins.
    {'eavesdroppers': (Eavesdropper(track=(
        (0.0, 0.0, 0.0, 50.0), (120.0, 0.0, 0.0, 50.0), (160.0, 400.0, 0.0, 10.0))),)},
    # A ground node on which an eavesdropper sits, and whose head start is enough.
    {'ground_nodes': (GroundNode((0.0, 0.0), 'a'), GroundNode((-300.0, 0.0), 'b')),
     'eavesdroppers': (Eavesdropper((0.0, 0.0), 30.0),), 'head_starts': (100.0, 0.0),
     'ground_node': None}])
def test_a_reason_not_to_deliver_counts_only_if_it_lasts_and_matters(fields):
    plan = shortest_duration(replace(Scenario.paper(110.0, slots=30), **fields), 20.0)
    assert plan.rate * plan.scenario.duration >= 20.0


def test_a_mission_that_cannot_be_flown_in_any_time_is_refused_as_by_solve():
    wall = NoFlyZone(((-900.0, 50.0), (900.0, 50.0), (900.0, 80.0), (-900.0, 80.0)), name='wall')
    scenario = replace(Scenario.paper(120.0, slots=20), no_fly_zones=(wall,), geofence=(
        (-800.0, -800.0), (800.0, -800.0), (800.0, 800.0), (-800.0, 800.0)))
    with pytest.raises(InfeasibleMissionError) as refused:
        solve(scenario)
    with pytest.raises(InfeasibleMissionError) as error:
        shortest_duration(scenario, 250.0)
    assert str(error.value) == str(refused.value)


def test_bits_for_which_no_flight_is_found_are_blamed_and_not_a_line_of_the_file(
        tmp_path, command, monkeypatch):
    file = tmp_path / 'mission.yaml'
    Scenario.paper(120.0, slots=6).save(file)
    monkeypatch.setattr('secure_uav_planner.bound.shortest.find_longest_duration', lambda _: 200)
    for bits, words in (('1e9', 'the longest flight'), ('900', 'no flights were found')):
        _, err = command('plan', file, '-o', tmp_path, '--deliver', bits, status=2)
        assert re.fullmatch(f'.*: --deliver: bits is .* bit/Hz; {words}.*\n', err)


def test_a_search_that_ends_early_keeps_what_suffices_or_says_that_nothing_was_found():
    scenario = Scenario.paper(150.0, slots=50)
    with pytest.raises(StoppedError, match='before flights that deliver 250 bit/Hz were found'):
        shortest_duration(scenario, 250.0, on_progress=lambda _: True)
    for limit in (1e-9, 5e-5, 1e-3):
        with pytest.raises(TimeLimitError, match=f'time_limit is {limit:g} s; it was over before '
                           'flights that deliver 250 bit/Hz were found'):
            shortest_duration(scenario, 250.0, time_limit=limit)
    tried = set()

    def stop(iteration):
        tried.add(re.match(r'(\d+\.\d) s: (start|joint|bound)', iteration.step)[1])
        return len(tried) > 1  # In the second duration.

    plan = shortest_duration(scenario, 250.0, on_progress=stop)
    assert plan.status == 'cancelled' and plan.scenario.duration == 150.0
    assert 'this suffices for 250 bit/Hz' in plan.message and 'proven' not in plan.message


def test_the_command_plans_the_shortest_flight(tmp_path, command, monkeypatch):
    texts = []
    monkeypatch.setattr('secure_uav_planner.apps.planning._Progress.show',
                        lambda _, text, force=False: texts.append(text))
    file = tmp_path / 'mission.yaml'
    Scenario.paper(150.0, slots=50).save(file)
    options = ('plan', file, '-o', tmp_path, '--deliver', '250', '--no-baselines',
               '--bound-time-limit', '0')
    out, _ = command(*options)
    plan = Plan.load(tmp_path / 'plan.json')
    assert plan.message in out and 'this suffices for 250' in plan.message
    # The progress tells the duration under trial, and no rate before there is one.
    assert any(re.search(r'\(150\.0 s: joint\), [\d.]+ bit/s/Hz', text) for text in texts)
    assert any('(150.0 s: start), nothing yet' in text for text in texts)
    assert '--deliver' in command(*options, '--method', 'alternating', status=2).err


def test_the_planner_plans_the_shortest_flight(client, planner):
    [result] = client.set_parameters('planner', deliver=250.0)
    assert result.successful
    [result] = client.set_parameters('planner', method='alternating')
    assert not result.successful and 'deliver is 250' in result.reason
    paths = client.listen(Path, 'uav1/path')
    assert 'this suffices for 250 bit/Hz' in client.plan_paper().message
    wait_for(lambda: paths, what='the plan')
    first, second = (seconds(pose.header.stamp) for pose in paths[-1].poses[:2])
    duration = (second - first) * (len(paths[-1].poses) - 2)
    wait_for(lambda: client.status.plan.identity)
    rate = client.status.plan.worst_case_rate
    assert 249.99 < rate * duration < 251.0 and duration < 120.0
