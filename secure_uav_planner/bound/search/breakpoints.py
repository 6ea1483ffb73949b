"""What the certificate needs from a search: breakpoints of w0, each with its own v and boxes."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .columns import Columns
from .dual import unpacked
from .multiplier_search import MultiplierSearch
from ..proof.certificate import Multipliers
from ..proof.chords import interpolated, neighbours, on_chords, over_pieces, pieces
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

SPARED = 1e-4
"""By how much a stage's bound may rise for a breakpoint that is left out, in nats."""


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
    estimates = _Estimates(team, point.prices[0], weights, shares, still.sum(0))
    needed, joint = np.ones(weights.shape, bool), known.sum(0)
    most = estimates.over(joint, needed)[1] + SPARED
    for k in range(len(needed) - 1):
        trial = needed.copy()
        trial[k] = False
        needed[k] = ~(estimates.over(joint, trial)[1] <= most)
    slack = TOLERANCE + SLACK / len(uavs) * estimates.slack(joint, needed)
    return Multipliers(*unpacked(point.potentials.transpose(1, 0, 2)), point.prices, weights,
                       shares, needed, still, known, slack)


def _constant(search: MultiplierSearch, uav: int) -> Array:
    """Return what a UAV's columns are worth beyond their values, (G,)."""
    potential = search.potential(uav)
    return potential.constant() if potential.curved else potential.turning()


@dataclass(frozen=True, eq=False)
class _Estimates:
    """
    About what the certificate will find, from what the terms are worth at the breakpoints of w0.

    :param team: the UAVs.
    :param price: lam of the transmitter.
    :param weights: w0, (K, G).
    :param shares: v, (K, G, E).
    :param silent: all terms where nothing is sent, (G,).
    """

    team: Team
    price: float
    weights: Array
    shares: Array
    silent: Array

    def over(self, joint: Array, needed: NDArray[np.bool_]) -> tuple[Array, Array]:
        """
        Return about the bounds of all pieces of w0, (PIECES, K, G), and of the stages, (G,).

        :param joint: all terms at the breakpoints, (K, G).
        :param needed: whether each is one, (K, G).
        """
        joint = interpolated(joint[None], self.silent, self.weights, needed)[0]
        total = on_chords(self.weights, self.shares, needed).sum(-1)
        value = over_pieces(self.team, self.silent, joint, self.weights, total, self.price)
        return value, np.maximum(self.silent, value.max((0, 1)))

    def slack(self, joint: Array, needed: NDArray[np.bool_]) -> Array:
        """Return by how much silence and every breakpoint could be higher, (K + 1, G)."""
        weights = self.weights
        value, best = self.over(joint, needed)
        # One that is too high lifts the pieces on both sides, the less the farther they are.
        slack = np.concatenate([(best - self.silent)[None], np.full(weights.shape, np.inf)])
        column = np.arange(weights.shape[1])
        at = np.concatenate([0 * weights[:1], weights])
        below, above = neighbours(needed)
        x = pieces()[:, None]
        for k in range(len(weights)):
            low, high = at[below[k], column], at[above[k], column]
            share = (at[k] + (at[k + 1] - at[k]) * x - low) / np.maximum(high - low, 1e-300)
            gap = best - value[:, k]
            for number, part in ((below[k], 1 - share[:-1]), (above[k], share[1:])):
                room = (gap / np.maximum(part, 1e-9)).min(0)
                slack[number, column] = np.minimum(slack[number, column], room)
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
