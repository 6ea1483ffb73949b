"""Measurements of a scenario: rates and times of all solvers, memory, warm starts."""

from dataclasses import replace
import statistics
import subprocess
import sys
import time

import numpy as np
from secure_uav_planner.model.problem import Problem
from secure_uav_planner.optimize import solve
from secure_uav_planner.optimize.initial import constant_powers, fly_hover_fly_positions

from .opponents import solve_by_fatrop, solve_by_ipopt

# A child inherits getrusage's ru_maxrss on Linux; VmHWM is its own.
_MEMORY = """
import sys
from secure_uav_planner import Scenario, solve
solve(Scenario.paper(200.0, 10.0, int(sys.argv[1])), objective='guaranteed')
with open('/proc/self/status') as status:
    print(*(int(line.split()[1]) / 1024 for line in status if line.startswith('VmHWM:')))
"""

OPPONENTS = {'ipopt': solve_by_ipopt, 'fatrop': solve_by_fatrop}


def measure(name, scenario, repeats, *, with_opponents=True, alternating=False, reference=None):
    """
    Return the measurements of a Scenario as a row, a dictionary.

    The solvers take turns, so that a change of the machine's load affects all. Times are medians
    in s. The time of `joint` includes everything, also its several starts. A ratio is the
    opponent's time, including the time to build the problem, divided by that of `joint`;
    `..._ratio_solve` counts the opponent's call alone.

    :param repeats: the number of runs of each solver.
    :param with_opponents: True to run the OPPONENTS.
    :param alternating: True to run the paper's algorithm as well, once.
    :param reference: the rate to reach in bit/s/Hz, or None.
    """
    start = fly_hover_fly_positions(Problem(scenario)), constant_powers(scenario)
    answers = {name: [] for name in OPPONENTS if with_opponents}
    plans = []
    for _ in range(repeats):
        plans.append(solve(scenario, objective='guaranteed'))
        for opponent, runs in answers.items():
            if not runs or runs[0].solve_time < 2.0:  # A slow answer is measured once.
                runs.append(OPPONENTS[opponent](scenario, *start))
    joint_time = statistics.median(plan.solve_time for plan in plans)
    row = {
        'name': name, 'uavs': len(scenario.uavs), 'eavesdroppers': len(scenario.eavesdroppers),
        'slots': scenario.slots, 'reference': reference, 'joint_rate': plans[0].guaranteed_rate,
        'joint_time': joint_time}
    for opponent, runs in answers.items():
        build = statistics.median(answer.build_time for answer in runs)
        call = statistics.median(answer.solve_time for answer in runs)
        row.update({
            f'{opponent}_rate': runs[0].rate, f'{opponent}_build': build,
            f'{opponent}_solve': call, f'{opponent}_converged': runs[0].is_converged,
            f'{opponent}_ratio': (build + call) / joint_time,
            f'{opponent}_ratio_solve': call / joint_time})
    if alternating:
        paper = solve(scenario, method='alternating')
        row.update(alternating_rate=paper.guaranteed_rate, alternating_time=paper.solve_time)
    return row


def measure_memory(slots):
    """Return the peak memory in MB of a process that solves the paper's scenario by `joint`."""
    process = subprocess.run([sys.executable, '-c', _MEMORY, str(slots)], check=True,
                             capture_output=True, text=True)
    return float(process.stdout)


def measure_warm(name, scenario, repeats):
    """Return a row that compares a warm with a cold start after eavesdroppers moved by 30 m."""
    before = solve(scenario, objective='guaranteed')
    angle = np.random.default_rng([5, scenario.slots]).uniform(0, 2 * np.pi)
    moved = replace(scenario, eavesdroppers=tuple(
        replace(eve, position=(eve.position[0] + 30 * np.cos(angle),
                               eve.position[1] + 30 * np.sin(angle)))
        for eve in scenario.eavesdroppers))
    cold, warm = zip(*([solve(moved, initial=initial, objective='guaranteed')
                        for initial in (None, before)] for _ in range(repeats)))
    times = [statistics.median(plan.solve_time for plan in plans) for plans in (cold, warm)]
    return {
        'name': name, 'slots': scenario.slots, 'cold_rate': cold[0].guaranteed_rate,
        'warm_rate': warm[0].guaranteed_rate, 'cold_time': times[0], 'warm_time': times[1],
        'warm_ratio': times[1] / times[0]}


def measure_objectives(name, scenario):
    """
    Return a row that compares the objectives of `joint` in rates and processor time.

    Both rates are worst-case rates in bit/s/Hz: of the plan for the guaranteed rate, problem (P2),
    and of that for the worst case, problem (P1).
    """
    plans, times = [], []
    for objective in ('guaranteed', 'worst_case'):
        started = time.process_time()
        plans.append(solve(scenario, objective=objective))
        times.append(time.process_time() - started)
    return {'name': name, 'slots': scenario.slots, 'p2_rate': plans[0].worst_case_rate,
            'p1_rate': plans[1].worst_case_rate, 'p2_time': times[0], 'p1_time': times[1],
            'objective_ratio': times[1] / times[0]}
