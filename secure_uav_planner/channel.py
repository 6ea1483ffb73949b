"""
Gains and rates: the paper's formulas, evaluation only.

Positions are (U, N+2, 2) in m and powers (U, N) in W throughout, as in Plan, for any N; gains are
divided by the noise power, so they are SNRs per watt.
"""

import numpy as np


def ground_gains(scenario, positions):
    """Return g_i[n] over sigma^2 from every UAV to the ground node, (U, N) in 1/W."""
    offset = positions[:, 1:-1] - np.array(scenario.ground_node)
    return scenario.reference_snr / (np.sum(offset**2, axis=-1) + _squared_altitudes(scenario))


def guaranteed_gains(scenario, positions):
    """
    Return the gains to each eavesdropper that the guarantee counts with, (E, U, N) in 1/W.

    The best case for the transmitter and the worst case for each jammer, taken separately over
    the disc: h-tilde of equation (r_e_approx), with the distance [d - eps]^+ inside the disc.
    """
    centres = np.array([eve.position for eve in scenario.eavesdroppers])[:, None, None]
    radius = np.array([eve.error_radius for eve in scenario.eavesdroppers])[:, None]
    distance = np.linalg.norm(positions[None, :, 1:-1] - centres, axis=-1)
    distance[:, 0] = np.maximum(distance[:, 0] - radius, 0.0)
    distance[:, 1:] += radius[:, None]
    return scenario.reference_snr / (distance**2 + _squared_altitudes(scenario))


def ground_rates(scenario, positions, powers):
    """Return r_0[n], equation (R_UG), (N,) in bit/s/Hz."""
    return _rates(ground_gains(scenario, positions), powers)


def guaranteed_rates(scenario, positions, powers):
    """
    Return R-bar[n] of problem (P2), (N,) in bit/s/Hz, negative where the leak is larger.

    A lower bound of worst_case_rates; equal to it when every error radius is zero.
    """
    leak = _rates(guaranteed_gains(scenario, positions), powers).max(axis=0)
    return ground_rates(scenario, positions, powers) - leak


def worst_case_rates(scenario, positions, powers):
    """
    Return r_0[n] less the largest leak to any one point of any disc, (N,) in bit/s/Hz.

    This is R[n] of problem (P1), equation (R_sec), before its [x]^+. The leak is searched on the
    disc and refined until the rate is exact to about 1e-6.
    """
    leak, _ = _worst_leak(scenario, positions[:, 1:-1], powers)
    return ground_rates(scenario, positions, powers) - leak


def worst_case_places(scenario, positions, powers):
    """Return where in the discs the leak of each slot is largest, (N, 2) in m."""
    _, places = _worst_leak(scenario, positions[:, 1:-1], powers)
    return places


def secrecy_rates(scenario, positions, powers, eavesdropper):
    """
    Return r_0[n] - r_e[n] for an eavesdropper whose place is known, (N,) in bit/s/Hz.

    :param eavesdropper: its true place, (2,) or one for each slot, (N, 2), in m.
    """
    places = np.broadcast_to(np.asarray(eavesdropper, float), (powers.shape[1], 2))
    leak = _leak_at(scenario, positions[:, 1:-1], powers, places[:, None])[:, 0]
    return ground_rates(scenario, positions, powers) - leak


def _squared_altitudes(scenario):
    return np.array([uav.altitude for uav in scenario.uavs])[:, None] ** 2


def _rates(gains, powers):
    """Return log2(1 + S / (1 + J)) for gains (..., U, N), as accurate for a small S."""
    received = gains * powers
    return np.log1p(received[..., 0, :] / (1.0 + received[..., 1:, :].sum(axis=-2))) / np.log(2.0)


def _leak_at(scenario, places_of_uavs, powers, points):
    """Return r_e at points (N, K, 2) on the ground for UAVs at (U, N, 2), (N, K)."""
    offset = places_of_uavs[:, :, None] - points
    gains = scenario.reference_snr / (
        np.sum(offset**2, axis=-1) + _squared_altitudes(scenario)[..., None])
    received = gains * powers[..., None]
    return np.log1p(received[0] / (1.0 + received[1:].sum(axis=0))) / np.log(2.0)


# The search for the worst place: a polar grid and every UAV's nearest and farthest place in the
# disc, then a compass search from the best few, whose step halves until it no longer matters.
_RINGS, _RAYS, _STARTS, _HALVINGS, _CHUNK = 12, 48, 4, 44, 256
_COMPASS = np.stack([np.cos(np.arange(8) * np.pi / 4), np.sin(np.arange(8) * np.pi / 4)], axis=-1)


def _worst_leak(scenario, places_of_uavs, powers):
    """Return the largest r_e over all discs for every slot, (N,), and where it is, (N, 2)."""
    found = []
    for first in range(0, powers.shape[1], _CHUNK):
        chunk = slice(first, first + _CHUNK)
        leaks, places = zip(*(
            _worst_leak_in_disc(scenario, eve, places_of_uavs[:, chunk], powers[:, chunk])
            for eve in scenario.eavesdroppers))
        worst = np.argmax(leaks, axis=0), np.arange(len(leaks[0]))
        found.append((np.array(leaks)[worst], np.array(places)[worst]))
    leaks, places = zip(*found)
    return np.concatenate(leaks), np.concatenate(places)


def _worst_leak_in_disc(scenario, eve, places_of_uavs, powers):
    centre, radius = np.array(eve.position), eve.error_radius
    if radius == 0.0:
        points = np.broadcast_to(centre, (powers.shape[1], 1, 2))
        return _leak_at(scenario, places_of_uavs, powers, points)[:, 0], points[:, 0]

    def into_disc(points):
        offset = points - centre
        distance = np.linalg.norm(offset, axis=-1, keepdims=True)
        return centre + offset * np.minimum(1.0, radius / np.maximum(distance, 1e-300))

    offset = np.swapaxes(places_of_uavs, 0, 1) - centre
    direction = offset / np.maximum(np.linalg.norm(offset, axis=-1, keepdims=True), 1e-300)
    angles = np.arange(_RAYS) * 2 * np.pi / _RAYS
    ray = np.stack([np.cos(angles), np.sin(angles)], axis=-1)
    grid = (np.linspace(0, 1, _RINGS + 1)[1:, None, None] * ray).reshape(-1, 2)
    points = np.concatenate([
        np.broadcast_to(centre + radius * grid, (len(offset), len(grid), 2)),
        into_disc(centre + offset), centre - radius * direction], axis=1)
    leak = _leak_at(scenario, places_of_uavs, powers, points)
    best = np.argpartition(leak, -_STARTS, axis=1)[:, -_STARTS:]
    points = np.take_along_axis(points, best[..., None], axis=1)
    leak = np.take_along_axis(leak, best, axis=1)

    step = np.full(leak.shape, radius / _RINGS)
    for _ in range(_HALVINGS):
        candidates = into_disc(points[:, :, None] + step[..., None, None] * _COMPASS)
        shape = candidates.shape
        found = _leak_at(scenario, places_of_uavs, powers,
                         candidates.reshape(shape[0], -1, 2)).reshape(shape[:3])
        choice = found.argmax(axis=2)[..., None]
        value = np.take_along_axis(found, choice, axis=2)[..., 0]
        better = value > leak
        moved = np.take_along_axis(candidates, choice[..., None], axis=2)[:, :, 0]
        points = np.where(better[..., None], moved, points)
        leak = np.where(better, value, leak)
        step = np.where(better, step, step / 2)
        if step.max() < 1e-6 * radius:
            break
    worst = np.arange(len(leak)), leak.argmax(axis=1)
    return leak[worst], points[worst]
