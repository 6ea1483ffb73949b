"""Tracking of UAVs against their plan, and the rejoin of a replan: the laws, without ROS."""

from dataclasses import replace

from hypothesis import assume, given, settings
from hypothesis import strategies as st
import numpy as np
import pytest
from secure_uav_planner import NoFlyZone, Scenario, solve
from secure_uav_planner.errors import InfeasibleMissionError, OptionError
from secure_uav_planner.model.channel import guaranteed_rates
from secure_uav_planner.optimize.rejoin import find_last_kept_point, find_rejoin
from secure_uav_planner.plan.playback import Playback
from secure_uav_planner.plan.splice import cut_tail
from secure_uav_planner.plan.tracking import (
    AchievedRates, deviation, FollowerReports, GAIN, MeasuredState, predict_return, predict_state,
    predict_stop, start_from_state, Watch)
from strategies import with_uavs

LEAD, TOLERANCE = 2.0, 1.0


def stop_early(iteration):
    """Stop a solve after its first steps."""
    return iteration.number > 3


@pytest.fixture(scope='module', params=[None, 2.0], ids=['unlimited', '2 m/s^2'])
def plan(request):
    """Return a plan with a minute to spare, for both kinds of vehicle."""
    scenario = with_uavs(Scenario.paper(160.0, slots=80), max_acceleration=request.param)
    return replace(solve(scenario), start_ns=10**18)


def state_at(playback, time, offset, gust=(0.0, 0.0), uav=0):
    moment = playback.at(time)
    return MeasuredState(time, tuple((moment.positions[uav] + offset).tolist()),
                         tuple((moment.velocities[uav] + gust).tolist()))


def get_limits(plan):
    uav = plan.scenario.uavs[0]
    return uav.max_speed, uav.max_acceleration


TIMES = st.floats(10.0, 80.0)
OFFSETS = st.tuples(st.floats(-40.0, 40.0), st.floats(-40.0, 40.0))
GUSTS = st.tuples(st.floats(-5.0, 5.0), st.floats(-5.0, 5.0))


@settings(max_examples=25)
@given(time=TIMES, offset=OFFSETS, gust=GUSTS)
def test_a_prediction_keeps_the_limits_of_the_vehicle(plan, time, offset, gust):
    most_speed, most_acceleration = get_limits(plan)
    measured = state_at(Playback(plan), time, offset, gust)
    times = np.linspace(time, time + 20.0, 401)
    positions, velocities = predict_return(Playback(plan), 0, measured, times)
    assert positions[0] == pytest.approx(measured.position)
    speeds = np.linalg.norm(np.diff(positions, axis=0), axis=1) / 0.05
    # After a gust it may be faster at first.
    assert (speeds <= max(most_speed, np.hypot(*measured.velocity)) + 1e-6).all()
    if most_acceleration is not None:
        changes = np.linalg.norm(np.diff(velocities, axis=0), axis=1) / 0.05
        assert changes.max() <= most_acceleration + 1e-6
        assert velocities[0] == pytest.approx(measured.velocity)


@settings(max_examples=25)
@given(time=st.floats(90.0, 100.0), offset=OFFSETS, gust=GUSTS)
def test_a_prediction_returns_to_a_plan_that_leaves_time_for_it(plan, time, offset, gust):
    playback = Playback(plan)
    # The plan hovers for a minute; this one hovers all the time.
    hovering = Playback(replace(
        plan, scenario=replace(plan.scenario, uavs=tuple(
            replace(uav, start=uav.goal) for uav in plan.scenario.uavs)),
        positions=np.repeat(plan.positions[:, -1:], plan.positions.shape[1], axis=1)))
    measured = state_at(hovering, time, offset, gust)
    (before, after), _ = predict_return(hovering, 0, measured, [time, time + 25.0])
    goal = plan.positions[0, -1]
    assert np.linalg.norm(after - goal) < 0.01
    assert np.linalg.norm(before - goal) == pytest.approx(np.hypot(*offset))
    # On the plan it stays on the plan.
    times = time + np.arange(5.0)
    on_plan, _ = predict_return(playback, 1, state_at(playback, time, (0, 0), uav=1), times)
    planned = playback.curve.at(times).positions[1]
    assert np.linalg.norm(on_plan - planned, axis=1).max() < 0.5 / GAIN


@settings(max_examples=25)
@given(time=TIMES, offset=OFFSETS, gust=GUSTS, seed=st.integers(0, 2**32 - 1))
def test_a_uav_that_stands_is_told_from_one_that_returns_to_its_plan(
        plan, time, offset, gust, seed):
    """Both are measured with noise, at 10 Hz for 7 s; not where both would move alike."""
    playback, limit, rng = Playback(plan), get_limits(plan)[1], np.random.default_rng(seed)
    measured = state_at(playback, time, offset, gust)
    times = time + np.arange(0.0, 7.0, 0.1)
    ways = [predict_return(playback, 0, measured, times), predict_stop(measured, times, limit)]
    assume(np.linalg.norm(ways[0][0][-20] - ways[1][0][-20]) > 10.0)
    for (positions, velocities), is_held in zip(ways, (False, True)):
        watch = Watch()
        for state in zip(times, positions + rng.normal(0.0, 0.2, positions.shape),
                         velocities + rng.normal(0.0, 0.1, velocities.shape)):
            measured = MeasuredState(state[0], *map(tuple, state[1:]))
            watch.add(measured)
            is_off = np.hypot(*deviation(playback, 0, measured)) > 5.0
            assert is_held or not (is_off and watch.is_held(playback, 0))
    assert watch.is_held(playback, 0)


@settings(max_examples=25)
@given(time=TIMES, offset=OFFSETS, gust=GUSTS)
def test_a_uav_that_is_held_brakes_within_its_limit_and_stands(plan, time, offset, gust):
    limit, measured = get_limits(plan)[1], state_at(Playback(plan), time, offset, gust)
    times = time + np.linspace(-1.0, 20.0, 421)
    positions, velocities = predict_stop(measured, times, limit)
    assert positions[:20] == pytest.approx(np.tile(measured.position, (20, 1)))
    assert not velocities[-1].any() and (positions[-1] == positions[-2]).all()
    if limit is not None:
        changes = np.linalg.norm(np.diff(velocities, axis=0), axis=1) / 0.05
        assert changes.max() <= limit + 1e-6
        moves = np.diff(positions, axis=0) - 0.05 * (velocities[:-1] + velocities[1:]) / 2
        assert np.abs(moves[20:]).max() < 0.05**2 * limit


def test_the_deviation_is_from_the_start_before_the_flight_and_from_the_goal_after_it(plan):
    playback, uav = Playback(plan), plan.scenario.uavs[0]
    for time, place in ((-100.0, uav.start), (playback.duration + 100.0, uav.goal)):
        measured = MeasuredState(time, (place[0] + 3.0, place[1] - 4.0))
        assert deviation(playback, 0, measured) == pytest.approx([3.0, -4.0])


def test_before_a_new_plan_a_uav_follows_its_plan_or_else_brakes(plan):
    playback, (_, limit) = Playback(plan), get_limits(plan)
    measured = state_at(playback, 30.0, (0.2, -0.1))
    position, velocity = predict_state(measured, 35.0, limit, playback, 0, TOLERANCE)
    assert position == tuple(playback.at(35.0).positions[0])
    assert velocity == tuple(playback.at(35.0).velocities[0])
    far = MeasuredState(30.0, (500.0, 0.0), (3.0, -4.0))
    for last in (playback, None):
        position, velocity = predict_state(far, 35.0, limit, last, 0, TOLERANCE)
        assert velocity == (0.0, 0.0)
        # 5 m/s at 2 m/s^2 take 6.25 m.
        assert position == pytest.approx((503.75, -5.0) if limit else (500.0, 0.0))
    if limit:  # There is no time to brake.
        position, velocity = predict_state(far, 31.0, limit)
        assert (position, velocity) == (pytest.approx((503.0, -4.0)), (3.0, -4.0))
    assert predict_state(far._replace(velocity=None), 35.0, limit) == (far.position, None)


def test_the_curve_of_a_uav_in_motion_begins_with_its_state(plan):
    limit = plan.scenario.uavs[0].max_acceleration
    uav = start_from_state(plan.scenario.uavs[0], (80.0, 480.0), (3.0, -4.0), 2.0)
    scenario = replace(plan.scenario, uavs=(uav, plan.scenario.uavs[1]))
    playback = Playback(solve(scenario, initial=plan))
    if limit is None:
        assert playback.at(0.0).positions[0] == pytest.approx([80.0, 480.0])
    else:
        begin = playback.at(playback.begin)
        assert playback.begin == -1.0
        assert begin.positions[0] == pytest.approx([80.0, 480.0])
        assert begin.velocities[0] == pytest.approx([3.0, -4.0])
        fast = start_from_state(uav, (0.0, 0.0), (30.0, -40.0), 2.0)
        assert fast.start_velocity == pytest.approx((6.0, -8.0))


def begin_replan(plan, time, states, tolerance=TOLERANCE):
    first = find_last_kept_point(plan.scenario, time + LEAD)
    return find_rejoin(plan, first, states, tolerance, plan.scenario)


@settings(max_examples=20)
@given(time=st.floats(5.0, 60.0), offset=OFFSETS, gust=GUSTS)
def test_a_replan_meets_a_uav_where_it_will_be_and_setpoints_keep_the_limits(
        plan, time, offset, gust):
    playback = Playback(plan)
    measured = state_at(playback, time, offset, gust)
    try:
        beginning = begin_replan(plan, time, [measured, None])
    except InfeasibleMissionError as error:
        assert 'uav1 (' in str(error) and 'cannot be met' in str(error)
        return
    scenario = beginning.scenario
    assert scenario.duration == pytest.approx(
        plan.scenario.duration - beginning.point * plan.scenario.slot_duration)
    # A plan checks the limits of all its points, those of the way included.
    whole = beginning.splice(solve(scenario, initial=beginning.tail, on_iteration=stop_early))
    new = Playback(whole)
    assert beginning.effect >= time + LEAD - 1e-9
    before = np.linspace(playback.begin, beginning.effect, 500)
    assert new.curve.at(before).positions == pytest.approx(playback.curve.at(before).positions)
    limited = plan.scenario.uavs[0].max_acceleration is not None
    meeting = (beginning.point - 0.5 * limited) * plan.scenario.slot_duration
    (position,), (velocity,) = predict_return(playback, 0, measured, [meeting])
    there, planned = new.at(meeting), playback.at(meeting)
    if np.linalg.norm(position - planned.positions[0]) <= TOLERANCE:
        assert there.positions[0] == pytest.approx(planned.positions[0])
    else:
        assert there.positions[0] == pytest.approx(position, abs=1e-6)
        if limited:
            assert there.velocities[0] == pytest.approx(velocity, abs=1e-6)
    assert there.positions[1] == pytest.approx(planned.positions[1])


def test_without_a_deviation_a_replan_begins_on_the_plan(plan):
    playback = Playback(plan)
    near = state_at(playback, 40.0, (0.3, -0.3))
    for states in ([None, None], [near, None]):
        beginning = begin_replan(plan, 40.0, states)
        assert beginning.point == beginning.last_kept
        assert beginning.scenario == cut_tail(plan, beginning.point).scenario
        assert (beginning.positions == plan.positions[:, :beginning.point + 1]).all()
        assert (beginning.powers == plan.powers[:, :beginning.point]).all()


@pytest.mark.parametrize('share', [0.6, 1.0], ids=['between', 'around'])
def test_the_way_to_a_uav_keeps_out_of_zones(plan, share):
    """The zone is between the UAV and its plan, or around the place where they would meet."""
    measured = state_at(Playback(plan), 30.0, (40.0, 20.0))
    free = begin_replan(plan, 30.0, [measured, None])
    assert free.point > free.last_kept
    x, y = (1 - share) * plan.positions[0, free.last_kept] + share * free.positions[0, -1]
    zone = NoFlyZone(tuple((x + u, y + v) for u, v in ((-2, -2), (2, -2), (2, 2), (-2, 2))),
                     ceiling=105.0, name='mast')
    zoned = replace(plan, scenario=replace(plan.scenario, no_fly_zones=(zone,)))
    beginning = begin_replan(zoned, 30.0, [measured, None])
    assert beginning.point > free.point
    whole = beginning.splice(solve(
        beginning.scenario, initial=beginning.tail, on_iteration=stop_early))
    assert whole.scenario.no_fly_zones == (zone,)


def test_slots_of_the_way_with_a_negative_rate_do_not_transmit(plan):
    """Far from its plan the transmitter may be nearer to the eavesdropper than to its node."""
    playback = Playback(plan)
    loud = replace(plan, powers=np.repeat([[1.0], [0.0]], plan.scenario.slots, axis=1))
    measured = state_at(playback, 70.0, (60.0, 0.0))
    beginning = begin_replan(loud, 70.0, [measured, None])
    whole = beginning.splice(solve(
        beginning.scenario, initial=beginning.tail, on_iteration=stop_early))
    way = slice(beginning.last_kept, beginning.point)
    assert beginning.point > beginning.last_kept
    rates = guaranteed_rates(whole.scenario, whole.positions, whole.powers)
    assert (rates[way] >= 0).all()


def test_the_achieved_rate_is_the_planned_one_on_the_plan_and_begins_anew_with_a_new_flight(plan):
    playback, exact, beside = Playback(plan), AchievedRates(), AchievedRates()
    assert exact.rates is None
    for time in np.arange(-3.0, playback.duration + 3.0, 0.1):
        exact.add(playback, time, playback.at(time).positions)
        beside.add(playback, time, playback.at(time).positions + [0.0, 200.0])
    (achieved, planned), (less, again) = exact.rates, beside.rates
    assert achieved == pytest.approx(planned, rel=1e-9) and planned == again
    assert planned == pytest.approx(playback.guaranteed_rates.mean(), rel=5e-3)
    assert less < 0.9 * planned
    assert exact.measured == pytest.approx(1.0)
    # A playback at 30 times the speed is measured every 3 s; here only its second half.
    fast = AchievedRates()
    for time in np.arange(0.0, playback.duration, 3.0):
        if time > playback.duration / 2:
            fast.add(playback, time, playback.at(time).positions, 30.0)
    assert fast.rates is not None and fast.measured == pytest.approx(0.5, abs=0.05)
    # No time counts twice, and a long gap does not count.
    exact.add(playback, playback.duration + 1.5, plan.scenario.goals)
    exact.add(playback, playback.duration + 90.0, plan.scenario.goals)
    assert exact.rates == (achieved, planned)
    # After ~/reset the same plan is another flight.
    beside.add(playback, playback.begin, plan.scenario.starts)
    assert beside.rates is None
    for time in np.arange(50.0, 53.0, 0.1):
        beside.add(playback, time, playback.at(time).positions)
    assert beside.rates[0] == pytest.approx(beside.rates[1]) and beside.measured < 0.1
    later = Playback(replace(plan, start_ns=plan.start_ns + 1))
    exact.add(later, 30.0, later.at(30.0).positions)
    assert exact.rates is None
    with pytest.raises(OptionError, match='positions has the shape'):
        exact.add(later, 31.0, np.zeros((3, 2)))


@given(st.floats(0.01, 1.0), st.floats(0.02, 0.3), st.floats(0.0, 0.9))
def test_a_flight_that_was_paused_is_not_steady_while_it_speeds_up(slope, period, phase):
    """Before, it was up to a rate of 0.07, and the solve of a replan was dropped."""
    reports, time, after = FollowerReports('tester', 'plan', 0.0), 10.0, -2.0 + phase * period
    while after < 2.0:
        rate = min(1.0, slope * max(0.0, after))
        time += rate * period
        reports.add(round((1000.0 + after) * 1e9), round(time * 1e9))
        if after <= 0.0:
            assert reports.is_steady(), 'paused'
        elif period < after < min(1.0 - 2 * period, 1.0 / slope):
            assert not reports.is_steady(), (after, rate)
        after += period


@pytest.mark.parametrize('speed', [0.5, 1.0, 2.0])
def test_stamps_that_jitter_do_not_change_the_playback_speed(speed):
    """Before, a replan was promised at the quotient of the last two reports, 5% off."""
    reports, late = FollowerReports('tester', 'plan', 0.0), np.random.default_rng(1).uniform
    for number in range(300):
        clock_ns = 10**12 + 20_000_000 * number
        reports.add(clock_ns + round(late(0.0, 1e6)), round(speed * clock_ns))
        _, scale = reports.at(reports.last_ns, 0)
        if number >= 50:
            assert scale == pytest.approx(speed, rel=1e-3)
    reports.add(reports.last_ns + 20_000_000, reports.plan_ns)
    assert reports.at(reports.last_ns, 0)[1] == 0.0, 'paused'
