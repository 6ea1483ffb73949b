"""A flight against its plan: the numbers that were put into a log come back, from any format."""

from dataclasses import replace
import json
import math
import random

import numpy as np
import pytest
from rosbags.highlevel import AnyReader
from rosbags.rosbag2 import StoragePlugin, Writer
from secure_uav_planner import (
    assess, Eavesdropper, fly_hover_fly, GroundNode, NoFlyZone, Origin, Propulsion, Scenario,
    solve, World)
from secure_uav_planner.apps.cli import main
from secure_uav_planner.assessment.flown import compare, read_flight
from secure_uav_planner.errors import LogFileError, OptionError
from secure_uav_planner.model.curve import GAUSS_LEGENDRE
from secure_uav_planner.output.flown_picture import draw_comparison
from secure_uav_planner.plan.splice import continue_plan, cut_tail
from strategies import with_uavs
from studies.flown.logs import (
    find_powers, fly, STORE, write_bag, write_csv, write_dataflash, write_telemetry, write_tum,
    write_ulog)

DELAY, OFFSET = 0.3, 0.8
START_NS = 1_795_743_002_000_000_000
ORIGINS = {'uav1': (100.0, 500.0), 'uav2': (120.0, 500.0)}
FORMATS = ('csv', 'ulg', 'BIN', 'tlog', 'mcap', 'tum')
SHIFTS = dict.fromkeys(('ulg', 'BIN', 'tlog'), ORIGINS)  # Formats whose frames begin anywhere.


@pytest.fixture(scope='module')
def plan():
    mission = with_uavs(replace(Scenario.paper(110.0, slots=55, error_radius=10.0),
                                separation=10.0), max_acceleration=2.0)
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
        write_bag(flight, folder / 'bag')
        return folder / 'bag'
    files = {uav.name: folder / f'{uav.name}.{kind}' for uav in uavs}
    for index, (name, file) in enumerate(files.items()):
        if kind == 'tum':
            write_tum(flight, index, file)
        else:
            write = {'ulg': write_ulog, 'BIN': write_dataflash, 'tlog': write_telemetry}[kind]
            write(flight, index, file, ORIGINS[name], 100.0 + 3.0 * index, START_NS * 1e-9,
                  **options)
    return files


@pytest.mark.parametrize('kind', FORMATS)
def test_a_known_delay_and_offset_come_back_from_a_log(kind, plan, flight, tmp_path):
    read = read_flight(write_logs(flight, kind, tmp_path), plan, shifts=SHIFTS.get(kind, {}))
    assert read.time_from == {'mcap': 'plan_time', 'tum': 'takeoff'}.get(kind, 'utc')
    if kind == 'tum':  # The delay of a departure is taken for the time of the plan.
        read = replace(read, times=read.times + DELAY)
    comparison = compare(plan, read)
    assert comparison.coverage == 1.0 and not comparison.broken.any()
    for errors in comparison.uavs.values():
        if kind != 'tum':
            assert errors.delay_s == pytest.approx(DELAY, abs=0.02)
        assert [errors.cross_track_rms_m, errors.cross_track_mean_m] == pytest.approx(
            [OFFSET, OFFSET], abs=0.05)  # To the left.
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


@pytest.mark.parametrize('kind', FORMATS)
def test_the_rates_are_those_of_assess_at_the_positions_that_were_read(kind, tmp_path):
    known = replace(fly_hover_fly(Scenario.paper(110.0, slots=55, error_radius=0.0)),
                    start_ns=START_NS)
    flown = write_logs(fly(known, DELAY, OFFSET), kind, tmp_path)
    comparison = compare(known, read_flight(flown, known, shifts=SHIFTS.get(kind, {})))
    rates = 0.0
    for place, weight in GAUSS_LEGENDRE:
        times = (np.arange(55) + 1.5 + place) * known.scenario.slot_duration
        rates = rates + weight * assess(known, draws=1, world=World(place='fixed'),
                                        flown=comparison.flight.at(times)).fan[2]
    achieved = comparison.achieved['guaranteed'][0]
    assert np.count_nonzero(achieved) > 20
    assert rates[achieved > 0] == pytest.approx(achieved[achieved > 0], abs=1e-9)


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


@pytest.mark.parametrize('kind', ['ulg', 'BIN', 'mcap', 'csv'])
def test_a_jump_of_the_frame_cuts_the_flight_at_its_second_and_is_told(
        kind, plan, flight, tmp_path):
    source = write_logs(flight.add(jump_at=60.0, jump=(3.0, 0.0)), kind, tmp_path,
                        **({'reset_at': 60.0} if kind == 'ulg' else {}))
    comparison = compare(plan, read_flight(source, plan, shifts=SHIFTS.get(kind, {})))
    for name, errors in comparison.uavs.items():
        assert errors.error_max_time_s > 59.0
        assert errors.jumps_s == pytest.approx([59.9], abs=0.11)
        [note] = [note for note in comparison.flight.notes
                  if note.startswith(name) and 'jumps' in note]
        seconds = float(note.split(' (')[1].split(' s')[0])
        begin = {'mcap': 6.0, 'csv': START_NS * 1e-9}.get(kind, 100.0 + 3.0 * (name == 'uav2'))
        assert seconds - begin == pytest.approx(59.9, abs=0.11)  # By the clock of the log.


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


def fly_twice(flight, later=None):
    """Return the track of a flight that is flown again some s later, by default 0.1 s after it."""
    once = fly(flight.plan, 0.0, 0.0)
    later = later or once.times[-1] - once.times[0] + 0.1
    return replace(once, times=np.append(once.times, once.times + later), **{
        name: np.concatenate([getattr(once, name)] * 2, axis=1)
        for name in ('positions', 'velocities', 'powers')})


def swap_axes(flight):
    """Return the track of a flight whose x and y are swapped."""
    return replace(flight, positions=flight.positions[..., [1, 0, 2]])


@pytest.mark.parametrize('kind, change, options, words', [
    ('BIN', replace, {}, r'--shift uav1=(99|100)\.\d,(499|500)\.\d'),
    ('csv', fly_twice, {'at': 'fit'}, 'two times fit alike'),
    ('csv', swap_axes, {}, 'x and y fit when they are swapped'),
    ('csv', swap_axes, {'at': 'fit'}, 'no time fits')])
def test_logs_whose_frame_or_time_is_not_known_are_refused_in_a_line(
        kind, change, options, words, plan, flight, tmp_path):
    source = write_logs(change(flight), kind, tmp_path)
    with pytest.raises(LogFileError, match=words) as error:
        read_flight(source, plan, **options)
    assert str(tmp_path) in str(error.value) and '\n' not in str(error.value)


def damage(name, data, generator):
    """Return the bytes of a damaged log."""
    middle = len(data) // 2
    return {'empty': b'', 'a header cut': data[:40], 'a middle cut': data[:middle],
            'random': generator.randbytes(5000), 'zeros': bytes(5000),
            'noise': data[:middle] + generator.randbytes(1000) + data[middle + 1000:]}[name]


@pytest.mark.parametrize('kind', FORMATS)
@pytest.mark.parametrize('name', [
    'empty', 'a header cut', 'a middle cut', 'random', 'zeros', 'noise', 'NaN', 'backwards',
    'another format', 'a folder', 'missing'])
def test_damaged_logs_are_refused_in_a_line(kind, name, plan, flight, tmp_path, capfd):
    if name == 'NaN':
        flight = replace(flight, positions=flight.positions * np.nan)
    elif name == 'backwards':
        times = flight.times.copy()
        times[600:] -= 30.0
        flight = replace(flight, times=times)
    source = write_logs(flight, kind, tmp_path)
    if name in ('another format', 'a folder', 'missing'):
        other = 'ulg' if kind != 'ulg' else 'BIN'
        path = tmp_path / {'another format': f'wrong.{other}', 'a folder': f'folder.{kind}',
                           'missing': f'none.{kind}'}[name]
        if name == 'another format':
            path.write_bytes(find_files(source)[0].read_bytes())
        elif name == 'a folder':
            path.mkdir()
        source = dict.fromkeys(ORIGINS, path) if (
            isinstance(source, dict) or name == 'another format') else path
    for number, file in enumerate(find_files(source)):
        if name not in ('NaN', 'backwards', 'another format', 'a folder', 'missing'):
            file.write_bytes(damage(name, file.read_bytes(), random.Random(number)))
    capfd.readouterr()
    words = [f'{uav}={file}' for uav, file in source.items()] if (
        isinstance(source, dict)) else [str(source)]
    shifts = ['--shift', 'uav1=100,500', 'uav2=120,500'] if kind in SHIFTS else []
    plan.save(tmp_path / 'plan.json')
    status = main(['assess', str(tmp_path / 'plan.json'), '--json', '--flown', *words, *shifts])
    out, err = capfd.readouterr()
    if out:  # What is left of the log can be compared.
        assert name in ('a middle cut', 'noise', 'backwards') and not err
        assert json.loads(out)['coverage'] <= 1.0
    else:
        assert status == 2 and err.count('\n') == 1 and str(tmp_path) in err


def find_files(source):
    """Return the files of what read_flight takes."""
    if isinstance(source, dict):
        return [*source.values()]
    return [*source.glob('*.mcap')] if source.is_dir() else [source]


@pytest.mark.parametrize('text, words', [
    ('time,uav,x,y\n1,uav1,2,3\n2,uav1,2\n', 'line 3 has 3 fields; it must have 4'),
    ('time,uav,x,y\n1,uav1,2,three\n', "line 2: could not convert string to float: 'three'"),
    ('time,uav,x,y\n1,uav1,2,3\n2,uav1,2,3\n', 'no positions of uav2; it has uav1'),
    ('time;uav;x;y\n1;uav1;2;3\n', 'it has no column time'),
    ('time,x\n1,2\n', 'no column y')])
def test_a_csv_that_is_no_table_is_refused_with_its_line(text, words, plan, tmp_path):
    (tmp_path / 'flight.csv').write_text(text)
    with pytest.raises(LogFileError, match=words):
        read_flight(tmp_path / 'flight.csv', plan)


@pytest.mark.parametrize('source, options, words', [
    ({'uav1': 'a.ulg'}, {}, 'uav2'), ('a.ulg', {}, 'uav1=a.ulg'),
    ({'uav1': 'a.doc', 'uav2': 'b.doc'}, {}, '.doc'), ('a.csv', {'at': 'noon'}, 'at is')])
def test_wrong_arguments_are_named(source, options, words, plan):
    with pytest.raises((LogFileError, OptionError), match=words):
        read_flight(source, plan, **options)


def test_the_picture_of_a_flight_names_zones_once(plan, flight, tmp_path):
    zones = tuple(NoFlyZone(((x, 800.0), (x + 9.0, 800.0), (x, 809.0))) for x in (0.0, 50.0, 90.0))
    zoned = replace(plan, scenario=replace(plan.scenario, no_fly_zones=zones))
    source = write_logs(flight, 'csv', tmp_path)
    figure = draw_comparison(compare(zoned, read_flight(source, zoned)))
    labels = [text.get_text() for axes in figure.axes if axes.get_legend()
              for text in axes.get_legend().get_texts() if 'zone' in text.get_text()]
    assert labels == ['no-fly zone']


def test_the_command_prints_draws_and_tells_by_its_status(plan, flight, tmp_path, command):
    plan.save(tmp_path / 'plan.json')
    words = 'assess', tmp_path / 'plan.json', '--flown'
    source = write_logs(flight, 'csv', tmp_path)
    assert 'tracking_margin' in command(*words, source).out
    assert (tmp_path / 'plan.flown.png').stat().st_size > 10_000
    page = tmp_path / 'flown.html'
    command(*words, source, '-o', page)
    assert page.read_text().count('"name":"flown"') == 3  # Two ways and the rates.
    assert '"name":"planned, mean of each slot"' in page.read_text()
    short = fly(plan, DELAY, OFFSET, after=-40.0)
    write_csv(short, tmp_path / 'short.csv', START_NS * 1e-9)
    out, _ = command(*words, tmp_path / 'short.csv', '--json', status=3)
    assert 0.5 < json.loads(out)['coverage'] < 0.7
    command(*words, tmp_path / 'none.csv', status=2)
    # Numbers as JSON need no picture, which could not be written here.
    (tmp_path / 'json.flown.png').mkdir()
    plan.save(tmp_path / 'json.json')
    command('assess', tmp_path / 'json.json', *words[2:], tmp_path / 'short.csv', '--json',
            status=3)
    assert '--json is for a flight' in command('assess', words[1], '--json', status=2).err
    _, err = command(*words, source, '--shift', 'uav1=1,2', 'uav1=3,4', status=2)
    assert "'uav1=3,4'; it must be UAV=X,Y in m, once for each UAV" in err


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


def test_what_a_log_does_not_know_is_taken_from_its_other_samples(plan, tmp_path):
    flight = fly(plan, 0.0, 0.0)
    write_csv(flight, tmp_path / 'whole.csv', START_NS * 1e-9)
    lines = (tmp_path / 'whole.csv').read_text().splitlines()
    lines[2::2] = [','.join([*line.split(',')[:5], '', '', '']) for line in lines[2::2]]
    (tmp_path / 'half.csv').write_text('\n'.join(lines))
    whole, half = (compare(plan, read_flight(tmp_path / name, plan)).to_dict()
                   for name in ('whole.csv', 'half.csv'))
    assert half['worst_case_rate'] == pytest.approx(whole['worst_case_rate'], rel=0.01)
    for name in ('uav1', 'uav2'):
        assert half['uavs'][name]['speed_max_m_s'] == pytest.approx(
            whole['uavs'][name]['speed_max_m_s'], rel=0.01)


def hover(plan, places):
    """Return the track of UAVs that stand at places (x, y, z) in m."""
    track = fly(plan, 0.0, 0.0)
    return replace(track, positions=np.broadcast_to(
        np.array(places)[:, None], track.positions.shape), velocities=0.0 * track.velocities)


def test_distances_count_heights_and_energy_the_time_in_the_air(plan, tmp_path):
    zone = NoFlyZone(((80.0, 480.0), (95.0, 480.0), (95.0, 520.0), (80.0, 520.0)), ceiling=90.0)
    scenario = with_uavs(replace(plan.scenario, separation=0.0, no_fly_zones=(zone,)),
                         propulsion=Propulsion())
    planned = replace(plan, scenario=scenario)
    for height, expected in ((100.0, None), (90.0, 3.0)):
        write_csv(hover(planned, [(98.0, 500.0, height), (118.0, 500.0, 115.0)]),
                  tmp_path / 'flight.csv', START_NS * 1e-9)
        comparison = compare(planned, read_flight(
            tmp_path / 'flight.csv', planned, shifts=dict.fromkeys(ORIGINS, (0.0, 0.0))))
        assert comparison.separation.distance == pytest.approx(math.hypot(20.0, 115.0 - height))
        assert (comparison.zones.distance if comparison.zones else None) == (
            expected and pytest.approx(expected))
        seconds = plan.curve.end - plan.curve.begin
        for errors in comparison.uavs.values():
            assert errors.energy_j == pytest.approx(
                scenario.uavs[0].propulsion.power(np.zeros(1))[0] * seconds, rel=2e-3)
        assert comparison.uavs['uav2'].height_error_max_m == pytest.approx(
            abs(115.0 - scenario.uavs[1].altitude))


def test_each_of_several_nodes_gets_what_an_integral_of_its_own_says(tmp_path):
    mission = replace(Scenario.paper(110.0, slots=22), ground_nodes=(
        GroundNode((0.0, 0.0), name='farm'), GroundNode((100.0, -200.0), name='barn')))
    plan = replace(fly_hover_fly(mission), start_ns=START_NS)
    track = fly(plan, 0.3, 0.8, after=-32.0)
    write_csv(track, tmp_path / 'flight.csv', START_NS * 1e-9)
    comparison = compare(plan, read_flight(tmp_path / 'flight.csv', plan))
    last = int(track.times[-1] / 5.0) - 1
    assert comparison.covered.tolist() == [True] * last + [False] * (22 - last)
    places, totals = [(0.0, 0.0), (100.0, -200.0)], np.zeros(2)
    step, snr = 0.05, 10.0**8
    for time in np.arange(5.0 + step / 2, 5.0 * (last + 1), step):
        slot = int(time / 5.0) - 1
        uavs = [[np.interp(time, track.times, column) for column in path.T]
                for path in track.positions]
        watts = plan.powers[:, slot]

        def rate(squares):
            return math.log2(1 + snr * watts[0] / squares[0] / (
                1 + snr * watts[1] / squares[1]))

        def squares(place, shrink, grow):
            level = [math.hypot(x - place[0], y - place[1]) for x, y, _ in uavs]
            return [max(level[0] - shrink, 0.0)**2 + uavs[0][2]**2,
                    (level[1] + grow)**2 + uavs[1][2]**2]

        leak = rate(squares((200.0, 0.0), 10.0, 10.0))
        totals += step * plan.shares[:, slot] * [
            rate(squares(place, 0.0, 0.0)) - leak for place in places]
    assert snr == 10.0**(mission.reference_snr_db / 10.0) and totals.min() > 0.5
    assert comparison.delivered() == pytest.approx(totals, rel=0.02)


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
    # A replan that expects the delay changes nothing for the slots before it.
    begin = 25 * plan.scenario.slot_duration
    revision = replace(late, powers=0.99 * late.powers, promise_delay=5.0)
    write_bag(flight, tmp_path / 'replanned', [(-math.inf, on_time), (begin + 5.0, revision)],
              late=5.0)
    comparison = compare(on_time, read_flight(tmp_path / 'replanned', on_time))
    assert comparison.achieved['guaranteed'].sum(axis=0)[:24] == pytest.approx(
        late.curve_rates[:24], rel=0.01, abs=0.01)


def test_a_way_from_home_to_the_start_is_no_departure(plan, tmp_path):
    track = fly(plan, DELAY, 0.0, before=60.0)
    home = np.clip((-20.0 - track.times) / 20.0, 0.0, 1.0)[:, None] * (-30.0, 10.0)
    positions = track.positions.copy()
    positions[..., :2] += home
    write_csv(replace(track, positions=positions), tmp_path / 'flight.csv')
    for at in ('takeoff', 'fit'):
        flight = read_flight(tmp_path / 'flight.csv', plan, at=at)
        assert flight.shifts['uav1'].seconds == pytest.approx(DELAY, abs=0.05)


def test_a_log_of_another_time_covers_nothing_and_says_so(plan, flight, tmp_path, command):
    later = replace(plan, start_ns=START_NS + 10**12)
    later.save(tmp_path / 'plan.json')
    words = ['assess', tmp_path / 'plan.json', '--flown', write_logs(flight, 'csv', tmp_path),
             '--at', 'utc', '--shift', 'uav1=0,0', 'uav2=0,0']
    assert 'not covered: slots 1 to 55' in command(*words, status=3).out
    out, _ = command(*words, '--json', status=3)
    values = json.loads(out, parse_constant=pytest.fail)
    assert values['coverage'] == 0.0 and values['uncovered_slots'] == [*range(1, 56)]
    assert values['uavs']['uav1']['error_max_m'] is values['guaranteed_rate'] is None
