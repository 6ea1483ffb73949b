"""
A channel of your own, tried in Python alone: no compiler, no change of the package.

Write `gain` and `slope`. The paper's mission with slots of five seconds is planned for free space,
then improved for that gain by SciPy's SLSQP. Both plans are evaluated in your channel. What is
lost against a channel of the package: the many starts, the worst case, all proofs, and speed.
"""

import numpy as np
from scipy.optimize import minimize
from secure_uav_planner import Plan, Scenario, solve

ABSORPTION = 150.0  # m, over which foliage absorbs a factor e


def gain(scenario, squared):
    """Return the gain over the noise power at squared horizontal distances (U, N) in m^2."""
    way = np.sqrt(squared + scenario.altitudes[:, None]**2)
    return scenario.reference_snr * np.exp(-way / ABSORPTION) / way**2


def slope(scenario, squared):
    """Return the derivative of the gain by the squared distance."""
    way = np.sqrt(squared + scenario.altitudes[:, None]**2)
    return -gain(scenario, squared) * (0.5 / (ABSORPTION * way) + 1 / way**2)


def evaluate(scenario, positions, powers):
    """
    Return the guaranteed rate of every slot, and its derivatives.

    :param positions: (U, N, 2) in m, the points at which something is transmitted.
    :param powers: (U, N) in W.
    :return: (N,) in bit/s/Hz, not cut at 0; derivatives by positions and by powers.
    """
    rates, by_positions, by_powers = 0.0, 0.0, 0.0
    jams = np.arange(len(powers))[:, None] > 0
    # The nearest place of the disc counts for the transmitter, the farthest for a jammer.
    edges = np.where(jams, 1.0, -1.0) * scenario.eavesdroppers[0].error_radius
    for sign, centre, edge in ((1, scenario.ground_node, np.zeros_like(edges)),
                               (-1, scenario.eavesdroppers[0].position, edges)):
        offsets = positions - centre
        distances = np.maximum(np.linalg.norm(offsets, axis=-1), 1e-9)
        shifted = np.maximum(distances + edge, 0.0)
        gains, slopes = gain(scenario, shifted**2), slope(scenario, shifted**2)
        noise = 1 + (gains * powers * jams).sum(axis=0)
        total = noise + (gains * powers)[0]
        weights = sign / np.log(2) * (1 / total - jams / noise)  # By the received power.
        rates = rates + sign * np.log2(total / noise)
        by_powers = by_powers + weights * gains
        by_positions = by_positions + (
            weights * powers * slopes * 2 * shifted / distances)[..., None] * offsets
    return rates, by_positions, by_powers


def improve(plan):
    """Return positions and powers that are better in the channel of `gain`."""
    scenario = plan.scenario
    shape = len(scenario.uavs), scenario.slots
    ends = plan.positions[:, :1], plan.positions[:, -1:]

    def unpack(values):
        split = values.reshape(*shape, 3)
        return split[..., :2] * 100, split[..., 2]  # Positions in 100 m, to be as large as W.

    def objective(values):
        rates, by_positions, by_powers = evaluate(scenario, *unpack(values))
        derivative = np.concatenate([by_positions * 100, by_powers[..., None]], axis=-1)
        return -rates.mean(), -derivative.ravel() / scenario.slots

    def slacks(values):
        positions, powers = unpack(values)
        moves = np.diff(np.concatenate([ends[0], positions, ends[1]], axis=1), axis=1)
        longest = scenario.max_step[:, None]
        # SLSQP may break limits by 1e-6.
        return np.concatenate([(1 - (moves**2).sum(axis=-1) / longest**2).ravel(),
                               scenario.average_powers - powers.mean(axis=1)]) - 2e-6

    start = np.concatenate([plan.positions[:, 1:-1] / 100, plan.powers[..., None]], axis=-1)
    bounds = [bound for peak in scenario.peak_powers for _ in range(scenario.slots)
              for bound in ((None, None), (None, None), (0.0, peak))]
    result = minimize(objective, start.ravel(), jac=True, method='SLSQP', bounds=bounds,
                      constraints={'type': 'ineq', 'fun': slacks}, options={'maxiter': 200})
    positions, powers = unpack(result.x)
    return np.concatenate([ends[0], positions, ends[1]], axis=1), powers


def mean_rate(scenario, positions, powers):
    """Return the guaranteed rate in the channel of `gain`; slots that lose count as 0."""
    return np.maximum(evaluate(scenario, positions[:, 1:-1], powers)[0], 0.0).mean()


if __name__ == '__main__':
    mission = Scenario.paper(duration=120.0, slots=24)
    free_space = solve(mission, objective='guaranteed')
    positions, powers = improve(free_space)
    Plan(mission, positions, powers)  # It checks every limit of the mission.
    for name, flight in (('planned for free space', (free_space.positions, free_space.powers)),
                         ('planned for this channel', (positions, powers))):
        print(f'{name}: {mean_rate(mission, *flight):.4f} bit/s/Hz')
