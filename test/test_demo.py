"""The main job, run as a stranger runs it."""

import os
from pathlib import Path

import city
from examples.isolation import free_domain, isolated
from processes import run_python
import pytest
from secure_uav_planner import fly_hover_fly, Plan, Scenario

pytestmark = pytest.mark.slow


@pytest.fixture(scope='module')
def demo(tmp_path_factory):
    out = tmp_path_factory.mktemp('demo') / 'out'
    return out, run_python('-m', 'examples.demo', '--out', out).stdout


def test_the_demo_plans_and_prints_the_plan_beside_its_baselines(demo):
    _, text = demo
    rates = {line.split('  ')[0]: float(line.split()[-4]) for line in text.splitlines()
             if line.startswith(('fly_hover_fly', 'joint'))}
    assert rates['fly_hover_fly_constant'] == pytest.approx(1.442, abs=1e-3)
    assert rates['fly_hover_fly_optimised'] == pytest.approx(2.640, abs=1e-3)
    assert rates['joint'] > 3.007
    missing = [float(line.split()[-1].rstrip('%')) for line in text.splitlines()
               if line.startswith(('fly_hover_fly', 'joint'))]
    assert missing[0] > missing[1] > missing[2] > 0


def test_the_plan_that_was_received_is_saved_and_drawn(demo):
    out, text = demo
    plan = Plan.load(out / 'plan.json')
    assert plan.scenario == Scenario.paper()
    assert plan.objective == 'worst_case'
    assert plan.bound.rate > plan.worst_case_rate
    assert f'{plan.guaranteed_rate:.4f}' in text
    assert (out / 'plan.png').read_bytes().startswith(b'\x89PNG')
    assert '<html' in (out / 'plan.html').read_text()[:100]
    assert (out / 'plan.mcap').read_bytes().startswith(b'\x89MCAP0')


def test_the_demo_chooses_a_domain_that_no_test_uses_and_no_other_demo():
    with free_domain() as first, free_domain() as second:
        assert first != second
        assert all(215 <= domain <= 232 for domain in (first, second))


def test_what_isolates_leaves_the_environment_as_it_was_and_reserves_again(tmp_path, monkeypatch):
    names = ('ROS_DOMAIN_ID', 'ROS_LOG_DIR', 'ROS_AUTOMATIC_DISCOVERY_RANGE')
    for name in names:
        monkeypatch.delenv(name, raising=False)
    with isolated(tmp_path):
        first = os.environ['ROS_DOMAIN_ID']
        with free_domain() as other:
            assert str(other) != first
        assert Path(os.environ['ROS_LOG_DIR']) == tmp_path / 'log'
    assert not any(name in os.environ for name in names)
    monkeypatch.setenv('ROS_DOMAIN_ID', '7')
    with isolated(tmp_path / 'again'):
        assert os.environ['ROS_DOMAIN_ID'] == '7'
        assert Path(os.environ['ROS_LOG_DIR']) == tmp_path / 'again' / 'log'
    assert [os.environ.get(name) for name in names] == ['7', None, None]


def test_the_demo_leaves_no_process_behind(demo):
    for entry in Path('/proc').glob('[0-9]*'):
        try:
            command = (entry / 'cmdline').read_bytes().decode(errors='replace')
            parent = (entry / 'stat').read_text().rsplit(')', 1)[1].split()[1]
        except (OSError, IndexError):
            continue  # it has just ended
        if parent == '1' and 'secure_uav_planner.ros.' in command:
            environment = (entry / 'environ').read_bytes().decode(errors='replace')
            assert f'ROS_DOMAIN_ID={os.environ["ROS_DOMAIN_ID"]}\0' not in environment, command


def test_the_demo_flies_the_city_as_well(tmp_path):
    result = run_python('-m', 'examples.demo', '--mission', 'city', '--out', tmp_path)
    plan = Plan.load(tmp_path / 'plan.json')  # which checks every limit along the curve
    assert plan.scenario == Scenario.load(city.FILE)
    assert 'planned for free space' in result.stdout and plan.bound is None
    assert plan.worst_case_rate > fly_hover_fly(plan.scenario, 'optimised').worst_case_rate
    for ending in ('png', 'html', 'mcap'):
        assert (tmp_path / f'plan.{ending}').stat().st_size > 10000
