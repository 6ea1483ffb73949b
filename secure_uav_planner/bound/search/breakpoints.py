"""What the certificate needs from a search: breakpoints of w0, each with its own v."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .descent import golden
from .division import share_division
from .dual import curved, parties, unpacked
from .multiplier_search import MultiplierSearch
from ..proof.chords import interpolated, neighbours, on_chords, over_pieces, pieces
from ..proof.conjugate import Array, entropy, transmit_power
from ..proof.multipliers import Multipliers
from ..proof.team import Team

BREAKPOINTS = (0.5, 0.8, 0.93, 0.98, 0.995, 1.0)
"""Breakpoints w0 of the certificate, beside the one that the search has used."""

FEW, SWEEPS = 60, (2, 5)
"""Columns that join those from which v is chosen, and how often: with one eavesdropper, more."""

TOLERANCE = 2e-4
"""What a maximum may be too large, in nats."""

SPARED = 1e-4
"""By how much a stage's bound may rise for a breakpoint that is left out, in nats."""

SLACK = 0.5
"""Share of what a node's maximum could be too large without raising its stage's bound."""


@dataclass(frozen=True, eq=False)
class _Estimates:
    """
    About what the terms are worth at breakpoints of w0, by columns.

    :param weights: w0, (K, G).
    :param shares: v, (K, G, E).
    :param sent: the transmitter's term, (K, G).
    :param jammed: those of all jammers, (K, G).
    """

    weights: Array
    shares: Array
    sent: Array
    jammed: Array

    @classmethod
    def of(cls, search: MultiplierSearch) -> _Estimates:
        """Return those of a search's multipliers, for all breakpoints of the certificate."""
        if not search.seen:
            search.dual(0.01)
        count, uavs = len(search.team.stages.count), len(search.team.regions)
        weights = np.sort([*(np.full(count, w0) for w0 in BREAKPOINTS), search.weight], axis=0)
        found = [_shares(search, weight) for weight in weights]
        values = np.zeros((2, *weights.shape))
        for number, party in enumerate(parties(uavs)):
            values[number] = [of_party[number] for _, of_party in found]
            values[number] += _constant(search, party)
        return cls(weights, np.array([shares for shares, _ in found]), *values)


def breakpoint_multipliers(search: MultiplierSearch, tolerance: float = TOLERANCE,
                           stop: Callable[[], bool] = lambda: False) -> Multipliers:
    """
    Return what the certificate needs, for its own breakpoints of w0.

    :param tolerance: what a maximum may be too large, in nats.
    :param stop: asked now and then; True ends the division into boxes.
    """
    found = _Estimates.of(search)
    team, point = search.team, search.point
    uavs, weights, shares = range(len(team.regions)), found.weights, found.shares
    still = np.array([search.values([i], search.silent(i))[0].max(1) + _constant(search, [i])
                      for i in uavs])
    needed, joint = np.ones(weights.shape, bool), found.sent + found.jammed
    most = _over(team, still, joint, found, needed, point.prices[0])[1] + SPARED
    for k in range(len(needed) - 1):
        trial = needed.copy()
        trial[k] = False
        needed[k] = ~(_over(team, still, joint, found, trial, point.prices[0])[1] <= most)
    at = np.nonzero(needed)
    slack = _slack(team, still, joint, found, needed, point.prices[0])
    boxes = share_division(search, at[1], weights[at], shares[at], found.jammed[at],
                           SLACK / 2 * slack[1:][at], stop)
    worth = boxes.bounds.max((0, 2))
    joint[at] = found.sent[at] + worth
    slack = tolerance + SLACK / len(uavs) * _slack(
        team, still, joint, found, needed, point.prices[0])
    slope, bend, turn = unpacked(point.potentials.transpose(1, 0, 2))
    return Multipliers(
        slope, bend, turn, point.prices, weights, shares, boxes.splits, boxes.theta, boxes.mean,
        _helpers(search), (found.sent, *boxes.known), still, needed, slack,
        slack[1:][at][:, None] + SLACK / len(uavs) * (worth[:, None] - boxes.bounds))


def _constant(search: MultiplierSearch, uavs: list[int]) -> Array | float:
    """Return what UAVs' columns are worth beyond their values, (G,)."""
    if not curved(search.point.potentials.shape[2]):
        return 0.0
    return np.asarray(sum(search.potential(uav).constant() for uav in uavs))


def _over(team: Team, still: Array, joint: Array, found: _Estimates, needed: NDArray[np.bool_],
          price: float) -> tuple[Array, Array]:
    """Return about the bounds of all pieces of w0, (PIECES, K, G), and of the stages, (G,)."""
    silent, weights = still.sum(0), found.weights
    joint = interpolated(joint[None], silent, weights, needed)[0]
    total = on_chords(weights, found.shares, needed).sum(-1)
    value = over_pieces(team, silent, joint, weights, total, price)
    return value, np.maximum(silent, value.max((0, 1)))


def _slack(team: Team, still: Array, joint: Array, found: _Estimates, needed: NDArray[np.bool_],
           price: float) -> Array:
    """Return by how much silence and every breakpoint could be higher for nothing, (K + 1, G)."""
    weights = found.weights
    value, best = _over(team, still, joint, found, needed, price)
    # A breakpoint that is too high lifts the pieces on both sides, the less the farther they are.
    slack = np.concatenate([(best - still.sum(0))[None], np.full(weights.shape, np.inf)])
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


def _shares(search: MultiplierSearch, weight: Array) -> tuple[Array, list[Array]]:
    """
    Return v (G, E) that nearly minimises a slot's bound at one breakpoint w0 (G,).

    And about what the terms of the transmitter and of all jammers are worth there, (G,) each.
    """
    team, point = search.team, search.point
    price, peak = point.prices[0], team.regions[0].peak
    v = point.shares * (weight / search.weight)[:, None]
    none = np.zeros_like(v)
    # What v does not change, and what it multiplies: of every UAV, or of the jammers together.
    # Those that are best at the present v join before every sweep: else v makes use of it that
    # others are missing. Measured: with one list a mission of one jammer is 24% above its plan
    # instead of 5%, others are the same.
    every = [(search.values(party, columns, weight[None], none[None])[0], columns.leaks)
             for party, columns in zip(parties(len(team.regions)), search.listed(weight, v))]
    chosen = [np.zeros((len(v), 0), int) for _ in every]
    row = np.arange(len(v))[:, None]

    def along(start: Array, way: Array) -> Callable[[Array], Array]:
        parts = [(base[row, few] + _dot(leaks[row, few], start), _dot(leaks[row, few], way))
                 for (base, leaks), few in zip(every, chosen)]

        def value(x: Array) -> Array:
            s = np.clip((start + x[:, None] * way).sum(-1), 0.0, weight)
            return np.asarray(transmit_power(weight - s, price, peak)[0] - entropy(s) + sum(
                (base + x[:, None] * part).max(1) for base, part in parts))
        return value

    count = v.shape[-1]
    for sweep in range(SWEEPS[count > 1]):
        chosen = [np.concatenate([few, np.argpartition(
            base + _dot(leaks, v), -min(FEW, base.shape[1]), 1)[:, -FEW:]], 1)
            for few, (base, leaks) in zip(chosen, every)]
        share = v / np.maximum(v.sum(-1, keepdims=True), 1e-300)
        v = share * golden(along(none, share), 0 * weight, weight)[:, None]
        for e in range(count if sweep < SWEEPS[1] - 1 else 0):
            for f in range(e):
                way = np.zeros_like(v)
                way[:, e], way[:, f] = 1.0, -1.0
                moved = golden(along(v, way), -v[:, e], v[:, f])[:, None]
                v = np.maximum(v + way * moved, 0.0)
    return v, [(base + _dot(leaks, v)).max(1) for base, leaks in every]


def _helpers(search: MultiplierSearch) -> Array:
    """Return prices of the helpers' powers at which they use about what they have."""
    team = search.team
    s = search.point.shares.sum(-1)
    prices = []
    for region in team.helpers:
        gain = np.exp(region.log_gain) / np.min([
            ((region.nearest(place) + radius)**2 + region.altitude**2) / np.exp(advantage)
            for place, radius, advantage in zip(
                region.eavesdroppers, region.radii, region.log_advantages)], axis=0)
        low, high = 1e-12, 1e12
        for _ in range(80):
            price = (low * high)**0.5
            used = np.clip(s / price - 1 / gain, 0.0, region.peak) @ team.stages.count
            low, high = (price, high) if used > region.average * team.stages.slots else (
                low, price)
        prices.append(high)
    return np.array(prices)


def _dot(leaks: Array, v: Array) -> Array:
    """Return sum_e v_e leaks, (G, C), for leaks (G, C, E) and v (G, E)."""
    return np.asarray(np.matmul(leaks, v[..., None])[..., 0])
