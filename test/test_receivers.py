"""
Eavesdroppers whose receivers are better or worse than the ground node's, and link budgets.

That rates count it is told by test_channel.py and test_worst_case.py, which draw it.
"""

import math

import pytest
from secure_uav_planner import reference_snr_db, Scenario, solve, upper_bound
from strategies import with_eavesdroppers


@pytest.mark.parametrize('objective', ['guaranteed', 'worst_case'])
def test_the_bound_depends_on_the_receiver_and_is_near_the_plan(objective):
    rates = []
    for advantage in (-10.0, 0.0, 10.0):
        scenario = with_eavesdroppers(
            Scenario.paper(104.0, slots=8), receiver_advantage_db=advantage)
        plan = solve(scenario, objective=objective)
        bound = upper_bound(scenario, objective=objective, plan=plan)
        assert bound.rate >= getattr(plan, f'{objective}_rate') and bound.gap(plan) < 0.1
        rates.append(bound.rate)
    assert rates[0] > rates[1] + 0.01 and rates[1] > rates[2] + 0.01


def test_pictures_name_the_advantage(tmp_path):
    from secure_uav_planner.output.page import save_page
    from secure_uav_planner.output.picture import draw_plan
    for advantage, shown in ((6.0, True), (0.0, False)):
        plan = solve(with_eavesdroppers(
            Scenario.paper(120.0, slots=10), receiver_advantage_db=advantage))
        texts = [text.get_text() for text in draw_plan(plan).axes[0].texts]
        assert ('+6 dB' in texts) == shown
        save_page(plan, tmp_path / 'plan.html')
        assert ('+6 dB' in (tmp_path / 'plan.html').read_text()) == shown


# Link budget


@pytest.mark.parametrize('budget, expected', [
    # Free-space path loss at 1 m and 2.4 GHz is 40.05 dB; k T B of 1 MHz is -113.98 dBm.
    ((2.4e9, 1e6), -40.05 + 113.98 + 30), ((2.4e9, 1e6, 5.0, 2.0, 3.0), 103.93),
    ((4.8e9, 1e6), 103.93 - 20 * math.log10(2)), ((2.4e9, 2e6), 103.93 - 10 * math.log10(2))])
def test_the_reference_snr_is_friis_equation_over_thermal_noise(budget, expected):
    assert reference_snr_db(*budget) == pytest.approx(expected, abs=0.01)


def test_the_command_computes_a_link_budget(command):
    out, _ = command('link-budget', '--carrier-hz', '2.4e9', '--bandwidth-hz', '20e6',
                     '--noise-figure-db', '6', '--receive-gain-dbi', '5')
    assert out == f'reference_snr_db: {reference_snr_db(2.4e9, 20e6, 6.0, 0.0, 5.0):.2f}\n'
    assert 'carrier_hz is 2.4' in command(
        'link-budget', '--carrier-hz', '2.4', '--bandwidth-hz', '20e6', status=2).err
