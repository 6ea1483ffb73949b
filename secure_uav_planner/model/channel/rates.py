"""The rates of a plan, by the plain formulas: what every published number comes from."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from .links import FreeSpace, guaranteed_squared_distance, make_link
from ...mission.fields import check_argument, find_range
from ...mission.scenario import Array, Eavesdropper, Scenario
from ...mission.tracks import ReceiverPlaces
from ...mission.validation import checked_array, checked_kind


def find_receivers(scenario: Scenario, slots: int, times: Array | None = None) -> ReceiverPlaces:
    """Return the ReceiverPlaces at times (N,) in s, by default at the points of N slots."""
    if times is None and slots == scenario.slots:
        return scenario.receivers
    return scenario.receivers_at(
        np.arange(1.0, slots + 1) * scenario.slot_duration if times is None else
        checked_array('times', times, (slots,)))


def ground_squared_distances(scenario: Scenario, positions: Array) -> Array:
    """Return the squared horizontal distances to the first ground node, (U, N) in m^2."""
    receivers = find_receivers(scenario, positions.shape[1] - 2)
    return _squared_norm(positions[:, 1:-1] - receivers.ground_nodes[0])


def guaranteed_squared_distances(scenario: Scenario, positions: Array) -> Array:
    """
    Return the squared distances to each eavesdropper that the guarantee uses, (E, U, N) in m^2.

    The best case for the transmitter and the worst case for each jammer, taken separately over
    the disc: those of h-tilde in equation (9), with [d - eps]^+ inside the disc.
    """
    receivers = find_receivers(scenario, positions.shape[1] - 2)
    return np.stack([_bound_squared_distances(positions[:, 1:-1] - centres, radii)
                     for centres, radii in zip(receivers.centres, receivers.radii, strict=True)])


def ground_gains(scenario: Scenario, positions: Array) -> Array:
    """Return g_i[n] over sigma^2 from every UAV to the ground node, (U, N) in 1/W."""
    return make_link(scenario, 'ground_node').gain(ground_squared_distances(scenario, positions))


def guaranteed_gains(scenario: Scenario, positions: Array) -> Array:
    """Return the gains at guaranteed_squared_distances, h-tilde / sigma^2, (E, U, N) in 1/W."""
    link = make_link(scenario, 'eavesdropper').for_receivers(
        scenario.receiver_advantages[:, None, None])
    return link.gain(guaranteed_squared_distances(scenario, positions))


def ground_rates(scenario: Scenario, positions: Array, powers: Array,
                 times: Array | None = None) -> Array:
    """
    Return r_0[n], equation (4), (N,) in bit/s/Hz, the largest of several ground nodes.

    :param times: as for guaranteed_rates.
    """
    return np.asarray(node_ground_rates(scenario, positions, powers, times).max(axis=0))


def node_ground_rates(scenario: Scenario, positions: Array, powers: Array,
                      times: Array | None = None) -> Array:
    """Return r_k[n] of each ground node, (G, N) in bit/s/Hz."""
    positions, powers = checked_flight(scenario, positions, powers)
    nodes = find_receivers(scenario, powers.shape[1], times).ground_nodes
    return _compute_node_rates(make_link(scenario, 'ground_node'), nodes, positions, powers)


def _compute_node_rates(link: FreeSpace, nodes: Array, positions: Array, powers: Array) -> Array:
    """Return the rates (G, N) of a link to ground nodes, (G, N, 2) in m."""
    return np.stack([compute_rate(link.gain(_squared_norm(positions[:, 1:-1] - node)) * powers)
                     for node in nodes])


def guaranteed_rates(scenario: Scenario, positions: Array, powers: Array,
                     altitudes: Array | None = None, times: Array | None = None) -> Array:
    """
    Return R-bar[n] of problem (P2), (N,) in bit/s/Hz, negative where the leak is larger.

    Of several ground nodes it is that of the node with the largest. A Plan counts [R-bar]^+, for
    in such a slot nothing secret need be sent. A lower bound of worst_case_rates; equal to it when
    every error radius is zero.

    :param altitudes: flown altitudes, (U, N) in m, instead of the scenario's.
    :param times: in s from point 0, (N,), at which receivers are where their tracks say; by
        default those of the points of the slots.
    """
    return np.asarray(
        guaranteed_node_rates(scenario, positions, powers, altitudes, times).max(axis=0))


def guaranteed_node_rates(scenario: Scenario, positions: Array, powers: Array,
                          altitudes: Array | None = None, times: Array | None = None) -> Array:
    """Return R-bar[n] of each ground node, (G, N) in bit/s/Hz; see guaranteed_rates."""
    positions, powers = checked_flight(scenario, positions, powers)
    # One eavesdropper after the other: arrays over all of them would not fit into the caches.
    sinr = np.full(powers.shape[1], 0.0 if scenario.colluding else -np.inf)
    combine = np.add if scenario.colluding else np.maximum
    if altitudes is not None:
        altitudes = checked_array('altitudes', altitudes, powers.shape)
    link = make_link(scenario, 'eavesdropper', altitudes=altitudes)
    receivers = find_receivers(scenario, powers.shape[1], times)
    for centres, radii, advantage in zip(
            receivers.centres, receivers.radii, scenario.receiver_advantages.tolist(),
            strict=True):
        combine(sinr, bound_sinrs(
            link.for_receivers(advantage), positions[:, 1:-1] - centres, radii, powers), out=sinr)
    return _subtract_leak(scenario, receivers.ground_nodes, positions, powers, convert_sinr(sinr),
                          altitudes)


def find_node_rates(scenario: Scenario, positions: Array, powers: Array, leak: Array,
                    times: Array | None = None) -> Array:
    """
    Return r_k[n] less the leak to eavesdroppers, (N,), and to nodes that listen, (G, N).

    :param times: as for guaranteed_rates.
    """
    positions, powers = checked_flight(scenario, positions, powers)
    nodes = find_receivers(scenario, powers.shape[1], times).ground_nodes
    return _subtract_leak(scenario, nodes, positions, powers, leak)


def _subtract_leak(scenario: Scenario, nodes: Array, positions: Array, powers: Array, leak: Array,
                   altitudes: Array | None = None) -> Array:
    """Return find_node_rates for places (G, N, 2) of the ground nodes in m."""
    if scenario.listeners:
        leak = include_listeners(scenario, leak, _compute_node_rates(
            make_link(scenario, 'eavesdropper', altitudes=altitudes),
            nodes[list(scenario.listeners)], positions, powers))
    return _compute_node_rates(
        make_link(scenario, 'ground_node', altitudes=altitudes), nodes, positions, powers) - leak


def include_listeners(scenario: Scenario, leak: Array, heard: Sequence[Array] | Array,
                      unit: float = 1.0) -> Array:
    """
    Return the leak of what each ground node is sent, (G, N), or (N,) where all are trusted.

    :param leak: to the eavesdroppers, (N,).
    :param heard: the rates at which listeners hear, (L, N).
    :param unit: of all rates, in bit/s/Hz.
    """
    if not scenario.listeners:
        return leak
    first, *rest = np.broadcast_arrays(leak, *heard)
    leaks = [np.stack([first, *(rates for listener, rates in zip(scenario.listeners, rest)
                                if listener != node)], axis=-1)
             for node in range(len(scenario.ground_nodes))]
    return np.stack([combine_leaks(unit * rates) / unit if scenario.colluding else
                     rates.max(axis=-1) for rates in leaks])


def secrecy_rates(scenario: Scenario, positions: Array, powers: Array,
                  eavesdropper: ArrayLike, receiver_advantage_db: float | None = None,
                  times: Array | None = None) -> Array:
    """
    Return r_0[n] - r_e[n] for an eavesdropper whose place is known, (N,) in bit/s/Hz.

    Of several ground nodes it is that of the node with the largest.

    :param eavesdropper: its true place, (2,) or one for each slot, (N, 2), in m.
    :param receiver_advantage_db: of its receiver; by default the largest that an eavesdropper of
        the scenario has.
    :param times: as for guaranteed_rates.
    """
    return np.asarray(secrecy_node_rates(
        scenario, positions, powers, eavesdropper, receiver_advantage_db, times).max(axis=0))


def secrecy_node_rates(scenario: Scenario, positions: Array, powers: Array,
                       eavesdropper: ArrayLike, receiver_advantage_db: float | None = None,
                       times: Array | None = None) -> Array:
    """Return r_k[n] less the leak of each ground node, (G, N); see secrecy_rates."""
    positions, powers = checked_flight(scenario, positions, powers)
    shape = (powers.shape[1], 2)
    places = np.broadcast_to(checked_array('eavesdropper', eavesdropper, (2,), shape), shape)
    if receiver_advantage_db is None:
        advantage = float(scenario.receiver_advantages.max())
    else:
        advantage = 10.0 ** (check_argument(
            'receiver_advantage_db', receiver_advantage_db,
            find_range(Eavesdropper, 'receiver_advantage_db')) / 10.0)
    leak = leakage_rates(scenario, positions[:, 1:-1], powers, places[:, None], advantage)[:, 0]
    return find_node_rates(scenario, positions, powers, leak, times)


def find_rate_scale(scenario: Scenario) -> float:
    """
    Return 1, or where that is less, the largest SNR that the average power can have, in nats.

    Tolerances of rates are relative to it. It is that at the least distance from the ground node
    at which the transmitter can be at the time of a point.
    """
    times, grounds = scenario.times[1:-1], scenario.receivers.ground_nodes
    speed = scenario.max_speeds[0]
    away = max(0.0, float(np.min(np.maximum(
        np.linalg.norm(grounds - scenario.starts[0], axis=-1) - speed * times,
        np.linalg.norm(grounds - scenario.goals[0], axis=-1)
        - speed * (scenario.times[-1] - times)))))
    gains = make_link(scenario, 'ground_node').gain(np.full((len(scenario.uavs), 1), away**2))
    return min(1.0, float(gains[0, 0] * scenario.average_powers[0]))


def checked_flight(scenario: Scenario, positions: Array, powers: Array) -> tuple[Array, Array]:
    """Return positions and powers as arrays, or raise OptionError unless they fit a Scenario."""
    count = len(checked_kind('scenario', scenario, Scenario).uavs)
    powers = checked_array('powers', powers, (count, None))
    return checked_array('positions', positions, (count, powers.shape[1] + 2, 2)), powers


def leakage_rates(scenario: Scenario, uav_positions: Array, powers: Array,
                  places: Array, advantage: float) -> Array:
    """
    Return r_e at places (N, K, 2) in m on the ground, (N, K) in bit/s/Hz.

    :param uav_positions: (U, N, 2) in m.
    :param advantage: by what factor the SNR of the receivers is larger than the ground node's.
    """
    offset = uav_positions[:, :, None] - places
    link = make_link(scenario, 'eavesdropper', axes=2).for_receivers(advantage)
    gains = link.gain(_squared_norm(offset))
    return compute_rate(gains * powers[..., None])


def compute_rate(received: Array) -> Array:
    """
    Return log2(1 + S / (1 + J)), (...) in bit/s/Hz, as accurate for a small S.

    :param received: powers over the noise power, the transmitter's S first, then those of the
        jammers, whose sum is J; (U, ...).
    """
    return convert_sinr(compute_sinr(received))


def convert_sinr(sinr: Array) -> Array:
    """Return the rate log2(1 + SINR) in bit/s/Hz."""
    return np.log1p(sinr) / np.log(2.0)


def compute_sinr(received: Array) -> Array:
    """Return S / (1 + J) of powers as in compute_rate, (...)."""
    return received[0] / (1.0 + received[1:].sum(axis=0))


def combine_leaks(leaks: Array) -> Array:
    """Return log2(1 + sum of the SINRs), (N,), of leaks (N, E) to colluding eavesdroppers."""
    return convert_sinr(np.expm1(leaks * np.log(2.0)).sum(axis=1))


def bound_sinrs(link: FreeSpace, offsets: Array, radii: Array, powers: Array) -> Array:
    """Bound the SINRs (...) in discs, whose centres UAVs have offsets (U, ..., 2) in m from."""
    return compute_sinr(link.gain(_bound_squared_distances(offsets, radii)) * powers)


def _bound_squared_distances(offsets: Array, radii: Array) -> Array:
    """Return the least of the transmitter, and the largest of jammers, to discs, (U, ...)."""
    edge = np.repeat(radii[None], len(offsets), axis=0)
    edge[0] *= -1
    return guaranteed_squared_distance(_squared_norm(offsets), edge)


def _squared_norm(offset: Array) -> Array:
    return offset[..., 0]**2 + offset[..., 1]**2


def find_least_rate(scenario: Scenario, means: Array, unit: float = 1.0) -> float:
    """
    Return the least of the ground nodes' means (G,), with their head starts, over weight.

    :param unit: of the means, in bit/s/Hz.
    """
    return float(((means + scenario.node_offsets / unit) / scenario.node_weights).min())


def find_head_starts(scenario: Scenario, delivered: Array) -> tuple[float, ...]:
    """Return the head_starts after more has been delivered to the ground nodes, (G,) in bit/Hz."""
    total, weights = delivered + scenario.duration * scenario.node_offsets, scenario.node_weights
    return tuple(np.maximum(total - weights * (total / weights).min(), 0.0).tolist())
