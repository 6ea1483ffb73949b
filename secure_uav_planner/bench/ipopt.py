"""The usual alternative, for comparison: problem (P2) in CasADi, solved by IPOPT."""

from dataclasses import dataclass
import time

import numpy as np

from ..limits import repaired
from ..optimize.feasible import without_losing_slots

_UNIT = 100.0  # m


@dataclass(frozen=True)
class Answer:
    """
    The result of IPOPT.

    :param rate: the guaranteed rate in bit/s/Hz, after the answer was made feasible and the
        transmitter was switched off in slots with a negative rate.
    :param build_time: the time to build expressions, derivatives and the solver object, in s.
    :param solve_time: the time of the solver's call alone, in s.
    :param iterations: IPOPT's number of iterations.
    :param status: IPOPT's return status.
    """

    rate: float
    build_time: float
    solve_time: float
    iterations: int
    status: str


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
    try:
        import casadi as ca
    except ImportError as error:
        raise ImportError('the comparison needs CasADi: pip install casadi') from error
    started = time.perf_counter()
    slots, uavs, eves = scenario.slots, len(scenario.uavs), scenario.eavesdroppers
    snr = scenario.reference_snr / _UNIT**2
    x, y = (ca.SX.sym(name, slots, uavs) for name in 'xy')
    p = ca.SX.sym('p', slots, uavs)

    def rate(place, radius, advantage=1.0):
        received = []
        for i, uav in enumerate(scenario.uavs):
            squared = (x[:, i] - place[0] / _UNIT)**2 + (y[:, i] - place[1] / _UNIT)**2
            if radius:
                distance = ca.sqrt(squared + 1e-8)
                edge = radius / _UNIT
                squared = (distance + edge)**2 if i else ca.fmax(distance - edge, 0)**2
            received.append(advantage * snr * p[:, i] / (squared + (uav.altitude / _UNIT)**2))
        jammed = 1 + sum(received[1:], ca.SX.zeros(slots))
        return ca.log(jammed + received[0]) - ca.log(jammed)

    leaks = [rate(eve.position, eve.error_radius, advantage)
             for eve, advantage in zip(eves, scenario.receiver_advantages)]
    steps, limits = [], []
    for i, (uav, step) in enumerate(zip(scenario.uavs, scenario.max_step)):
        start, goal = np.array(uav.start) / _UNIT, np.array(uav.goal) / _UNIT
        moves = [ca.diff(ca.vertcat(start[k], place[:, i], goal[k]))
                 for k, place in enumerate((x, y))]
        steps.append(moves[0]**2 + moves[1]**2)
        limits.append(np.full(slots + 1, (step / _UNIT)**2))
    steps += [ca.sum1(p[:, i]) / slots for i in range(uavs)]
    limits += [[uav.average_power] for uav in scenario.uavs]
    largest, extra = leaks[0], []
    inner = np.concatenate([np.swapaxes(positions[:, 1:-1] / _UNIT, 0, 2)[k].ravel('F')
                            for k in range(2)] + [powers.ravel()])
    if len(eves) > 1:
        largest = ca.SX.sym('t', slots)
        steps += [leak - largest for leak in leaks]
        limits += [np.zeros(slots)] * len(eves)
        extra = [largest]
    peak = np.repeat([uav.peak_power for uav in scenario.uavs], slots)
    variables = ca.vertcat(ca.vec(x), ca.vec(y), ca.vec(p), *extra)
    problem = {'x': variables, 'f': ca.sum1(largest - rate(scenario.ground_node, 0.0)) / slots,
               'g': ca.vertcat(*steps)}
    solver = ca.nlpsol('solver', 'ipopt', problem, {
        'print_time': False, 'ipopt.print_level': 0, 'ipopt.sb': 'yes',
        'ipopt.max_wall_time': time_limit})
    free = np.full(2 * uavs * slots, np.inf)
    slack = np.full(slots * len(extra), np.inf)
    guess = inner
    if extra:
        at_start = ca.Function('leaks', [ca.vertcat(ca.vec(x), ca.vec(y), ca.vec(p))],
                               [ca.horzcat(*leaks)])
        guess = np.concatenate([inner, np.array(at_start(inner)).max(axis=1)])
    built = time.perf_counter()
    found = solver(x0=guess, lbx=np.concatenate([-free, 0 * peak, -slack]),
                   ubx=np.concatenate([free, peak, slack]), lbg=-np.inf,
                   ubg=np.concatenate(limits))
    solved = time.perf_counter()
    values = np.array(found['x']).ravel()[:3 * uavs * slots].reshape(3, uavs, slots)
    path = positions.copy()
    path[:, 1:-1] = np.stack([values[0], values[1]], axis=-1) * _UNIT
    path, power = repaired(scenario, path, values[2])
    _, rates = without_losing_slots(scenario, path, power)
    stats = solver.stats()
    return Answer(float(rates.mean()), built - started,
                  solved - built, stats['iter_count'], stats['return_status'])
