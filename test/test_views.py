"""Views of missions and plans as their methods: `plot`, `to_dataframe`, `save_mat`."""

from dataclasses import replace

from hypothesis import given, settings
import numpy as np
from processes import run_python
import pytest
from scipy.io import loadmat
from secure_uav_planner import (
    Bound, Eavesdropper, fly_hover_fly, GroundNode, Scenario, solve, upper_bound)
from secure_uav_planner.errors import OptionError
from secure_uav_planner.output.drawing import eavesdropper_color, node_color
from secure_uav_planner.output.tables import COLUMNS
from secure_uav_planner.plan.playback import Playback
from strategies import scenarios, with_uavs

PNG = b'\x89PNG'


@pytest.fixture(scope='module')
def plan():
    return fly_hover_fly(Scenario.paper(120.0, slots=12))


def test_a_plan_and_its_mission_plot_themselves_without_pyplot(plan, tmp_path):
    for figure in (plan.plot(), plan.plot([plan]), plan.scenario.plot()):
        figure.savefig(tmp_path / 'figure.png')
        assert (tmp_path / 'figure.png').read_bytes().startswith(PNG)
        assert figure._repr_png_().startswith(PNG)  # What a notebook asks for.
    with pytest.raises(OptionError, match='baselines is .*; it must be a sequence of Plans'):
        plan.plot(plan)
    run_python('-c', 'import secure_uav_planner as s, sys; '
               's.fly_hover_fly(s.Scenario.paper(120.0, slots=12)).plot(); '
               'sys.exit("matplotlib.pyplot" in sys.modules)')


@settings(max_examples=10)
@given(scenario=scenarios())
def test_the_map_of_any_mission_has_all_who_take_part(scenario):
    [axes] = scenario.plot().axes
    texts = {text.get_text() for text in axes.get_legend().get_texts()}
    assert {f'{uav.name}, {uav.altitude:g} m high' for uav in scenario.uavs} <= texts
    points = np.array([line.get_xydata()[0] for line in axes.lines if len(line.get_xydata()) == 1])
    if axes.get_xlabel().startswith('north'):
        points = points[:, ::-1]
    for place in (scenario.ground_node, *scenario.starts, *scenario.goals,
                  *(eve.position for eve in scenario.eavesdroppers)):
        assert np.abs(points - place).max(axis=1).min() < 1e-9


def test_tables_and_mat_files_have_the_disc_of_a_receiver_that_moves(tmp_path):
    scenario = Scenario.paper(120.0, slots=12)
    track = ((0.0, 200.0, -300.0, 10.0), (100.0, 200.0, 300.0, 20.0))
    plan = fly_hover_fly(replace(scenario, eavesdroppers=(Eavesdropper(name='car', track=track),)))
    table = plan.to_dataframe()
    for number, (knot, x, y, radius) in enumerate(track):
        row = table[table.time == knot].iloc[0]
        assert (row['car.x'], row['car.y'], row['car.radius']) == (x, y, radius)
    plan.save_mat(tmp_path / 'plan.mat')
    arrays = loadmat(tmp_path / 'plan.mat')
    for name in ('positions', 'powers'):
        assert np.array_equal(arrays[name], getattr(plan, name))
    for name in ('times', 'guaranteed_rates', 'worst_case_rates'):
        assert np.array_equal(arrays[name][:, 0], getattr(plan, name))
    assert arrays['eavesdroppers'].shape == (1, 14, 2) and arrays['error_radii'][0, 10] == 20.0
    assert [name.item() for name in arrays['eavesdropper_names'][:, 0]] == ['car']
    with pytest.raises(OSError):
        plan.save_mat(tmp_path / 'missing' / 'plan.mat')


def test_the_dataframe_has_the_shares_of_each_ground_node(plan):
    nodes = tuple(GroundNode((0, y), name) for name, y in (('barn', 150), ('well', -150)))
    flight = fly_hover_fly(replace(plan.scenario, ground_node=None, ground_nodes=nodes))
    rows = flight.to_dataframe().query('uav == "uav1"')
    assert (rows[['barn.share', 'well.share']].to_numpy().T[:, 1:-1] == flight.shares).all()


def test_the_dataframe_is_the_flown_curve_with_its_start_and_goal(plan):
    pytest.importorskip('pandas')
    for scenario in (plan.scenario, with_uavs(plan.scenario, max_acceleration=2.0)):
        flight = fly_hover_fly(scenario)
        table = flight.to_dataframe()
        assert tuple(table.columns) == (
            *COLUMNS, 'eavesdropper.x', 'eavesdropper.y', 'eavesdropper.radius')
        for number, (uav, rows) in enumerate(table.groupby('uav')):
            first, last = rows.iloc[0], rows.iloc[-1]
            assert (first.x, first.y) == pytest.approx(scenario.uavs[number].start)
            assert (last.x, last.y) == pytest.approx(scenario.uavs[number].goal)
            assert (first.power, last.power) == (0.0, 0.0)
            inner = rows[rows.point.between(1, scenario.slots)]
            assert inner.power.to_numpy() == pytest.approx(flight.powers[number])
            for objective in ('guaranteed', 'worst_case'):
                assert inner[f'{objective}_rate'].to_numpy() == pytest.approx(
                    getattr(flight, f'{objective}_rates'))
                assert rows[f'{objective}_rate'].sum() == pytest.approx(
                    inner[f'{objective}_rate'].sum())
            for row in rows.itertuples():
                moment = Playback(flight).at(row.time)
                assert (row.x, row.y) == pytest.approx(tuple(moment.positions[number]), abs=1e-9)
                assert row.z == scenario.uavs[number].altitude
                assert (row.velocity_x, row.velocity_y) == pytest.approx(
                    tuple(moment.velocities[number]), abs=1e-9)
        steps = table[table.uav == scenario.uavs[0].name].time.diff().dropna()
        # A UAV with a limit of acceleration leaves half a slot before point 0.
        half = 0.5 if scenario.uavs[0].max_acceleration else 1.0
        assert steps.iloc[0] == steps.iloc[-1] == pytest.approx(half * scenario.slot_duration)


def test_many_ground_nodes_and_moving_eavesdroppers_have_colours_of_their_own(plan):
    track = ((0.0, 200.0, -300.0, 10.0), (100.0, 200.0, 300.0, 20.0))
    scenario = replace(plan.scenario, ground_node=None, ground_nodes=tuple(
        GroundNode((0.0, 10.0 * number)) for number in range(16)))
    assert len({node_color(scenario, number) for number in range(16)}) == 16
    assert len({eavesdropper_color(number, Eavesdropper(track=track)) for number in range(6)}) == 6


def test_a_repr_is_short_and_has_the_rate_that_was_maximised():
    scenario = Scenario.paper(120.0, slots=12)
    for objective, name in (('worst_case', 'worst-case'), ('guaranteed', 'guaranteed')):
        plan = solve(scenario, objective=objective)
        bound = upper_bound(scenario, objective=objective, plan=plan, time_limit=0.5)
        assert repr(plan).startswith(f'<Plan: {name} rate {plan.rate:.4f} bit/s/Hz by joint')
        assert repr(plan.with_bound(bound)).endswith(f'; {name} rate {bound.claim(plan)}>')
        assert f'{name} rate above {bound.rate:.4f}' in repr(bound)
        for value in (plan, plan.with_bound(bound), bound, plan.clearance):
            assert len(repr(value)) < 200 and '\n' not in repr(value)
    nearest = plan.clearance.between_uavs
    assert f'UAVs at least {nearest.distance:.4g} m apart (uav1 and uav2' in repr(plan.clearance)


def test_a_plan_is_equal_to_no_other():
    plan = replace(solve(Scenario.paper(120.0, slots=12)), start_ns=5)
    plan = plan.with_bound(Bound(plan.scenario, np.inf, plan.objective))
    for change in ({'start_ns': 6}, {'method': 'other'}, {'bound': None}, {'history': ()},
                   {'powers': 0.5 * plan.powers}, {'solve_time': 0.0}):
        assert replace(plan, **change) != plan
    assert plan != 'plan' and plan != fly_hover_fly(plan.scenario)
