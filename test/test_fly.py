"""Plans flown in physics over DDS: a short form of `make fly`, and what its numbers mean."""

from dataclasses import replace
import math

import numpy as np
import pytest
from secure_uav_planner import (
    compare, Eavesdropper, NoFlyZone, read_flight, Scenario, solve, Uav)
from secure_uav_planner.model.channel import guaranteed_rates
from secure_uav_planner.output.autopilots import Setpoint
from secure_uav_planner.plan.playback import Playback
from studies.flown import missions, report
from studies.flown.__main__ import main
from studies.flown.flight import fly_event, fly_plan
from studies.flown.flight_picture import save_flight
from studies.flown.logs import find_powers, from_physics, write_logs
from studies.flown.quadrotor import Gusts, Quadrotor, STEP

pytestmark = pytest.mark.slow


@pytest.fixture(scope='module')
def plan():
    uavs = (Uav('uav1', (-120.0, 0.0), (120.0, 0.0), 60.0, 12.0, max_acceleration=3.0),
            Uav('uav2', (-120.0, 40.0), (120.0, 40.0), 70.0, 12.0, max_acceleration=3.0))
    return solve(Scenario((0.0, 0.0), (Eavesdropper((60.0, 80.0), 10.0),), uavs, 40.0, 40))


@pytest.fixture(scope='module')
def flight(plan):
    return fly_plan('short', plan, seed=1)


def test_quadrotors_in_gusts_fly_the_plan_from_the_setpoints_of_the_replay_node(plan, flight):
    found = report.flight_report(plan, flight)
    print(f'\n{report.report_table([found])}')
    assert found.error_rms < 2.0 and found.error_max < 6.0
    assert found.arrival < 4.0
    assert found.flown_rate == pytest.approx(found.planned_rate, rel=0.01)
    assert found.flown_apart > 5.0
    # They fly, all of it, and they are blown about.
    playback = Playback(plan)
    assert flight.times[0] == playback.begin
    assert flight.times[-1] >= playback.duration - 1e-9
    assert found.error_rms > 0.05


def planned(plan, times):
    """Return where the planned curve is at some times, (U, K, 3) in m."""
    level = Playback(plan).curve.at(times).positions
    heights = np.broadcast_to(plan.scenario.altitudes[:, None, None], (*level.shape[:2], 1))
    return np.concatenate([level, heights], axis=-1)


def test_the_setpoints_are_the_curve_at_the_times_of_the_flight(plan, flight):
    assert flight.setpoints == pytest.approx(planned(plan, flight.times), abs=1e-6)
    assert flight.plan_times == pytest.approx(flight.times)


def test_the_rate_of_a_flight_that_is_exact_is_that_of_the_playback(plan, flight):
    times = np.arange(flight.times[0], flight.times[-1], 0.01)
    rate = report.mean_rate(plan, times, planned(plan, times))
    assert rate == pytest.approx(Playback(plan).guaranteed_rates.mean(), rel=1e-3)


def test_heights_count_in_the_rate(plan):
    scenario, shape = plan.scenario, plan.powers.shape
    own = np.broadcast_to(scenario.altitudes[:, None], shape)
    assert guaranteed_rates(scenario, plan.positions, plan.powers, own) == pytest.approx(
        plan.guaranteed_rates)
    higher = replace(scenario, uavs=tuple(
        replace(uav, altitude=uav.altitude + 7) for uav in scenario.uavs))
    assert guaranteed_rates(scenario, plan.positions, plan.powers, own + 7) == pytest.approx(
        guaranteed_rates(higher, plan.positions, plan.powers))


def test_the_distance_from_zones_and_fence_is_the_smallest_at_the_height(plan):
    square = ((0.0, 0.0), (10.0, 0.0), (10.0, 10.0), (0.0, 10.0))
    zones = (NoFlyZone(square, floor=0.0, ceiling=50.0),)
    scenario = replace(plan.scenario, no_fly_zones=zones)
    for place, expected in (((13.0, 14.0, 40.0), 5.0), ((4.0, 5.0, 40.0), -4.0),
                            ((4.0, 5.0, 51.0), math.inf)):
        assert report.smallest_clearance(scenario, np.array([[place]])) == pytest.approx(expected)
    fenced = replace(plan.scenario, geofence=(
        (-200.0, -200.0), (200.0, -200.0), (200.0, 200.0), (-200.0, 200.0)))
    for place, expected in (((190.0, 0.0, 40.0), 10.0), ((230.0, 240.0, 40.0), -50.0)):
        assert report.smallest_clearance(fenced, np.array([[place]])) == pytest.approx(expected)


def test_a_vehicle_turns_round_in_the_wind_without_leaving_its_place():
    place = (1.0, 2.0, 50.0)
    vehicle = Quadrotor(place, 0.0, Gusts((5.0, 0.0), 1.0, 50.0, STEP, seed=2))
    rest = Setpoint('map', 0, place, 0.0, (0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
    vehicle.follow(rest, 10.0)
    for yaw in (math.pi, 0.0, -math.pi / 2):
        vehicle.follow(replace(rest, yaw=yaw), 4.0)
        assert np.linalg.norm(vehicle.place - place) < 1.0


def test_the_program_flies_a_saved_plan_and_writes_its_table(tmp_path):
    uav = Uav('lone', (0.0, 0.0), (20.0, 0.0), 40.0, 8.0, max_acceleration=3.0)
    plan = solve(Scenario((10.0, 0.0), (Eavesdropper((60.0, 0.0), 5.0),), (uav,), 6.0, 12))
    plan.save(tmp_path / 'hop.json')
    assert main(['--out', str(tmp_path), '--plans', str(tmp_path / 'hop.json')]) == 0
    row = (tmp_path / 'fly.md').read_text().splitlines()[-1]
    assert row.startswith('| hop | ') and row.endswith('| - | - |')
    assert (tmp_path / 'flight_1.png').exists()


def test_gusts_have_the_mean_the_deviation_and_the_memory_that_they_are_given():
    step, count = 0.1, 200_000
    gusts = Gusts((3.0, 4.0), 5 / 3, 100.0, step, seed=3)
    wind = np.array([gusts.step() for _ in range(count)])
    assert wind.mean(axis=0) == pytest.approx([3.0, 4.0, 0.0], abs=0.2)
    assert wind.std(axis=0) == pytest.approx([5 / 3, 5 / 3, 5 / 6], rel=0.1)
    # At 100 m the length scale of MIL-F-8785C is 278 m; the wind of 5 m/s carries it past.
    feet = 100 / 0.3048
    scale = 0.3048 * feet / (0.177 + 0.000823 * feet)**1.2
    lag = round(scale / 5 / step)
    off = wind[:, 0] - wind[:, 0].mean()
    assert (off[lag:] * off[:-lag]).mean() / off.var() == pytest.approx(math.exp(-1), abs=0.12)
    again = Gusts((3.0, 4.0), 5 / 3, 100.0, step, seed=3)
    assert (again.step() == wind[0]).all()


def test_a_flight_that_is_late_paused_and_pushed_aside_comes_home_and_is_drawn(tmp_path):
    """Whether setpoints jump then is told by test_player.py and test_stories.py."""
    uav = Uav('lone', (-30.0, 0.0), (30.0, 0.0), 60.0, 12.0, max_acceleration=3.0)
    scenario = Scenario((0.0, 0.0), (Eavesdropper((60.0, 80.0), 10.0),), (uav,), 20.0, 20)
    event = missions.Event('short', ((2.0, 'replay/start'), (5.0, 'replay/pause'),
                                     (7.0, 'replay/start')), push=(9.0, 10.0))
    flown = fly_event(event, scenario)
    found = report.event_report(flown)
    # The planner saw the push; here it refuses, since no way back is in time for the goal.
    assert found.is_smooth and found.replans + found.refusals > 0 and found.error_max > 10.0
    assert flown.places[0, -1] == pytest.approx((30.0, 0.0, 60.0), abs=2.0)
    save_flight(flown, tmp_path / 'event.png')
    assert (tmp_path / 'event.png').read_bytes().startswith(b'\x89PNG')
    # A jump would be found.
    flown.setpoints[0, 100:] += 0.5
    assert not report.event_report(flown).is_smooth


def test_the_missions_can_be_flown_and_there_are_as_many_random_ones_as_are_asked_for():
    named = [*missions.paper_missions(), *missions.random_missions(5)]
    assert len({name for name, _ in named}) == len(named) == 9
    for _, scenario in named:
        assert all(uav.max_acceleration in (2.0, 3.0) for uav in scenario.uavs)
    names = [name for name, _ in missions.random_missions(120)]
    assert len(set(names)) == 120 and names[:5] == [name for name, _ in named[4:]]
    assert list(missions.random_missions(0)) == []


START_NS = 1_795_743_002_000_000_000


def compare_logs(track, folder):
    """Yield the format and the Comparison of each log of a track."""
    starts = {uav.name: uav.start for uav in track.plan.scenario.uavs}
    for kind, source in write_logs(track, folder).items():
        shifts = starts if kind in ('ulg', 'BIN') else None
        yield kind, compare(track.plan, read_flight(source, track.plan, shifts=shifts))


@pytest.fixture(scope='module')
def track(plan, flight):
    """Return where the quadrotors were, as what logs are written of."""
    return from_physics(replace(plan, start_ns=START_NS), flight)


def flown_errors(track):
    """Return the horizontal errors (K,) in m of each UAV at all steps of the physics."""
    asked = track.plan.curve.at(track.times).positions
    return {uav.name: np.linalg.norm(asked[index] - track.positions[index, :, :2], axis=-1)
            for index, uav in enumerate(track.plan.scenario.uavs)}


def test_errors_and_broken_slots_of_a_flight_in_physics_are_found_in_every_log(
        plan, track, tmp_path):
    positions = track.positions.copy()
    away = 80.0 * np.sin(np.clip((track.times - 14.0) / 10.0, 0.0, 1.0) * math.pi)**2
    positions[0, :, 1] += away  # The transmitter leaves its way, to the eavesdropper.
    lost = replace(track, positions=positions)
    fine = np.arange(1.0, 41.0, 0.02) + 0.01
    places = np.stack([[np.interp(fine, lost.times, column) for column in path.T[:2]]
                       for path in positions]).swapaxes(1, 2)
    powers = find_powers(plan, fine)
    flown, asked = (np.maximum(guaranteed_rates(
        plan.scenario, np.pad(level, ((0, 0), (1, 1), (0, 0))), powers, times=fine), 0.0).reshape(
            -1, 50).mean(axis=1) for level in (places, plan.curve.at(fine).positions))
    broken = asked - flown > 0.05 * asked + 0.01 * asked.mean()
    assert 3 < broken.sum() < 20
    for kind, comparison in compare_logs(lost, tmp_path):
        assert comparison.broken.tolist() == broken.tolist(), kind
        achieved = comparison.achieved['guaranteed'].sum(axis=0)
        assert achieved[1:] == pytest.approx(flown[1:], abs=0.01)
        assert achieved[0] == pytest.approx(flown[0], rel=0.03)  # Power is logged 0.02 s late.
        for name, errors in flown_errors(lost).items():
            assert comparison.uavs[name].error_rms_m == pytest.approx(
                np.sqrt((errors**2).mean()), rel=0.02), kind
