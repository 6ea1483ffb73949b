import csv

from benchmarks import __main__ as bench, measuring, throughput, users
from benchmarks.missions import random_mission
from benchmarks.opponents import solve_by_fatrop, solve_by_ipopt
import numpy as np
from processes import ROOT
import pytest
from secure_uav_planner import __version__, Scenario, solve
from secure_uav_planner.model.problem import Problem
from secure_uav_planner.optimize.initial import constant_powers, fly_hover_fly_positions


def test_missions_are_the_same_for_a_seed_and_of_every_kind():
    missions = [random_mission(seed) for seed in range(40)]
    assert missions[7] == random_mission(7)
    assert {len(mission.uavs) for mission in missions} == {2, 3, 4}
    assert {len(mission.eavesdroppers) for mission in missions} == {1, 2, 3}
    radii = [eve.error_radius for mission in missions for eve in mission.eavesdroppers]
    assert min(radii) < 5 and 55 < max(radii) <= 60


@pytest.mark.parametrize('scenario', [
    Scenario.paper(104, slots=30), random_mission(1, slots=20), random_mission(4, 20, jammers=1)])
def test_ipopt_and_fatrop_solve_the_same_problem(scenario):
    start = fly_hover_fly_positions(Problem(scenario)), constant_powers(scenario)
    ipopt, fatrop = (call(scenario, *start) for call in (solve_by_ipopt, solve_by_fatrop))
    plan = solve(scenario, objective='guaranteed')
    assert 0.5 * plan.guaranteed_rate < ipopt.rate <= plan.guaranteed_rate * (1 + 1e-3)
    assert fatrop.rate == pytest.approx(ipopt.rate, rel=1e-3) and ipopt.is_converged
    assert all(answer.build_time > 0 and answer.solve_time > 0 for answer in (ipopt, fatrop))


@pytest.mark.slow
def test_the_quick_benchmark_writes_a_table_and_its_summary(monkeypatch, capsys, tmp_path):
    monkeypatch.setattr(bench, 'PAPER', bench.PAPER[:1])
    monkeypatch.setattr(bench, 'random_mission', lambda seed, slots=20, jammers=None:
                        random_mission(seed, 20, jammers))
    assert bench.main(['--quick', '--missions', '1', '--seed', '1', '--out', str(tmp_path)]) == 0
    printed = capsys.readouterr().out
    speed = (tmp_path / 'speed.md').read_text()
    assert speed in printed and __version__ in speed
    for said in ("the paper's, T = 102 s, radius 10 m |", '1 random ones of two UAVs, median |',
                 'starts from the last plan', 'worst-case objective takes'):
        assert said in speed
    with open(tmp_path / 'bench.csv', newline='') as file:
        rows = list(csv.DictReader(file))
    assert [row['table'] for row in rows] == [
        'paper', 'slots', 'slots', 'random', 'two UAVs', *['warm'] * 3, *['objectives'] * 3]
    assert float(rows[0]['joint_rate']) >= float(rows[0]['reference'])
    assert all(0 < float(row['peak_memory']) < 1000 for row in rows[1:3])


def test_the_peak_memory_is_that_of_the_solve_and_not_of_who_measures():
    before = measuring.measure_memory(20)
    ours = np.ones(2 ** 26)  # 512 MB
    assert measuring.measure_memory(20) < min(1.5 * before, ours.nbytes / 2 ** 20)


@pytest.mark.parametrize('name', users.SCRIPTS)
def test_a_mission_as_a_user_types_it_is_solved_and_feasible(name):
    python = ROOT / users.PYTHON
    if name != 'this package' and not python.exists():
        pytest.skip('CVXPY with Uno and OpenSCvx come by `make .venv-users/.check`')
    _, lines, rate, excess, _, _ = users.measure(name, 8, 30.0, python)
    ours = solve(Scenario.paper(120.0, slots=8), objective='guaranteed').guaranteed_rate
    assert 0.5 * ours < float(rate) <= ours + 1e-3
    assert float(excess) < 1e-3 and lines < 60


def test_what_a_plan_exceeds_is_found_in_each_limit():
    scenario = Scenario.paper(120.0, slots=8)
    plan = solve(scenario)
    assert users.compute_excess(scenario, plan.positions, plan.powers) < 1e-6
    for row, shift in ((0, 15.0), (4, 300.0), (-1, 15.0)):
        moved = plan.positions.copy()
        moved[0, row, 0] += shift
        assert users.compute_excess(scenario, moved, plan.powers) > 0.09
    for power in (-1.0, 5.0, 1.1):
        powers = np.full_like(plan.powers, power)
        assert users.compute_excess(scenario, plan.positions, powers) > 0.09


@pytest.mark.slow
def test_the_throughput_is_measured_and_written(tmp_path):
    assert throughput.main(['--missions', '30', '--out', str(tmp_path)]) == 0
    assert '30 missions: ' in (tmp_path / 'throughput.md').read_text()
