"""What autopilots need to follow a plan, against flights in simulators, and as it is told."""

from dataclasses import replace
import math
from pathlib import Path

from hypothesis import given
from hypothesis import strategies as st
import pytest
from secure_uav_planner import Scenario
from secure_uav_planner.output.autopilots import AUTOPILOTS, changes, lean

GUIDE = Path(__file__).resolve().parents[1] / 'docs' / 'autopilots.md'

speeds, accelerations = st.floats(0.5, 25), st.floats(0.1, 8)


def test_every_limit_has_a_third_more_than_the_plan_needs():
    ardupilot = {parameter.name: parameter for parameter in AUTOPILOTS['ardupilot']}
    assert ardupilot['WPNAV_SPEED'].least(10.0, 2.0) == pytest.approx(1000 * 4 / 3)
    assert ardupilot['WPNAV_ACCEL'].least(10.0, 2.0) == pytest.approx(200 * 4 / 3)
    needed, least = lean(10.0, 2.0), ardupilot['ANGLE_MAX'].least(10.0, 2.0) / 100
    tangents = [math.tan(math.radians(angle)) for angle in (needed, least)]
    assert tangents[1] == pytest.approx(tangents[0] * 4 / 3)


def test_what_flew_at_its_limits_gets_a_reserve_and_what_did_not_gets_what_flew():
    assert {parameter.name: value for parameter, value in changes('ardupilot', 10.0, 2.0)} == {
        'WPNAV_SPEED': 1500.0, 'WPNAV_ACCEL': 350.0, 'ANGLE_MAX': 4000.0}
    assert {parameter.name: value for parameter, value in changes('px4', 10.0, 2.0)} == {
        'MPC_XY_VEL_MAX': 15.0}
    assert not changes('px4', 8.0, 2.0)
    assert {parameter.name: value for parameter, value in changes('ardupilot', 10.0, 3.0)} == {
        'WPNAV_SPEED': 1500.0, 'WPNAV_ACCEL': 500.0, 'ANGLE_MAX': 4500.0}


@pytest.mark.parametrize('autopilot', AUTOPILOTS)
@given(speeds, accelerations)
def test_with_the_changes_every_limit_carries_the_plan_or_is_as_large_as_it_can_be(
        autopilot, speed, acceleration):
    raised = dict(changes(autopilot, speed, acceleration))
    for parameter in AUTOPILOTS[autopilot]:
        value = raised.get(parameter, parameter.default)
        assert parameter.default <= value <= parameter.most
        assert value >= parameter.least(speed, acceleration) or value == parameter.most


def test_the_guide_has_every_parameter_with_its_values():
    rows = [
        f'| {name} | `{limit.name}` | {limit.limits} | {limit.default} {limit.unit} | '
        f'{limit.least(10.0, 2.0):.4g} | {max(limit.default, dict(changed).get(limit, 0)):g} |'
        for name, parameters in AUTOPILOTS.items()
        for changed in (changes(name, 10.0, 3.0),) for limit in parameters]
    assert '\n'.join(rows) in GUIDE.read_text()


def mission(folder, *limits):
    """Return the file of a mission whose UAVs have limits of speed and acceleration."""
    scenario = Scenario.paper(300.0, slots=30)
    file = folder / 'mission.yaml'
    replace(scenario, uavs=tuple(
        replace(uav, max_speed=speed, max_acceleration=acceleration)
        for uav, (speed, acceleration) in zip(scenario.uavs, limits))).save(file)
    return file


@pytest.mark.parametrize('autopilot, limits, lines', [
    ('px4', [(8.0, 2.0)] * 2, ['px4, uav1, uav2 at 8 m/s and 2 m/s^2: the defaults suffice']),
    ('ardupilot', [(5.0, 1.5), (8.0, 5.5)], [
        'ardupilot, uav1 at 5 m/s and 1.5 m/s^2: the defaults suffice',
        'ardupilot, uav2 at 8 m/s and 5.5 m/s^2: set WPNAV_SPEED to 1200 cm/s (default 1000, at '
        'most 2000)',
        'ardupilot, uav2 at 8 m/s and 5.5 m/s^2: WPNAV_ACCEL would have to be 733.3 cm/s^2; lower '
        'max_speed or max_acceleration (default 250, at most 500)',
        'ardupilot, uav2 at 8 m/s and 5.5 m/s^2: set ANGLE_MAX to 5000 cdeg (default 3000, at '
        'most 8000)']),
    ('px4', [(10.0, None)] * 2, [
        'px4, uav1, uav2 at 10 m/s: no autopilot follows a plan without max_acceleration'])])
def test_the_command_names_each_parameter_to_change(tmp_path, command, autopilot, limits, lines):
    out, _ = command('check', '--autopilot', autopilot, mission(tmp_path, *limits))
    assert out.splitlines()[1:] == lines
