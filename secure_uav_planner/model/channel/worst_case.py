"""The worst case: the place in the discs where the leak is largest, proven in every slot."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from .links import FreeSpace, make_link, PathLoss
from .rates import (
    bound_sinrs, checked_flight, combine_leaks, convert_sinr, find_node_rates, find_rate_scale,
    find_receivers, guaranteed_node_rates)
from ..kernel import core
from ...errors import OptionError
from ...mission.scenario import Array, Scenario
from ...mission.tracks import ReceiverPlaces
from ...mission.validation import checked_array, checked_kind

MOST_SECTORS = 50000
"""
Approximate limit of the sectors examined in a slot; the bound reached by then is returned.

Measured in 36000 slots of random scenarios, with all extremes that a Scenario allows: no slot
needed 20000 sectors, 99% of the slots less than 1200, and half of the slots 20. With two UAVs,
50000 sectors take 0.02 s.
"""

_AT_ONCE = 2**15  # Triples (slot, eavesdropper, UAV) in a chunk whose arrays fit into caches.
_ROUNDING = 1e-12  # Rounding error of a leak: bit/s/Hz above 1, relative below; leaks are < 150.
_SILENT = 1e-100  # Leak in bit/s/Hz up to which a slot is silent.


def worst_case_rates(scenario: Scenario, positions: Array, powers: Array,
                     times: Array | None = None) -> Array:
    """
    Return r_0[n] less the largest leak to any point of any disc, (N,) in bit/s/Hz.

    With several ground nodes it is the largest of their rates. It is a lower bound of R[n] of
    problem (P1), equation (6), before its [x]^+, and never below guaranteed_rates. A branch and
    bound over the discs proves that no point leaks more than the subtracted leak. The subtracted
    leak exceeds the leak at worst_case_places by at most 1e-6 times find_rate_scale, or by more in
    a slot that needs more than MOST_SECTORS sectors, and where distances of 1e7 m at altitudes of
    1e-3 m exhaust floating-point numbers.

    :param times: as for guaranteed_rates.
    """
    return np.asarray(worst_case_node_rates(scenario, positions, powers, times).max(axis=0))


def worst_case_node_rates(scenario: Scenario, positions: Array, powers: Array,
                          times: Array | None = None) -> Array:
    """Return R[n] of each ground node, (G, N) in bit/s/Hz; see worst_case_rates."""
    positions, powers = checked_flight(scenario, positions, powers)
    powers = np.maximum(powers, 0.0)
    receivers = find_receivers(scenario, powers.shape[1], times)
    leak, _ = _by_chunks(_worst_leaks, scenario, receivers, positions[:, 1:-1], powers)
    return np.maximum(find_node_rates(scenario, positions, powers, leak, times),
                      guaranteed_node_rates(scenario, positions, powers, times=times))


def worst_case_places(scenario: Scenario, positions: Array, powers: Array) -> Array:
    """
    Return the place with the largest leak that the proof found in each slot, (N, 2) in m.

    With colluding eavesdroppers, it is the place with the largest single leak. With a negligible
    leak it is the centre of a disc.
    """
    positions, powers = checked_flight(scenario, positions, powers)
    _, places = _by_chunks(
        _worst_leaks, scenario, find_receivers(scenario, powers.shape[1]), positions[:, 1:-1],
        np.maximum(powers, 0.0))
    return places


def leak_maximisers(scenario: Scenario, uav_positions: Array, powers: Array,
                    receivers: ReceiverPlaces | None = None) -> tuple[Array, Array]:
    """
    Return the worst place in each slot and disc, (E, N, 2) in m, and its leak, (E, N) in bit/s/Hz.

    A local search from the best of some places finds it; it is not proven. Of 12000 slots of
    random scenarios, 13 missed the largest leak by more than 2e-6. In a slot whose leaks are at
    most _SILENT, the place is the centre and the leak 0.

    :param uav_positions: positions of the UAVs in the N slots, (U, N, 2) in m.
    :param powers: (U, N) in W.
    :param receivers: discs in the N slots; by default the scenario's, in N slots.
    """
    count = len(checked_kind('scenario', scenario, Scenario).uavs)
    powers = np.maximum(checked_array('powers', powers, (count, None)), 0.0)
    uav_positions = checked_array('uav_positions', uav_positions, (*powers.shape, 2))
    receivers = find_receivers(scenario, powers.shape[1]) if receivers is None else (
        checked_kind('receivers', receivers, ReceiverPlaces))
    leaks, places = _by_chunks(_likely_leaks, scenario, receivers, uav_positions, powers)
    return places.swapaxes(0, 1), leaks.T


def _by_chunks(examine: Callable[[Scenario, Array, Array, Array, Array], tuple[Array, Array]],
               scenario: Scenario, receivers: ReceiverPlaces, uav_positions: Array,
               powers: Array) -> tuple[Array, Array]:
    """Return leaks and places by `examine`, called for chunks of slots that fit into caches."""
    size = max(1, _AT_ONCE // (len(scenario.eavesdroppers) * len(powers)))
    centres, radii = receivers.centres.swapaxes(0, 1), receivers.radii.T
    chunks = (slice(first, first + size) for first in range(0, powers.shape[1], size))
    leaks, places = zip(*(
        examine(scenario, centres[chunk], radii[chunk], uav_positions[:, chunk], powers[:, chunk])
        for chunk in chunks), strict=True)
    return np.concatenate(leaks), np.concatenate(places)


def _likely_leaks(scenario: Scenario, centres: Array, radii: Array, uav_positions: Array,
                  powers: Array) -> tuple[Array, Array]:
    """
    Return the probable largest leak of each disc, and its place, by a local search.

    The search may miss the worst place; prove_leaks of the kernel bounds the leak. In slots whose
    leaks are at most _SILENT, the leak is 0 and the place is the centre.

    :param centres: centres of the discs, (N, E, 2) in m.
    :param radii: radii of the discs, (N, E) in m.
    :return: leaks (N, E) in bit/s/Hz and places (N, E, 2) in m.
    """
    offsets = uav_positions[:, :, None] - centres
    leaks = np.zeros(offsets.shape[1:3])
    places = np.zeros((*leaks.shape, 2))
    active = np.flatnonzero(
        _guaranteed_leaks(scenario, radii, offsets, powers).max(axis=1) > _SILENT)
    if active.size:
        candidates = np.empty((3, active.size * len(scenario.eavesdroppers)))
        core.find_local_minima(
            _pack_discs(scenario, radii[active], offsets[:, active], powers[:, active]),
            candidates)
        inverse_sinr, x, y = candidates
        leaks[active] = convert_sinr(1.0 / inverse_sinr).reshape(active.size, -1)
        places[active] = np.stack([x, y], axis=-1).reshape(active.size, -1, 2)
    return leaks, centres + places


def _worst_leaks(scenario: Scenario, centres: Array, radii: Array, uav_positions: Array,
                 powers: Array) -> tuple[Array, Array]:
    """
    Return an upper bound of each slot's leak, (N,) in bit/s/Hz, and the worst place, (N, 2) in m.

    The worst place has the largest leak found to a single eavesdropper.

    :param centres: centres of the discs, (N, E, 2) in m.
    :param radii: radii of the discs, (N, E) in m.
    """
    offsets = uav_positions[:, :, None] - centres
    by_formula = _guaranteed_leaks(scenario, radii, offsets, powers)
    leaks = combine_leaks(by_formula) if scenario.colluding else by_formula.max(axis=1)
    eves = by_formula.argmax(axis=1)
    # A leak below the tolerance, as in a silent slot, keeps the formula's bound and the centre.
    scale = find_rate_scale(scenario)
    active = np.flatnonzero(leaks > scale * core.TOLERANCE)
    if not active.size:
        return leaks, centres[np.arange(len(eves)), eves]
    discs = _pack_discs(scenario, radii[active], offsets[:, active], powers[:, active])
    # A group has one proven leak. Leaks of colluding eavesdroppers add up, so each disc is a
    # group; otherwise only the largest matters, and the discs of a slot are one group.
    groups_each = by_formula.shape[1] if scenario.colluding else 1
    groups = active.size * groups_each
    group = np.repeat(np.arange(groups), by_formula.shape[1] // groups_each)
    proven: Array = np.empty(groups)
    disc, place = np.empty(groups, np.int64), np.empty((groups, 2))
    core.prove_leaks(discs, group, by_formula[active].ravel(), MOST_SECTORS,
                     scale * core.TOLERANCE / groups_each, proven, disc, place)
    by_slot = proven.reshape(-1, groups_each)
    places = np.zeros((len(leaks), 2))  # Places from the centre of the eavesdropper's disc.
    worst = np.arange(0, groups, groups_each) + by_slot.argmax(axis=1)
    eves[active], places[active] = disc[worst] % by_formula.shape[1], place[worst]
    total = combine_leaks(by_slot) if scenario.colluding else proven
    leaks[active] = np.minimum(leaks[active], total + _ROUNDING * np.minimum(
        np.maximum(scale, total), 1.0))
    return leaks, centres[np.arange(len(eves)), eves] + places


def _pack_discs(scenario: Scenario, radii: Array, offsets: Array,
                powers: Array) -> dict[str, Any]:
    """
    Return the discs of all slots and eavesdroppers, slot by slot, by the names of core.pyi.

    :param radii: (N, E) in m.
    :param offsets: horizontal offsets of the UAVs from the centres, (U, N, E, 2) in m.
    :param powers: (U, N) in W.
    :raises OptionError: for a channel of one's own, whose largest leak the kernel cannot prove.
    """
    uavs, slots, eves = offsets.shape[:3]
    link = make_link(scenario, 'eavesdropper').for_receivers(
        np.tile(scenario.receiver_advantages, slots))
    if type(link) is not FreeSpace and not isinstance(link, PathLoss):
        raise OptionError(f'the worst case in a disc is proven for links of the classes FreeSpace '
                          f'and PathLoss, and these are {type(link).__name__}: use the '
                          'guaranteed rate')
    offsets, powers = offsets.reshape(uavs, -1, 2), np.repeat(powers, eves, axis=1)
    snr = np.broadcast_to(link.reference_snr, (uavs, slots * eves))
    discs: dict[str, Any] = {name: np.ascontiguousarray(values) for name, values in {
        'x': offsets[..., 0], 'y': offsets[..., 1], 'squared_altitudes': link.squared_altitudes,
        'noise': 1.0 / (snr[0] * powers[0]),
        'jamming': powers[1:] / powers[0] * (snr[1:] / snr[0]), 'radius': radii.ravel()}.items()}
    if isinstance(link, PathLoss):
        discs['channel'] = replace(
            make_link(scenario, 'eavesdropper', axes=0), reference_snr=1.0).compiled(1, uavs)
    return discs


def _guaranteed_leaks(scenario: Scenario, radii: Array, offsets: Array, powers: Array) -> Array:
    """Return upper bounds of the leaks by the formula of the guarantee, (N, E) in bit/s/Hz."""
    link = make_link(scenario, 'eavesdropper', axes=2).for_receivers(scenario.receiver_advantages)
    return convert_sinr(bound_sinrs(link, offsets, radii, powers[..., None]))
