"""A flight against its plan: the numbers that were put into a log come back, from any format."""

from dataclasses import replace
import json
import math
import random

from flown_logs import (
    DELAY, fly_twice, make_flight, make_plan, OFFSET, ORIGINS, START_NS, write_logs)
import numpy as np
import pytest
from secure_uav_planner import (
    assess, fly_hover_fly, GroundNode, NoFlyZone, Origin, Propulsion, Scenario, World)
from secure_uav_planner.apps.cli import main
from secure_uav_planner.assessment.flown import compare, read_flight
from secure_uav_planner.errors import LogFileError, OptionError
from secure_uav_planner.model.channel import guaranteed_node_rates
from secure_uav_planner.model.curve import GAUSS_LEGENDRE
from secure_uav_planner.output.flown_picture import draw_comparison
from strategies import with_uavs
from studies.flown.logs import fly, write_csv, write_dataflash, write_ulog

FORMATS = ('csv', 'ulg', 'BIN', 'tlog', 'mcap', 'tum')
SHIFTS = dict.fromkeys(('ulg', 'BIN', 'tlog'), ORIGINS)  # Formats whose frames begin anywhere.


@pytest.fixture(scope='module')
def plan():
    return make_plan()


@pytest.fixture(scope='module')
def flight():
    return make_flight()


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
        assert errors.speed_max_m_s == pytest.approx(10.0, abs=0.05)
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


@pytest.mark.parametrize('begin, end', [(40.24, 40.98), (40.96, 41.04)])
def test_powers_that_change_inside_a_slot_count_for_as_long_as_they_are_set(
        begin, end, plan, tmp_path):
    dense = fly(plan, 0.0, 0.0, frequency=50.0)
    dense.powers[1, (dense.times > begin - 0.01) & (dense.times < end - 0.01)] = 0.0
    write_csv(dense, tmp_path / 'flight.csv', START_NS * 1e-9)
    comparison = compare(plan, read_flight(tmp_path / 'flight.csv', plan))
    times = 40.0 + (np.arange(1000) + 0.5) * 0.002  # Slot 20.
    powers = np.repeat(plan.powers[:, 19:20], 1000, axis=1)
    powers[1, (times > begin) & (times < end)] = 0.0
    mean = guaranteed_node_rates(
        plan.scenario, np.pad(plan.curve.at(times).positions, ((0, 0), (1, 1), (0, 0))), powers,
        times=times).mean()
    assert comparison.achieved['guaranteed'][0, 19] == pytest.approx(mean, rel=0.01)
    assert mean < 0.99 * plan.curve_rates[19]


def test_a_pause_on_the_way_is_no_distance_from_the_way(plan, tmp_path):
    flight = fly(plan, 0.0, OFFSET, after=30.0)
    later = flight.times - np.clip(flight.times - 50.0, 0.0, 25.0)  # A pause of 25 s.
    positions = [[np.interp(later, flight.times, column) for column in path.T]
                 for path in flight.positions]
    write_csv(replace(flight, positions=np.moveaxis(positions, 1, 2)), tmp_path / 'flight.csv',
              START_NS * 1e-9)
    comparison = compare(plan, read_flight(tmp_path / 'flight.csv', plan))
    for errors in comparison.uavs.values():
        assert errors.error_max_m > 50.0
        assert errors.cross_track_max_m == pytest.approx(OFFSET, abs=0.1)


def test_in_short_slots_at_a_gap_every_covered_slot_has_a_rate(tmp_path):
    plan = fly_hover_fly(Scenario.paper(110.0, slots=300))  # Slots of 0.367 s.
    read = read_flight(write_logs(fly(plan, 0.0, 0.0), 'csv', tmp_path), plan)
    for gap in np.arange(5.0, 7.0, 0.1):
        positions = np.where(((read.times > gap) & (read.times < gap + 4.0))[:, None], np.nan,
                             read.positions)
        comparison = compare(plan, replace(read, positions=positions))
        assert 0.94 < comparison.coverage < 0.98
        json.dumps(comparison.to_dict(), allow_nan=False)


def test_setpoints_that_were_never_sent_are_not_compared(plan, flight, tmp_path):
    read = read_flight(write_logs(flight, 'csv', tmp_path), plan)
    sent = np.array([20.0, 20.5, 21.0, 80.0, 80.5])
    log = read.logs['uav1']
    log = replace(log, setpoints=(sent + read.shifts['uav1'].seconds,
                                  plan.curve.at(sent).positions[0]))
    comparison = compare(plan, replace(read, logs={**read.logs, 'uav1': log}))
    assert comparison.uavs['uav1'].setpoint_error_rms_m < 0.1
    swapped = replace(plan, bound=None, scenario=replace(plan.scenario, uavs=[
        replace(uav, name=name) for uav, name in zip(plan.scenario.uavs, ('uav2', 'uav1'))]))
    with pytest.raises(OptionError, match='flight is of the plan'):
        compare(swapped, read)


def test_a_battery_counts_in_the_time_covered(plan, tmp_path):
    fuelled = replace(plan, scenario=with_uavs(plan.scenario, propulsion=Propulsion()), bound=None)
    read = read_flight(write_logs(fly(fuelled, 0.0, 0.0), 'BIN', tmp_path), fuelled,
                       shifts=SHIFTS['BIN'])
    end = read.logs['uav1'].times[-1]
    logs = {name: replace(log, battery=(np.array([0.0, end]), np.array([0.0, 300.0 * end])))
            for name, log in read.logs.items()}
    positions = np.where(((read.times > 20.0) & (read.times < 80.0))[:, None], np.nan,
                         read.positions)
    whole = compare(fuelled, replace(read, logs=logs)).uavs['uav1']
    cut = compare(fuelled, replace(read, logs=logs, positions=positions)).uavs['uav1']
    assert whole.energy_j == pytest.approx(whole.planned_energy_j, rel=2e-4)
    assert cut.battery_wh == pytest.approx(whole.battery_wh * 53 / 113, rel=0.05)


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


def swap_axes(flight):
    """Return the track of a flight whose x and y are swapped."""
    return replace(flight, positions=flight.positions[..., [1, 0, 2]])


def thin(flight):
    """Return the track of a flight with one position each 3 s."""
    return fly(flight.plan, DELAY, OFFSET, frequency=1 / 3)


@pytest.mark.parametrize('kind, change, options, words', [
    ('csv', thin, {'at': 'fit'}, 'by positions that are at most 2 s apart'),
    ('csv', thin, {'at': 'takeoff'}, 'or only positions over 2 s apart'),
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


def test_uavs_of_any_name_are_in_both_legends_of_the_picture(plan, tmp_path):
    uavs = [replace(uav, name=name)
            for uav, name in zip(plan.scenario.uavs, ('$^$', '_b'), strict=True)]
    named = replace(plan, scenario=replace(plan.scenario, uavs=tuple(uavs)))
    write_csv(fly(named), tmp_path / 'flight.csv', START_NS * 1e-9)
    figure = compare(named, read_flight(tmp_path / 'flight.csv', named)).plot()
    figure.savefig(tmp_path / 'flight.png')
    for panel in figure.axes[:2]:
        texts = [text.get_text() for text in panel.get_legend().get_texts()]
        assert {r'\$^\$', ' _b'} <= set(texts)


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
