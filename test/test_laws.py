"""Whatever can be asked for works together: any mission goes through all that there is."""

from dataclasses import replace
import json
import math
from pathlib import Path
import re
import shutil
import warnings

from hypothesis import example, given, HealthCheck, settings
import matplotlib
import numpy as np
import pytest
from secure_uav_planner import assess, Bound, Plan, Scenario, solve, upper_bound
from secure_uav_planner.apps.cli import main
from secure_uav_planner.apps.editing import list_handles, to_mission
from secure_uav_planner.assessment.world import World
from secure_uav_planner.bound import explain_refusal
from secure_uav_planner.errors import InfeasibleMissionError, PlanningError, TimeLimitError
from secure_uav_planner.model import channel
from secure_uav_planner.output.page import draw_page
from secure_uav_planner.output.tables import assessment_table, rate_table, save_csv
from secure_uav_planner.plan.playback import Playback
from secure_uav_planner.plan.splice import continue_plan, cut_tail
from strategies import SEEDS, whole_missions
from test_mission_file import RICH
import yaml

PICTURES = 30, 60, 90  # Of every 100 missions, those of which all pictures are drawn.


def check_files(folder, scenario):
    """Assert that a mission survives its files."""
    for name in ('mission.yaml', 'mission.json'):
        scenario.save(folder / name)
        assert Scenario.load(folder / name) == scenario
    assert list_handles(to_mission(scenario))


def check_plan(folder, plan):
    """Assert that a plan survives its file, and its views are made."""
    file, bound = folder / 'plan.json', Bound(plan.scenario, math.inf, plan.objective)
    for saved in (plan, replace(plan, start_ns=1795246192039494728).with_bound(bound)):
        saved.save(file)
        again, text = Plan.load(file), file.read_text()
        assert again == saved and hash(again) == hash(saved) and again.energies == saved.energies
        assert json.loads(text)['worst_case_rate'] == saved.worst_case_rate
        assert 'Infinity' not in text  # Which is no JSON.
    for text in (plan.message, repr(plan), rate_table([plan]), plan.promise.text):
        assert 'nan' not in text
    save_csv(plan, folder / 'plan.csv')
    plan.save_mat(folder / 'plan.mat')
    plan.to_dataframe()
    if plan.scenario.origin is not None:
        plan.to_geojson(folder / 'plan.geojson')


def check_bound(plan):
    """Assert that a bound is not below the rate of a plan, and is refused with its reason."""
    scenario = plan.scenario
    reason = explain_refusal(scenario)
    if reason:
        with pytest.raises(PlanningError, match=re.escape(reason)):
            upper_bound(scenario, time_limit=0.1)
        return
    bound = upper_bound(scenario, objective=plan.objective, plan=plan, time_limit=0.1)
    assert bound.rate >= plan.rate - 1e-9 and 'nan' not in plan.with_bound(bound).claim


def check_assessment(plan, rng):
    """Assess a plan in a random world, and within its promise."""
    world = World(place=str(rng.choice(['disc', 'normal', 'fixed'])),
                  los_distance=rng.choice([None, 0.0, 50.0]), tracking_std=rng.choice([0.0, 2.0]))
    for assessment in (assess(plan, 3), assess(plan, 3, world=world)):
        assert np.isfinite(assessment.rates).all() and assessment_table(assessment)


def check_parts(plan, rng):
    """Assert that a plan cut at a point and continued by its own rest is the plan."""
    point = int(rng.integers(plan.scenario.slots))
    tail = cut_tail(plan, point)
    joined = continue_plan(plan, point, tail)
    np.testing.assert_allclose(joined.positions, plan.positions, atol=1e-9)
    np.testing.assert_allclose(joined.rate, plan.rate, rtol=1e-6, atol=1e-9)
    np.testing.assert_allclose(tail.node_shares, plan.node_shares[:, point:], atol=1e-6)
    np.testing.assert_allclose(tail.rate * tail.scenario.duration, max(0, plan.rate * (
        plan.scenario.duration) - delivered_least(plan, tail, point)), rtol=1e-6, atol=1e-6)


def delivered_least(plan, tail, point):
    """Return what the least served node over weight got before a point, in bit/Hz."""
    scenario = plan.scenario
    delivered = (plan.node_shares[:, :point].sum(axis=1) * scenario.slot_duration
                 + scenario.node_offsets * scenario.duration)
    return float((delivered / scenario.node_weights).min())


def check_playback(plan, rng):
    """Assert that a secrecy rate at any time is the one of its slot, with its shares."""
    playback, scenario = Playback(plan), plan.scenario
    for time in rng.uniform(-5, scenario.duration + 5, 3):
        moment = playback.at(float(time))
        rate = playback.secrecy_rate(float(time), rng.uniform(-100, 100, 2))
        assert 0 <= rate < np.inf and np.isfinite(moment.positions).all()
        slot = int(np.floor(time / scenario.slot_duration))
        if 1 <= slot <= scenario.slots:
            assert (moment.shares == plan.shares[:, slot - 1]).all()
            assert (moment.powers == plan.powers[:, slot - 1]).all()
    eve, place = scenario.eavesdroppers[0], rng.uniform(-300, 300, 2)
    if not scenario.limits_acceleration:
        rates = channel.secrecy_node_rates(scenario, plan.positions, plan.powers, place)
        np.testing.assert_allclose(
            playback.secrecy_rates(plan.times[1:-1], place),
            (plan.shares * np.maximum(rates, 0)).sum(axis=0), rtol=1e-6, atol=1e-9)
    if scenario.limits_acceleration or eve.error_radius or eve.track or scenario.listeners or len(
            scenario.eavesdroppers) > 1:
        return
    rates = [playback.secrecy_rate(time, eve.position) for time in scenario.times[1:-1].tolist()]
    np.testing.assert_allclose(rates, plan.guaranteed_rates, rtol=1e-6, atol=1e-9)


def check_parameters(scenario):
    """Assert that a mission becomes parameters of the planner and back, or names what cannot."""
    settings = pytest.importorskip('secure_uav_planner.ros.settings')
    planner = pytest.importorskip('secure_uav_planner.ros.planner.settings')
    parameters = pytest.importorskip('secure_uav_planner.ros.parameters')
    values = {name: spec.default for name, spec in parameters.PLANNER.items()}
    values |= settings.mission_values(scenario)
    try:
        for name in parameters.PLANNER_MEMBERS:
            parameters.PLANNER[name].convert(name, values[name])
        specs = parameters.read_member_specs(values, parameters.PLANNER_MEMBERS)
    except PlanningError as error:
        assert 'names' in str(error)
        return
    values = {name: spec.default for name, spec in specs.items()} | values
    made = planner.PlannerSettings.from_values(values)
    assert tuple(uav.mission for uav in made.uavs.values()) == scenario.uavs
    fields = dict(made.mission)
    for zone, original in zip(fields.pop('no_fly_zones'), scenario.no_fly_zones, strict=True):
        assert replace(zone, name='') == replace(original, name='')
    if scenario.origin is not None:  # Its altitude is only for files of zones.
        scenario = replace(scenario, origin=replace(scenario.origin, altitude=None))
    for field, value in fields.items():
        assert value == getattr(scenario, field), field
    for name, node in zip(values['ground_nodes'], scenario.ground_nodes, strict=True):
        assert values['tracks'].get(name) == node.track
        assert (values[f'{name}.weight'], values[f'{name}.trusted']) == (
            node.weight, node.trusted)
    for name, eve in zip(values['eavesdroppers'], scenario.eavesdroppers, strict=True):
        assert values['tracks'].get(name) == eve.track
        assert eve.track or values[f'{name}.error_radius'] == eve.error_radius


def check_pictures(plan):
    """Draw everything that can be drawn of a plan."""
    pyplot = pytest.importorskip('matplotlib.pyplot')
    plan.plot()
    plan.scenario.plot()
    assess(plan, 3).plot()
    draw_page(plan)
    pyplot.close('all')


def check_mission(folder, scenario, seed, has_pictures):
    """Let a mission go through everything; return whether it could be planned."""
    rng = np.random.default_rng(seed)
    check_files(folder, scenario)
    check_parameters(scenario)
    plans = []
    for objective in ('guaranteed', 'worst_case'):
        try:
            plans.append(solve(scenario, objective=objective, time_limit=0.5))
        except (InfeasibleMissionError, TimeLimitError) as error:
            assert '\n' not in str(error)
    for plan in plans:
        check_bound(plan)
        check_parts(plan, rng)
        check_assessment(plan, rng)
        check_playback(plan, rng)
        check_plan(folder, plan)
        if has_pictures:
            check_pictures(plan)
    return len(plans) == 2


@pytest.mark.parametrize('count', [
    60, pytest.param(250, marks=pytest.mark.slow), pytest.param(1000, marks=pytest.mark.soak)])
def test_any_mission_goes_through_everything(tmp_path, count):
    planned = []

    @settings(max_examples=count)
    @given(whole_missions(), SEEDS)
    @example(RICH, 0)
    def check(scenario, seed):
        planned.append(check_mission(
            tmp_path, scenario, seed, len(planned) % 100 in PICTURES))

    with matplotlib.rc_context({'backend': 'agg'}), warnings.catch_warnings():
        warnings.simplefilter('error', RuntimeWarning)
        check()
    assert len(planned) >= count and np.mean(planned) > 0.6


CAMPAIGN = {'mission': 'mission.yaml', 'methods': ['joint', 'fly_hover_fly_optimised'],
            'objectives': ['guaranteed'], 'assess': {'draws': 2}, 'time_limit': 0.3,
            'bound_time_limit': 0.1, 'plans': True}
LIMITS = ['--time-limit', '0.3']
NOTES = 'note: ', 'warning: ', 'no fly-hover-fly with ', 'written: ', 'sweep: '


def run(capsys, *arguments):
    """Run the command; return whether it ends with 0. Otherwise each fault must have a line."""
    status = main([*map(str, arguments)])
    lines = capsys.readouterr().err.splitlines()
    lines = [line for line in lines if not line.startswith(NOTES)]
    assert status in (0, 1, 2) and bool(lines) == bool(status), (arguments, status, lines)
    assert all(line.startswith('secure_uav_planner: ') for line in lines), (arguments, lines)
    return status == 0


@pytest.mark.parametrize('count', [4, pytest.param(20, marks=pytest.mark.slow)])
def test_the_command_does_what_any_file_asks_for_or_says_in_a_line_why_not(
        tmp_path, capsys, monkeypatch, count):
    monkeypatch.chdir(tmp_path)
    planned = []
    assert run(capsys, 'new', 'example.yaml') and run(capsys, 'check', 'example.yaml')

    @settings(max_examples=count, suppress_health_check=list(HealthCheck))
    @given(whole_missions())
    def check(scenario):
        shutil.rmtree('out', ignore_errors=True)
        scenario.save('mission.yaml')
        run(capsys, 'check', 'mission.yaml', '--autopilot', 'px4')
        planned.append(run(capsys, 'plan', 'mission.yaml', '-o', 'out', *LIMITS,
                           '--bound-time-limit', '0.1'))
        if planned[-1]:
            assert run(capsys, 'show', 'out/plan.json', '-o', 'out/map.svg')
            assert run(capsys, 'assess', 'out/plan.json', '--draws', '3')
        Path('campaign.yaml').write_text(yaml.dump(CAMPAIGN))
        assert run(capsys, 'sweep', 'campaign.yaml', '-o', 'out', '--jobs', '1')

    check()
    assert len(planned) >= count and np.mean(planned) > 0.6
