"""A flight against its plan: the numbers that were put into a log come back, from any format."""

from dataclasses import replace
import json

from flight_logs import fly, write_bag, write_csv, write_dataflash, write_tum, write_ulog
import numpy as np
import pytest
from secure_uav_planner import assess, Origin, Scenario, solve, World
from secure_uav_planner.apps.cli import main
from secure_uav_planner.assessment.flown import compare, read_flight
from secure_uav_planner.errors import LogFileError, OptionError, PlanningError
from secure_uav_planner.model import channel
from secure_uav_planner.plan.file import make_text

DELAY, OFFSET = 0.3, 0.8
START_NS = 1_795_743_002_000_000_000
ORIGINS = {'uav1': (100.0, 500.0), 'uav2': (120.0, 500.0)}
FORMATS = ('csv', 'ulg', 'BIN', 'mcap', 'tum')


@pytest.fixture(scope='module')
def plan():
    mission = Scenario.paper(110.0, slots=55, error_radius=10.0)
    mission = replace(mission, separation=10.0, uavs=tuple(
        replace(uav, max_acceleration=2.0) for uav in mission.uavs))
    return replace(solve(mission, objective='guaranteed'), start_ns=START_NS)


@pytest.fixture(scope='module')
def flight(plan):
    return fly(plan, DELAY, OFFSET)


def write_logs(flight, kind, folder, **options):
    """Write the logs of all UAVs in a format; return what read_flight takes."""
    uavs = flight.plan.scenario.uavs
    if kind == 'csv':
        write_csv(flight, folder / 'flight.csv', START_NS * 1e-9)
        return folder / 'flight.csv'
    if kind == 'mcap':
        write_bag(flight, folder / 'bag', make_text(flight.plan, 'map'))
        return folder / 'bag'
    files = {uav.name: folder / f'{uav.name}.{kind}' for uav in uavs}
    for index, (name, file) in enumerate(files.items()):
        if kind == 'tum':
            write_tum(flight, index, file)
        else:
            write = write_ulog if kind == 'ulg' else write_dataflash
            write(flight, index, file, ORIGINS[name], 100.0 + 3.0 * index, START_NS * 1e-9,
                  **options)
    return files


@pytest.mark.parametrize('kind', FORMATS)
def test_a_known_delay_and_offset_come_back_from_a_log(kind, plan, flight, tmp_path):
    shifts = ORIGINS if kind in ('ulg', 'BIN') else {}
    source = write_logs(flight, kind, tmp_path)
    read = read_flight(source, plan, shifts=shifts)
    assert read.time_from == {'mcap': 'plan_time', 'tum': 'takeoff'}.get(kind, 'utc')
    if kind == 'tum':  # The delay of a departure is taken for the time of the plan.
        read = replace(read, times=read.times + DELAY)
    comparison = compare(plan, read)
    assert comparison.coverage == 1.0 and not comparison.broken.any()
    for errors in comparison.uavs.values():
        if kind != 'tum':
            assert errors.delay_s == pytest.approx(DELAY, abs=0.02)
        assert errors.cross_track_rms_m == pytest.approx(OFFSET, abs=0.05)
        assert errors.height_error_max_m < 0.01 and errors.gap_max_s == 0.0
    assert comparison.rate('guaranteed') == pytest.approx(plan.curve_rate, rel=0.01)
    assert json.loads(json.dumps(comparison.to_dict()))['slots_broken'] == 0
    assert len(comparison.to_dataframe()) == 55 and 'uav1' in comparison.summary()


@pytest.mark.parametrize('at', ['utc', 'takeoff', 'fit'])
def test_every_source_of_time_finds_the_shift_of_each_clock(at, plan, flight, tmp_path):
    read = read_flight(write_logs(flight, 'ulg', tmp_path), plan, at=at, shifts=ORIGINS)
    late = {'utc': 0.0}.get(at, DELAY)
    for index, shift in enumerate(read.shifts.values()):
        assert shift.seconds == pytest.approx(100.0 + 3.0 * index + late, abs=0.05)


def test_the_rates_are_those_of_the_positions_that_assess_takes(plan, flight, tmp_path):
    read = read_flight(write_logs(flight, 'csv', tmp_path), plan)
    at_slots = read.at(plan.times[1:-1])
    points = np.pad(at_slots, ((0, 0), (1, 1), (0, 0)))
    true = channel.secrecy_node_rates(plan.scenario, points, plan.powers, (200.0, 0.0))
    assessed = assess(plan, draws=1, world=World(place='fixed'), flown=at_slots)
    assert np.maximum(true, 0.0).mean() == pytest.approx(assessed.mean, abs=1e-9)


def test_the_slots_that_were_broken_in_a_log_are_found(plan, flight, tmp_path):
    mute = np.flatnonzero((plan.powers > 0.5).all(axis=0) & (plan.guaranteed_rates > 1.0))[2:5]
    powers = flight.powers.copy()
    for slot in mute:
        begin = (slot + 1) * plan.scenario.slot_duration
        powers[1, (flight.times >= begin - 1e-6) & (
            flight.times < begin + plan.scenario.slot_duration - 1e-6)] = 0.0
    source = write_logs(replace(flight, powers=powers), 'mcap', tmp_path)
    comparison = compare(plan, read_flight(source, plan))
    assert np.flatnonzero(comparison.broken).tolist() == mute.tolist()
    assert comparison.to_dict()['powers_from'] == 'log'


def test_a_jump_of_the_frame_cuts_the_flight_at_its_second_and_is_told(plan, flight, tmp_path):
    source = write_logs(flight, 'ulg', tmp_path, jump_at=60.0, jump=(3.0, 0.0))
    comparison = compare(plan, read_flight(source, plan, shifts=ORIGINS))
    for name, errors in comparison.uavs.items():
        assert errors.error_max_time_s > 59.0
        [note] = [note for note in comparison.flight.notes
                  if note.startswith(name) and 'jumped' in note]
        seconds = float(note.split(' at ')[1].split(' s')[0])
        assert seconds - (100.0 if name == 'uav1' else 103.0) == pytest.approx(60.0, abs=0.2)


def test_origins_on_earth_place_the_logs(plan, flight, tmp_path):
    origin = Origin(47.4, 8.5)
    placed = replace(plan, scenario=replace(plan.scenario, origin=origin))
    for index, (name, place) in enumerate(ORIGINS.items()):
        latitude, longitude = origin.to_geographic(*place)
        for kind, write in (('ulg', write_ulog), ('BIN', write_dataflash)):
            write(flight, index, tmp_path / f'{name}.{kind}', place, 100.0, START_NS * 1e-9,
                  reference=(float(latitude), float(longitude)))
    for kind in ('ulg', 'BIN'):
        comparison = compare(placed, read_flight(
            {name: tmp_path / f'{name}.{kind}' for name in ORIGINS}, placed))
        assert all(errors.cross_track_rms_m == pytest.approx(OFFSET, abs=0.05)
                   for errors in comparison.uavs.values())


def test_a_frame_that_nobody_knows_is_asked_for_with_the_place_that_fits(plan, flight, tmp_path):
    source = write_logs(flight, 'BIN', tmp_path)
    with pytest.raises(LogFileError, match=r'--shift uav1=(99|100)\.\d,(499|500)\.\d') as error:
        read_flight(source, plan)
    assert str(tmp_path) in str(error.value) and '\n' not in str(error.value)


def test_flights_that_fit_twice_are_refused(plan, tmp_path):
    once = fly(plan, 0.0, 0.0)
    length = once.times[-1] - once.times[0] + 0.1
    twice = replace(once, times=np.append(once.times, once.times + length), **{
        name: np.concatenate([getattr(once, name)] * 2, axis=1)
        for name in ('positions', 'velocities', 'powers')})
    write_csv(twice, tmp_path / 'flight.csv')
    with pytest.raises(LogFileError, match='two times fit alike'):
        read_flight(tmp_path / 'flight.csv', plan, at='fit')


def test_a_bag_of_another_plan_is_refused(plan, flight, tmp_path):
    source = write_logs(flight, 'mcap', tmp_path)
    with pytest.raises(LogFileError, match=plan.identity):
        read_flight(source, replace(plan, start_ns=0))


@pytest.mark.parametrize('kind', FORMATS)
def test_damaged_logs_are_refused_in_a_line(kind, plan, flight, tmp_path):
    source = write_logs(flight, kind, tmp_path)
    files = source.values() if isinstance(source, dict) else (
        [source] if source.is_file() else source.glob('*.mcap'))
    for file in files:
        data = file.read_bytes()
        for damage in (b'', data[:40], b'\0' * 500, data[:200] + b'\xff' * 200 + data[400:]):
            file.write_bytes(damage)
            try:
                read_flight(source, plan, shifts={} if kind in ('csv', 'mcap') else ORIGINS)
            except (PlanningError, OSError) as error:
                assert '\n' not in str(error) and str(tmp_path) in str(error)
        file.write_bytes(data)


def test_wrong_arguments_are_named(plan, tmp_path):
    (tmp_path / 'a.csv').write_text('time,x\n1,2\n')
    for arguments, words in (
            (({'uav1': 'a.ulg'},), 'uav2'), (('a.ulg',), 'uav1=a.ulg'),
            ((tmp_path / 'a.csv',), 'no column y'),
            (({'uav1': 'a.doc', 'uav2': 'b.doc'},), '.doc')):
        with pytest.raises((LogFileError, OptionError), match=words):
            read_flight(*arguments, plan)
    with pytest.raises(OptionError, match='at is'):
        read_flight(tmp_path / 'a.csv', plan, at='noon')


def test_the_command_prints_draws_and_tells_by_its_status(plan, flight, tmp_path, capsys):
    plan.save(tmp_path / 'plan.json')
    source = str(write_logs(flight, 'csv', tmp_path))
    assert main(['assess', str(tmp_path / 'plan.json'), '--flown', source]) == 0
    assert 'tracking_margin' in capsys.readouterr().out
    assert (tmp_path / 'plan.flown.png').stat().st_size > 10_000
    page = tmp_path / 'flown.html'
    assert main(['assess', str(tmp_path / 'plan.json'), '--flown', source, '-o', str(page)]) == 0
    assert page.read_text().count('"name":"flown"') == 3  # Two ways and the rates.
    short = fly(plan, DELAY, OFFSET, after=-40.0)
    write_csv(short, tmp_path / 'short.csv', START_NS * 1e-9)
    command = ['assess', str(tmp_path / 'plan.json'), '--flown', str(tmp_path / 'short.csv')]
    capsys.readouterr()
    assert main([*command, '--json']) == 3
    assert 0.5 < json.loads(capsys.readouterr().out)['coverage'] < 0.7
    assert main([*command[:-1], str(tmp_path / 'none.csv')]) in (1, 2)
