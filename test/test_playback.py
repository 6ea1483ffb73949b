from dataclasses import replace

from hypothesis import given
from hypothesis import strategies as st
import numpy as np
import pytest
from secure_uav_planner import channel, fly_hover_fly, Scenario
from secure_uav_planner.playback import headings, Playback, Player, velocities
from strategies import scenarios


@pytest.fixture
def plan():
    return fly_hover_fly(Scenario.paper(102), 'optimised')


@given(scenarios(), st.floats(-1, 2))
def test_positions_are_interpolated_and_powers_held(scenario, share):
    plan = fly_hover_fly(scenario)
    playback = Playback(plan)
    time = share * playback.duration
    moment = playback.at(time)
    for path, at in zip(plan.positions, moment.positions):
        assert at == pytest.approx([
            np.interp(time, plan.times, path[:, axis]) for axis in range(2)], abs=1e-6)
    slot = np.floor(np.clip(time, 0, playback.duration) / scenario.slot_duration + 1e-9)
    expected = plan.powers[:, int(slot) - 1] if 1 <= slot <= scenario.slots else 0.0
    assert moment.powers == pytest.approx(np.broadcast_to(expected, len(moment.powers)))


def test_at_the_points_the_rate_is_that_of_the_slots(plan):
    playback = Playback(plan)
    place = (203.0, 4.0)
    rates = channel.secrecy_rates(plan.scenario, plan.positions, plan.powers, place)
    played = [playback.secrecy_rate(playback.at(time), place) for time in plan.times[1:-1]]
    assert played == pytest.approx(np.maximum(rates, 0))


def test_headings_are_held_while_hovering():
    plan = fly_hover_fly(Scenario.paper(200))
    hovering = np.linalg.norm(velocities(plan), axis=-1) == 0
    heading = headings(plan)
    assert hovering[0].sum() > 50
    assert np.unique(np.round(heading[0], 9)).size == 2
    assert heading[0, 0] == pytest.approx(np.arctan2(-500, -100))
    assert heading[0, -1] == pytest.approx(np.arctan2(-500, 100))


def play(player, step, eavesdropper=None):
    player.start()
    while not player.finished:
        player.advance(step, eavesdropper)
    return player.delivered


@pytest.mark.parametrize('step', [0.05, 0.73, 40.0])
def test_what_is_delivered_does_not_depend_on_the_playback_speed(plan, step):
    player = Player()
    player.load(plan)
    place = (195.0, 0.0)
    rates = channel.secrecy_rates(plan.scenario, plan.positions, plan.powers, place)
    # Positions move on within a slot, so the sum over slots is only close.
    assert play(player, step, place) == pytest.approx(np.maximum(rates, 0).sum(), rel=0.01)


def test_the_largest_step_is_that_of_the_fastest_uav(plan):
    player = Player()
    player.load(plan)
    play(player, 0.25)
    assert player.largest_step == pytest.approx(2.5, rel=1e-6)


def test_pause_holds_reset_returns_and_start_goes_on(plan):
    player = Player()
    player.load(plan)
    assert not player.streaming
    player.start()
    player.advance(10.0)
    player.pause()
    held = player.advance(10.0)
    assert player.time == 10.0 and player.streaming
    assert held.positions == pytest.approx(plan.positions[:, 10])
    player.start()
    player.advance(5.0)
    assert player.time == 15.0
    player.reset()
    assert player.time == 0.0 and not player.streaming


def test_a_new_plan_takes_over_when_its_time_has_come_and_joins_continuously(plan):
    plan = replace(plan, start_ns=10**18)
    player = Player()
    player.load(plan)
    player.start()
    player.advance(20.0)
    player.load(plan.tail(30))
    assert player.playback.plan is plan  # not yet
    last, largest = player.advance(0.0), 0.0
    while not player.finished:
        moment = player.advance(0.5)
        largest = max(largest, np.linalg.norm(moment.positions - last.positions, axis=-1).max())
        last = moment
    assert player.playback.plan.scenario.slots == 72
    assert largest <= 5.0 + 1e-6
    assert last.positions == pytest.approx(plan.positions[:, -1])


def test_a_plan_whose_time_has_passed_takes_over_at_the_right_moment(plan):
    plan = replace(plan, start_ns=10**18)
    player = Player()
    player.load(plan)
    player.start()
    player.advance(40.0)
    player.load(plan.tail(30))
    assert player.playback.plan.scenario.slots == 72
    assert player.time == pytest.approx(10.0)
