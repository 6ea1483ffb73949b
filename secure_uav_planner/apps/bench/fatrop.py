"""The fastest alternative, for comparison: problem (P2) as optimal control, by FATROP."""

import time

import numpy as np

from .opponent import imported_casadi, judged, largest_leaks, rate_expressions, UNIT

TOLERANCE = 1e-6


def solve_by_fatrop(scenario, positions, powers, iterations=1000):
    """
    Solve (P2) with FATROP, which finds the stages by itself, and return an Answer.

    The slots are the stages. Their states are positions, in units of 100 m, and the powers used
    before; their controls are the powers, the moves to the next slot and, with several
    eavesdroppers, the largest leakage rate. The tolerance is TOLERANCE, other options are
    FATROP's own, and derivatives are exact.

    :param positions: of the start, (U, N+2, 2) in m.
    :param powers: of the start, (U, N) in W.
    :param iterations: the most iterations.
    :raises ImportError: if CasADi is missing; the text says what to install.
    """
    ca = imported_casadi()
    started = time.perf_counter()
    slots, uavs, eves = scenario.slots, len(scenario.uavs), len(scenario.eavesdroppers)
    size = 4 * uavs + (eves > 1)  # of a stage, but for the moves to the next one.
    early = ca.SX.sym('early', size + 2 * uavs, slots - 1)
    last = ca.SX.sym('last', size)
    stages = ca.horzcat(early[:size, :], last)
    x, y, used, power = (stages[k * uavs:(k + 1) * uavs, :] for k in range(4))
    moves = early[size:, :]
    ground, leaks = rate_expressions(scenario, x.T, y.T, power.T)
    largest = stages[4 * uavs, :].T if eves > 1 else leaks[0]

    def squares(dx, dy):
        return dx**2 + dy**2

    starts, goals = (ca.DM(np.array([getattr(uav, end) for uav in scenario.uavs]) / UNIT)
                     for end in ('start', 'goal'))
    longest = (scenario.max_step / UNIT)**2
    average = scenario.average_powers
    constraints, equal, upper = [], [], []

    def add(expression, bound, is_equal=False):
        constraints.append(expression)
        equal.append(np.full(expression.shape, is_equal))
        upper.append(np.broadcast_to(bound, expression.shape[::-1]).T)

    excess = ca.horzcat(*[leak - largest for leak in leaks]).T if eves > 1 else None
    # The next state less what this one and the controls make of it, as FATROP asks for.
    inner = ca.vertcat(x[:, 1:] - x[:, :-1] - moves[:uavs, :],
                       y[:, 1:] - y[:, :-1] - moves[uavs:, :],
                       used[:, 1:] - used[:, :-1] - power[:, :-1] / slots)
    squared = squares(moves[:uavs, :], moves[uavs:, :])
    for slot in range(slots):
        if slot < slots - 1:
            add(inner[:, slot], 0.0, True)
            add(squared[:, slot], longest)
        if slot == 0:
            add(used[:, 0], 0.0, True)
            add(squares(x[:, 0] - starts[:, 0], y[:, 0] - starts[:, 1]), longest)
        if slot == slots - 1:
            add(squares(x[:, -1] - goals[:, 0], y[:, -1] - goals[:, 1]), longest)
            add(used[:, -1] + power[:, -1] / slots, average)
        if eves > 1:
            add(excess[:, slot], 0.0)
    equality = np.concatenate([one.ravel() for one in equal])
    above = np.concatenate([one.ravel() for one in upper])
    problem = {'x': ca.vertcat(ca.vec(early), last), 'g': ca.vertcat(*constraints),
               'f': ca.sum1(largest - ground) / slots}
    solver = ca.nlpsol('solver', 'fatrop', problem, {
        'print_time': False, 'structure_detection': 'auto', 'equality': equality.tolist(),
        'fatrop': {'print_level': 0, 'tolerance': TOLERANCE, 'max_iter': iterations}})

    before = np.cumsum(powers, axis=1) - powers
    guess = np.concatenate([
        positions[:, 1:-1, 0] / UNIT, positions[:, 1:-1, 1] / UNIT, before / slots, powers,
        *([largest_leaks(scenario, positions, powers)[None]] if eves > 1 else []),
        np.diff(positions[:, 1:, 0]) / UNIT, np.diff(positions[:, 1:, 1]) / UNIT]).T
    low, high = np.full(guess.shape, -np.inf), np.full(guess.shape, np.inf)
    low[:, 3 * uavs:4 * uavs] = 0.0
    high[:, 3 * uavs:4 * uavs] = scenario.peak_powers
    present = guess.size - 2 * uavs  # The last slot has no moves.
    built = time.perf_counter()
    found = solver(x0=guess.ravel()[:present], lbx=low.ravel()[:present],
                   ubx=high.ravel()[:present], lbg=np.where(equality, 0.0, -np.inf), ubg=above)
    solved = time.perf_counter()
    values = np.append(np.array(found['x']).ravel(), np.zeros(2 * uavs)).reshape(slots, -1)
    path = positions.copy()
    path[:, 1:-1, 0] = values[:, :uavs].T * UNIT
    path[:, 1:-1, 1] = values[:, uavs:2 * uavs].T * UNIT
    return judged(scenario, path, values[:, 3 * uavs:4 * uavs].T, (started, built, solved),
                  {**solver.stats(), 'return_status': _status(solver.stats())})


def _status(stats):
    """Return in words how FATROP ended."""
    return 'Solve_Succeeded' if stats['success'] else 'Not_Converged'
