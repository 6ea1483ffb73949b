"""Energy: the rotary wing of the literature, integrated along the curve that is flown."""

import csv
from dataclasses import asdict, replace
import json
import math
from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import quad
from secure_uav_planner import (
    assess, Channel, fly_hover_fly, Propulsion, Scenario, solve, World)
from secure_uav_planner.apps.cli import main
from secure_uav_planner.model.curve import compute_energies, Curve, HOVERING_SPEED
from secure_uav_planner.output.picture import draw_plan
from secure_uav_planner.output.tables import rate_table
from secure_uav_planner.ros.planner.status import plan_status
from secure_uav_planner.ros.planner_status import EnergyStatus
from strategies import with_uavs

# As it stands in the paper, with its numbers for a UAV of 20 N and a rotor of 0.4 m.
WEIGHT, DENSITY, AREA, SOLIDITY, TIP, DRAG = 20.0, 1.225, 0.503, 0.05, 120.0, 0.6
BLADE = 0.012 / 8 * DENSITY * SOLIDITY * AREA * TIP**3
INDUCED = 1.1 * WEIGHT**1.5 / math.sqrt(2 * DENSITY * AREA)
VELOCITY = 4.03


def reference_power(speed):
    """Return equation (12) of Zeng, Xu and Zhang (2019) in W."""
    return (BLADE * (1 + 3 * speed**2 / TIP**2)
            + INDUCED * (math.sqrt(1 + speed**4 / (4 * VELOCITY**4))
                         - speed**2 / (2 * VELOCITY**2))**0.5
            + 0.5 * DRAG * DENSITY * SOLIDITY * AREA * speed**3)


@pytest.fixture(scope='module')
def plan():
    """Return a plan in which only the first UAV has a propulsion."""
    scenario = Scenario.paper(120.0, slots=24)
    first, second = scenario.uavs
    return fly_hover_fly(replace(scenario, uavs=(replace(first, propulsion=Propulsion()), second)))


@pytest.mark.parametrize('speed', [0.0, 0.5, 4.0, 10.2, 30.0, 60.0])
def test_the_default_is_the_rotary_wing_of_the_paper(speed):
    assert Propulsion().power(speed) == pytest.approx(reference_power(speed), rel=2e-6)


@pytest.mark.parametrize('acceleration, slots, tolerance', [
    (None, 30, 1e-9), (1.0, 120, 1e-6), (3.0, 120, 1e-6), (3.0, 30, 1e-6), (3.0, 12, 1e-6),
    (9.0, 40, 1e-6)])
def test_the_energy_is_the_integral_along_the_curve(acceleration, slots, tolerance):
    scenario = with_uavs(Scenario.paper(120.0, slots=slots), max_acceleration=acceleration,
                         propulsion=Propulsion(fuselage_drag_ratio=0.1))
    curve = fly_hover_fly(scenario).curve
    steps = np.arange(curve.begin, curve.end + curve.piece / 2, curve.piece)
    for index, energy in enumerate(compute_energies(scenario, curve)):
        propulsion = scenario.uavs[index].propulsion

        def power(time, index=index, propulsion=propulsion):
            velocity = curve.at([time]).velocities[index, 0]
            return float(propulsion.power(np.hypot(*velocity)))

        wanted = sum(quad(power, start, end, limit=200)[0]
                     for start, end in zip(steps[:-1], steps[1:]))
        assert energy.total == pytest.approx(wanted, rel=tolerance)
        assert energy.total == pytest.approx(energy.hovering + energy.flying, rel=1e-12)


def test_below_a_tenth_of_max_speed_a_uav_hovers():
    scenario = with_uavs(Scenario.paper(1000.0, slots=4), propulsion=Propulsion())
    x = np.cumsum([0.0, 0.99, 0.0, 1.01, 10.0, 5.0]) * scenario.slot_duration
    positions = np.repeat(np.stack([x, 0 * x], axis=-1)[None], 2, axis=0)
    energy = compute_energies(scenario, Curve(scenario, positions))[0]
    power, step = Propulsion().power, scenario.slot_duration
    assert HOVERING_SPEED * scenario.uavs[0].max_speed == 1.0
    assert energy.hovering == pytest.approx(step * power([0.99, 0.0]).sum())
    assert energy.flying == pytest.approx(step * power([1.01, 10.0, 5.0]).sum())


def test_an_empty_block_in_a_file_means_the_defaults():
    data = Scenario.paper().to_dict()
    data['uavs'][0]['propulsion'] = {}
    assert Scenario.from_dict(data).uavs[0].propulsion == Propulsion()


def test_table_picture_and_status_show_the_energy_of_each_uav_with_a_propulsion(plan):
    total, hovering, flying = plan.energies[0]
    lines = rate_table([plan]).splitlines()
    assert lines[-1].split() == [plan.method, 'uav1', *(
        f'{joules:.0f}' for joules in (total, hovering, flying))]
    without = fly_hover_fly(Scenario.paper(120.0, slots=24))
    assert rate_table([without]).splitlines() == lines[:3]
    labels = [text.get_text() for text in draw_plan(plan).axes[1].get_legend().get_texts()]
    assert labels == [f'uav1 (transmits)\n{total / 1e3:.3g} kJ by the model (hovering '
                      f'{hovering / 1e3:.3g})', 'uav2 (jams)']
    assert plan_status(plan, None, 0.0).energy == {'uav1': EnergyStatus(total, hovering, flying)}


def test_a_campaign_has_columns_for_energies_and_for_its_assessment(
        plan, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path('campaign.json').write_text(json.dumps({
        'mission': plan.scenario.to_dict(), 'methods': ['joint'],
        'assess': {'draws': 20, 'seed': 5, 'place': 'normal', 'channel': {'los': 'urban'}},
        'vary': {'uavs.0.propulsion': [None, asdict(Propulsion())]}}))
    assert main(['sweep', 'campaign.json', '--out', 'out', '--jobs', '1']) == 0
    with open('out/results.csv', newline='') as file:
        without_energy, with_energy = csv.DictReader(file)
    assert without_energy['energy.uav1'] == '' and 'energy.uav2' not in without_energy
    wanted = solve(plan.scenario)
    assert [float(with_energy[f'{name}.uav1']) for name in (
        'energy', 'hovering_energy', 'flying_energy')] == pytest.approx(list(wanted.energies[0]))
    assessed = assess(wanted, 20, 5, World('normal', channel=Channel(los='urban'))).summary
    for row in (without_energy, with_energy):
        assert {name: float(row[f'assess.{name}']) for name in assessed} == pytest.approx(assessed)
