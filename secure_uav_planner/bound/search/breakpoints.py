"""What the certificate needs from a search: breakpoints of w0 and of rho, each with its own v."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .descent import golden
from .dual import Branch, curved, Dual, unpacked
from .multiplier_search import MultiplierSearch
from ..proof.chords import interpolated, neighbours, on_chords, over_pieces, pieces
from ..proof.conjugate import Array, entropy, mixing, transmit_power
from ..proof.jammer_shares import corners, no_splits, over_boxes, share_boxes, Splits
from ..proof.multipliers import Multipliers
from ..proof.team import Team
from ...model.kernel import core

BREAKPOINTS = (0.5, 0.8, 0.93, 0.98, 0.995, 1.0)
"""Breakpoints w0 of the certificate, beside those that the search has used."""

SPLITS, MORE = 3, 20
"""How often two jammers' shares and powers are cut at all breakpoints, and at those needed."""

"""Share of a jammer from which it is cut no finer, and steps for the best theta."""

FEW = 300
"""Columns of every UAV in every mode from which v is chosen."""

TOLERANCE = 5e-4
"""What a maximum may be too large, in nats."""

SPARED = 1e-4
"""By how much a stage's bound may rise for a breakpoint that is left out, in nats."""

SLACK = 0.5
"""Share of what a node's maximum could be too large without raising its stage's bound."""


def breakpoint_multipliers(search: MultiplierSearch,
                           tolerance: float = TOLERANCE) -> Multipliers:
    """
    Return what the certificate needs, for its own breakpoints of w0 and of rho.

    :param tolerance: what a maximum may be too large, in nats.
    """
    if not search.seen:
        search.dual(0.01)
    team, point = search.team, search.point
    count, uavs = len(team.stages.count), len(team.regions)
    dual = Dual(team, [], [], [], 1e-9)
    breakpoints = np.sort([*(np.full(count, w0) for w0 in BREAKPOINTS), *search.weights], axis=0)
    shares = np.array([_shares(search, dual, weight) for weight in breakpoints])
    still = np.array([dual.values(i, point, search.silent(i))[0].max(1) for i in range(uavs)])
    known = [dual.values(i, point, search.seen[i], list(zip(breakpoints, shares))).max(2)
             for i in range(min(uavs, 2))]
    every = np.ones(breakpoints.shape, bool)
    division = _Division(no_splits(every.shape), np.ones((1, *every.shape)),
                         np.zeros((1, team.eavesdroppers, *every.shape)),
                         np.array([part[None, None] for part in known[1:]]))
    if team.jammers > 1:
        division = _Division.of(search, breakpoints, shares, every, SPLITS)
    known[1:] = division.known
    for i in range(uavs):
        constant = search.potential(i).constant() if curved(point.potentials.shape[2]) else 0.0
        still[i] += constant
        known[i] = known[i] + constant
    x = point.potentials.transpose(1, 0, 2)
    slope, bend, turn = unpacked(x)
    given = Multipliers(
        slope, bend, turn, point.prices, breakpoints, shares, division.splits,
        division.theta, division.slope, _helpers(search), tuple(known), still, every,
        np.full((len(breakpoints) + 1, count), tolerance),
        np.full(division.theta.shape, tolerance))
    given = replace(given, needed=_needed(team, given))
    if team.jammers > 1:
        finer = _Division.of(search, breakpoints, shares, given.needed, MORE)
        given = replace(given, splits=finer.splits, theta=finer.theta, theta_slope=finer.slope,
                        known=(given.known[0], *finer.known),
                        box_slack=np.full(finer.theta.shape, tolerance))
    return _with_slack(team, given, tolerance)


def _boxes(team: Team, given: Multipliers) -> Array:
    """Return about the bounds of the jammers' terms in every box, (B, K, G)."""
    if team.jammers < 2:
        return given.known[1][:, 0] if team.jammers else np.zeros((1, *given.weights.shape))
    low, high, _ = share_boxes(given.splits, team.eavesdroppers)
    theta = given.theta[:, None] + (corners(low, high) * given.theta_slope[:, None]).sum(2)
    values = given.known[1] + given.known[2] - given.weights * mixing(np.stack([theta, 1 - theta]))
    return over_boxes(values, low, high, given.shares)


def _over(team: Team, given: Multipliers, boxes: Array,
          needed: NDArray[np.bool_]) -> tuple[Array, Array]:
    """Return about the bounds of all pieces of w0, (PIECES, K, G), and of the stages, (G,)."""
    silent, weights = given.still.sum(0), given.weights
    joint = interpolated((given.known[0] + boxes.max(0))[None], silent, weights, needed)[0]
    total = on_chords(weights, given.shares, needed).sum(-1)
    value = over_pieces(team, silent, joint, weights, total, given.prices[0])
    return value, np.maximum(silent, value.max((0, 1)))


def _needed(team: Team, given: Multipliers) -> NDArray[np.bool_]:
    """Return which breakpoints matter, (K, G)."""
    needed, boxes = given.needed.copy(), _boxes(team, given)
    most = _over(team, given, boxes, needed)[1] + SPARED
    for k in range(len(needed) - 1):
        trial = needed.copy()
        trial[k] = False
        needed[k] = ~(_over(team, given, boxes, trial)[1] <= most)
    return needed


def _with_slack(team: Team, given: Multipliers, tolerance: float) -> Multipliers:
    """Return multipliers with what their maxima may be too large."""
    silent, weights, needed = given.still.sum(0), given.weights, given.needed
    boxes = _boxes(team, given)
    value, best = _over(team, given, boxes, needed)
    # A breakpoint that is too high lifts the pieces on both sides, the less the farther they are.
    slack = np.concatenate([(best - silent)[None], np.full(weights.shape, np.inf)])
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
    factor = SLACK / len(team.regions)
    # Only the highest of all boxes counts.
    box = np.nan_to_num(boxes.max(0) - boxes, posinf=0.0)
    return replace(given, slack=tolerance + factor * slack,
                   box_slack=tolerance + factor * (slack[1:] + box))


@dataclass(frozen=True, eq=False)
class _Division:
    """
    The boxes of the jammers' shares and powers at breakpoints; see jammer_shares.

    :param splits: (S, K, G) each.
    :param theta: where the shares are 0, (B, K, G).
    :param slope: of theta by the shares, (B, E, K, G).
    :param known: what both jammers' terms are worth at the corners, (2, B, V, K, G).
    """

    splits: Splits
    theta: Array
    slope: Array
    known: Array

    @classmethod
    def of(cls, search: MultiplierSearch, weights: Array, shares: Array,
           needed: NDArray[np.bool_], count: int) -> _Division:
        """
        Cut what two jammers can do, the box with the largest bound again and again.

        :param weights: w0, (K, G).
        :param shares: v, (K, G, E).
        :param needed: where, (K, G).
        :param count: of the cuts.
        """
        team, point = search.team, search.point
        dual = Dual(team, [], [], [], 1e-9)
        k, g = np.nonzero(needed)
        e = shares.shape[-1]
        given: dict[str, list[Any]] = {}
        for j, columns in enumerate(search.candidates[1:], 1):
            region, cost = team.regions[j], point.prices[j] * columns.power
            with np.errstate(divide='ignore'):
                power = np.log(columns.power)
            for name, value in {
                    'place': columns.place, 'power': power,
                    'base': dual.values(j, point, columns)[0] + cost,
                    'pull': search.potential(j).change[0],
                    'people': np.concatenate([[region.ground], region.eavesdroppers]),
                    'radii': np.append(0.0, region.radii),
                    'gain': np.exp(region.log_gain + math.log(team.copies) + np.append(
                        0.0, region.log_advantages)),
                    'altitude': region.altitude, 'distance': region.distance,
                    'price': point.prices[j], 'peak': math.log(region.peak),
                    'from_start': region.from_start, 'to_goal': region.to_goal,
                    'width': np.subtract(*region.sides[::-1]).max(1)}.items():
                given.setdefault(name, []).append(value)
        box, side = np.zeros((2, len(k), count), np.int64)
        at, theta = np.zeros((len(k), count)), np.zeros((len(k), count + 1))
        slope, known = np.zeros((*theta.shape, e)), np.zeros((*theta.shape, 2, 2**e))
        core.bound_share_boxes({
            **{name: np.ascontiguousarray(value, float) for name, value in given.items()},
            'stages': weights.shape[1], 'stage': g.astype(np.int64),
            'weight': weights[k, g], 'shares': shares[k, g], 'box': box, 'side': side, 'at': at,
            'theta': theta, 'slope': slope, 'known': known})

        def spread(values: NDArray[Any], *axes: int) -> NDArray[Any]:
            values = values.transpose(*(axis + 1 for axis in axes), 0)
            found = np.zeros(values.shape[:-1] + weights.shape, values.dtype)
            found[..., k, g] = values
            return found
        return cls((spread(box, 0), spread(side, 0), spread(at, 0)), spread(theta, 0),
                   spread(slope, 0, 1), spread(known, 1, 0, 2))


def _shares(search: MultiplierSearch, dual: Dual, weight: Array) -> Array:
    """Return v (G, E) that nearly minimises a slot's bound at one breakpoint w0 (G,)."""
    team, point = search.team, search.point
    price, peak = point.prices[0], team.regions[0].peak
    v = point.shares[0] * (weight / search.weights[0])[:, None]
    none = np.zeros_like(v)
    branches = [Branch(weight, 0, search.initial.theta, search.initial.rho)]
    if team.jammers > 1:
        branches = [Branch.of_two(weight, 0, *mode) for mode in search.modes(
            weight, v, search.candidates)]
    # What v does not change, of every UAV in every mode, and what it multiplies.
    lists = []
    for branch in branches:
        for i, columns in enumerate(search.seen):
            ground, parts = branch.parts(i)
            worth = dual.values(i, point, columns, [(weight * ground, none),
                                                    (weight * ground, v * parts)])
            few = np.argpartition(worth[1], -min(FEW, worth.shape[2]), 1)[:, -FEW:]
            lists.append((np.take_along_axis(worth[0], few, 1),
                          columns.take(few).leaks * parts[:, None]))
    extra = [mixing(one.rho) if team.jammers else none for one in branches]
    less = [weight * mixing(one.theta) if team.jammers else none[:, 0] for one in branches]
    uavs = len(team.regions)

    def along(start: Array, way: Array) -> Callable[[Array], Array]:
        parts = [(base + _dot(leaks, start), _dot(leaks, way)) for base, leaks in lists]

        def value(x: Array) -> Array:
            trial = start + x[:, None] * way
            s = np.clip(trial.sum(-1), 0.0, weight)
            sums = [sum((base + x[:, None] * part).max(1)
                        for base, part in parts[uavs * m:uavs * (m + 1)])
                    + (trial * extra[m]).sum(-1) - less[m] for m in range(len(branches))]
            return np.asarray(transmit_power(weight - s, price, peak)[0] - entropy(s)
                              + np.max(sums, axis=0))
        return value

    count = v.shape[-1]
    for sweep in range(4 if count > 1 else 1):
        share = v / np.maximum(v.sum(-1, keepdims=True), 1e-300)
        v = share * golden(along(none, share), 0 * weight, weight)[:, None]
        for e in range(count if sweep < 3 else 0):
            for f in range(e):
                way = np.zeros_like(v)
                way[:, e], way[:, f] = 1.0, -1.0
                moved = golden(along(v, way), -v[:, e], v[:, f])[:, None]
                v = np.maximum(v + way * moved, 0.0)
    return np.asarray(v)


def _helpers(search: MultiplierSearch) -> Array:
    """Return prices of the helpers' powers at which they use about what they have."""
    team = search.team
    s = search.point.shares[0].sum(-1)
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


def second_breakpoint(search: MultiplierSearch) -> None:
    """Add a breakpoint of w0 to those that the multipliers have to be good for: the next best."""
    given = breakpoint_multipliers(search)
    team, price = search.team, search.point.prices[0]
    total = given.shares.sum(-1)
    value = given.known[0] + _boxes(team, given).max(0) - entropy(total)
    value += entropy(given.weights) + (
        transmit_power(np.maximum(given.weights - total, 0.0), price, team.regions[0].peak)[0])
    first = search.weights[0]
    # Neighbours of the first breakpoint are as good as it is: what counts is a hump elsewhere.
    value[np.abs(given.weights - first) < 1e-9] = -np.inf
    best = value.argmax(0)
    row = np.arange(len(first))
    weight = np.minimum(given.weights[best, row], 1 - 1e-9)
    v = np.clip(given.shares[best, row], 1e-6, None)
    s = v.sum(-1)
    room = first - search.point.shares[0].sum(-1)
    v *= (np.minimum(s, weight - np.minimum(room, weight / 2)) / s)[:, None]
    search.weights.append(weight)
    search.point = replace(search.point, shares=np.concatenate([search.point.shares, v[None]]))
