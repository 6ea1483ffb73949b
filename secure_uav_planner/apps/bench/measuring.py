"""Measurements of a scenario: rates and times beside those of others, memory, warm starts."""

from dataclasses import replace
import statistics
import subprocess
import sys
import time

import numpy as np

from .fatrop import solve_by_fatrop
from .ipopt import solve_by_ipopt
from .opponent import has_fatrop
from ...optimize import solve
from ...optimize.initial import constant_powers, fly_hover_fly_positions

# Linux hands getrusage's ru_maxrss down from the process that starts another; VmHWM is its own.
_MEMORY = """
import sys
from secure_uav_planner import Scenario, solve
solve(Scenario.paper(200.0, 10.0, int(sys.argv[1])), objective='guaranteed')
with open('/proc/self/status') as status:
    print(*(int(line.split()[1]) / 1024 for line in status if line.startswith('VmHWM:')))
"""

_OPPONENTS = {'ipopt': solve_by_ipopt, 'fatrop': solve_by_fatrop}


def measure(name, scenario, repeats, *, ipopt=True, fatrop=True, alternating=False,
            reference=None):
    """
    Return the measurements of a scenario as a row, a dictionary.

    The solvers take turns, so that a change of the machine's load affects all. Times are medians
    in s. The time of `joint` includes everything, also its several starts. A ratio is the other
    solver's time, including the time to build the problem, divided by that of `joint`;
    `..._ratio_solve` counts the other solver's call alone.

    :param name: the name of the row.
    :param scenario: a Scenario.
    :param repeats: how often each solver runs.
    :param ipopt: whether to run IPOPT.
    :param fatrop: whether to run FATROP, where CasADi brings it.
    :param alternating: whether to run the paper's algorithm as well, once.
    :param reference: the rate to reach in bit/s/Hz, if it is known.
    """
    start = fly_hover_fly_positions(scenario), constant_powers(scenario)
    others = {other: [] for other, wanted in (
        ('ipopt', ipopt), ('fatrop', fatrop and has_fatrop())) if wanted}
    plans = []
    for _ in range(repeats):
        plans.append(solve(scenario, method='joint', objective='guaranteed'))
        for other, answers in others.items():
            # One run is enough to know the time of a slow answer.
            if not answers or answers[0].solve_time < 2.0:
                answers.append(_OPPONENTS[other](scenario, *start))
    plan = plans[0]
    row = {
        'name': name, 'uavs': len(scenario.uavs), 'eavesdroppers': len(scenario.eavesdroppers),
        'slots': scenario.slots, 'reference': reference, 'joint_rate': plan.guaranteed_rate,
        'joint_time': statistics.median(plan.solve_time for plan in plans),
        'joint_iterations': len(plan.history) - 1, 'joint_status': plan.status}
    for other, answers in others.items():
        build = statistics.median(answer.build_time for answer in answers)
        call = statistics.median(answer.solve_time for answer in answers)
        row.update({
            f'{other}_rate': answers[0].rate, f'{other}_build': build, f'{other}_solve': call,
            f'{other}_iterations': answers[0].iterations, f'{other}_status': answers[0].status,
            f'{other}_ratio': (build + call) / row['joint_time'],
            f'{other}_ratio_solve': call / row['joint_time']})
    if alternating:
        paper = solve(scenario, method='alternating')
        row.update(alternating_rate=paper.guaranteed_rate, alternating_time=paper.solve_time)
    return row


def peak_memory(slots):
    """Return the peak memory in MB of a process that solves the paper's scenario by `joint`."""
    done = subprocess.run([sys.executable, '-c', _MEMORY, str(slots)], check=True,
                          capture_output=True, text=True)
    return float(done.stdout)


def measure_warm(name, scenario, seed, repeats):
    """
    Return a row that compares a warm with a cold start after all eavesdroppers moved by 5 m.

    :param seed: the seed of the direction of the move.
    """
    before = solve(scenario, method='joint', objective='guaranteed')
    angle = np.random.default_rng([5, seed]).uniform(0, 2 * np.pi)
    moved = replace(scenario, eavesdroppers=tuple(
        replace(eve, position=(eve.position[0] + 5 * np.cos(angle),
                               eve.position[1] + 5 * np.sin(angle)))
        for eve in scenario.eavesdroppers))
    cold, warm = [], []
    for _ in range(repeats):
        cold.append(solve(moved, method='joint', objective='guaranteed'))
        warm.append(solve(moved, method='joint', initial=before, objective='guaranteed'))
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
