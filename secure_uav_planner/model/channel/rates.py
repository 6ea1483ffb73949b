"""The rates of a plan, by the plain formulas from which every published number is computed."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from .links import FreeSpace, guaranteed_squared_distance, make_link
from ...mission.fields import check_argument, find_range
from ...mission.scenario import Array, Eavesdropper, Scenario
from ...mission.tracks import ReceiverPlaces
from ...mission.validation import checked_array, checked_kind


def find_receivers(scenario: Scenario, slots: int, times: Array | None = None) -> ReceiverPlaces:
    """Return the ReceiverPlaces at times (N,) in s from point 0, by default at points 1 to N."""
    if times is None and slots == scenario.slots:
        return scenario.receivers
    return scenario.receivers_at(
        np.arange(1.0, slots + 1) * scenario.slot_duration if times is None else
        checked_array('times', times, (slots,)))


def ground_squared_distances(scenario: Scenario, positions: Array) -> Array:
    """Return squared horizontal distances of the UAVs to the first ground node, (U, N) in m^2."""
    receivers = find_receivers(scenario, positions.shape[1] - 2)
    return _squared_norm(positions[:, 1:-1] - receivers.ground_nodes[0])


def guaranteed_squared_distances(scenario: Scenario, positions: Array) -> Array:
    """
    Return the squared distances to each eavesdropper that the guarantee uses, (E, U, N) in m^2.

    They are the transmitter's distance to the nearest place of the disc, and each jammer's
    distance to its farthest place, as in h-tilde of equation (9). No single place of the disc has
    both distances in general. A transmitter inside the disc has distance 0, [d - eps]^+.
    """
    receivers = find_receivers(scenario, positions.shape[1] - 2)
    return np.stack([_bound_squared_distances(positions[:, 1:-1] - centres, radii)
                     for centres, radii in zip(receivers.centres, receivers.radii, strict=True)])


def ground_gains(scenario: Scenario, positions: Array) -> Array:
    """Return g_i[n] / sigma^2 of every UAV to the first ground node, (U, N) in 1/W."""
    return make_link(scenario, 'ground_node').gain(ground_squared_distances(scenario, positions))


def guaranteed_gains(scenario: Scenario, positions: Array) -> Array:
    """
    Return h-tilde / sigma^2, the gains that the guarantee uses, (E, U, N) in 1/W.

    The transmitter's gain is no smaller, and a jammer's no larger, than its gain to any place of
    the eavesdropper's disc. Outside the disc neither holds.
    """
    link = make_link(scenario, 'eavesdropper').for_receivers(
        scenario.receiver_advantages[:, None, None])
    return link.gain(guaranteed_squared_distances(scenario, positions))


def ground_rates(scenario: Scenario, positions: Array, powers: Array,
                 times: Array | None = None) -> Array:
    """
    Return the largest r_0[n], equation (4), of all ground nodes in each slot, (N,) in bit/s/Hz.

    It is the rate without secrecy: no leak is subtracted.

    :param times: as for guaranteed_rates.
    """
    return np.asarray(node_ground_rates(scenario, positions, powers, times).max(axis=0))


def node_ground_rates(scenario: Scenario, positions: Array, powers: Array,
                      times: Array | None = None) -> Array:
    """Return the rate without secrecy, r_k[n], of each ground node, (G, N) in bit/s/Hz."""
    positions, powers = checked_flight(scenario, positions, powers)
    nodes = find_receivers(scenario, powers.shape[1], times).ground_nodes
    return _compute_node_rates(make_link(scenario, 'ground_node'), nodes, positions, powers)


def _compute_node_rates(link: FreeSpace, nodes: Array, positions: Array, powers: Array) -> Array:
    """Return the rates (G, N) in bit/s/Hz of a link to ground nodes at (G, N, 2) in m."""
    return np.stack([compute_rate(link.gain(_squared_norm(positions[:, 1:-1] - node)) * powers)
                     for node in nodes])


def guaranteed_rates(scenario: Scenario, positions: Array, powers: Array,
                     altitudes: Array | None = None, times: Array | None = None) -> Array:
    """
    Return R-bar[n] of problem (P2), (N,) in bit/s/Hz, negative where the leak is larger.

    With several ground nodes it is the largest of their rates. A Plan counts [R-bar]^+, because
    nothing secret need be sent in a slot with a negative rate. R-bar is a lower bound of
    worst_case_rates, and equal to it when every error radius is zero. It holds for every place of
    the eavesdroppers inside their discs at the given times. It holds neither outside the discs
    nor between these times; Plan.curve_rates averages over the curve.

    :param altitudes: flown altitudes, (U, N) in m, instead of the scenario's.
    :param times: times [s] from point 0, (N,), at which the receivers' places are taken from
        their tracks. By default the receivers are at their places at the slots' points.
    """
    return np.asarray(
        guaranteed_node_rates(scenario, positions, powers, altitudes, times).max(axis=0))


def guaranteed_node_rates(scenario: Scenario, positions: Array, powers: Array,
                          altitudes: Array | None = None, times: Array | None = None) -> Array:
    """Return R-bar[n] of each ground node, (G, N) in bit/s/Hz; see guaranteed_rates."""
    positions, powers = checked_flight(scenario, positions, powers)
    # One eavesdropper after the other, because arrays over all would not fit into the caches.
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
    Return the rate of each ground node minus its leak, (G, N) in bit/s/Hz, which may be negative.

    Ground nodes that are not trusted listen to what other nodes are sent; this is added to the
    leak here.

    :param leak: leak to the eavesdroppers, (N,) in bit/s/Hz.
    :param times: as for guaranteed_rates.
    """
    positions, powers = checked_flight(scenario, positions, powers)
    nodes = find_receivers(scenario, powers.shape[1], times).ground_nodes
    return _subtract_leak(scenario, nodes, positions, powers, leak)


def _subtract_leak(scenario: Scenario, nodes: Array, positions: Array, powers: Array, leak: Array,
                   altitudes: Array | None = None) -> Array:
    """Return rates (G, N) of nodes at (G, N, 2) m minus `leak` (N,), after include_listeners."""
    if scenario.listeners:
        leak = include_listeners(scenario, leak, _compute_node_rates(
            make_link(scenario, 'eavesdropper', altitudes=altitudes),
            nodes[list(scenario.listeners)], positions, powers))
    return _compute_node_rates(
        make_link(scenario, 'ground_node', altitudes=altitudes), nodes, positions, powers) - leak


def include_listeners(scenario: Scenario, leak: Array, heard: Sequence[Array] | Array,
                      unit: float = 1.0) -> Array:
    """
    Return the leak of what each ground node is sent, to eavesdroppers and listeners, (G, N).

    SINRs add up for colluding eavesdroppers; otherwise the largest leak counts. A listener does
    not count for what it is sent itself. Without listeners `leak` itself is returned, (N,).

    :param leak: leak to the eavesdroppers, (N,).
    :param heard: rates at which the listeners hear, (L, N).
    :param unit: unit of all rates here [bit/s/Hz].
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

    With several ground nodes it is the largest of their rates. The rate is exact for this place
    and bounds nothing for others. It is no smaller than guaranteed_rates if the place lies inside
    the disc of an eavesdropper with this advantage or a larger one.

    :param eavesdropper: true place of the eavesdropper in m, (2,), or (N, 2) for each slot.
    :param receiver_advantage_db: advantage of the eavesdropper's receiver; by default the largest
        advantage among the scenario's eavesdroppers.
    :param times: as for guaranteed_rates.
    """
    return np.asarray(secrecy_node_rates(
        scenario, positions, powers, eavesdropper, receiver_advantage_db, times).max(axis=0))


def secrecy_node_rates(scenario: Scenario, positions: Array, powers: Array,
                       eavesdropper: ArrayLike, receiver_advantage_db: float | None = None,
                       times: Array | None = None) -> Array:
    """Return r_k[n] - r_e[n] of each ground node, (G, N) in bit/s/Hz; see secrecy_rates."""
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
    Return the scale of rate tolerances, min(1, largest SNR at average power), in nats.

    The largest SNR is at the least distance from a ground node that the transmitter can have at
    the time of a point, flying from its start and to its goal at full speed. An SNR bounds its
    rate in nats, so tolerances shrink with the rates of weak links.
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
    Return the rate r_e at which receivers hear at places (N, K, 2) in m, (N, K) in bit/s/Hz.

    :param uav_positions: (U, N, 2) in m.
    :param advantage: factor by which the receivers' SNR exceeds a ground node's at equal gain.
    """
    offset = uav_positions[:, :, None] - places
    link = make_link(scenario, 'eavesdropper', axes=2).for_receivers(advantage)
    gains = link.gain(_squared_norm(offset))
    return compute_rate(gains * powers[..., None])


def compute_rate(received: Array) -> Array:
    """
    Return log2(1 + S / (1 + J)), (...) in bit/s/Hz, to full relative accuracy also for small S.

    :param received: received powers relative to the noise power, (U, ...). The transmitter's
        power S is first; J is the sum of the other powers.
    """
    return convert_sinr(compute_sinr(received))


def convert_sinr(sinr: Array) -> Array:
    """Return the rate log2(1 + SINR) in bit/s/Hz."""
    return np.log1p(sinr) / np.log(2.0)


def compute_sinr(received: Array) -> Array:
    """Return the SINR S / (1 + J) of received powers (U, ...), (...); see compute_rate."""
    return received[0] / (1.0 + received[1:].sum(axis=0))


def combine_leaks(leaks: Array) -> Array:
    """
    Return the leak to colluding eavesdroppers, log2(1 + sum of their SINRs), (N,).

    :param leaks: leak to each eavesdropper alone, (N, E) in bit/s/Hz.
    """
    return convert_sinr(np.expm1(leaks * np.log(2.0)).sum(axis=1))


def bound_sinrs(link: FreeSpace, offsets: Array, radii: Array, powers: Array) -> Array:
    """
    Return an upper bound of the SINR of a receiver anywhere in each disc, (...).

    It is exact for a radius of 0. Outside the disc it does not hold.

    :param offsets: UAVs' positions minus the centres of the discs, (U, ..., 2) in m.
    :param radii: radii of the discs, (...) in m.
    :param powers: powers of the UAVs, the transmitter first, (U, ...) in W.
    """
    return compute_sinr(link.gain(_bound_squared_distances(offsets, radii)) * powers)


def _bound_squared_distances(offsets: Array, radii: Array) -> Array:
    """Return the transmitter's least and the jammers' largest squared distances, (U, ...)."""
    edge = np.repeat(radii[None], len(offsets), axis=0)
    edge[0] *= -1
    return guaranteed_squared_distance(_squared_norm(offsets), edge)


def _squared_norm(offset: Array) -> Array:
    return offset[..., 0]**2 + offset[..., 1]**2


def find_least_rate(scenario: Scenario, means: Array, unit: float = 1.0) -> float:
    """
    Return the least over ground nodes of (mean rate + node_offset) / node_weight.

    :param means: mean rate of each ground node, (G,).
    :param unit: unit of the means and of the result [bit/s/Hz].
    """
    return float(((means + scenario.node_offsets / unit) / scenario.node_weights).min())


def find_head_starts(scenario: Scenario, delivered: Array) -> tuple[float, ...]:
    """
    Return the head_starts (G,) in bit/Hz of a mission that continues this scenario's.

    With T = delivered + the head starts here, they are T - weight * min(T / weight).

    :param delivered: what has been delivered since this scenario's start, (G,) in bit/Hz.
    """
    total, weights = delivered + scenario.duration * scenario.node_offsets, scenario.node_weights
    return tuple(np.maximum(total - weights * (total / weights).min(), 0.0).tolist())
