"""
What the kernel computes, stated plainly in m and W: tests compare both.

Variables x are those of a Grid, and may be complex: `gradient` differentiates by complex steps.
"""

import numpy as np
from scipy.stats import rice
from secure_uav_planner.model.channel import guaranteed_rates, worst_case_rates
from secure_uav_planner.model.channel.rates import leakage_rates
from secure_uav_planner.model.limits import build_limits
from secure_uav_planner.model.limits.motion import NormLimit

SOFTENING = 0.3  # Rounding of the kink above an eavesdropper, in sqrt(mu); see rates.hpp.
STEP = 1e-30  # Of complex steps, which nothing cancels.
# a, b and the extra loss in dB, from Al-Hourani, Kandeepan and Lardner 2014.
ENVIRONMENTS = {'suburban': (4.88, 0.43, 21.0), 'urban': (9.61, 0.16, 20.0),
                'dense_urban': (12.08, 0.11, 23.0), 'highrise': (27.23, 0.08, 34.0)}


def snr(scenario, squared, to_ground):
    """
    Return the SNR per watt that counts, of links at squared distances (..., U) in m^2.

    :param to_ground: whether the links are those to the ground node, or to an eavesdropper.
    """
    channel, uavs = scenario.channel, len(scenario.uavs)
    snrs = 10.0**(scenario.reference_snr_db / 10) / np.exp(
        0.5 * channel.exponent * np.log(squared + scenario.altitudes**2))
    is_adverse = np.array([(uav > 0) == to_ground for uav in range(uavs)])
    links = len(scenario.eavesdroppers) + sum(2 - node.trusted for node in scenario.ground_nodes)
    share = (channel.outage or 0.0) / (uavs * links)
    if channel.los is not None and channel.rician_k_db is not None:
        share /= 2
    if channel.los is not None:
        a, b, loss = ENVIRONMENTS.get(channel.los, channel.los)
        elevation = 90 - 180 / np.pi * np.arctan(np.sqrt(squared) / scenario.altitudes)
        if share:
            helped, harmed = (a - np.log(odds / a) / b for odds in (
                share / (1 - share), (1 - share) / share))
            z = elevation - np.where(is_adverse, harmed - 1, helped)
            z = np.where(z.real > 1, 1, np.where(z.real < 0, 0, z))
            snrs = snrs / 10**(loss / 10 * (1 - 10 * z**3 + 15 * z**4 - 6 * z**5))
        else:
            sight = 1 / (1 + a * np.exp(-b * (elevation - a)))
            mean = sight + (1 - sight) / 10**(loss / 10)
            snrs = snrs * np.where(np.logical_and(is_adverse, channel.cautious), 1.0, mean)
    if channel.rician_k_db is not None:
        factor = 10**(channel.rician_k_db / 10)
        low, high = (quantile(share, np.sqrt(2 * factor))**2 / (2 * (factor + 1))
                     for quantile in (rice.ppf, rice.isf))
        snrs = snrs * np.where(is_adverse, high, low)
    return snrs


def rates(grid, x, softening=0.0, node=0):
    """
    Return r_k (..., N) of a ground node and the guarantee's leaks (..., N, E + L) in nats.

    :param x: (..., N, U, 3).
    :param softening: of the jammers' distances to discs, in units of the grid.
    :param node: k; what it is sent leaks to the E eavesdroppers and to L other nodes that listen.
    """
    times = np.arange(1, grid.slots + 1) * grid.slot_duration
    return _rates_at(grid.scenario, times, x[..., 1:] * grid.length + grid.origin,
                     x[..., 0] * grid.power, softening * grid.length, node)


def secrecy_rates(scenario, times, positions, powers):
    """
    Return r_k less the guarantee's leak of each ground node, (G, N) in bit/s/Hz.

    :param positions: at the N times, (U, N, 2) in m; powers (U, N) in W.
    """
    found = []
    for node in range(len(scenario.ground_nodes)):
        ground, leaks = _rates_at(
            scenario, times, np.swapaxes(positions, 0, 1), powers.T, 0.0, node)
        found.append(ground - combine(scenario, leaks))
    return np.array(found) / np.log(2)


def combine(scenario, leaks):
    """Return what leaks to all, of the leaks to each (..., E) in nats."""
    if scenario.colluding:
        return np.log(1 + (np.exp(leaks) - 1).sum(axis=-1))
    return leaks.max(axis=-1)


def _rates_at(scenario, times, positions, powers, softening, node):
    """Return rates() at positions (..., N, U, 2) in m, powers (..., N, U) in W."""
    points = np.zeros(len(times))
    receivers = [(place_at(scenario.ground_nodes[node], times), points, 1.0, True)] + [
        (*disc_at(eve, times), 10**(eve.receiver_advantage_db / 10), False)
        for eve in scenario.eavesdroppers] + [
        (place_at(other, times), points, 1.0, False)
        for other in scenario.ground_nodes[:node] + scenario.ground_nodes[node + 1:]
        if not other.trusted]
    ground, *leaks = (_rate(scenario, positions, powers, *receiver, softening)
                      for receiver in receivers)
    return ground, np.stack(leaks, axis=-1)


def disc_at(eve, times):
    """Return the centres (N, 2) and the radii (N,) of an eavesdropper's disc at times."""
    if eve.track is None:
        return np.tile(eve.position, (len(times), 1)), np.full(len(times), eve.error_radius)
    t, x, y, radius = np.transpose(eve.track)
    return np.transpose([np.interp(times, t, x), np.interp(times, t, y)]), np.interp(
        times, t, radius)


def place_at(node, times):
    """Return the places of a ground node at times, (N, 2)."""
    if node.track is None:
        return np.tile(node.position, (len(times), 1))
    t, x, y = np.transpose(node.track)
    return np.transpose([np.interp(times, t, x), np.interp(times, t, y)])


def _rate(scenario, positions, powers, place, radius, advantage, to_ground, softening):
    offset = positions - place[:, None]
    squared = offset[..., 0]**2 + offset[..., 1]**2
    if radius.any():
        # Inside a disc the paper's (d - eps)^2 would promise too much.
        distance = np.sqrt(squared[..., 0])
        squared[..., 0] = np.where(distance.real > radius, (distance - radius)**2, 0.0)
        rounded = np.sqrt(squared[..., 1:] + softening**2)
        squared[..., 1:] += radius[:, None] * (2 * rounded + radius[:, None])
    if not scenario.channel.is_inverse_square:  # Whose kink is rounded as well.
        squared = squared + softening**2
    received = advantage * snr(scenario, squared, to_ground) * powers
    return np.log(1 + received[..., 0] / (1 + received[..., 1:].sum(axis=-1)))


def model(barrier):
    """
    Return the model from which the next step of an InteriorPointSolver is computed.

    :return: the barrier function, (S,), its gradient, (S, N, U, 3), and the Hessian of the
        objective slot by slot, of which the lower triangles count, (S, N, 3 U, 3 U).
    """
    size = 3 * barrier.x.shape[2]
    parts = (np.empty(len(barrier.x)), np.empty_like(barrier.x),
             np.empty((*barrier.x.shape[:2], size, size)))
    barrier._core.evaluate(*parts)
    return parts


def slacks(limit, path, lines=None):
    """
    Return c of a limit of flights.

    :param path: points with start and goal in units of the limit's grid, (N+2, U, 2).
    :param lines: of a limit with lines, where they stand.
    """
    grid = limit.grid
    if isinstance(limit, NormLimit):
        positions = np.swapaxes(path, 0, 1) * grid.length + grid.origin
        differences = limit.differences(positions).swapaxes(0, 1)
        return np.where(limit.absent | grid.fixed, 1.0,
                        1 - (differences**2).sum(axis=-1) / limit.longest**2)
    return np.where(limit.ignored, 1.0, limit.slacks(path, lines))


def path_of(grid, x):
    """Return the points of x with start and goal in units, (N+2, U, 2)."""
    return np.concatenate([grid.starts[None], x[..., 1:], grid.goals[None]])


def slacks_at(grid, x, at=None):
    """
    Return c of all limits at an x (N, U, 3), each with its weight, as pairs.

    :param at: where lines were chosen, by default at x.
    """
    for limit in build_limits(grid):
        if limit.compiled is not None:
            lines = (None if isinstance(limit, NormLimit)
                     else limit.choose_lines(path_of(grid, x if at is None else at)))
            yield slacks(limit, path_of(grid, x), lines), 1.0
    peaks = grid.scenario.peak_powers / grid.power
    yield x[..., 0], 1.0
    yield 1 - x[..., 0] / peaks, 1.0
    yield 1 - x[..., 0].mean(axis=0), grid.slots


def objective(grid, x, mu, softening, node=0):
    """
    Return the largest leak, smoothed where there are several, less r_k of a ground node, (..., N).

    :param x: (..., N, U, 3).
    :param mu: in the grid's unit of rates.
    """
    ground, leaks = rates(grid, x, softening * np.sqrt(mu), node)
    mu = mu * grid.rate
    if grid.scenario.colluding and leaks.shape[-1] > 1:
        return combine(grid.scenario, leaks) - ground + mu
    if leaks.shape[-1] == 1:
        return leaks[..., 0] + mu - ground
    # The t that minimises t - mu sum log(t - leak): its own derivative does not matter.
    low = leaks.real.max(axis=-1)
    high = low + mu * leaks.shape[-1]
    for _ in range(100):
        middle = 0.5 * (low + high)
        with np.errstate(divide='ignore'):
            above = (mu / (middle[..., None] - leaks.real)).sum(axis=-1) < 1
        low, high = np.where(above, low, middle), np.where(above, middle, high)
    return high - mu * np.log((high[..., None] - leaks) / mu).sum(axis=-1) - ground


def barrier(grid, x, mu, softening, at=None):
    """Return the barrier function at an x (N, U, 3), with lines chosen at x or elsewhere."""
    value = objective(grid, x, mu, softening).sum()
    for values, weight in slacks_at(grid, x, at):
        # Negative slacks count as positive ones: the derivatives are the same.
        value -= weight * mu * grid.rate * 0.5 * np.log(values**2).sum()
    return value


def gradient(function, x):
    """Return the derivatives of a real function by every variable, shaped as x."""
    slopes = np.empty(x.shape)
    for index in np.ndindex(x.shape):
        moved = x.astype(complex)
        moved[index] += STEP * 1j
        slopes[index] = function(moved).imag / STEP
    return slopes


def hessians(function, x, step=1e-5):
    """
    Return the second derivatives of a function (N,) of x (N, U, 3) slot by slot, (N, 3 U, 3 U).

    Differences of complex steps; all slots at once, for none depends on another. Two lengths of
    step, whose errors of second order cancel (Richardson): a shorter step alone would lose more
    to rounding.
    """
    size = x.shape[1] * 3

    def slopes(at):
        return np.stack([function(at + STEP * 1j * unit).imag / STEP
                         for unit in np.eye(size).reshape(size, *x.shape[1:])], axis=-1)

    def differences(step):
        return np.stack([(slopes(x + step * unit) - slopes(x - step * unit)) / (2 * step)
                         for unit in np.eye(size).reshape(size, *x.shape[1:])], axis=-1)

    return (4 * differences(step / 2) - differences(step)) / 3


def sampled_leaks(scenario, positions, powers, worst, rng, count=300):
    """
    Return the largest leak at random places in the discs, on edges and by the worst, (N,).

    :param worst: places near which to look closely, (N, 2) in m.
    """
    leaks_by_disc = []
    times = np.arange(1, powers.shape[1] + 1) * scenario.slot_duration
    for eve, advantage in zip(scenario.eavesdroppers, scenario.receiver_advantages):
        centre, radius = (values[:, None] for values in disc_at(eve, times))
        radius = radius[..., None]
        angles = rng.uniform(0, 2 * np.pi, count)
        rays = np.stack([np.cos(angles), np.sin(angles)], axis=-1)
        inside = centre + radius * np.sqrt(rng.random((count, 1))) * rays
        near = worst[:, None] + radius * 10**rng.uniform(-8, 0, (count, 1)) * rays - centre
        distance = np.linalg.norm(near, axis=-1, keepdims=True)
        near = centre + near * np.minimum(1.0, radius / np.maximum(distance, 1e-300))
        largest = np.full(powers.shape[1], -np.inf)
        for places in (inside, centre + radius * rays, near):
            leaks = leakage_rates(scenario, positions[:, 1:-1], powers, np.broadcast_to(
                places, (powers.shape[1], count, 2)), advantage)
            largest = np.maximum(largest, leaks.max(axis=1))
        leaks_by_disc.append(largest)
    if scenario.colluding:
        return np.log2(1 + (2**np.array(leaks_by_disc) - 1).sum(axis=0))
    return np.max(leaks_by_disc, axis=0)


def check_rates(plan):
    """Assert that the history rises to the plan's rate and that no slot leaks what it receives."""
    guaranteed = plan.objective == 'guaranteed'
    history = [iteration.rate for iteration in plan.history]
    assert (np.diff(history) >= 0).all()
    # In a plan, slots of less than 1e-7 are silent.
    assert abs(history[-1] - plan.rate) <= (1e-7 if guaranteed else 5e-6)
    rates = (guaranteed_rates if guaranteed else worst_case_rates)(
        plan.scenario, plan.positions, plan.powers)
    assert rates.min() >= (-1e-12 if guaranteed else -1e-9)


def inverse_sinr(pairs, x, y):
    """Return v = (1 + J) / S at one place of each of the kernel's Pairs, (P,)."""
    loss = (x - pairs['x'])**2 + (y - pairs['y'])**2 + pairs['squared_altitudes']
    return loss[0] * (pairs['noise'] + (pairs['jamming'] / loss[1:]).sum(axis=0))
