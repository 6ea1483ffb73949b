"""What the certificate needs from a search: breakpoints of w0 and of rho, each with its own v."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from itertools import product

import numpy as np
from numpy.typing import NDArray

from .descent import golden
from .dual import Branch, curved, Dual, unpacked
from .multiplier_search import MultiplierSearch
from ..proof.chords import interpolated, neighbours, on_chords, over_pieces, pieces
from ..proof.conjugate import Array, entropy, mixing, sigmoid, transmit_power
from ..proof.jammer_shares import affine, corners, no_splits, over_boxes, share_boxes
from ..proof.multipliers import Multipliers
from ..proof.team import Team

BREAKPOINTS = (0.5, 0.8, 0.93, 0.98, 0.995, 1.0)
"""Breakpoints w0 of the certificate, beside those that the search has used."""

SPLITS = {0: 0, 1: 0, 2: 7}
"""How often the jammers' shares are divided, by the number of jammers that are followed."""

END, STEPS = 0.005, 16
"""Share of a jammer from which it is cut no finer, and steps for the best theta."""

FEW = 300
"""Columns of every UAV in every mode from which v is chosen."""

TOLERANCES = {0: 5e-4, 1: 5e-4, 2: 2e-3}
"""What a maximum may be too large, in nats, by the number of jammers that are followed."""

SPARED = 1e-4
"""By how much a stage's bound may rise for a breakpoint that is left out, in nats."""

SLACK = 0.3
"""Share of what a node's maximum could be too large without raising its stage's bound."""


def breakpoint_multipliers(search: MultiplierSearch,
                           tolerance: float | None = None) -> Multipliers:
    """
    Return what the certificate needs, for its own breakpoints of w0 and of rho.

    :param tolerance: what a maximum may be too large, in nats; by default one of TOLERANCES.
    """
    if not search.seen:
        search.dual(0.01)
    team, point = search.team, search.point
    count, uavs = len(team.stages.count), len(team.regions)
    dual = Dual(team, [], [], [], 1e-9)
    breakpoints = np.sort([*(np.full(count, w0) for w0 in BREAKPOINTS), *search.weights], axis=0)
    shares = np.array([_shares(search, dual, weight) for weight in breakpoints])
    boxes = _Boxes(search, dual, breakpoints, shares)
    for _ in range(SPLITS[team.jammers]):
        boxes.split()
    still = np.array([dual.values(i, point, search.silent(i))[0].max(1) for i in range(uavs)])
    known = [dual.values(i, point, search.seen[i], list(zip(breakpoints, shares))).max(2)
             for i in range(min(uavs, 2))]
    if uavs > 1:
        known[1:] = boxes.known if uavs == 3 else [known[1][None, None]]
    for i in range(uavs):
        constant = search.potential(i).constant() if curved(point.potentials.shape[2]) else 0.0
        still[i] += constant
        known[i] = known[i] + constant
    x = point.potentials.transpose(1, 0, 2)
    slope, bend, turn = unpacked(x)
    if tolerance is None:
        tolerance = TOLERANCES[team.jammers]
    given = Multipliers(
        slope, bend, turn, point.prices, breakpoints, shares, boxes.splits, boxes.theta,
        boxes.slope,
        _helpers(search), tuple(known), still, np.ones(breakpoints.shape, bool),
        np.full((len(breakpoints) + 1, count), tolerance),
        np.full(boxes.theta.shape, tolerance))
    return _thinned(team, given, tolerance)


def _boxes(team: Team, given: Multipliers) -> Array:
    """Return about the bounds of the jammers' terms in every box, (B, K, G)."""
    if team.jammers < 2:
        return given.known[1][:, 0] if team.jammers else np.zeros((1, *given.weights.shape))
    low, high = share_boxes(given.splits, team.eavesdroppers)
    theta = given.theta[:, None] + (corners(low, high) * given.theta_slope[:, None]).sum(2)
    values = given.known[1] + given.known[2] - given.weights * mixing(np.stack([theta, 1 - theta]))
    return over_boxes(values, low, high, given.shares)


def _thinned(team: Team, given: Multipliers, tolerance: float) -> Multipliers:
    """Return multipliers without breakpoints that matter little, and slack for the others."""
    silent, weights = given.still.sum(0), given.weights
    boxes = _boxes(team, given)
    estimate = given.known[0] + boxes.max(0)

    def over(needed: NDArray[np.bool_]) -> tuple[Array, Array]:
        joint = interpolated(estimate[None], silent, weights, needed)[0]
        total = on_chords(weights, given.shares, needed).sum(-1)
        value = over_pieces(team, silent, joint, weights, total, given.prices[0])
        return value, np.maximum(silent, value.max((0, 1)))

    needed = given.needed.copy()
    most = over(needed)[1] + SPARED
    for k in range(len(weights) - 1):
        trial = needed.copy()
        trial[k] = False
        needed[k] = ~(over(trial)[1] <= most)
    value, best = over(needed)
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
    return replace(given, needed=needed, slack=tolerance + factor * slack,
                   box_slack=tolerance + factor * (slack[1:] + box))


class _Boxes:
    """
    The boxes of the first jammer's shares at all breakpoints, by what columns are worth.

    :param weights: w0, (K, G).
    :param shares: v, (K, G, E).
    :ivar splits: see jammer_shares.
    :ivar theta: where the shares are 0, (B, K, G).
    :ivar slope: of theta by the shares, (B, E, K, G).
    :ivar known: what both jammers' terms are worth at the corners, (2, B, V, K, G).
    """

    def __init__(self, search: MultiplierSearch, dual: Dual, weights: Array,
                 shares: Array) -> None:
        self._search, self._dual, self._weights, self._shares = search, dual, weights, shares
        self._at = tuple(np.indices(weights.shape))
        self.splits = no_splits(weights.shape)
        low, high = share_boxes(self.splits, shares.shape[-1])
        self.theta, self.slope = np.ones((1, *weights.shape)), np.zeros_like(low)
        if search.team.jammers == 2:
            self._columns = [search.few(dual, j) for j in (1, 2)]
            self.theta, self.slope, self.known, self._sum, self._slopes = self._fitted(low, high)

    def split(self) -> None:
        """Cut the box with the largest bound at every breakpoint where its plane fits least."""
        k, g = self._at
        low, high = share_boxes(self.splits, self._shares.shape[-1])
        worst = over_boxes(self._sum, low, high, self._shares).argmax(0)
        low, high = (np.moveaxis(part[worst, :, k, g], -1, 0) for part in (low, high))
        # How much the sum bends along every share, by its slopes at the corners.
        slope = np.moveaxis(self._slopes[worst, ..., k, g], (-2, -1), (0, 1))
        corner = np.array(list(product((0, 1), repeat=len(low))), bool)
        bends = [((slope[corner[:, e], e] - slope[~corner[:, e], e]) * width).max(0)
                 for e, width in enumerate(high - low)]
        which = np.argmax(bends, axis=0)
        # The middle, by the logarithm of what one jammer is heard with more than the other.
        ends = [np.clip(part[which, k, g], END, 1.0 - END) for part in (low, high)]
        cut = sigmoid(sum(np.log(end / (1.0 - end)) for end in ends) / 2)
        box, share, at = self.splits
        self.splits = (np.concatenate([box, worst[None]]), np.concatenate([share, which[None]]),
                       np.concatenate([at, cut[None]]))
        low, high = share_boxes(self.splits, len(low))
        both = np.stack([worst, np.full_like(worst, len(low) - 1)])
        found = self._fitted(*(np.moveaxis(part[both, :, k, g], -1, 1) for part in (low, high)))
        self.theta, self.slope, self._sum, self._slopes, *known = (
            self._replaced(old, new, worst) for old, new in zip(
                (self.theta, self.slope, self._sum, self._slopes, *self.known),
                (found[0], found[1], found[3], found[4], *found[2])))
        self.known = np.stack(known)

    def _replaced(self, old: Array, new: Array, worst: Array) -> Array:
        """Return values of boxes (B, ..., K, G) with those that were cut, and the new boxes."""
        whole = np.concatenate([old, new[1:]])
        whole[worst, ..., self._at[0], self._at[1]] = np.moveaxis(new[0], (-2, -1), (0, 1))
        return whole

    def _fitted(self, low: Array, high: Array) -> tuple[Array, Array, Array, Array, Array]:
        """Return theta, its slope, both jammers' terms, F, and its slopes, for some boxes."""
        at = corners(low, high)
        best = golden(lambda theta: self._worth(theta, at)[1],
                      np.zeros_like(at[:, :, 0]), np.ones_like(at[:, :, 0]), STEPS)
        slope, middle, centre = affine(low, high, best), best.mean(1), (low + high) / 2
        rise = ((at - centre[:, None]) * slope[:, None]).sum(2)
        room = np.minimum(middle, 1.0 - middle) * (1 - 1e-9)
        slope = slope * np.minimum(1.0, room / np.maximum(np.abs(rise).max(1), 1e-300))[:, None]
        start = middle - (centre * slope).sum(1)
        theta = np.clip(start[:, None] + (at * slope[:, None]).sum(2), 0.0, 1.0)
        return start, slope, *self._worth(theta, at)

    def _worth(self, theta: Array, rho: Array) -> tuple[Array, Array, Array]:
        """Return both jammers' terms at (B, V, E, K, G), F, and its slopes by rho."""
        breakpoints, count = self._weights.shape
        known = np.empty((2, *theta.shape))
        slopes = np.zeros(rho.shape)
        row = np.arange(count)
        for j, (columns, share, part) in enumerate(zip(
                self._columns, (theta, 1.0 - theta), (rho, 1.0 - rho))):
            for b, vertex in np.ndindex(*theta.shape[:2]):
                worth = self._dual.values(j + 1, self._search.point, columns, [
                    (self._weights[k] * share[b, vertex, k],
                     self._shares[k] * part[b, vertex, :, k].T) for k in range(breakpoints)])
                known[j, b, vertex] = worth.max(2)
                leaks = columns.leaks[row, worth.argmax(2)] * self._shares
                slopes[b, vertex] += (1 - 2 * j) * leaks.transpose(2, 0, 1)
        total = known.sum(0) - self._weights * mixing(np.stack([theta, 1.0 - theta]))
        return known, total, slopes


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
