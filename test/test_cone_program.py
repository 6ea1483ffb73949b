"""Cone programs: signals while Clarabel runs, and its failures."""

from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from functools import partial
from itertools import chain
import queue
import random
import signal
import subprocess
import sys
import threading
import time

import clarabel
import numpy as np
import pytest
from scipy.sparse import csc_array
from secure_uav_planner import NoFlyZone, Plan, Scenario
from secure_uav_planner.errors import StoppedError
from secure_uav_planner.mission.kinematics import Vehicle
from secure_uav_planner.model.cone_program import minimise_utilisation, solve_cone_program
from secure_uav_planner.plan.splice import cut_tail
from strategies import with_uavs

WAIT = 120.0
# The least x_0 with |(x_1, x_2)| <= x_0 and x_1 >= 1.
CONE = (csc_array((3, 3)), np.array([1.0, 0.0, 0.0]), csc_array(-np.vstack([
    [0.0, 1.0, 0.0], np.eye(3)])), np.array([-1.0, 0.0, 0.0, 0.0]))
solve = partial(solve_cone_program, *CONE, inequalities=1)
PROGRAM = """
from dataclasses import replace
import signal, sys
from secure_uav_planner import NoFlyZone, Scenario
from secure_uav_planner.model.problem import Problem
from secure_uav_planner.optimize.initial.flights import generate_direct_flights
from secure_uav_planner.optimize.initial.projection import project

wall = NoFlyZone(((50.0, -50.0), (150.0, -50.0), (150.0, 50.0), (50.0, 50.0)))
scenario = replace(Scenario.paper(200.0), no_fly_zones=(wall,))
problem = Problem(scenario)
grid, flights = problem.grid, next(generate_direct_flights(problem, lambda: None))
number = getattr(signal, sys.argv[1])
signal.signal(number, signal.default_int_handler)
while True:
    try:
        print('working', flush=True)
        while True:
            project(grid, flights, 1e-3, lambda: None)
    except KeyboardInterrupt:
        print('stopped', flush=True)
"""


@pytest.mark.parametrize('name', ['SIGINT', 'SIGTERM'])
def test_a_signal_at_any_time_of_a_projection_raises_its_error(name):
    process = subprocess.Popen([sys.executable, '-c', PROGRAM, name], text=True,
                               stdout=subprocess.PIPE, stderr=subprocess.PIPE)
    lines, rng = queue.Queue(), random.Random(0)
    reader = threading.Thread(target=lambda: [*map(lines.put, chain(process.stdout, ['']))])
    reader.start()
    try:
        for _ in range(30):
            assert lines.get(timeout=WAIT) == 'working\n'
            time.sleep(rng.uniform(0.0, 0.1))
            process.send_signal(getattr(signal, name))
            assert lines.get(timeout=WAIT) == 'stopped\n'
    finally:
        process.kill()
        reader.join()
        _, errors = process.communicate()
    assert not errors


def test_a_signal_handler_that_returns_is_called_during_the_solve():
    calls = []
    before = signal.signal(signal.SIGINT, lambda number, _: calls.append(number))
    try:
        assert solve(raise_if_over=lambda: calls or signal.raise_signal(
            signal.SIGINT)) == pytest.approx([1.0, 1.0, 0.0])
    finally:
        signal.signal(signal.SIGINT, before)
    assert calls == [signal.SIGINT]


def test_an_exception_of_the_check_ends_the_solve_in_any_thread():
    def check():
        raise StoppedError

    for thread in (None, ThreadPoolExecutor(1)):
        with pytest.raises(StoppedError):
            (thread.submit(solve, raise_if_over=check).result() if thread
             else solve(raise_if_over=check))


def test_missions_and_plans_are_made_without_the_solver(monkeypatch):
    monkeypatch.setattr(clarabel, 'DefaultSolver', None)
    scenario = with_uavs(Scenario.paper(200.0, slots=10000), max_acceleration=2.0,
                         start_velocity=(0.0, -5.0), goal_velocity=(0.0, -5.0))
    fence = ((-400.0, -800.0), (600.0, -800.0), (600.0, 800.0), (-400.0, 800.0))
    scenario = replace(scenario, reference_snr_db=79.0, geofence=fence, no_fly_zones=(
        NoFlyZone(((300.0, -50.0), (350.0, -50.0), (350.0, 50.0), (300.0, 50.0))),))
    straight = np.linspace(scenario.starts, scenario.goals, scenario.slots + 2, axis=1)
    fast = with_uavs(scenario, max_speed=20.0, max_acceleration=1e6)
    plan = Plan(fast, straight, np.zeros((2, scenario.slots)))
    assert cut_tail(plan, 100).scenario.slots == 9900


def test_where_the_solver_fails_no_flight_is_within_the_limits(monkeypatch):
    healthy = clarabel.DefaultSettings

    def hasty():
        settings = healthy()
        settings.max_iter = 1
        return settings

    monkeypatch.setattr(clarabel, 'DefaultSettings', hasty)
    vehicle = Vehicle((100.0, 0.0), 10.0, 1.0, (0.0, 5.0))
    utilisation, points = minimise_utilisation(vehicle, 20, 1.0)
    assert utilisation == np.inf and points[[0, -1]].tolist() == [[0.0, 0.0], [100.0, 0.0]]
