"""The multipliers of the certificate: breakpoints of w0, each with its own v, from a search."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from .columns import Columns
from .dual import split_potentials
from .multipliers import MultiplierSearch
from ..proof.certificate import bound_pieces, entropy, maximise_power, Multipliers, piece_ends
from ..proof.reachable_set import Team
from ...mission.validation import Array

BREAKPOINTS = (0.5, 0.8, 0.93, 0.98, 0.995, 1.0)
"""Breakpoints w0 of the certificate; the w0 of the search is added to them."""

SLACK = 0.5
"""Share of the slack of a maximum that its branch and bound may use."""

SWEEP_COLUMNS, SWEEPS = 60, (2, 5)
"""Columns that join before each sweep of v, and sweeps with one eavesdropper and with more."""

TOLERANCE = 2e-4
"""Tolerance of every maximum, in nats."""


def build_multipliers(search: MultiplierSearch) -> Multipliers:
    """Return the multipliers of the certificate, with breakpoints of w0 in every stage."""
    team, point, uavs = search.team, search.point, range(len(search.team.regions))
    weights = np.sort([*(np.full(len(search.weight), w0) for w0 in BREAKPOINTS), search.weight],
                      axis=0)
    columns = search.recent_columns
    constant = np.array([_potential_constant(search, i) for i in uavs])
    minima = [_minimise_shares(search, columns, weight) for weight in weights]
    shares = np.array([v for v, _ in minima])
    incumbents = np.array([terms for _, terms in minima]).swapaxes(0, 1) + constant[:, None]
    silent_incumbents = constant + [
        search.evaluate(i, search.silent_columns(i)).max(1) for i in uavs]
    slacks = _find_slacks(team, silent_incumbents.sum(0), incumbents.sum(0), weights, shares,
                          point.prices[0])
    return Multipliers(
        *split_potentials(point.potentials.transpose(1, 0, 2)), point.prices, weights, shares,
        silent_incumbents, incumbents, TOLERANCE + SLACK / len(uavs) * slacks)


def _potential_constant(search: MultiplierSearch, uav: int) -> Array:
    """Return the part of a UAV's potential that its columns' values leave out, (G,)."""
    potential = search.potential(uav)
    return potential.constant() if potential.is_quadratic else potential.acceleration_cost()


def _find_slacks(team: Team, silent: Array, joint: Array, weights: Array, shares: Array,
                 price: float) -> Array:
    """
    Return the rise of silence and of every breakpoint that leaves B as it is, (K + 1, G) in nats.

    :param silent: estimate of all terms where nothing is sent, (G,).
    :param joint: estimate of all terms at the breakpoints, (K, G).
    """
    value = bound_pieces(team, silent, joint, weights, shares.sum(-1), price)
    best = np.maximum(silent, value.max((0, 1)))
    slacks = np.concatenate([(best - silent)[None], np.full(weights.shape, np.inf)])
    # A breakpoint lifts the pieces on both sides, in proportion to how near they are.
    x = piece_ends()[:, None, None]
    for breakpoints, share in ((slice(-1), 1 - x[:-1]), (slice(1, None), x[1:])):
        slack = ((best - value) / np.maximum(share, 1e-9)).min(0)
        slacks[breakpoints] = np.minimum(slacks[breakpoints], slack)
    return slacks


def _slot_constant(team: Team, price: float, weight: Array, total: Array) -> Array:
    """Return the part of a slot's bound that depends on w0 and s alone, m(w0 - s) - H(s)."""
    return maximise_power(weight - total, price, team.regions[0].peak)[0] - entropy(total)


def _minimise_shares(search: MultiplierSearch, columns: list[Columns],
                     weight: Array) -> tuple[Array, list[Array]]:
    """
    Minimise a slot's bound on given columns over v, nearly, at w0.

    :param columns: of every UAV.
    :param weight: w0, (G,).
    :return: v, (G, E), and the terms of every UAV there, (G,) each.
    """
    team, point = search.team, search.point
    v = point.shares * (weight / search.weight)[:, None]
    zero = np.zeros_like(v)
    # The constant part of every column's value, and its factors of v. The columns that are best at
    # the present v join before every sweep: on a fixed list, v exploits what is missing in it.
    # Measured: with one list a mission of one jammer is 24% above its plan instead of 5%.
    parts = [(search.evaluate(i, part, weight, zero), part.leaks)
             for i, part in enumerate(columns)]
    chosen = [np.zeros((len(v), 0), int) for _ in parts]
    row = np.arange(len(v))[:, None]

    def restrict(start: Array, direction: Array) -> Callable[[Array], Array]:
        """Return the slot's bound along a line from v = start, a function of the length (G,)."""
        lines = [(base[row, few] + _weigh_leaks(leaks[row, few], start),
                  _weigh_leaks(leaks[row, few], direction))
                 for (base, leaks), few in zip(parts, chosen)]

        def value(x: Array) -> Array:
            s = np.clip((start + x[:, None] * direction).sum(-1), 0.0, weight)
            return np.asarray(_slot_constant(team, point.prices[0], weight, s) + sum(
                (base + x[:, None] * slope).max(1) for base, slope in lines))
        return value

    count = v.shape[-1]
    for sweep in range(SWEEPS[count > 1]):
        chosen = [np.concatenate([few, np.argpartition(
            base + _weigh_leaks(leaks, v), -min(SWEEP_COLUMNS, base.shape[1]), 1)[
                :, -SWEEP_COLUMNS:]], 1) for few, (base, leaks) in zip(chosen, parts)]
        share = v / np.maximum(v.sum(-1, keepdims=True), 1e-300)
        v = share * _minimise_convex(restrict(zero, share), 0 * weight, weight)[:, None]
        for e in range(count if sweep < SWEEPS[1] - 1 else 0):
            for f in range(e):
                direction = np.zeros_like(v)
                direction[:, e], direction[:, f] = 1.0, -1.0
                length = _minimise_convex(restrict(v, direction), -v[:, e], v[:, f])
                v = np.maximum(v + direction * length[:, None], 0.0)
    return v, [(base + _weigh_leaks(leaks, v)).max(1) for base, leaks in parts]


def _minimise_convex(value: Callable[[Array], Array], low: Array, high: Array,
                     steps: int = 20) -> Array:
    """Return the minimisers of one convex function per stage by golden section, (G,)."""
    gold = (5**0.5 - 1) / 2
    x1, x2 = high - gold * (high - low), low + gold * (high - low)
    f1, f2 = value(x1), value(x2)
    for _ in range(steps):
        left = f1 < f2
        low, high = np.where(left, low, x1), np.where(left, x2, high)
        new = np.where(left, high - gold * (high - low), low + gold * (high - low))
        f = value(new)
        x1, x2, f1, f2 = (np.where(left, new, x2), np.where(left, x1, new),
                          np.where(left, f, f2), np.where(left, f1, f))
    return (low + high) / 2


def _weigh_leaks(leaks: Array, v: Array) -> Array:
    """Return sum_e v_e leaks, (G, C), for leaks (G, C, E) and v (G, E)."""
    return np.asarray(np.matmul(leaks, v[..., None])[..., 0])
