"""
Differences between the world and a plan's assumptions, and their random draws slot by slot.

Every kind of draw has a stream of its own, a PCG64 whose seed sequence is spawned from one seed:
no kind depends on which other kinds are drawn. NumPy promises the bits of PCG64 for ever, and
`Generator.random` and `Generator.standard_normal` within a version only. Both have not changed
from NumPy 1.26 to the newest, which a test pins.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from functools import partial
import math
from typing import Any

import numpy as np

from ..errors import describe_class, OptionError, quote
from ..mission import LOCATION_MODELS, LocationModel
from ..mission.fields import (
    Block, check_items, Checked, checked_by, checked_point, Choice, FieldChecks, number, Point,
    read_object, refuse)
from ..mission.propagation import Channel
from ..mission.scenario import Array, Scenario

CONFIDENCE = 0.95
"""Probability that a normal place without a covariance is in the disc, as in the planner."""

_PLACES, _SIGHT, _FADING, _TRACKING = range(4)  # Kinds of draws, each with its own stream.


def _checked_pairs(value: Any, count: int | None = None) -> tuple[Point, ...]:
    """Return a list of pairs of numbers as tuples; refuse an empty one, or one not of `count`."""
    if not isinstance(value, (tuple, list, np.ndarray)) or not 0 < len(value) or (
            count and len(value) != count):
        raise refuse(value, f'a list of {f"{count} " if count else ""}pairs')
    return check_items(value, checked_point)


@dataclass(frozen=True)
class World(Checked):
    """
    How the world may differ from what a plan was made for; by default only within its promise.

    Every eavesdropper stays at one place, or at one offset from its track, for the whole mission.

    :param place: 'disc', uniformly in the disc of each eavesdropper; 'normal', around its centre;
        'beyond', uniformly in the ring around the disc; 'fixed', at `positions`.
    :param covariance: covariance of a 'normal' place, ((xx, xy), (xy, yy)) in m^2. By default it
        is round, and the place is in the disc with the probability CONFIDENCE.
    :param beyond: width of the ring in m.
    :param positions: 'fixed' place (x, y) in m of each eavesdropper; by default the centres.
    :param channel: a Channel instead of the scenario's.
    :param los_distance: distance in m flown by a UAV between draws of the lines of sight of its
        links; 0 draws them in each slot, None takes the mean gain instead. Used only if the
        channel has a probability of line of sight. The default is the correlation distance of
        urban cells in 3GPP TR 38.901, table 7.6.3.1-2.
    :param speed_factor: speed of the eavesdroppers relative to their planned tracks: with 1.2,
        they are 20% faster.
    :param receiver_db: further SNR advantage of every eavesdropper's receiver in dB, beyond the
        scenario's receiver_advantage_db.
    :param tracking_std: standard deviation in m, in x and in y, of the UAVs around their plan.
    :param tracking_time: time in s after which the correlation of tracking errors has fallen to
        1/e.
    :raises OptionError: naming the field, its value and what is allowed.
    """

    place: LocationModel = field(default='disc', metadata=checked_by(Choice(LOCATION_MODELS)))
    covariance: tuple[Point, Point] | None = field(
        default=None, metadata=checked_by(partial(_checked_pairs, count=2), 'm^2'))
    beyond: float = field(default=0.0, metadata=number(0.0, 1e6, 'm'))
    positions: tuple[Point, ...] | None = field(
        default=None, metadata=checked_by(_checked_pairs, 'm'))
    channel: Channel | None = field(default=None, metadata=checked_by(Block(Channel)))
    los_distance: float | None = field(default=50.0, metadata=number(0.0, 1e6, 'm'))
    speed_factor: float = field(default=1.0, metadata=number(0.0, 100.0))
    receiver_db: float = field(default=0.0, metadata=number(-100.0, 100.0, 'dB'))
    tracking_std: float = field(default=0.0, metadata=number(0.0, 1e4, 'm'))
    tracking_time: float = field(default=2.0, metadata=number(0.0, 1e6, 's'))

    _ERROR = OptionError

    @staticmethod
    def _check_together(checks: FieldChecks) -> None:
        """Check that beyond, positions and covariance come with their place and are right."""
        item = checks.item
        for name, place in (('beyond', 'beyond'), ('positions', 'fixed'),
                            ('covariance', 'normal')):
            value = getattr(item, name)
            if checks.are_right(name, 'place') and value and item.place != place:
                checks.add(name, f'is {quote(value)} and place is {item.place!r}; it counts only '
                           f'with the place {place!r}')
        if item.place == 'beyond' and not item.beyond:
            checks.add('beyond', "is 0.0; with the place 'beyond' it must be above 0 m")
        if item.covariance is not None and checks.are_right('covariance'):
            (xx, xy), (yx, yy) = item.covariance
            if xy != yx or min(xx, yy) < 0 or xy**2 > xx * yy:
                checks.add('covariance', f'is {quote(item.covariance)}; it must be symmetric and '
                           'positive semidefinite')

    def deviations(self, radius: float) -> Array:
        """
        Return B, (2, 2) in m, such that B z is a normal place's offset for standard normal z.

        B B^T is the covariance. Without one, B is round, and the disc of `radius` [m] holds the
        place with probability CONFIDENCE.
        """
        if self.covariance is None:
            return np.eye(2) * (radius / math.sqrt(-2.0 * math.log1p(-CONFIDENCE)))
        variances, axes = np.linalg.eigh(np.array(self.covariance))
        return axes * np.sqrt(np.maximum(variances, 0.0))

    @classmethod
    def from_dict(cls, data: Any) -> 'World':
        """
        Return a World of plain values, as in a campaign file; missing fields take their defaults.

        :raises OptionError: for an unknown field or a wrong value.
        """
        return read_object(cls, data, describe_class(cls))  # type: ignore[no-any-return]


def make_stream(seed: int, kind: int) -> np.random.Generator:
    """Return the random numbers of one kind of draw."""
    return np.random.Generator(np.random.PCG64(np.random.SeedSequence(seed, spawn_key=(kind,))))


def draw_places(scenario: Scenario, world: World, draws: int, seed: int) -> Iterator[Array]:
    """
    Yield the places of the eavesdroppers in each slot, (E, D, 2) in m.

    In a draw, an eavesdropper keeps the random numbers of its offset from its centre in all slots.
    Centres are world.positions, or on the tracks at speed_factor times the slot's time. Radii are
    the tracks' at the slot's time.
    """
    rng, shape = make_stream(seed, _PLACES), (draws, len(scenario.eavesdroppers), 2)
    laws: dict[str, Callable[..., Array]] = {'normal': rng.standard_normal, 'fixed': np.zeros}
    numbers = laws.get(world.place, rng.random)(shape)
    centres = scenario.receivers_at(world.speed_factor * scenario.times[1:-1]).centres
    if world.positions is not None:
        centres = np.broadcast_to(np.array(world.positions)[:, None], centres.shape)  # (E, N, 2)
    last_radii = None
    for centre, radii in zip(
            centres.swapaxes(0, 1), scenario.receivers.radii.T, strict=True):
        if last_radii is None or not np.array_equal(radii, last_radii):
            offsets, last_radii = _scale_offsets(world, radii, numbers), radii
        yield np.moveaxis(centre + offsets, 1, 0)


def _scale_offsets(world: World, radii: Array, numbers: Array) -> Array:
    """
    Return the offsets of eavesdroppers from the centres of their discs, (D, E, 2) in m.

    A 'normal' place takes standard normal numbers. For a 'fixed' place, numbers and offsets are 0.
    Otherwise numbers are (share, turn) in [0, 1): the angle is 2 pi turn, and the place is uniform
    by area from radius 0 to `radii`, or for 'beyond' from `radii` to `radii` + world.beyond.

    :param radii: radii of the discs, (E,) in m.
    :param numbers: random numbers, (D, E, 2).
    """
    if world.place == 'normal':
        roots = np.stack([world.deviations(radius) for radius in radii.tolist()])
        return np.einsum('eij,dej->dei', roots, numbers)
    inner = radii if world.place == 'beyond' else np.zeros_like(radii)
    share, turn = np.moveaxis(numbers, -1, 0)
    distance = np.sqrt(inner**2 + share * ((radii + world.beyond)**2 - inner**2))
    angle = 2 * np.pi * turn
    return np.asarray(distance[..., None] * np.stack([np.cos(angle), np.sin(angle)], axis=-1))


def draw_tracking_errors(scenario: Scenario, world: World, draws: int,
                         seed: int) -> Iterator[Array]:
    """
    Yield the offsets of the UAVs from their plan in each slot, (U, D, 2) in m, without end.

    The offsets are a stationary Gauss-Markov process, x[n+1] = c x[n] + s sqrt(1 - c^2) w[n], with
    c = exp(-slot / tracking_time), s = tracking_std and w standard normal, in x and in y. For a
    tracking_time of 0, c is 0.
    """
    rng, shape = make_stream(seed, _TRACKING), (len(scenario.uavs), draws, 2)
    step, decay = scenario.slot_duration, world.tracking_time
    correlation = math.exp(-step / decay) if decay else 0.0
    offsets = world.tracking_std * rng.standard_normal(shape)
    while True:
        yield offsets
        offsets = correlation * offsets + world.tracking_std * math.sqrt(1 - correlation**2) * (
            rng.standard_normal(shape))


def draw_sights(scenario: Scenario, positions: Array, distance: float, draws: int,
                seed: int) -> Iterator[Array]:
    """
    Yield a uniform number for each link in each slot, (U, G + E, D); ground nodes come first.

    A link has a line of sight if its number is below the probability. All links of a UAV get new
    numbers in the slot in which its way from point 1 passes a multiple of `distance`.

    :param positions: positions of the UAVs at the points 1..N, (U, N, 2) in m.
    :param distance: way in m between new numbers; 0 for new numbers in each slot.
    :param draws: D, the number of independent draws.
    """
    rng = make_stream(seed, _SIGHT)
    receivers = len(scenario.ground_nodes) + len(scenario.eavesdroppers)
    shape = len(positions), receivers, draws
    numbers = rng.random(shape)
    yield numbers
    distances = np.cumsum(np.linalg.norm(np.diff(positions, axis=1), axis=-1), axis=1)
    stretches = np.floor(distances / distance) if distance else np.broadcast_to(
        np.arange(distances.shape[1]) + 1.0, distances.shape)
    changes = np.diff(stretches, axis=1, prepend=0.0) > 0
    for changed in changes.T:  # Whether each UAV begins a stretch of `distance` in the next slot.
        numbers = numbers.copy()
        numbers[changed] = rng.random((np.count_nonzero(changed), *shape[1:]))
        yield numbers


def draw_fading(rician_k_db: float, links: tuple[int, int], draws: int,
                seed: int) -> Iterator[Array]:
    """
    Yield |h|^2 of Rician fading for each link in each slot, (U, G + E, D), without end.

    The mean is 1: a constant path has K / (K + 1) of the power, and a normal path has the rest.
    """
    rng, factor = make_stream(seed, _FADING), 10.0 ** (rician_k_db / 10.0)
    scale = math.sqrt(0.5 / (factor + 1.0))
    while True:
        parts = rng.standard_normal((2, *links, draws))
        parts *= scale
        parts[0] += math.sqrt(factor / (factor + 1.0))
        np.square(parts, out=parts)
        yield parts[0] + parts[1]
