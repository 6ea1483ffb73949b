"""The worst case: the place in the discs where the leak is largest, searched for in every slot."""

import numpy as np

from .rates import ground_rates, leakage_rates
from ..scenario import Array, Eavesdropper, Scenario

# The search for the worst place: a polar grid and every UAV's nearest and farthest place in the
# disc, then a compass search from the best few, whose step halves until it no longer matters.
_RINGS, _RAYS, _STARTS, _HALVINGS, _CHUNK = 12, 48, 4, 44, 256
_COMPASS = np.stack([np.cos(np.arange(8) * np.pi / 4), np.sin(np.arange(8) * np.pi / 4)], axis=-1)


def worst_case_rates(scenario: Scenario, positions: Array, powers: Array) -> Array:
    """
    Return r_0[n] less the largest leak to any one point of any disc, (N,) in bit/s/Hz.

    This is R[n] of problem (P1), equation (R_sec), before its [x]^+. The leak is searched on the
    disc and refined until the rate is exact to about 1e-6.
    """
    leak, _ = _worst_leak(scenario, positions[:, 1:-1], powers)
    return ground_rates(scenario, positions, powers) - leak


def worst_case_places(scenario: Scenario, positions: Array, powers: Array) -> Array:
    """Return where in the discs the leak of each slot is largest, (N, 2) in m."""
    _, places = _worst_leak(scenario, positions[:, 1:-1], powers)
    return places


def _worst_leak(scenario: Scenario, uav_positions: Array,
                powers: Array) -> tuple[Array, Array]:
    """Return the largest r_e over all discs for every slot, (N,), and where it is, (N, 2)."""
    found = []
    for first in range(0, powers.shape[1], _CHUNK):
        chunk = slice(first, first + _CHUNK)
        leaks, places = zip(*(
            _worst_leak_in_disc(scenario, eve, uav_positions[:, chunk], powers[:, chunk])
            for eve in scenario.eavesdroppers))
        worst = np.argmax(leaks, axis=0), np.arange(len(leaks[0]))
        found.append((np.array(leaks)[worst], np.array(places)[worst]))
    leaks, places = zip(*found)
    return np.concatenate(leaks), np.concatenate(places)


def _worst_leak_in_disc(scenario: Scenario, eve: Eavesdropper, uav_positions: Array,
                        powers: Array) -> tuple[Array, Array]:
    centre, radius = np.array(eve.position), eve.error_radius
    if radius == 0.0:
        points = np.broadcast_to(centre, (powers.shape[1], 1, 2))
        return leakage_rates(scenario, uav_positions, powers, points)[:, 0], points[:, 0]

    def into_disc(points: Array) -> Array:
        offset = points - centre
        distance = np.linalg.norm(offset, axis=-1, keepdims=True)
        inside: Array = centre + offset * np.minimum(1.0, radius / np.maximum(distance, 1e-300))
        return inside

    offset = np.swapaxes(uav_positions, 0, 1) - centre
    direction = offset / np.maximum(np.linalg.norm(offset, axis=-1, keepdims=True), 1e-300)
    angles = np.arange(_RAYS) * 2 * np.pi / _RAYS
    ray = np.stack([np.cos(angles), np.sin(angles)], axis=-1)
    grid = (np.linspace(0, 1, _RINGS + 1)[1:, None, None] * ray).reshape(-1, 2)
    points = np.concatenate([
        np.broadcast_to(centre + radius * grid, (len(offset), len(grid), 2)),
        into_disc(centre + offset), centre - radius * direction], axis=1)
    leak = leakage_rates(scenario, uav_positions, powers, points)
    best = np.argpartition(leak, -_STARTS, axis=1)[:, -_STARTS:]
    points = np.take_along_axis(points, best[..., None], axis=1)
    leak = np.take_along_axis(leak, best, axis=1)

    step = np.full(leak.shape, radius / _RINGS)
    for _ in range(_HALVINGS):
        candidates = into_disc(points[:, :, None] + step[..., None, None] * _COMPASS)
        shape = candidates.shape
        found = leakage_rates(scenario, uav_positions, powers,
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
