"""What the certificate needs from a search: breakpoints of w0, each with its own v and boxes."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
import math

import numpy as np
from numpy.typing import NDArray

from .division import divided, fields_of, LISTENERS, SLACK
from .dual import parties, unpacked
from .multiplier_search import MultiplierSearch
from ..proof.certificate import Multipliers
from ..proof.chords import interpolated, neighbours, on_chords, over_pieces, pieces
from ..proof.conjugate import Array, entropy, transmit_power
from ..proof.team import Team

BREAKPOINTS = (0.5, 0.8, 0.93, 0.98, 0.995, 1.0)
"""Breakpoints w0 of the certificate, beside the one that the search has used."""

FEW, SWEEPS = 60, (2, 5)
"""Columns that join those from which v is chosen, and how often: with one eavesdropper, more."""

TOLERANCE = 2e-4
"""What a maximum may be too large, in nats."""

SPARED = (1e-4, 2e-3)
"""
By how much a stage's bound may rise for a breakpoint that is left out, in nats.

With up to one jammer and with several, whose boxes lose more than that at every breakpoint.
"""

FEWER = {3: 2}
"""
How many count where that is better: what fewer hear is divided more finely.

Measured on ten missions of three jammers: with three at all breakpoints some are up to 12% of
their rate farther above their plans, with two up to 10%.
"""

PILOT = 0.2
"""Share of the cuts by which that is decided."""

NEGLIGIBLE = 0.02
"""Share of all v below which an eavesdropper does not count at a breakpoint."""


def breakpoint_multipliers(search: MultiplierSearch,
                           stop: Callable[[], bool] = lambda: False) -> Multipliers:
    """
    Return what the certificate needs, for its own breakpoints of w0.

    :param stop: asked now and then; True ends the division into boxes.
    """
    team, point, uavs = search.team, search.point, range(len(search.team.regions))
    weights = np.sort([*(np.full(len(search.weight), w0) for w0 in BREAKPOINTS), search.weight],
                      axis=0)
    counted = _largest(point.shares, LISTENERS.get(team.copies, team.eavesdroppers))
    shares, known, jammed = _worth(search, weights, np.broadcast_to(
        counted, (*weights.shape, team.eavesdroppers)))
    still = np.array([search.values([i], search.silent(i)).max(1) + _constant(search, [i])
                      for i in uavs])
    estimates = _Estimates(team, point.prices[0], weights, shares, still.sum(0))
    needed, joint = np.ones(weights.shape, bool), known + jammed
    most = estimates.over(joint, needed)[1] + SPARED[team.jammers > 1]
    for k in range(len(needed) - 1):
        trial = needed.copy()
        trial[k] = False
        needed[k] = ~(estimates.over(joint, trial)[1] <= most)
    at = np.nonzero(needed)
    slack = estimates.slack(joint, needed)[1:][at]
    fields = fields_of(search)
    if team.eavesdroppers > FEWER.get(team.copies, math.inf):
        other = _worth(search, weights, _largest(shares, FEWER[team.copies]))
        values = [first[at] + _alone(team, point.prices[0], weights[at], v[at].sum(-1)) + divided(
            search, fields, at[1], weights[at], v[at], second[at], SLACK / 2 * slack, stop,
            PILOT)[1]
            for v, first, second in ((shares, known, jammed), other)]
        better = tuple(part[values[1] < values[0]] for part in at)
        for one, two in zip((shares, known, jammed), other):
            one[better] = two[better]
        estimates, joint = replace(estimates, shares=shares), known + jammed
        slack = estimates.slack(joint, needed)[1:][at]
    boxes, worst = divided(search, fields, at[1], weights[at], shares[at], jammed[at],
                           SLACK / 2 * slack, stop)
    joint[at] = known[at] + worst
    slack = TOLERANCE + SLACK / len(uavs) * estimates.slack(joint, needed)
    boxes = replace(boxes, slack=boxes.slack + slack[1:][at][:, None])
    return Multipliers(
        *unpacked(point.potentials.transpose(1, 0, 2)), point.prices, _helpers(search), weights,
        shares, needed, boxes, still, known, slack)


def _constant(search: MultiplierSearch, uavs: list[int]) -> Array:
    """Return what UAVs' columns are worth beyond their values, (G,)."""
    some = [search.potential(uav) for uav in uavs]
    return np.sum([one.constant() if one.curved else one.turning() for one in some], axis=0)


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


def _worth(search: MultiplierSearch, weights: Array,
           counted: NDArray[np.bool_]) -> tuple[Array, Array, Array]:
    """
    Return v (K, G, E) at the breakpoints of w0 (K, G).

    And about what the terms of the transmitter and of all jammers are worth there, (K, G) each.

    :param counted: whose v may be above 0, (K, G, E).
    """
    found = [_shares(search, *both) for both in zip(weights, counted)]
    worth = np.zeros((2, *weights.shape))
    for number, party in enumerate(parties(len(search.team.regions))):
        worth[number] = [terms[number] for _, terms in found]
        worth[number] += _constant(search, party)
    return np.array([v for v, _ in found]), *worth


def _largest(shares: Array, count: int) -> NDArray[np.bool_]:
    """Return whose v are the largest ones, (..., E)."""
    return np.asarray((-shares).argsort(-1).argsort(-1) < count)


def _alone(team: Team, price: float, weight: Array, total: Array) -> Array:
    """Return a slot's bound at w0 and s but for what v multiplies, m(w0 - s) - H(s)."""
    return transmit_power(weight - total, price, team.regions[0].peak)[0] - entropy(total)


def _shares(search: MultiplierSearch, weight: Array,
            counted: NDArray[np.bool_]) -> tuple[Array, list[Array]]:
    """
    Return v (G, E) that nearly minimises a slot's bound at one breakpoint w0 (G,).

    And about what the terms of the transmitter and of all jammers are worth there, (G,) each.

    :param counted: whose v may be above 0, (G, E).
    """
    team, point = search.team, search.point
    v = np.where(counted, point.shares * (weight / search.weight)[:, None], 0.0)
    none = np.zeros_like(v)
    # What v does not change, and what it multiplies: of every UAV, or of the jammers together.
    # Those that are best at the present v join before every sweep: else v makes use of it that
    # others are missing. Measured: with one list a mission of one jammer is 24% above its plan
    # instead of 5%, others are the same.
    every = [(search.values(party, columns, weight, none), columns.leaks)
             for party, columns in zip(parties(len(team.regions)), search.listed(weight, v))]
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
                v = np.maximum(v + way * (moved * counted[:, e] * counted[:, f])[:, None], 0.0)
    if team.jammers > 1:  # What they do is divided by those that count.
        v = np.where(v > NEGLIGIBLE * v.sum(-1, keepdims=True), v, 0.0)
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


def _helpers(search: MultiplierSearch) -> Array:
    """Return prices of the helpers' powers at which they use about what they have."""
    team = search.team
    s = search.point.shares.sum(-1)
    prices = []
    for region in team.helpers:
        gain = np.exp(region.largest_gain())
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
