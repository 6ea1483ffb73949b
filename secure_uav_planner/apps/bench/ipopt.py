"""The usual alternative, for comparison: problem (P2) in CasADi, solved by IPOPT."""

import time

import numpy as np

from .opponent import imported_casadi, judged, largest_leaks, rate_expressions, UNIT


def solve_by_ipopt(scenario, positions, powers, time_limit=120.0):
    """
    Solve (P2) with IPOPT's default options and return an Answer.

    Positions are in units of 100 m, and derivatives are exact. With several eavesdroppers the
    largest leakage rate of a slot is an epigraph variable; with one it is an expression.

    :param positions: of the start, (U, N+2, 2) in m.
    :param powers: of the start, (U, N) in W.
    :param time_limit: for IPOPT in s.
    :raises ImportError: if CasADi is missing; the text says what to install.
    """
    ca = imported_casadi()
    started = time.perf_counter()
    slots, uavs, eves = scenario.slots, len(scenario.uavs), scenario.eavesdroppers
    x, y = (ca.SX.sym(name, slots, uavs) for name in 'xy')
    p = ca.SX.sym('p', slots, uavs)
    ground, leaks = rate_expressions(scenario, x, y, p)
    steps, limits = [], []
    for i, (uav, step) in enumerate(zip(scenario.uavs, scenario.max_step)):
        start, goal = np.array(uav.start) / UNIT, np.array(uav.goal) / UNIT
        moves = [ca.diff(ca.vertcat(start[k], place[:, i], goal[k]))
                 for k, place in enumerate((x, y))]
        steps.append(moves[0]**2 + moves[1]**2)
        limits.append(np.full(slots + 1, (step / UNIT)**2))
    steps += [ca.sum1(p[:, i]) / slots for i in range(uavs)]
    limits += [[uav.average_power] for uav in scenario.uavs]
    largest, extra = leaks[0], []
    guess = np.concatenate([np.swapaxes(positions[:, 1:-1] / UNIT, 0, 2)[k].ravel('F')
                            for k in range(2)] + [powers.ravel()])
    if len(eves) > 1:
        largest = ca.SX.sym('t', slots)
        steps += [leak - largest for leak in leaks]
        limits += [np.zeros(slots)] * len(eves)
        extra = [largest]
        guess = np.concatenate([guess, largest_leaks(scenario, positions, powers)])
    peak = np.repeat([uav.peak_power for uav in scenario.uavs], slots)
    variables = ca.vertcat(ca.vec(x), ca.vec(y), ca.vec(p), *extra)
    problem = {'x': variables, 'f': ca.sum1(largest - ground) / slots, 'g': ca.vertcat(*steps)}
    solver = ca.nlpsol('solver', 'ipopt', problem, {
        'print_time': False, 'ipopt.print_level': 0, 'ipopt.sb': 'yes',
        'ipopt.max_wall_time': time_limit})
    free = np.full(2 * uavs * slots, np.inf)
    slack = np.full(slots * len(extra), np.inf)
    built = time.perf_counter()
    found = solver(x0=guess, lbx=np.concatenate([-free, 0 * peak, -slack]),
                   ubx=np.concatenate([free, peak, slack]), lbg=-np.inf,
                   ubg=np.concatenate(limits))
    solved = time.perf_counter()
    values = np.array(found['x']).ravel()[:3 * uavs * slots].reshape(3, uavs, slots)
    path = positions.copy()
    path[:, 1:-1] = np.stack([values[0], values[1]], axis=-1) * UNIT
    return judged(scenario, path, values[2], (started, built, solved), solver.stats())
