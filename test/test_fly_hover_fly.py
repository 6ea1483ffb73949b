from dataclasses import replace

import numpy as np
import pytest
from secure_uav_planner import fly_hover_fly, Scenario


def test_with_time_the_uavs_hover_above_their_places_as_long_as_possible():
    plan = fly_hover_fly(Scenario.paper(200))
    distance = np.hypot(100, 500)
    hovering = 201 - 2 * np.ceil(distance / 10) + 1
    for path, place in zip(plan.positions, ((0, 0), (200, 0))):
        assert np.count_nonzero(np.hypot(*(path - place).T) < 1e-9) == hovering


def test_without_time_the_uavs_turn_back_at_the_last_moment():
    scenario = Scenario.paper(102)
    plan = fly_hover_fly(scenario)
    lengths = np.linalg.norm(np.diff(plan.positions, axis=1), axis=-1)
    # Full speed all the way but for the step that cuts the corner.
    assert np.count_nonzero(lengths > 10 - 1e-9) >= 2 * (scenario.slots - 2)
    outbound = plan.positions[0, :40] - (100, 500)
    heading = outbound[1:] / np.linalg.norm(outbound[1:], axis=-1, keepdims=True)
    assert heading == pytest.approx(np.tile([-100, -500] / np.hypot(100, 500), (39, 1)))


def test_a_uav_that_starts_on_its_hovering_place_stays_there():
    scenario = Scenario.paper(200)
    over = replace(scenario.uavs[1], start=(200.0, 0.0), goal=(200.0, 0.0))
    plan = fly_hover_fly(replace(scenario, uavs=(scenario.uavs[0], over)))
    assert (plan.positions[1] == (200.0, 0.0)).all()


def test_a_uav_whose_start_is_its_goal_goes_out_and_back():
    scenario = Scenario.paper(200)
    there = replace(scenario.uavs[0], goal=scenario.uavs[0].start)
    plan = fly_hover_fly(replace(scenario, uavs=(there,), duration=60.0, slots=60))
    reached = np.linalg.norm(plan.positions[0] - there.start, axis=-1).max()
    assert 299 < reached <= 305
