"""A bag against its plan: the plan in force, teams, replans, promises and second flights."""

from dataclasses import replace
import math

from flown_logs import DELAY, fly_twice, make_flight, make_plan, ORIGINS, START_NS
import numpy as np
import pytest
from rosbags.highlevel import AnyReader
from rosbags.rosbag2 import StoragePlugin, Writer
from secure_uav_planner import Eavesdropper, fly_hover_fly, Scenario
from secure_uav_planner.assessment.flown import compare, read_flight
from secure_uav_planner.assessment.flown.alignment import find_clock, Shift
from secure_uav_planner.assessment.flown.bag import read_bag, Report
from secure_uav_planner.errors import LogFileError, OptionError
from secure_uav_planner.plan.splice import continue_plan, cut_tail
from studies.flown.logs import find_powers, fly, STORE, write_bag, write_csv


@pytest.fixture(scope='module')
def plan():
    return make_plan()


@pytest.fixture(scope='module')
def flight():
    return make_flight()


@pytest.fixture(scope='module')
def replans():
    """Return plans of one flight, each with its time: a car goes on, and its estimate changes."""
    mission = Scenario.paper(110.0, slots=22, error_radius=10.0)
    plan = replace(fly_hover_fly(mission), start_ns=START_NS)
    plans = [(-math.inf, plan)]
    for point in range(1, 21):
        rest = cut_tail(plan, point)
        car = Eavesdropper((200.0 - 12.0 * point, 10.0 * point), 10.0)
        tail = replace(rest, scenario=replace(rest.scenario, eavesdroppers=(car,)),
                       powers=0.99 * rest.powers)
        plan = continue_plan(plan, point, tail)
        plans.append((point * plan.scenario.slot_duration, plan))
    return plans


def test_each_slot_is_compared_with_the_plan_in_force(replans, tmp_path):
    first, last = replans[0][1], replans[-1][1]
    assert len({plan.identity for _, plan in replans}) == 21
    flown = fly(last, 0.0, 0.0)
    write_bag(flown, tmp_path / 'bag', replans)
    for given in (first, replans[7][1], last):
        comparison = compare(given, read_flight(tmp_path / 'bag', given))
        assert [plan.identity for plan in comparison.flight.course.plans] == [
            plan.identity for _, plan in replans]
        # A replan keeps the receivers of the slots before, so the last plan knows them all.
        assert comparison.planned['guaranteed'].sum(axis=0) == pytest.approx(
            last.curve_rates, abs=0.02)
        assert not comparison.broken.any() and comparison.coverage == 1.0


def test_a_plan_that_was_in_force_for_some_slots_counts_for_these_alone(plan, flight, tmp_path):
    silent = replace(plan, powers=plan.powers * 0.0)
    half = 28 * plan.scenario.slot_duration
    powers = np.where(flight.times < half, flight.powers, 0.0)
    write_bag(replace(flight, powers=powers), tmp_path / 'bag', [
        (-math.inf, plan), (half, silent)])
    comparison = compare(plan, read_flight(tmp_path / 'bag', plan))
    planned = comparison.planned['guaranteed'].sum(axis=0)
    assert planned[:27] == pytest.approx(plan.curve_rates[:27]) and planned[27:].max() == 0.0
    assert not comparison.broken.any()
    # The second plan alone would find that half of the powers were not planned.
    assert comparison.rate('guaranteed', True) == pytest.approx(
        plan.curve_rates[:27].sum() / 55, rel=1e-6)


def test_a_second_flight_in_a_bag_is_compared_if_its_plan_is_given(plan, flight, tmp_path):
    later = replace(plan, start_ns=START_NS + 200 * 10**9)
    write_bag(fly_twice(flight, 200.0), tmp_path / 'bag', [(-math.inf, plan), (150.0, later)])
    for given in (plan, later):
        comparison = compare(given, read_flight(tmp_path / 'bag', given))
        assert comparison.coverage == 1.0 and not comparison.broken.any()
        assert all(errors.error_max_m < 0.01 for errors in comparison.uavs.values())
        assert any('was flown, too' in note for note in comparison.flight.notes)
    with pytest.raises(LogFileError, match=f'is a flight of the plan {later.identity}'):
        read_flight(tmp_path / 'bag', replace(plan, start_ns=0))
    with pytest.raises(OptionError, match='flight is of the plan'):
        compare(plan, read_flight(tmp_path / 'bag', later))


@pytest.mark.parametrize('places', [('/alpha', '/bravo'), ('/alpha', ''), ('', '/bravo')])
def test_of_several_teams_in_a_bag_the_one_that_flies_the_plan_counts(
        places, plan, flight, tmp_path):
    silent = replace(plan, powers=0.0 * plan.powers)
    far = replace(flight, positions=flight.positions + 1000.0, powers=0.0 * flight.powers,
                  plan=silent)
    for team, track in (('alpha', far), ('bravo', flight)):
        write_bag(track, tmp_path / team)
    with Writer(tmp_path / 'bag', version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        for team, namespace in zip(('alpha', 'bravo'), places):
            with AnyReader([tmp_path / team], default_typestore=STORE) as reader:
                topics = {item.topic: writer.add_connection(
                    f'{namespace}{item.topic}', item.msgtype, typestore=STORE)
                    for item in reader.connections}
                for item, stamp, data in reader.messages():
                    writer.write(topics[item.topic], stamp, data)
    alone, among = (compare(plan, read_flight(tmp_path / bag, plan)) for bag in ('bravo', 'bag'))
    assert among.to_dict() == alone.to_dict() and not among.broken.any()


def test_a_copy_of_a_plan_in_another_namespace_is_no_other_team(plan, flight, tmp_path):
    write_bag(flight, tmp_path / 'alone', late=DELAY)
    with Writer(tmp_path / 'bag', version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        with AnyReader([tmp_path / 'alone'], default_typestore=STORE) as reader:
            topics = {name: writer.add_connection(name, item.msgtype, typestore=STORE)
                      for item in reader.connections
                      for name in (item.topic, *(['/gcs/plan'] if item.topic == '/plan' else []))}
            for item, stamp, data in reader.messages():
                if item.topic == '/plan':
                    writer.write(topics['/gcs/plan'], stamp - 10**6, data)
                writer.write(topics[item.topic], stamp, data)
    alone, copied = (compare(plan, read_flight(tmp_path / bag, plan)).to_dict()
                     for bag in ('alone', 'bag'))
    assert copied == alone and alone['time_from'] == 'plan_time'


def test_a_plan_that_waits_at_its_start_again_after_a_flight_is_not_flown(plan, flight, tmp_path):
    write_bag(flight, tmp_path / 'bag')
    bag = read_bag(tmp_path / 'bag', [*ORIGINS], plan)
    waiting = [Report(bag.reports[-1].clock_ns + number * 10**8, bag.reports[0].plan_ns,
                      plan.identity) for number in range(1, 100)]
    alone, _ = bag.follow(plan)
    reset, _ = replace(bag, reports=[*bag.reports, *waiting]).follow(plan)
    for name in ORIGINS:
        assert np.array_equal(reset[name].plan_times, alone[name].plan_times)
        assert reset[name].notes == alone[name].notes == ()
    waited, _ = replace(bag, reports=waiting).follow(plan)  # UTC may time it all the same.
    assert waited['uav1'].plan_times is None and 'does not advance' in waited['uav1'].notes[-1]


def test_rare_reports_tell_when_the_time_of_the_plan_begins_and_ends(plan, flight, tmp_path):
    write_bag(flight, tmp_path / 'bag')
    bag = read_bag(tmp_path / 'bag', [*ORIGINS], plan)
    curve = plan.curve
    begin, end = curve.begin, curve.end
    pause = 20.45, 10.0  # Time of the plan and length in s.
    reports = []
    for clock in np.arange(begin - 5.0, end + 20.0):  # One a second.
        time = np.clip(clock - 0.3, begin, pause[0]) + np.clip(
            clock - 0.3 - sum(pause), 0.0, end - pause[0])
        reports.append(Report(START_NS + round(clock * 1e9), START_NS + round(time * 1e9),
                              plan.identity))
    logs, _ = replace(bag, origin_ns=START_NS, reports=reports).follow(plan)
    times = np.array([begin - 4e-10, -0.5, 20.4, 20.5, end - 0.1, end + 4e-10])
    clocks = find_clock(logs['uav1'], Shift(0.0, 0.0), 'plan_time', times, plan)
    assert clocks == pytest.approx(times + 0.3 + np.where(times > pause[0], pause[1], 0.0))


def test_powers_have_their_time_where_odometry_arrives_late(plan, flight, tmp_path):
    write_bag(flight, tmp_path / 'prompt')
    with Writer(tmp_path / 'late', version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        with AnyReader([tmp_path / 'prompt'], default_typestore=STORE) as reader:
            topics = {item.topic: writer.add_connection(item.topic, item.msgtype, typestore=STORE)
                      for item in reader.connections}
            for item, stamp, data in reader.messages():
                writer.write(topics[item.topic],
                             stamp + 4 * 10**8 * item.topic.endswith('odom'), data)
    prompt, late = (read_flight(tmp_path / name, plan).powers for name in ('prompt', 'late'))
    assert np.array_equal(prompt, late)


@pytest.mark.parametrize('has_tracks', [False, True])
def test_a_promise_ends_where_the_flight_is_late_for_receivers_that_move(
        has_tracks, plan, tmp_path):
    eve = plan.scenario.eavesdroppers[0]
    predicted = replace(plan, scenario=replace(plan.scenario, eavesdroppers=[replace(
        eve, position=None, error_radius=None, track=[
            (time, *eve.position, eve.error_radius) for time in (0.0, 200.0)])]),
        bound=None) if has_tracks else replace(plan, promised_until=100.0)
    for late, promised in ((0.0, predicted.promised_slots.sum()), (0.5, 0)):
        write_bag(fly(predicted, late, 0.0), tmp_path / f'bag{late}', late=late)
        comparison = compare(predicted, read_flight(tmp_path / f'bag{late}', predicted))
        assert comparison.promised.sum() == promised
        assert bool(comparison.flight.notes) == (promised == 0)
        assert all(errors.delay_s == pytest.approx(0.0, abs=0.02)
                   for errors in comparison.uavs.values())


def test_receivers_that_move_go_on_while_a_flight_is_late(plan, tmp_path):
    on_time, late = (replace(plan, bound=None, scenario=replace(plan.scenario, eavesdroppers=[
        Eavesdropper(track=[(-delay, 200.0, -300.0, 10.0), (200.0 - delay, 200.0, 300.0, 10.0)])]))
        for delay in (0.0, 5.0))
    flight = fly(on_time, 5.0, 0.0)
    flight = replace(flight, powers=find_powers(plan, flight.times - 5.0))
    write_bag(flight, tmp_path / 'bag', late=5.0)
    comparison = compare(on_time, read_flight(tmp_path / 'bag', on_time))
    assert comparison.achieved['guaranteed'].sum(axis=0) == pytest.approx(
        late.curve_rates, rel=0.01, abs=0.01)
    assert np.abs(late.curve_rates - on_time.curve_rates).max() > 0.05
    # The same by a log in UTC, whose time of the plan is found by the flight itself.
    write_csv(flight, tmp_path / 'flight.csv', START_NS * 1e-9)
    for at in ('fit', 'takeoff'):
        fitted = compare(on_time, read_flight(tmp_path / 'flight.csv', on_time, at=at))
        assert fitted.achieved['guaranteed'].sum(axis=0) == pytest.approx(
            late.curve_rates, rel=0.01, abs=0.01)
        assert comparison.promised.sum() == fitted.promised.sum() == 0
    # A plan that expects the delay is flown on time, by UTC, too.
    expected = replace(on_time, promise_delay=5.0)
    by_utc = compare(expected, read_flight(tmp_path / 'flight.csv', expected))
    assert by_utc.promised.all() and by_utc.uavs['uav1'].error_rms_m < 0.1
    # A replan that expects the delay changes nothing for the slots before it.
    begin = 25 * plan.scenario.slot_duration
    revision = replace(late, powers=0.99 * late.powers, promise_delay=5.0)
    write_bag(flight, tmp_path / 'replanned', [(-math.inf, on_time), (begin + 5.0, revision)],
              late=5.0)
    comparison = compare(on_time, read_flight(tmp_path / 'replanned', on_time))
    assert comparison.promised.tolist() == 24 * [False] + 31 * [True]
    assert comparison.achieved['guaranteed'].sum(axis=0)[:24] == pytest.approx(
        late.curve_rates[:24], rel=0.01, abs=0.01)
