"""Plans played one after another: no setpoint jumps, whatever the order of calls and plans."""

from dataclasses import replace
import math

from hypothesis import settings, strategies as st
from hypothesis.stateful import initialize, invariant, precondition, rule, RuleBasedStateMachine
import numpy as np
import pytest
from secure_uav_planner import fly_hover_fly, Plan, PlanningError, Scenario
from secure_uav_planner.errors import OptionError
from secure_uav_planner.model import channel
from secure_uav_planner.plan.flight import VELOCITY_JUMP
from secure_uav_planner.plan.playback import Playback
from secure_uav_planner.plan.player import Player, POSITION_JUMP
from secure_uav_planner.plan.splice import continue_plan, cut_tail
from secure_uav_planner.plan.tracking import start_from_state
from strategies import with_eavesdroppers, with_uavs

BEGIN = 10**18
SECOND = 10**9
STEP = 0.2  # s between setpoints


@pytest.fixture(scope='module', params=[None, 2.0], ids=['unlimited', '2 m/s^2'])
def plan(request):
    scenario = with_uavs(Scenario.paper(130.0, slots=65), max_acceleration=request.param)
    return replace(fly_hover_fly(scenario, 'optimised'), start_ns=BEGIN)


class Bench:
    """A player, its clock, its setpoints and its refusals."""

    def __init__(self, plan=None, mutes=False):
        self.refused, self.sent = [], []
        self.player = Player(self.refused.append, mutes)
        self.now = BEGIN - 5 * SECOND
        if plan is not None:
            self.player.load(plan)

    def run(self, seconds, step=STEP, **options):
        """Advance the clock in steps; return the last setpoints."""
        for _ in range(round(seconds / step)):
            self.now += round(step * SECOND)
            moment = self.player.tick(self.now, **options)
            if moment is not None:
                self.sent.append((self.now, moment))
        return self.sent[-1][1] if self.sent else None

    @property
    def lag(self):
        """Delay of the flight against the stamps of its plan in s."""
        start_ns = self.player.playback.plan.start_ns
        return (self.now - start_ns) * 1e-9 - self.player.flight.time


def start_flight(plan, seconds, released=0.0, mutes=False):
    """Return a Bench whose plan was released after a time, and then flown for another one."""
    bench = Bench(plan, mutes)
    bench.run(released)
    bench.player.start()
    bench.run(seconds)
    return bench


@pytest.mark.parametrize('released, lag', [(0.0, 0.0), (9.0, 4.0)], ids=['early', 'late'])
def test_a_plan_is_flown_as_a_whole_from_its_time_or_from_a_later_release(plan, released, lag):
    bench = start_flight(plan, 4.0 if not released else STEP, released)
    start = bench.sent[0][1]
    assert len(bench.sent) == (20 if not released else 1)  # None before the release.
    assert start.positions == pytest.approx(plan.scenario.starts) and not start.velocities.any()
    bench.run(30.0)
    late = lag and lag - bench.player.playback.begin
    assert bench.lag == pytest.approx(late, abs=STEP + 0.01 if lag else 1e-6)
    end = bench.run(120.0)
    assert bench.player.ended and bench.player.largest_jump < 1e-9
    assert end.positions == pytest.approx(plan.scenario.goals)


def test_a_flight_goes_on_when_the_clock_is_set_back_before_its_begin(plan):
    bench = start_flight(plan, 30.0)
    time, bench.now = bench.player.flight.time, BEGIN - 3600 * SECOND
    bench.run(10.0)
    assert bench.player.flight.time == pytest.approx(time + 10.0 - STEP)


@pytest.mark.parametrize('has_ended', [False, True])
def test_after_the_clock_was_set_back_in_flight_a_plan_of_the_new_time_is_new(plan, has_ended):
    bench = start_flight(plan, 30.0)
    bench.now = BEGIN - 3600 * SECOND
    bench.run(150.0 if has_ended else 10.0)
    old = replace(plan, start_ns=BEGIN - 3601 * SECOND)
    assert not bench.player.load(old) and 'a plan that has been flown' in bench.refused.pop()
    bench.player.reset()
    new = replace(plan, start_ns=bench.now + 20 * SECOND)
    assert bench.player.load(new) and not bench.refused
    bench.player.start()
    bench.run(40.0)
    assert bench.player.playback.plan is new and bench.player.flight.state == 'flying'


@pytest.mark.parametrize('slots', [200, 20000])
def test_many_slots_take_no_more_evaluations_and_the_goal_is_reached_at_rest(slots, monkeypatch):
    scenario = with_uavs(Scenario.paper(150.0, slots=slots), max_acceleration=2.0,
                         start_velocity=None, goal_velocity=(0.0, -8.0))
    plan, calls, at = replace(fly_hover_fly(scenario), start_ns=BEGIN), [], Playback.at
    monkeypatch.setattr(Playback, 'at', lambda *args: calls.append(args) or at(*args))
    bench = start_flight(plan, 6.0)
    assert len(calls) < 1500
    monkeypatch.undo()
    bench.run(200.0)
    for (_, before), (_, after) in zip(bench.sent, bench.sent[1:]):
        change = np.linalg.norm(after.velocities - before.velocities, axis=-1)
        assert (change <= 2.0 * STEP * (1 + 1e-6)).all()
    assert bench.player.ended and not bench.sent[-1][1].velocities.any()


@pytest.mark.parametrize('share', [0.5, 0.95])
@pytest.mark.parametrize('speed', [1.0, 2.0])
def test_a_goal_reached_in_a_turn_is_approached_to_a_stop(share, speed):
    # 8 points of a circle, 20 degrees apart. The uniform bend between two moves of the flight is a
    # share of the limit. The end of this flight is 7.500000000000001 slots.
    paper = Scenario.paper(130.0, slots=65)
    angles = np.radians(20.0) * np.arange(8)
    radius = share * (20 / 6)**2 / (4 * np.sin(np.radians(10.0))**2)
    path = radius * np.stack([np.cos(angles), np.sin(angles)], axis=1)
    scenario = replace(paper, duration=20.0, slots=6, uavs=(replace(
        paper.uavs[0], start=tuple(path[0]), goal=tuple(path[-1]), max_acceleration=1.0,
        start_velocity=None, goal_velocity=None),))
    bench = start_flight(Plan(scenario, path[None], np.ones((1, 6)), start_ns=BEGIN), 2.0)
    while not bench.player.ended:
        (_, before), after = bench.sent[-1], bench.run(0.05, 0.05, speed=speed)
        change = np.linalg.norm(after.velocities - before.velocities)
        assert change <= max(1.0, speed)**2 * 0.05 * (1 + 1e-6) + VELOCITY_JUMP
    assert not bench.sent[-1][1].velocities.any()


TEAM = "and ['uav1', 'uav2'] fly"


@pytest.mark.parametrize('change, reason', [
    (lambda first, second: (first, second, replace(second, name='uav3', altitude=120.0)), TEAM),
    (lambda first, second: (first,), TEAM),
    (lambda first, second: (first, replace(second, name='uav3')), TEAM),
    (lambda first, second: (replace(first, start=(100.013, 500.0)), second),
     '0.013 m from the last one'),
    (lambda first, second: (replace(first, altitude=150.0), second), '50 m from the last one')])
def test_a_plan_for_another_team_or_from_elsewhere_is_refused_with_the_reason(
        plan, change, reason):
    bench = start_flight(plan, 3.0)
    other = fly_hover_fly(replace(plan.scenario, uavs=change(*plan.scenario.uavs)))
    for start_ns in (BEGIN, BEGIN + 60 * SECOND):
        assert not bench.player.load(replace(other, start_ns=start_ns))
        assert reason in bench.refused[-1]


def test_an_ended_and_an_older_plan_are_never_played_again(plan):
    bench = start_flight(plan, 150.0)
    assert bench.player.ended
    reason = 'it begins no later than a plan that has been flown'
    for start_ns, text in ((None, 'no newer one'), (BEGIN, 'no newer one'), (BEGIN - 1, reason)):
        if start_ns is not None:
            bench.player.load(replace(plan, start_ns=start_ns))
        with pytest.raises(OptionError, match=f'has ended, and .*{text}'):
            bench.player.start()
    assert bench.refused == [reason]
    assert not bench.run(1.0).velocities.any()


def test_after_its_end_a_flight_holds_nothing_and_a_plan_begins_where_the_uavs_are(plan):
    """Before, a plan from elsewhere was refused for ever; only ~/reset helped."""
    bench = start_flight(plan, 150.0)
    first, second = plan.scenario.uavs
    other = replace(fly_hover_fly(replace(plan.scenario, uavs=(
        replace(first, start=(119.0, -503.0), goal=(100.0, 500.0)),
        replace(second, start=second.goal, goal=second.start)))), start_ns=bench.now + SECOND)
    assert not bench.player.load(other) and '19.2 m from the last one' in bench.refused[-1]
    assert '~/start begins it where the UAVs are' in bench.refused[-1]
    there = [(120.0, -500.0, 100.0), (100.0, -500.0, 110.0)]
    for places, text in (((), 'of uav1 is not known; the position of uav2 is not'),
                         ([None, None], 'of uav1 is not known; the position of uav2 is not'),
                         ([there[0], None], 'the position of uav2 is not known; call ~/plan'),
                         ([there[1]] * 2, 'uav1 is 21.7 m from its start; the limit is 5 m')):
        with pytest.raises(OptionError, match=text):
            bench.player.start(places, 5.0)
        assert bench.player.ended and bench.player.streaming  # The last flight still holds.
    bench.player.start(there, 5.0)
    assert bench.player.playback.plan is other and bench.player.streaming
    assert bench.run(STEP).positions[0] == pytest.approx([119.0, -503.0], abs=0.1)
    bench.run(150.0)
    assert bench.player.ended and bench.sent[-1][1].positions[0].tolist() == [100.0, 500.0]


def test_after_a_reset_the_flight_waits_until_the_uavs_can_be_back(plan):
    bench = start_flight(plan, 45.0)
    bench.player.reset()
    assert not bench.player.streaming
    bench.player.start()
    unknown = [None, None]
    waits = bench.player.unmet_conditions(unknown, 5.0, 1.0)
    assert len(waits) == 2 and 'uav1 to reach its start, another' in waits[0]
    # A jump of the clock does not count as time to fly.
    bench.now += 60 * SECOND
    bench.run(STEP, is_ready=False)
    assert len(bench.player.unmet_conditions(unknown, 5.0, 1.0)) == 2
    bench.run(60.0, is_ready=False)
    assert not bench.player.unmet_conditions(unknown, 5.0, 1.0)
    # Measured places count instead of times.
    places = [(*uav.start, uav.altitude) for uav in plan.scenario.uavs]
    assert not bench.player.unmet_conditions(places, 5.0, 1.0)
    for x, distance in ((0.0, '509.9'), (math.nan, 'nan')):
        places[1] = (x, 0.0, 110.0)
        assert bench.player.unmet_conditions(places, 5.0, 1.0) == [
            f'uav2 to be at its start, {distance} m away']


def plan_continuation(bench, plan, ahead):
    """Return a plan that continues the setpoints some seconds ahead."""
    player, slot = bench.player, plan.scenario.slot_duration
    moment = player.playback.at(player.flight.time + player.flight.time_scale * ahead)
    uavs = tuple(
        start_from_state(uav, tuple(at.tolist()),
                         tuple((velocity * player.flight.time_scale).tolist()),
                         slot)
        for uav, at, velocity in zip(
            plan.scenario.uavs, moment.positions, moment.velocities, strict=True))
    next_plan = fly_hover_fly(replace(plan.scenario, uavs=uavs))
    lead = round(-Playback(next_plan).begin * SECOND)
    return replace(next_plan, start_ns=bench.now + round(ahead * SECOND) + lead)


@pytest.mark.parametrize('ahead, before_pause', [(3.0, None), (6.0, 1.0), (1.0, 0.8)])
def test_a_continuation_is_spliced_in_at_its_time_which_a_pause_delays(plan, ahead, before_pause):
    bench = start_flight(plan, 20.0, released=8.0)
    next_plan = plan_continuation(bench, plan, ahead)
    bench.player.load(next_plan)
    assert bench.player.playback.plan is plan
    if before_pause:
        bench.run(before_pause)
        assert bench.player.pause()
        assert not bench.run(20.0).velocities.any() and not bench.player.pause()
        bench.player.start()
    bench.run(15.0)
    assert bench.player.playback.plan is next_plan and not bench.refused
    assert bench.player.flight.time_scale == 1.0
    assert 10.0 < bench.lag < 30.0 if before_pause else bench.lag == pytest.approx(0.0, abs=1e-6)


@pytest.mark.parametrize('happening', ['pause', 'low speed', 'jump ahead', 'jump back'])
def test_a_plan_that_waits_for_its_splice_and_comes_again_keeps_it_and_takes_the_promise(
        plan, happening):
    bench = start_flight(plan, 20.0)
    next_plan = replace(plan_continuation(bench, plan, 6.0), promised_until=90.0)
    assert bench.player.load(next_plan)
    bench.run(1.0)
    if happening == 'pause':
        bench.player.pause()
        bench.run(10.0)
    elif happening == 'low speed':
        bench.run(6.0, speed=0.5)
    else:
        bench.now += (3 if happening == 'jump ahead' else -3) * SECOND
        bench.run(STEP)
    again = next_plan.end_promise(0.0)
    assert not bench.player.load(again)
    bench.player.start()
    bench.run(15.0)
    assert bench.player.playback.plan is again and not bench.refused


@pytest.mark.parametrize('is_paused', [False, True])
def test_a_plan_back_begins_after_the_flight_at_its_own_time_and_not_in_a_pause(plan, is_paused):
    bench = start_flight(plan, 25.0)
    back = replace(plan.scenario, uavs=tuple(
        replace(uav, start=uav.goal, goal=uav.start) for uav in plan.scenario.uavs))
    home = replace(fly_hover_fly(back), start_ns=BEGIN + 150 * SECOND)
    bench.player.load(home)
    bench.run(bench.player.playback.duration - bench.player.flight.time - 0.5)
    if is_paused:
        bench.player.pause()
        assert not bench.run(60.0).velocities.any() and not bench.player.playing
        bench.player.start()
        bench.run(5.0)
    else:
        held = bench.run(15.0)
        assert held.positions == pytest.approx(plan.scenario.goals) and not held.velocities.any()
    bench.run(30.0)
    assert bench.player.playback.plan is home and not bench.refused
    assert is_paused or bench.lag == pytest.approx(0.0, abs=1e-6)


def test_a_plan_that_comes_after_its_begin_is_refused_and_one_that_waits_stays(plan):
    bench = start_flight(plan, 30.0)
    next_plan, waiting = (plan_continuation(bench, plan, ahead) for ahead in (0.2, 6.0))
    assert bench.player.load(waiting)
    bench.run(0.6)
    assert not bench.player.load(next_plan)
    assert bench.refused[-1].startswith('it came 0.40 s too late: its setpoint of uav')
    bench.run(15.0)
    assert bench.player.playback.plan is waiting and len(bench.refused) == 1


def test_a_revision_replaces_its_plan_at_once_and_a_late_revision_is_refused(plan):
    bench = start_flight(plan, 25.0)
    ahead = cut_tail(plan, 20)
    new_tail = fly_hover_fly(with_eavesdroppers(ahead.scenario, position=(150.0, 60.0)))
    revised = continue_plan(plan, 20, new_tail)
    bench.player.load(revised)
    assert bench.player.playback.plan is revised
    bench.run(30.0)
    late = continue_plan(plan, 20, replace(fly_hover_fly(replace(
        ahead.scenario, ground_node=(0.0, 200.0))), start_ns=None))
    bench.player.load(late)
    assert bench.refused[0].startswith('it comes too late for the flight that it changes')
    assert bench.player.playback.plan is revised


@pytest.mark.parametrize('step', [STEP, 0.43])
@pytest.mark.parametrize('speed', [1.0, 40.0])
def test_the_delivered_information_does_not_depend_on_the_playback_speed(plan, step, speed):
    bench, place = Bench(plan), (195.0, 0.0)
    bench.player.start()
    bench.run(10.0 + 140.0 / speed, step, speed=speed, eavesdropper=place)
    assert bench.player.ended
    rates = channel.secrecy_rates(plan.scenario, plan.positions, plan.powers, place)
    # The rate changes within a slot, so the sum over slots is only close.
    assert bench.player.delivered == pytest.approx(
        2 * np.maximum(rates, 0).sum(), rel=0.01)
    assert bench.player.largest_jump < 1e-6


class AnyOrder(RuleBasedStateMachine):
    """Calls, plans and clocks in any order."""

    @initialize(acceleration=st.sampled_from([None, 1.0, 2.0]),
                ends=st.sampled_from([(0.0, 0.0), None]),
                released=st.sampled_from([0, 20, 100, 330]))
    def begin(self, acceleration, ends, released):
        """Begin with a plan that has been released for so many ticks, or without one."""
        scenario = Scenario.paper(150.0, slots=50)
        self.plan = replace(fly_hover_fly(with_uavs(
            scenario, max_acceleration=acceleration, start_velocity=ends, goal_velocity=ends)),
            start_ns=BEGIN)
        self.bench = Bench()
        self.player = self.bench.player
        self.last = None
        self.speed = self.rate = 1.0
        if released:
            self.player.load(self.plan)
            self.player.start()
            self.tick(0.5, released)

    def observe(self, moment, seconds, is_silent=False):
        """Compare setpoints with the last ones, a number of seconds before."""
        if self.last is not None:
            self.since += seconds
        if moment is None:
            return
        if self.last is not None:
            scale = max(1.0, self.fastest)
            for index, uav in enumerate(self.plan.scenario.uavs):
                assert math.dist(moment.positions[index], self.last.positions[index]) <= (
                    uav.max_speed * scale * self.since + POSITION_JUMP + 1e-9)
                if uav.max_acceleration is not None:  # Without a limit, 0 s would allow inf * 0.
                    assert math.dist(moment.velocities[index], self.last.velocities[index]) <= (
                        uav.max_acceleration * scale**2 * self.since + 2e-3)
        # A lower playback speed is reached by and by; what is not released never goes on.
        flight = self.player.flight
        rate = flight.time_scale
        assert rate <= max(self.speed * self.player.playing, self.rate) + 1e-9
        # They are on the curve, and a UAV that is held is silent, too.
        planned = flight.playback.at(flight.time)
        assert (moment.positions == planned.positions).all()
        assert (moment.velocities == rate * planned.velocities).all()
        assert (moment.powers == (planned.powers if rate and not is_silent else 0.0)).all()
        self.last, self.since, self.rate = moment, 0.0, rate
        self.fastest = max(self.speed, rate)

    @rule(seconds=st.sampled_from([0.0, 0.02, 0.05, 0.2, 1.0]), count=st.integers(1, 60),
          is_silent=st.booleans())
    def tick(self, seconds, count, is_silent=False):
        for _ in range(count):
            self.bench.now += round(seconds * SECOND)
            playback, delivered = self.player.playback, self.player.delivered
            ready = not self.player.playing or self.player.playback is None or (
                not self.player.unmet_conditions([None, None], 5.0, self.speed))
            self.observe(self.player.tick(
                self.bench.now, self.speed, is_ready=ready, is_silent=is_silent), seconds,
                is_silent)
            if is_silent and self.player.playback is playback:
                assert self.player.delivered == delivered

    @rule(seconds=st.floats(-100.0, 100.0))
    def jump(self, seconds):
        # The time that passed is unknown: at most `longest`, and none where the clock is set back.
        self.bench.now += round(seconds * SECOND)
        self.observe(self.player.tick(self.bench.now, self.speed, is_ready=False),
                     min(max(0.0, seconds), 0.5))

    @rule(speed=st.sampled_from([0.5, 1.0, 1.0, 1.0, 3.0]))
    def play_at(self, speed):
        flight = self.player.flight
        self.fastest = max(speed, getattr(self, 'fastest', 1.0),
                           flight.time_scale if flight else 0.0)
        self.speed = speed

    @rule()
    def start(self):
        try:
            self.player.start([None, None], 5.0)
        except OptionError:
            assert self.player.playback is None or self.player.ended

    @rule(count=st.integers(0, 40))
    def pause(self, count):
        was_playing = self.player.playing and not self.player.ended
        assert self.player.pause() == was_playing
        self.tick(0.2, count)

    @precondition(lambda self: self.bench.now % 3 == 0)  # Not as often as the others.
    @rule()
    def reset(self):
        self.player.reset()
        assert not self.player.streaming

    @rule(seconds=st.floats(-20.0, 20.0))
    def load_the_first_plan(self, seconds):
        self.player.load(replace(self.plan, start_ns=self.bench.now + round(seconds * SECOND)))

    @precondition(lambda self: self.player.playback is not None)
    @rule(ahead=st.floats(0.0, 5.0))
    def load_a_continuation(self, ahead):
        try:
            plan = plan_continuation(self.bench, self.plan, ahead)
        except PlanningError:
            return  # It is infeasible from there.
        is_held = self.player.streaming and self.player.flight.state == 'held'
        is_adopted = self.player.load(plan)
        assert not is_held or is_adopted and self.player.playback.plan is plan

    @precondition(lambda self: self.player.playback is not None)
    @rule(ahead=st.floats(-10.0, 20.0), x=st.floats(100.0, 300.0))
    def load_a_revision(self, ahead, x):
        plan = self.player.playback.plan
        point = math.ceil((self.player.flight.time + ahead) / plan.scenario.slot_duration)
        try:
            tail = cut_tail(plan, min(max(point, 0), plan.scenario.slots - 1))
            new_tail = fly_hover_fly(with_eavesdroppers(tail.scenario, position=(x, 0.0)))
            self.player.load(continue_plan(plan, max(point, 0), new_tail))
        except PlanningError:
            pass

    @invariant()
    def time_is_within_the_plan(self):
        playback = self.player.playback
        assert playback is None or playback.begin <= self.player.flight.time <= playback.duration


TestAnyOrder = AnyOrder.TestCase
TestAnyOrder.settings = settings(max_examples=60, stateful_step_count=30, deadline=None)


@pytest.mark.soak
class TestAnyOrderAtLength(AnyOrder.TestCase):
    """Ten thousand sequences."""

    settings = settings(max_examples=10000, stateful_step_count=40, deadline=None)


@pytest.mark.parametrize('mutes', [False, True])
def test_power_is_sent_in_promised_slots_only_where_that_is_asked_for(plan, mutes):
    promised = replace(plan, promised_until=80.0, gaps=((20.0, 40.0),))  # Slots of 2 s.
    bench = start_flight(promised, 140.0, mutes=mutes)
    slots = np.array([(now - BEGIN) // (2 * SECOND) for now, _ in bench.sent])
    powers = np.array([moment.powers for _, moment in bench.sent])
    inside = (slots >= 1) & (slots <= 65)
    assert not powers[~inside].any()
    mask = promised.promised_slots | (not mutes)
    assert mask.sum() == (31 if mutes else 65)
    assert powers[inside] == pytest.approx((plan.powers * mask).T[slots[inside] - 1])
    to_the_ground = Playback(plan).secrecy_rates(plan.times[1:-1] + 1.0)
    assert bench.player.delivered == pytest.approx(2.0 * to_the_ground[mask].sum(), rel=0.02)


def test_a_late_flight_has_left_its_promise_until_a_new_one_is_for_its_time(plan):
    promised = replace(plan, promised_until=100.0)
    bench = start_flight(promised, 45.0, mutes=True)  # It begins 5 s later.
    assert bench.sent[-1][1].powers.any()
    bench.player.pause()
    bench.run(8.0)
    bench.player.start()
    bench.run(20.0)
    assert not bench.sent[-1][1].powers.any()
    assert not bench.player.playback.plan.promised_slots[20:].any()
    # The same flight with receivers that are predicted for its delay.
    assert not bench.player.load(replace(promised, promise_delay=bench.lag))
    bench.run(1.0)
    assert bench.sent[-1][1].powers.any()
    assert not bench.player.load(promised)
    bench.run(1.0)
    assert not bench.sent[-1][1].powers.any()
