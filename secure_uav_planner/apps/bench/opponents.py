"""The usual alternatives, for comparison: problem (P2) in CasADi, solved by IPOPT or FATROP."""

from dataclasses import dataclass
import time

import numpy as np

from ...model.limits import repaired
from ...optimize.feasible import without_losing_slots

UNIT = 100.0  # m
TOLERANCE = 1e-6  # Of FATROP.


@dataclass(frozen=True)
class Answer:
    """
    The result of another solver.

    :param rate: the guaranteed rate in bit/s/Hz, after the answer was made feasible and the
        transmitter was switched off in slots with a negative rate.
    :param build_time: the time to build expressions, derivatives and the solver object, in s.
    :param solve_time: the time of the solver's call alone, in s.
    :param is_converged: whether the solver says that it succeeded.
    """

    rate: float
    build_time: float
    solve_time: float
    is_converged: bool


def solve_by_ipopt(scenario, positions, powers, time_limit=120.0):
    """
    Solve (P2) with IPOPT's default options and exact derivatives, and return an Answer.

    With several eavesdroppers the largest leakage rate of a slot is an epigraph variable; with one
    it is an expression.

    :param positions: of the start, (U, N+2, 2) in m.
    :param powers: of the start, (U, N) in W.
    :param time_limit: for IPOPT in s.
    :raises ImportError: if CasADi is missing; the text says what to install.
    """
    ca = imported_casadi()
    started = time.perf_counter()
    slots, uavs = scenario.slots, len(scenario.uavs)
    x, y, power = variables = [ca.SX.sym(name, slots, uavs) for name in 'xyp']
    ground, leaks = rate_expressions(scenario, *variables)
    squares = sum(ca.diff(ca.vertcat(start.T, place, goal.T))**2
                  for start, place, goal in zip(_ends(scenario, 'start'), (x, y),
                                                _ends(scenario, 'goal')))
    left = [ca.vec(squares), ca.sum1(power).T / slots]
    right = [np.repeat((scenario.max_step / UNIT)**2, slots + 1), scenario.average_powers]
    guess = [positions[:, 1:-1, 0] / UNIT, positions[:, 1:-1, 1] / UNIT, powers]
    largest = leaks[0]
    if len(leaks) > 1:
        largest = ca.SX.sym('t', slots)
        variables.append(largest)
        left += [leak - largest for leak in leaks]
        right.append(np.zeros(slots * len(leaks)))
        guess.append(_largest_leaks(scenario, positions, powers))
    solver = ca.nlpsol('solver', 'ipopt', {
        'x': ca.vertcat(*map(ca.vec, variables)), 'f': ca.sum1(largest - ground) / slots,
        'g': ca.vertcat(*left)}, {
            'print_time': False, 'ipopt.print_level': 0, 'ipopt.sb': 'yes',
            'ipopt.max_wall_time': time_limit})
    guess = np.concatenate([values.ravel() for values in guess])
    low, high = np.full(guess.shape, -np.inf), np.full(guess.shape, np.inf)
    of_powers = slice(2 * powers.size, 3 * powers.size)
    low[of_powers], high[of_powers] = 0.0, np.repeat(scenario.peak_powers, slots)
    built = time.perf_counter()
    found = solver(x0=guess, lbx=low, ubx=high, lbg=-np.inf, ubg=np.concatenate(right))
    solved = time.perf_counter()
    values = np.array(found['x']).ravel()[:3 * powers.size].reshape(3, uavs, slots)
    return _judged(scenario, values, (started, built, solved), solver)


def solve_by_fatrop(scenario, positions, powers):
    """
    Solve (P2) with FATROP, which finds the stages by itself, and return an Answer.

    The slots are the stages. Their states are positions and the powers used before; their controls
    are the powers, the moves to the next slot and, with several eavesdroppers, the largest leakage
    rate. The tolerance is TOLERANCE, and derivatives are exact.

    :param positions: of the start, (U, N+2, 2) in m.
    :param powers: of the start, (U, N) in W.
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
    longest = (scenario.max_step / UNIT)**2
    constraints, equal, upper = [], [], []

    def add(expression, bound, is_equal=False):
        constraints.append(expression)
        equal.append(np.full(expression.shape, is_equal))
        upper.append(np.broadcast_to(bound, expression.shape[::-1]).T)

    def add_end(slot, end):
        at_x, at_y = _ends(scenario, end)
        add((x[:, slot] - at_x)**2 + (y[:, slot] - at_y)**2, longest)

    excess = ca.horzcat(*[leak - largest for leak in leaks]).T if eves > 1 else None
    # The next state less what this one and the controls make of it, as FATROP asks for.
    inner = ca.vertcat(x[:, 1:] - x[:, :-1] - moves[:uavs, :],
                       y[:, 1:] - y[:, :-1] - moves[uavs:, :],
                       used[:, 1:] - used[:, :-1] - power[:, :-1] / slots)
    squares = moves[:uavs, :]**2 + moves[uavs:, :]**2
    for slot in range(slots):
        if slot < slots - 1:
            add(inner[:, slot], 0.0, True)
            add(squares[:, slot], longest)
        if slot == 0:
            add(used[:, 0], 0.0, True)
            add_end(slot, 'start')
        if slot == slots - 1:
            add_end(slot, 'goal')
            add(used[:, -1] + power[:, -1] / slots, scenario.average_powers)
        if eves > 1:
            add(excess[:, slot], 0.0)
    equality = np.concatenate([one.ravel() for one in equal])
    solver = ca.nlpsol('solver', 'fatrop', {
        'x': ca.vertcat(ca.vec(early), last), 'f': ca.sum1(largest - ground) / slots,
        'g': ca.vertcat(*constraints)}, {
            'print_time': False, 'structure_detection': 'auto', 'equality': equality.tolist(),
            'fatrop': {'print_level': 0, 'tolerance': TOLERANCE, 'max_iter': 1000}})

    before = np.cumsum(powers, axis=1) - powers
    guess = np.concatenate([
        positions[:, 1:-1, 0] / UNIT, positions[:, 1:-1, 1] / UNIT, before / slots, powers,
        *([_largest_leaks(scenario, positions, powers)[None]] if eves > 1 else []),
        np.diff(positions[:, 1:, 0]) / UNIT, np.diff(positions[:, 1:, 1]) / UNIT]).T
    low, high = np.full(guess.shape, -np.inf), np.full(guess.shape, np.inf)
    of_powers = slice(3 * uavs, 4 * uavs)
    low[:, of_powers], high[:, of_powers] = 0.0, scenario.peak_powers
    present = guess.size - 2 * uavs  # The last slot has no moves.
    built = time.perf_counter()
    found = solver(x0=guess.ravel()[:present], lbx=low.ravel()[:present],
                   ubx=high.ravel()[:present], lbg=np.where(equality, 0.0, -np.inf),
                   ubg=np.concatenate([one.ravel() for one in upper]))
    solved = time.perf_counter()
    values = np.append(np.array(found['x']).ravel(), np.zeros(2 * uavs)).reshape(slots, -1).T
    values = values[:4 * uavs].reshape(4, uavs, slots)[[0, 1, 3]]
    return _judged(scenario, values, (started, built, solved), solver)


def imported_casadi():
    """
    Return the module casadi.

    :raises ImportError: if it is missing; the text says what to install.
    """
    try:
        import casadi
    except ImportError as error:
        raise ImportError('the comparison needs CasADi: pip install casadi') from error
    return casadi


def rate_expressions(scenario, x, y, power):
    """
    Return expressions of r_0 and of the list of leaks, in nats, with the rows of the arguments.

    The kink at d = 0 is rounded by 1 cm; that at d = epsilon is left to the solver.

    :param x: expressions of the positions in UNITs, a column for each UAV; and y.
    :param power: of the powers in W, likewise.
    """
    ca = imported_casadi()
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
    places = imported_casadi().DM(np.array([getattr(uav, end) for uav in scenario.uavs]) / UNIT)
    return places[:, 0], places[:, 1]


def _largest_leaks(scenario, positions, powers):
    """Return the largest leak of every slot at a start, where an epigraph begins, in nats."""
    ca = imported_casadi()
    inner = ca.DM(positions[:, 1:-1, 0].T / UNIT), ca.DM(positions[:, 1:-1, 1].T / UNIT)
    symbols = [ca.SX.sym(name, *powers.T.shape) for name in 'xyp']
    leaks = ca.Function('leaks', symbols, [ca.horzcat(*rate_expressions(scenario, *symbols)[1])])
    return np.array(leaks(*inner, ca.DM(powers.T))).max(axis=1)


def _judged(scenario, values, times, solver):
    """
    Return the Answer that a solver's iterate is.

    :param values: x and y in UNITs and powers in W, (3, U, N).
    :param times: readings of the clock before the problem was built, before and after the call.
    """
    inner = UNIT * np.stack(values[:2], axis=-1)
    path, powers = repaired(scenario, np.concatenate(
        [scenario.starts[:, None], inner, scenario.goals[:, None]], axis=1), values[2])
    _, found = without_losing_slots(scenario, path, powers)
    return Answer(float(found.mean()), times[1] - times[0], times[2] - times[1],
                  solver.stats()['success'])
