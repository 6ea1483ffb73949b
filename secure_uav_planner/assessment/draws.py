"""
Draws of the world, slot after slot, so that memory does not grow with the slots.

Every kind of draw has a stream of its own, a PCG64 whose seed sequence is spawned from one seed:
which other kinds are drawn does not change it. NumPy promises the bits of PCG64 for good. Of
`Generator.random` and `Generator.standard_normal`, which make numbers of them, it promises the
same within a version; they have not changed from NumPy 1.26 to the newest, which a test pins.
"""

from collections.abc import Callable, Iterator
import math

import numpy as np

from .world import World
from ..mission.scenario import Array, Scenario

_PLACES, _SIGHT, _FADING, _TRACKING = range(4)


def stream(seed: int, kind: int) -> np.random.Generator:
    """Return the random numbers of one kind of draw."""
    return np.random.Generator(np.random.PCG64(np.random.SeedSequence(seed, spawn_key=(kind,))))


def places(scenario: Scenario, world: World, draws: int, seed: int) -> Iterator[Array]:
    """
    Yield the places of the eavesdroppers in each slot, (E, D, 2) in m.

    In a draw, an eavesdropper keeps its angle and its share of the radius around its track.
    """
    rng, shape = stream(seed, _PLACES), (draws, len(scenario.eavesdroppers), 2)
    laws: dict[str, Callable[..., Array]] = {'normal': rng.standard_normal, 'fixed': np.zeros}
    numbers = laws.get(world.place, rng.random)(shape)
    centres = scenario.receivers_at(world.speed_factor * scenario.times[1:-1]).centres
    if world.positions is not None:
        centres = np.broadcast_to(np.array(world.positions)[:, None], centres.shape)
    before = None
    for centre, radii in zip(
            centres.swapaxes(0, 1), scenario.receivers.radii.T, strict=True):
        if before is None or not np.array_equal(radii, before):
            offsets, before = _scale_offsets(world, radii, numbers), radii
        yield np.moveaxis(centre + offsets, 1, 0)


def _scale_offsets(world: World, radii: Array, numbers: Array) -> Array:
    """Return the offsets of drawn numbers (D, E, 2) in discs with radii (E,), likewise in m."""
    if world.place == 'normal':
        roots = np.stack([world.deviations(radius) for radius in radii.tolist()])
        return np.einsum('eij,dej->dei', roots, numbers)
    inner = radii if world.place == 'beyond' else np.zeros_like(radii)
    share, turn = np.moveaxis(numbers, -1, 0)
    distance = np.sqrt(inner**2 + share * ((radii + world.beyond)**2 - inner**2))
    angle = 2 * np.pi * turn
    return np.asarray(distance[..., None] * np.stack([np.cos(angle), np.sin(angle)], axis=-1))


def tracking_errors(scenario: Scenario, world: World, draws: int, seed: int) -> Iterator[Array]:
    """
    Yield the offsets of the UAVs from their plan in each slot, (U, D, 2) in m, without end.

    They are a stationary Gauss-Markov process: normal in x and in y, correlated over time.
    """
    rng, shape = stream(seed, _TRACKING), (len(scenario.uavs), draws, 2)
    kept = math.exp(-scenario.slot_duration / world.tracking_time) if world.tracking_time else 0.0
    offsets = world.tracking_std * rng.standard_normal(shape)
    while True:
        yield offsets
        offsets = kept * offsets + world.tracking_std * math.sqrt(1 - kept**2) * (
            rng.standard_normal(shape))


def sights(scenario: Scenario, positions: Array, distance: float, draws: int, seed: int
           ) -> Iterator[Array]:
    """
    Yield a uniform number for each link in each slot, (U, 1 + E, D).

    A link has a line of sight where its number is below the probability. The first receiver is
    the ground node. The numbers of a UAV, whose positions are (U, N, 2) in m, are kept until it
    has flown a distance in m, with 0 for one slot.
    """
    rng = stream(seed, _SIGHT)
    shape = len(positions), 1 + len(scenario.eavesdroppers), draws
    numbers = rng.random(shape)
    yield numbers
    way = np.cumsum(np.linalg.norm(np.diff(positions, axis=1), axis=-1), axis=1)
    stretch = np.floor(way / distance) if distance else np.broadcast_to(
        np.arange(way.shape[1]) + 1.0, way.shape)
    changes = np.diff(stretch, axis=1, prepend=0.0) > 0
    for changed in changes.T:
        numbers = numbers.copy()
        numbers[changed] = rng.random((np.count_nonzero(changed), *shape[1:]))
        yield numbers


def fading(rician_k_db: float, links: tuple[int, int], draws: int, seed: int) -> Iterator[Array]:
    """
    Yield |h|^2 of Rician fading for each link in each slot, (U, 1 + E, D), without end.

    Its mean is 1: a constant path with K / (K + 1) of the power, and a normal one with the rest.
    """
    rng, factor = stream(seed, _FADING), 10.0 ** (rician_k_db / 10.0)
    scale = math.sqrt(0.5 / (factor + 1.0))
    while True:
        parts = rng.standard_normal((2, *links, draws))
        parts *= scale
        parts[0] += math.sqrt(factor / (factor + 1.0))
        np.square(parts, out=parts)
        yield parts[0] + parts[1]
