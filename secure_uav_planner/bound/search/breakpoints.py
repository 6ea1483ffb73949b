"""What the certificate needs from a search: breakpoints of w0, each with its own v and boxes."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from .columns import Columns
from .dual import unpacked
from .multiplier_search import MultiplierSearch
from ..proof.certificate import Multipliers
from ..proof.chords import over_pieces, pieces
from ..proof.conjugate import Array, entropy, transmit_power
from ..proof.team import Team

BREAKPOINTS = (0.5, 0.8, 0.93, 0.98, 0.995, 1.0)
"""Breakpoints w0 of the certificate, beside the one that the search has used."""

SLACK = 0.5
"""Share of what a maximum could be too large without raising its stage's bound."""

FEW, SWEEPS = 60, (2, 5)
"""Columns that join those from which v is chosen, and how often: with one eavesdropper, more."""

TOLERANCE = 2e-4
"""What a maximum may be too large, in nats."""

def breakpoint_multipliers(search: MultiplierSearch) -> Multipliers:
    """Return what the certificate needs, for its own breakpoints of w0."""
    team, point, uavs = search.team, search.point, range(len(search.team.regions))
    weights = np.sort([*(np.full(len(search.weight), w0) for w0 in BREAKPOINTS), search.weight],
                      axis=0)
    seen, constant = search.seen, np.array([_constant(search, i) for i in uavs])
    found = [_shares(search, seen, weight) for weight in weights]
    shares = np.array([v for v, _ in found])
    known = np.array([terms for _, terms in found]).swapaxes(0, 1) + constant[:, None]
    still = np.array([search.values(i, search.silent(i)).max(1) for i in uavs]) + constant
    slack = TOLERANCE + SLACK / len(uavs) * _slack(team, still.sum(0), known.sum(0), weights,
                                                   shares, point.prices[0])
    return Multipliers(*unpacked(point.potentials.transpose(1, 0, 2)), point.prices, weights,
                       shares, still, known, slack)


def _constant(search: MultiplierSearch, uav: int) -> Array:
    """Return what a UAV's columns are worth beyond their values, (G,)."""
    potential = search.potential(uav)
    return potential.constant() if potential.curved else potential.turning()


def _slack(team: Team, silent: Array, joint: Array, weights: Array, shares: Array,
           price: float) -> Array:
    """
    Return by how much silence and every breakpoint could be higher, (K + 1, G) in nats.

    :param silent: about what all terms are where nothing is sent, (G,).
    :param joint: the same at the breakpoints, (K, G).
    """
    value = over_pieces(team, silent, joint, weights, shares.sum(-1), price)
    best = np.maximum(silent, value.max((0, 1)))
    slack = np.concatenate([(best - silent)[None], np.full(weights.shape, np.inf)])
    # One that is too high lifts the pieces on both sides, the less the farther they are.
    x = pieces()[:, None, None]
    for ends, part in ((slice(-1), 1 - x[:-1]), (slice(1, None), x[1:])):
        room = ((best - value) / np.maximum(part, 1e-9)).min(0)
        slack[ends] = np.minimum(slack[ends], room)
    return slack


def _alone(team: Team, price: float, weight: Array, total: Array) -> Array:
    """Return a slot's bound at w0 and s but for what v multiplies, m(w0 - s) - H(s)."""
    return transmit_power(weight - total, price, team.regions[0].peak)[0] - entropy(total)


def _shares(search: MultiplierSearch, seen: list[Columns],
            weight: Array) -> tuple[Array, list[Array]]:
    """
    Return v (G, E) that nearly minimises a slot's bound at one breakpoint w0 (G,).

    And about what the terms of every UAV are worth there, (G,) each.

    :param seen: columns of every UAV.
    """
    team, point = search.team, search.point
    v = point.shares * (weight / search.weight)[:, None]
    none = np.zeros_like(v)
    # What v does not change, and what it multiplies. Those that are best at the present v join
    # before every sweep: else v makes use of it that others are missing. Measured: with one list a
    # mission of one jammer is 24% above its plan instead of 5%, others are the same.
    every = [(search.values(i, columns, weight, none), columns.leaks)
             for i, columns in enumerate(seen)]
    chosen = [np.zeros((len(v), 0), int) for _ in every]
    row = np.arange(len(v))[:, None]

    def along(start: Array, way: Array) -> Callable[[Array], Array]:
        parts = [(base[row, few] + _dot(leaks[row, few], start), _dot(leaks[row, few], way))
                 for (base, leaks), few in zip(every, chosen)]

        def value(x: Array) -> Array:
            s = np.clip((start + x[:, None] * way).sum(-1), 0.0, weight)
            return np.asarray(_alone(team, point.prices[0], weight, s) + sum(
                (base + x[:, None] * part).max(1) for base, part in parts))
        return value

    count = v.shape[-1]
    for sweep in range(SWEEPS[count > 1]):
        chosen = [np.concatenate([few, np.argpartition(
            base + _dot(leaks, v), -min(FEW, base.shape[1]), 1)[:, -FEW:]], 1)
            for few, (base, leaks) in zip(chosen, every)]
        share = v / np.maximum(v.sum(-1, keepdims=True), 1e-300)
        v = share * _golden(along(none, share), 0 * weight, weight)[:, None]
        for e in range(count if sweep < SWEEPS[1] - 1 else 0):
            for f in range(e):
                way = np.zeros_like(v)
                way[:, e], way[:, f] = 1.0, -1.0
                moved = _golden(along(v, way), -v[:, e], v[:, f])
                v = np.maximum(v + way * moved[:, None], 0.0)
    return v, [(base + _dot(leaks, v)).max(1) for base, leaks in every]


def _golden(value: Callable[[Array], Array], low: Array, high: Array, steps: int = 20) -> Array:
    """Return the minimisers of convex functions, one of each stage, by golden section."""
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


def _dot(leaks: Array, v: Array) -> Array:
    """Return sum_e v_e leaks, (G, C), for leaks (G, C, E) and v (G, E)."""
    return np.asarray(np.matmul(leaks, v[..., None])[..., 0])
