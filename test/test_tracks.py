"""Receivers that move: tracks in missions, rates, proofs, plans and files, by plain formulas."""

from dataclasses import replace
import json

import numpy as np
from oracle import disc_at, secrecy_rates
import pytest
from secure_uav_planner import assess, Scenario, solve, World
from secure_uav_planner.assessment.world import draw_places
from secure_uav_planner.mission.scenario import Eavesdropper
from secure_uav_planner.model.channel import guaranteed_rates
from strategies import PLACED, with_eavesdroppers


def rates_at(scenario, times, positions, powers):
    """Return the guaranteed rates by the plain formulas at times, (N,)."""
    [rates] = secrecy_rates(scenario, times, positions, powers)
    return rates


def drive(scenario, speed=5.0, radius=10.0):
    half = speed * scenario.duration / 2
    return replace(scenario, eavesdroppers=(Eavesdropper(track=(
        (0.0, 200.0, -half, radius), (scenario.duration, 200.0, half, radius))),))


@pytest.fixture(scope='module')
def driving():
    return drive(Scenario.paper(120))


@pytest.mark.parametrize('method, least', [('joint', 2.3219), ('alternating', 2.28)])
def test_a_plan_for_the_track_reaches_the_rate_of_the_reference(driving, method, least):
    plan = solve(driving, method, objective='guaranteed')
    assert plan.rate >= least
    times = plan.times[1:-1]
    plain = rates_at(driving, times, plan.positions[:, 1:-1], plan.powers)
    np.testing.assert_allclose(plan.guaranteed_rates, np.maximum(plain, 0), atol=1e-9)
    first = solve(with_eavesdroppers(driving, track=None), method, objective='guaranteed')
    assert guaranteed_rates(driving, first.positions, first.powers).clip(0).mean() < (
        0.8 * plan.rate)


def test_the_worst_case_is_planned_for_and_a_warm_start_is_no_worse(driving):
    plan = solve(driving)
    assert plan.rate > 2.33
    faster = drive(driving, 6.0)
    assert solve(faster, initial=plan).rate >= 0.998 * solve(faster).rate


def test_rates_along_the_curve_move_the_receivers_in_continuous_time(driving):
    plan = solve(driving, objective='guaranteed')
    shares = (np.arange(200) + 0.5) / 200
    means = []
    for n in range(1, driving.slots + 1):
        times = (n + shares) * driving.slot_duration
        powers = np.repeat(plan.powers[:, [n - 1]], len(shares), axis=1)
        means.append(rates_at(driving, times, plan.curve.at(times).positions, powers).mean())
    np.testing.assert_allclose(plan.curve_rates, np.maximum(means, 0), atol=1e-4)


def test_a_constant_track_is_the_same_as_no_track():
    scenario = Scenario.paper(120)
    still = drive(scenario, 0.0)
    ours, theirs = solve(still), solve(scenario)
    assert ours.rate == theirs.rate
    assert (ours.positions == theirs.positions).all()


def test_an_assessment_moves_the_eavesdropper_and_a_wrong_speed_breaks_the_promise(driving):
    plan = solve(driving)
    assert assess(plan, 200).outage == 0
    assert assess(plan, 200, world=World(speed_factor=1.0)).outage == 0
    assert assess(plan, 200, world=World(speed_factor=2.0)).outage == 1
    assert assess(plan, 200).mean > plan.rate


def test_what_a_track_decides_may_be_left_out(driving):
    """What differs from the track is refused, see test_wrong_values.py."""
    eve, track = driving.eavesdroppers[0], ((0.0, 0.0, 0.0), (60.0, 5.0, 5.0))
    moving = replace(driving, ground_node_track=track)
    same = Eavesdropper((200.0, -300.0), 10.0, track=eve.track)
    assert same == eve and eve.position == (200.0, -300.0) and eve.error_radius == 10.0
    data = json.loads(json.dumps(moving.to_dict()))
    assert data['ground_node'] == {'track': [[*knot] for knot in track]}
    assert not {*PLACED} & {*data['eavesdroppers'][0]}
    # As files had them before.
    data['ground_node']['position'] = (0.0, 0.0)
    data['eavesdroppers'][0] |= {'position': (200.0, -300.0), 'error_radius': 10.0}
    assert Scenario.from_dict(data) == moving


def test_an_assessment_draws_offsets_that_keep_their_share_of_the_radius():
    scenario = drive(Scenario.paper(120, slots=40), 5.0)
    half = scenario.duration / 2
    scenario = replace(scenario, eavesdroppers=(Eavesdropper(track=(
        (0.0, 200.0, -300.0, 5.0), (half, 200.0, 0.0, 20.0), (120.0, 300.0, 0.0, 20.0))),))
    plan = solve(scenario, objective='guaranteed')
    found = assess(plan, draws=50, seed=4)
    times = plan.times[1:-1]
    centres, radii = disc_at(scenario.eavesdroppers[0], times)
    first = next(draw_places(scenario, World(), 50, 4))[0]
    shares = (first - centres[0]) / radii[0]
    wanted = np.array([
        np.maximum(rates_at(
            replace(scenario, eavesdroppers=(Eavesdropper(track=tuple(
                (time, *(centre + radius * share), 0.0) for time, centre, radius in zip(
                    times.tolist(), centres, radii.tolist()))),)),
            times, plan.positions[:, 1:-1], plan.powers), 0.0).mean() for share in shares])
    np.testing.assert_allclose(found.rates, wanted, rtol=1e-9)


def test_the_page_moves_the_discs(driving):
    pytest.importorskip('plotly')
    from secure_uav_planner.output.traces import PlanTraces
    plan = solve(driving, objective='guaranteed')
    content = PlanTraces(plan)
    for point in (0, 60, 121):
        disc = next(trace for trace, _ in content.moving_traces(point)
                    if trace.name == "eavesdropper's disc")
        centres, radii = disc_at(driving.eavesdroppers[0], plan.times[[point]])
        away = np.hypot(np.array(disc.x) - centres[0, 0], np.array(disc.y) - centres[0, 1])
        np.testing.assert_allclose(away, radii[0], atol=1e-9)
