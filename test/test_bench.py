import csv
import sys

import numpy as np
import pytest
from secure_uav_planner import __version__, Scenario, solve
from secure_uav_planner.apps.bench import __main__ as bench, measuring, report
from secure_uav_planner.apps.bench.fatrop import solve_by_fatrop
from secure_uav_planner.apps.bench.ipopt import solve_by_ipopt
from secure_uav_planner.apps.bench.missions import random_mission
from secure_uav_planner.apps.bench.opponent import has_fatrop
from secure_uav_planner.optimize.initial import constant_powers, fly_hover_fly_positions


def test_missions_are_the_same_for_a_seed_and_of_every_kind():
    missions = [random_mission(seed) for seed in range(40)]
    assert missions[7] == random_mission(7)
    assert {len(mission.uavs) for mission in missions} == {2, 3, 4}
    assert {len(mission.eavesdroppers) for mission in missions} == {1, 2, 3}
    radii = [eve.error_radius for mission in missions for eve in mission.eavesdroppers]
    assert min(radii) < 5 and 55 < max(radii) <= 60


@pytest.mark.parametrize('scenario', [
    Scenario.paper(104, slots=30), random_mission(1, slots=20)])
def test_ipopt_solves_the_same_problem(scenario):
    pytest.importorskip('casadi')
    answer = solve_by_ipopt(scenario, fly_hover_fly_positions(scenario),
                            constant_powers(scenario))
    plan = solve(scenario, objective='guaranteed')
    assert plan.guaranteed_rate >= answer.rate * (1 - 1e-3)
    assert answer.rate > 0.5 * plan.guaranteed_rate
    assert answer.build_time > 0 and answer.solve_time > 0 and answer.iterations > 0


@pytest.mark.parametrize('scenario', [
    Scenario.paper(104, slots=30), random_mission(1, slots=20), random_mission(4, 20, jammers=1)])
def test_fatrop_reaches_the_rate_of_ipopt(scenario):
    if not has_fatrop():
        pytest.skip('needs a CasADi that brings FATROP')
    start = fly_hover_fly_positions(scenario), constant_powers(scenario)
    answer, other = (solve(scenario, *start) for solve in (solve_by_fatrop, solve_by_ipopt))
    assert answer.rate == pytest.approx(other.rate, rel=1e-3)
    assert answer.build_time > 0 and answer.solve_time > 0 and answer.iterations > 0
    assert answer.status in ('Solve_Succeeded', 'Not_Converged')


def test_without_casadi_the_benchmark_says_what_to_install(monkeypatch, capsys, tmp_path):
    monkeypatch.setitem(sys.modules, 'casadi', None)
    assert bench.main(['--out', str(tmp_path)]) == 1
    assert 'pip install casadi' in capsys.readouterr().err
    scenario = Scenario.paper(102, slots=5)
    with pytest.raises(ImportError, match='pip install casadi'):
        solve_by_ipopt(scenario, fly_hover_fly_positions(scenario), constant_powers(scenario))


@pytest.mark.slow
def test_the_quick_benchmark_writes_tables_and_a_picture(monkeypatch, capsys, tmp_path):
    pytest.importorskip('casadi')
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
    document = (tmp_path / 'bench.md').read_text()
    for name in ('paper', 'slots', 'random', 'two UAVs', 'warm', 'objectives'):
        assert f'\n## {name}\n' in document
    with open(tmp_path / 'bench.csv', newline='') as file:
        rows = list(csv.DictReader(file))
    assert [row['table'] for row in rows] == [
        'paper', 'slots', 'slots', 'random', 'two UAVs', *['warm'] * 4, *['objectives'] * 3]
    assert float(rows[0]['joint_rate']) >= float(rows[0]['reference'])
    assert all(0 < float(row['peak_memory']) < 1000 for row in rows[1:3])
    picture = (tmp_path / 'time_against_slots.png').read_bytes()
    assert picture.startswith(b'\x89PNG')


def test_the_peak_memory_is_that_of_the_solve_and_not_of_who_measures():
    before = measuring.peak_memory(20)
    ours = np.ones(2 ** 26)  # 512 MB
    assert measuring.peak_memory(20) < min(1.5 * before, ours.nbytes / 2 ** 20)


def test_a_table_leaves_missing_values_empty():
    table = report.table_of([{'name': 'a', 'rate': 1.23456}, {'name': 'b', 'ratio': np.pi}])
    assert table == ('| name | rate | ratio |\n| --- | --- | --- |\n'
                     '| a | 1.2346 |  |\n| b |  | 3.14 |\n')
