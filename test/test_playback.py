from hypothesis import given, settings
from hypothesis import strategies as st
import numpy as np
import pytest
from secure_uav_planner import fly_hover_fly, Scenario
from secure_uav_planner.model.curve import Curve
from secure_uav_planner.plan.playback import Playback
from strategies import scenarios, with_uavs


@given(scenarios(), st.floats(-1, 2))
def test_positions_are_interpolated_and_powers_held(scenario, share):
    plan = fly_hover_fly(scenario)
    playback = Playback(plan)
    time = share * playback.duration
    moment = playback.at(time)
    for uav, path, at in zip(scenario.uavs, plan.positions, moment.positions):
        if uav.max_acceleration is None:
            assert at == pytest.approx([
                np.interp(time, plan.times, path[:, axis]) for axis in range(2)], abs=1e-6)
    slot = np.floor(np.clip(time, 0, playback.duration) / scenario.slot_duration + 1e-9)
    expected = plan.powers[:, int(slot) - 1] if 1 <= slot <= scenario.slots else 0.0
    assert moment.powers == pytest.approx(np.broadcast_to(expected, len(moment.powers)))


def test_headings_are_held_while_hovering():
    plan = fly_hover_fly(Scenario.paper(200))
    motion = Curve(plan.scenario, plan.positions).at(plan.times)
    hovering = np.linalg.norm(motion.velocities, axis=-1) == 0
    heading = motion.headings
    assert hovering[0].sum() > 50
    assert np.unique(np.round(heading[0], 9)).size == 2
    assert heading[0, 0] == pytest.approx(np.arctan2(-500, -100))
    assert heading[0, -1] == pytest.approx(np.arctan2(-500, 100))


@settings(max_examples=60)
@given(scenarios(), st.integers(0, 2**32 - 1))
def test_the_curve_is_smooth_and_keeps_its_limits_at_any_time(scenario, seed):
    plan = fly_hover_fly(scenario)
    curve = Curve(scenario, plan.positions)
    times = np.random.default_rng(seed).uniform(curve.begin, curve.end, 400)
    small = 1e-6 * scenario.slot_duration
    before, here, after = (curve.at(times + by) for by in (-small, 0.0, small))
    smooth = np.isfinite(scenario.max_accelerations)
    # Position, velocity and acceleration belong together.
    speed = (after.positions - before.positions) / (2 * small)
    scale = scenario.max_speeds[:, None, None]
    assert (np.abs(speed - here.velocities) / scale)[smooth].max(initial=0) < 1e-4
    for values, most in ((here.velocities, scenario.max_speeds),
                         (here.accelerations, scenario.max_accelerations)):
        largest = np.linalg.norm(values, axis=-1).max(axis=1)
        assert (largest <= most * (1 + 1e-6) + 3e-6 / scenario.slot_duration**2)[smooth].all()
    # The heading is that of the velocity, but held while hovering.
    ahead = np.stack([np.cos(here.headings), np.sin(here.headings)], axis=-1)
    speeds = np.linalg.norm(here.velocities, axis=-1) / scale[:, 0]
    along = (ahead * here.velocities).sum(axis=-1) / scale[:, 0]
    assert np.abs(along - speeds)[smooth[:, None] & (speeds > 1.01e-3)].max(initial=0) < 1e-4
    # It leaves the points by no more than a t_s^2 / 8.
    apart = np.linalg.norm(curve.at(plan.times).positions - plan.positions, axis=-1).max(axis=1)
    assert (apart <= scenario.max_accelerations * scenario.slot_duration**2 / 8 + 1e-6).all()


def test_a_uav_at_rest_leaves_its_start_and_reaches_its_goal_half_a_slot_beyond_the_points():
    scenario = with_uavs(Scenario.paper(200), max_acceleration=2.0)
    plan = fly_hover_fly(scenario)
    curve = Curve(scenario, plan.positions)
    assert (curve.begin, curve.end) == (-0.5, 201.5)
    first, last = curve.at([-0.5]), curve.at([201.5])
    assert np.allclose(first.positions[:, 0], scenario.starts)
    assert np.allclose(last.positions[:, 0], scenario.goals)
    assert np.allclose(first.velocities, 0) and np.allclose(last.velocities, 0)
    halves = curve.at(plan.times[:-1] + 0.5)
    assert np.allclose(halves.positions, (plan.positions[:, 1:] + plan.positions[:, :-1]) / 2)
    assert np.allclose(halves.velocities, np.diff(plan.positions, axis=1))
