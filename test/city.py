"""The mission of config/city.yaml, and a flight by hand that keeps its limits."""

from pathlib import Path

import numpy as np
from secure_uav_planner import Plan
from secure_uav_planner.ros.parameters import (
    PLANNER, PLANNER_MEMBERS, read_member_specs)
from secure_uav_planner.ros.settings import load_mission

FILE = Path(__file__).resolve().parents[1] / 'config' / 'city.yaml'
WAY = {'courier': [(-190, 250), (-110, 120), (0, 0), (150, -60), (220, -100), (300, -160)],
       'escort1': [(-150, 250), (190, 130), (300, -80)],
       'escort2': [(-300, 80), (-170, -120), (100, -220)]}

WAIT = {'courier': 8, 'escort1': 24, 'escort2': 12}  # How long each waits at its start, in slots.


def values():
    """Return all values of the planner's parameters, checked."""
    given = load_mission(FILE)
    specs = {**PLANNER, **read_member_specs(given, PLANNER_MEMBERS)}
    return {**{name: spec.default for name, spec in specs.items()},
            **{name: specs[name].convert(name, value) for name, value in given.items()
               if name in specs}}


def plan_by_hand(scenario):
    """Return a plan along straight lines with rounded corners."""
    count, positions = scenario.slots + 2, []
    for uav in scenario.uavs:
        corners = np.array([uav.start, *WAY[uav.name], uav.goal])
        length = np.append(0, np.cumsum(np.linalg.norm(np.diff(corners, axis=0), axis=1)))
        way = np.interp(np.linspace(0, length[-1], count - 24), length, np.arange(len(corners)))
        line = np.stack([np.interp(way, np.arange(len(corners)), corners[:, axis])
                         for axis in range(2)], axis=1)
        # A mean over neighbours bounds the accelerations.
        wait = WAIT[uav.name]
        line = np.concatenate([np.repeat(line[:1], wait, axis=0), line,
                               np.repeat(line[-1:], 32 - wait, axis=0)])
        positions.append(np.stack([np.convolve(line[:, axis], np.ones(9) / 9, 'valid')
                                   for axis in range(2)], axis=1))
    powers = np.array([[1.0], [0.05], [0.05]]) * np.ones((3, scenario.slots))
    return Plan(scenario, np.array(positions), powers)
