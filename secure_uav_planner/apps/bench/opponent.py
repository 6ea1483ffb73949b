"""Problem (P2) in CasADi: what the comparisons with IPOPT and with FATROP share."""

from dataclasses import dataclass

import numpy as np

from ...model.limits import repaired
from ...optimize.feasible import without_losing_slots

UNIT = 100.0  # m


@dataclass(frozen=True)
class Answer:
    """
    The result of another solver.

    :param rate: the guaranteed rate in bit/s/Hz, after the answer was made feasible and the
        transmitter was switched off in slots with a negative rate.
    :param build_time: the time to build expressions, derivatives and the solver object, in s.
    :param solve_time: the time of the solver's call alone, in s.
    :param iterations: the solver's number of iterations.
    :param status: the solver's return status.
    """

    rate: float
    build_time: float
    solve_time: float
    iterations: int
    status: str


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


def has_fatrop():
    """Return whether CasADi is there and brings FATROP, which finds the stages by itself."""
    try:
        casadi = imported_casadi()
    except ImportError:
        return False
    version = tuple(int(part) for part in casadi.__version__.split('.')[:2])
    return version >= (3, 7) and casadi.has_nlpsol('fatrop')


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


def largest_leaks(scenario, positions, powers):
    """Return the largest leak of every slot at a start, where an epigraph begins, in nats."""
    ca = imported_casadi()
    inner = ca.DM(positions[:, 1:-1, 0].T / UNIT), ca.DM(positions[:, 1:-1, 1].T / UNIT)
    symbols = [ca.SX.sym(name, *powers.T.shape) for name in 'xyp']
    leaks = ca.Function('leaks', symbols, [ca.horzcat(*rate_expressions(scenario, *symbols)[1])])
    return np.array(leaks(*inner, ca.DM(powers.T))).max(axis=1)


def judged(scenario, path, powers, times, stats):
    """
    Return the Answer that a solver's iterate is.

    :param path: positions found, (U, N+2, 2) in m.
    :param powers: powers found, (U, N) in W.
    :param times: readings of the clock before the problem was built, before and after the call.
    :param stats: CasADi's statistics of the call.
    """
    path, powers = repaired(scenario, path, powers)
    _, found = without_losing_slots(scenario, path, powers)
    return Answer(float(found.mean()), times[1] - times[0], times[2] - times[1],
                  int(stats['iter_count']), str(stats['return_status']))
