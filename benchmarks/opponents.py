"""Problem (P2) in CasADi, solved by IPOPT or FATROP, for comparison."""

from dataclasses import dataclass
import time

import casadi as ca
import numpy as np
from secure_uav_planner.model.problem import Problem
from secure_uav_planner.optimize.incumbent import mute_negative_slots

UNIT = 100.0  # m
TOLERANCE = 1e-6  # Of FATROP.
TIME_LIMIT = 120.0  # Of IPOPT in s.


@dataclass(frozen=True)
class Answer:
    """
    The result of an opponent.

    The rate is the guaranteed rate in bit/s/Hz, after the iterate was made feasible and the
    transmitter was switched off in slots with a negative rate.
    """

    rate: float
    build_time: float  # Of expressions, derivatives and the solver object, in s.
    solve_time: float  # Of the solver's call alone, in s.
    is_converged: bool  # The solver's own verdict.


def solve_by_ipopt(scenario, positions, powers):
    """
    Return the Answer of IPOPT with its default options and exact derivatives.

    With several eavesdroppers the largest leakage rate of a slot is an epigraph variable; with a
    single eavesdropper it is an expression.

    :param positions: of the start, (U, N+2, 2) in m.
    :param powers: of the start, (U, N) in W.
    """
    initial_leaks = _largest_leaks(scenario, positions, powers)  # Not timed.
    started = time.perf_counter()
    slots, uavs = scenario.slots, len(scenario.uavs)
    x, y, power = variables = [ca.SX.sym(name, slots, uavs) for name in 'xyp']
    ground, leaks = rate_expressions(scenario, *variables)
    squares = sum(ca.diff(ca.vertcat(start.T, place, goal.T))**2
                  for start, place, goal in zip(_ends(scenario, 'start'), (x, y),
                                                _ends(scenario, 'goal')))
    left = [ca.vec(squares), ca.sum1(power).T / slots]
    right = [np.repeat((scenario.max_step / UNIT)**2, slots + 1), scenario.average_powers]
    initial = [positions[:, 1:-1, 0] / UNIT, positions[:, 1:-1, 1] / UNIT, powers]
    largest = leaks[0]
    if len(leaks) > 1:
        largest = ca.SX.sym('t', slots)
        variables.append(largest)
        left += [leak - largest for leak in leaks]
        right.append(np.zeros(slots * len(leaks)))
        initial.append(initial_leaks)
    solver = ca.nlpsol('solver', 'ipopt', {
        'x': ca.vertcat(*map(ca.vec, variables)), 'f': ca.sum1(largest - ground) / slots,
        'g': ca.vertcat(*left)}, {
            'print_time': False, 'ipopt.print_level': 0, 'ipopt.sb': 'yes',
            'ipopt.max_wall_time': TIME_LIMIT})
    initial = np.concatenate([values.ravel() for values in initial])
    low, high = np.full(initial.shape, -np.inf), np.full(initial.shape, np.inf)
    power_slice = slice(2 * powers.size, 3 * powers.size)
    low[power_slice], high[power_slice] = 0.0, np.repeat(scenario.peak_powers, slots)
    built = time.perf_counter()
    solution = solver(x0=initial, lbx=low, ubx=high, lbg=-np.inf, ubg=np.concatenate(right))
    solved = time.perf_counter()
    values = np.array(solution['x']).ravel()[:3 * powers.size].reshape(3, uavs, slots)
    return _make_answer(scenario, values, (started, built, solved), solver)


def solve_by_fatrop(scenario, positions, powers):
    """
    Return the Answer of FATROP with exact derivatives, which detects the stages by itself.

    The slots are the stages. Their states are positions and accumulated powers; their controls
    are the powers, the moves to the next slot and, with several eavesdroppers, the largest leakage
    rate. The arguments are those of solve_by_ipopt.
    """
    initial_leaks = _largest_leaks(scenario, positions, powers)  # Not timed.
    started = time.perf_counter()
    slots, uavs, eves = scenario.slots, len(scenario.uavs), len(scenario.eavesdroppers)
    size = 4 * uavs + (eves > 1)  # Of a stage without its moves.
    early = ca.SX.sym('early', size + 2 * uavs, slots - 1)
    last = ca.SX.sym('last', size)
    stages = ca.horzcat(early[:size, :], last)
    x, y, used, power = (stages[k * uavs:(k + 1) * uavs, :] for k in range(4))
    moves = early[size:, :]
    ground, leaks = rate_expressions(scenario, x.T, y.T, power.T)
    largest = stages[4 * uavs, :].T if eves > 1 else leaks[0]
    excess = [leak.T - largest.T for leak in leaks] if eves > 1 else []
    # FATROP expects the dynamics first: the next state less that of state and controls.
    each = ca.vertcat(x[:, 1:] - x[:, :-1] - moves[:uavs, :],
                      y[:, 1:] - y[:, :-1] - moves[uavs:, :],
                      used[:, 1:] - used[:, :-1] - power[:, :-1] / slots,
                      moves[:uavs, :]**2 + moves[uavs:, :]**2, *(row[:, :-1] for row in excess))
    from_start, to_goal = (
        (x[:, slot] - end_x)**2 + (y[:, slot] - end_y)**2 for slot, (end_x, end_y) in (
            (0, _ends(scenario, 'start')), (slots - 1, _ends(scenario, 'goal'))))
    # The first slot has the start beside these, and the last slot has no next state.
    constraints = ca.vertcat(
        each[:4 * uavs, 0], used[:, 0], from_start, each[4 * uavs:, 0], ca.vec(each[:, 1:]),
        to_goal, used[:, -1] + power[:, -1] / slots, *(row[:, -1] for row in excess))
    longest, zero = (scenario.max_step / UNIT)**2, np.zeros(uavs)
    most = np.concatenate([np.zeros(3 * uavs), longest, np.zeros(len(excess))])
    upper = np.concatenate([
        most[:4 * uavs], zero, longest, np.tile(most, slots - 1)[4 * uavs:],
        longest, scenario.average_powers, np.zeros(len(excess))])
    is_equal = np.arange(len(most)) < 3 * uavs
    equality = np.concatenate([
        is_equal[:4 * uavs], np.ones(uavs, bool), np.zeros(uavs, bool),
        np.tile(is_equal, slots - 1)[4 * uavs:], np.zeros(2 * uavs + len(excess), bool)])
    solver = ca.nlpsol('solver', 'fatrop', {
        'x': ca.vertcat(ca.vec(early), last), 'f': ca.sum1(largest - ground) / slots,
        'g': constraints}, {
            'print_time': False, 'structure_detection': 'auto', 'equality': equality.tolist(),
            'fatrop': {'print_level': 0, 'tolerance': TOLERANCE, 'max_iter': 1000}})

    before = np.cumsum(powers, axis=1) - powers
    initial = np.concatenate([
        positions[:, 1:-1, 0] / UNIT, positions[:, 1:-1, 1] / UNIT, before / slots, powers,
        *([initial_leaks[None]] if eves > 1 else []),
        np.diff(positions[:, 1:, 0]) / UNIT, np.diff(positions[:, 1:, 1]) / UNIT]).T
    low, high = np.full(initial.shape, -np.inf), np.full(initial.shape, np.inf)
    power_slice = slice(3 * uavs, 4 * uavs)
    low[:, power_slice], high[:, power_slice] = 0.0, scenario.peak_powers
    count = initial.size - 2 * uavs  # The last slot has no moves.
    built = time.perf_counter()
    solution = solver(x0=initial.ravel()[:count], lbx=low.ravel()[:count],
                      ubx=high.ravel()[:count], lbg=np.where(equality, 0.0, -np.inf), ubg=upper)
    solved = time.perf_counter()
    values = np.append(np.array(solution['x']).ravel(), np.zeros(2 * uavs)).reshape(slots, -1).T
    values = values[:4 * uavs].reshape(4, uavs, slots)[[0, 1, 3]]
    return _make_answer(scenario, values, (started, built, solved), solver)


def rate_expressions(scenario, x, y, power):
    """
    Return expressions of r_0 and of the list of leaks, in nats, with the rows of the arguments.

    The kink at d = 0 is rounded by 1 cm; that at d = epsilon is left to the solver.

    :param x: expressions of the positions in UNITs, a column for each UAV; and y.
    :param power: of the powers in W, likewise.
    """
    snr = scenario.reference_snr / UNIT**2

    def rate(place, radius, advantage=1.0):
        received = []
        for i, uav in enumerate(scenario.uavs):
            squared = (x[:, i] - place[0] / UNIT)**2 + (y[:, i] - place[1] / UNIT)**2
            if radius:
                distance = ca.sqrt(squared + 1e-8)
                edge = radius / UNIT
                squared = (distance + edge)**2 if i else ca.fmax(distance - edge, 0)**2
            received.append(advantage * snr * power[:, i] / (squared + (uav.altitude / UNIT)**2))
        jammed = 1 + sum(received[1:], ca.SX.zeros(power.shape[0]))
        return ca.log(jammed + received[0]) - ca.log(jammed)

    return (rate(scenario.ground_node, 0.0),
            [rate(eve.position, eve.error_radius, advantage) for eve, advantage in zip(
                scenario.eavesdroppers, scenario.receiver_advantages)])


def _ends(scenario, end):
    """Return x and y of the 'start' or 'goal' of the UAVs in UNITs, each (U, 1)."""
    points = ca.DM(np.array([getattr(uav, end) for uav in scenario.uavs]) / UNIT)
    return points[:, 0], points[:, 1]


def _largest_leaks(scenario, positions, powers):
    """Return the largest leak of each slot at the start, the initial epigraph, in nats."""
    inner = ca.DM(positions[:, 1:-1, 0].T / UNIT), ca.DM(positions[:, 1:-1, 1].T / UNIT)
    symbols = [ca.SX.sym(name, *powers.T.shape) for name in 'xyp']
    leaks = ca.Function('leaks', symbols, [ca.horzcat(*rate_expressions(scenario, *symbols)[1])])
    return np.array(leaks(*inner, ca.DM(powers.T))).max(axis=1)


def _make_answer(scenario, values, times, solver):
    """Return the Answer of an iterate: x and y in UNITs and powers in W, (3, U, N)."""
    inner = UNIT * np.stack(values[:2], axis=-1)
    positions = np.concatenate(
        [scenario.starts[:, None], inner, scenario.goals[:, None]], axis=1)
    return Answer(compute_rate(scenario, positions, values[2]), times[1] - times[0],
                  times[2] - times[1], solver.stats()['success'])


def compute_rate(scenario, positions, powers):
    """Return the guaranteed rate of an iterate made feasible, in bit/s/Hz."""
    problem = Problem(scenario)
    _, rates = mute_negative_slots(
        scenario, problem.retract(positions), problem.retract_powers(powers))
    return float(rates.mean())
