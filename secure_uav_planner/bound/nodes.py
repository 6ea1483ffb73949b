"""What the certificate needs from a search: nodes of w0 and of rho, each with its own v."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from .certificate import gibbs
from .chords import chords, neighbours, on_chords, over_pieces, pieces
from .conjugate import Array, entropy, transmit_power
from .dual import Branch, Dual
from .multipliers import Multipliers
from .team import Team

if TYPE_CHECKING:
    from .search import Search

NODES = (0.5, 0.8, 0.93, 0.98, 0.995, 1.0)
"""Nodes w0 of the certificate, beside those that the search has used."""

DIVISIONS = (0.0, 0.02, 0.1, 0.25, 0.5, 0.75, 0.9, 0.98, 1.0)
"""
Nodes rho of the certificate with two jammers.

Measured: without 0.02, 0.25 and their mirror images, bounds are 0.5 to 2.5% higher.
"""


TOLERANCES = {0: 5e-4, 1: 5e-4, 2: 2e-3}
"""What a maximum may be too large, in nats, by the number of jammers that are followed."""

SPARED = 1e-4
"""By how much a stage's bound may rise for a node that is left out, in nats."""

SLACK = 0.3
"""Share of what a node's maximum could be too large without raising its stage's bound."""


def multipliers(search: Search, tolerance: float | None = None) -> Multipliers:
    """
    Return what the certificate needs, for its own nodes of w0 and of rho.

    :param tolerance: what a maximum may be too large, in nats; by default one of TOLERANCES.
    """
    if not search.seen:
        search.dual(0.01)
    team, point = search.team, search.point
    count, uavs = len(team.stages.count), len(team.lenses)
    dual = Dual(team, [], [], search.branches(), 1e-9)
    nodes = np.sort([*(np.full(count, node) for node in NODES), *search.weights], axis=0)
    potential = [dual.potential(i, point, columns.place)[0]
                 for i, columns in enumerate(search.seen)]
    shares = np.array([_shares(search, weight, potential) for weight in nodes])
    divisions = np.array(DIVISIONS if team.jammers == 2 else (1.0,))
    theta = np.ones((len(nodes), len(divisions), count))
    known = np.zeros((uavs, len(nodes), len(divisions), count))
    for k, (weight, v) in enumerate(zip(nodes, shares)):
        for r, rho in enumerate(divisions):
            if team.jammers == 2:
                theta[k, r] = theta_of(search, weight, v, float(rho))
            branch = Branch(weight, 0, theta[k, r], np.full(count, rho))
            for i, columns in enumerate(search.seen):
                ground, leak = branch.parts(i)
                known[i, k, r] = (potential[i] + columns.value(
                    weight * ground, v * leak[:, None], point.prices[i])).max(1)
    still = np.array([dual.potential(i, point, search.places[i])[0].max(1)
                      for i in range(uavs)])
    for i in range(uavs if point.potentials.shape[2] == 5 else 0):
        jump = search.potential(i).constant()
        known[i] += jump
        still[i] += jump
    x = point.potentials.transpose(1, 0, 2)
    bend = x[..., 2:] if x.shape[2] == 5 else np.zeros(x.shape[:2] + (3,))
    if tolerance is None:
        tolerance = TOLERANCES[team.jammers]
    given = Multipliers(x[..., :2], bend, point.prices, nodes, shares, theta, divisions,
                        _helpers(search), known, still, np.ones(nodes.shape, bool),
                        np.full((len(nodes) + 1, count), tolerance))
    return _thinned(team, given, tolerance)


def _thinned(team: Team, given: Multipliers, tolerance: float) -> Multipliers:
    """Return multipliers without the nodes that matter little, and with slack for the others."""
    silent, weights = given.still.sum(0), given.weights
    guess = given.known.sum(0).transpose(1, 0, 2) + [
        gibbs(team, weights, given.theta[:, r], given.shares.sum(-1))
        for r in range(len(given.divisions))]

    def over(needed: NDArray[np.bool_]) -> tuple[Array, Array]:
        values = chords(guess, silent, weights, needed)
        total = on_chords(weights, given.shares, needed).sum(-1)
        value = over_pieces(team, given.divisions, silent, values, weights, total,
                            given.prices[0])
        return value, np.maximum(silent, value.max((0, 1)))

    needed = given.needed.copy()
    most = over(needed)[1] + SPARED
    for k in range(len(weights) - 1):
        trial = needed.copy()
        trial[k] = False
        needed[k] = ~(over(trial)[1] <= most)
    value, best = over(needed)
    # A node that is too high lifts the pieces on both sides, the less the farther they are.
    slack = np.concatenate([(best - silent)[None], np.full(weights.shape, np.inf)])
    column = np.arange(weights.shape[1])
    at = np.concatenate([0 * weights[:1], weights])
    below, above = neighbours(needed)
    x = pieces()[:, None]
    for k in range(len(weights)):
        low, high = at[below[k], column], at[above[k], column]
        share = (at[k] + (at[k + 1] - at[k]) * x - low) / np.maximum(high - low, 1e-300)
        gap = best - value[:, k]
        for node, part in ((below[k], 1 - share[:-1]), (above[k], share[1:])):
            room = (gap / np.maximum(part, 1e-9)).min(0)
            slack[node, column] = np.minimum(slack[node, column], room)
    return replace(given, needed=needed, slack=tolerance + SLACK / len(team.lenses) * slack)


def _shares(search: Search, weight: Array, potential: list[Array]) -> Array:
    """Return v (G, E) that nearly minimises a slot's bound at one node w0 (G,)."""
    price, peak = search.point.prices[0], search.team.lenses[0].peak
    none = np.zeros(search.point.shares.shape[1:])
    branch = Branch(weight, 0, search.guess.theta, search.guess.rho)
    fixed, leaks = [], []
    for i, columns in enumerate(search.seen):
        ground, leak = branch.parts(i) if search.team.jammers == 2 else (1.0, np.ones(1))
        fixed.append(potential[i] + columns.value(weight * ground, none,
                                                  search.point.prices[i]))
        leaks.append(columns.leaks * np.asarray(leak)[:, None, None])

    def along(start: Array, way: Array) -> Callable[[Array], Array]:
        parts = [(base + _dot(part, start), _dot(part, way))
                 for base, part in zip(fixed, leaks)]
        total, slope = start.sum(-1), way.sum(-1)

        def value(x: Array) -> Array:
            s = np.clip(total + x * slope, 0.0, weight)
            y = transmit_power(weight - s, price, peak)[0] - entropy(s)
            for base, part in parts:
                y = y + (base + x[:, None] * part).max(1)
            return np.asarray(y)
        return value

    v = search.point.shares[0]
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


def _helpers(search: Search) -> Array:
    """Return prices of the helpers' powers at which they use about what they have."""
    team = search.team
    s = search.point.shares[0].sum(-1)
    prices = []
    for lens in team.helpers:
        gain = np.exp(lens.log_gain) / np.min([
            ((lens.nearest(place) + radius)**2 + lens.altitude**2) / np.exp(advantage)
            for place, radius, advantage in zip(
                lens.eavesdroppers, lens.radii, lens.log_advantages)], axis=0)
        low, high = 1e-12, 1e12
        for _ in range(80):
            price = (low * high)**0.5
            used = np.clip(s / price - 1 / gain, 0.0, lens.peak) @ team.stages.count
            low, high = (price, high) if used > lens.average * team.stages.slots else (
                low, price)
        prices.append(high)
    return np.array(prices)


def theta_of(search: Search, weight: Array, v: Array, rho: float) -> Array:
    """Return the first jammer's share at the ground node that nearly minimises a branch."""
    one = np.ones_like(weight)
    dual = Dual(search.team, [], [], [Branch(weight, 0, one, one)], 1e-9)
    fixed = [dual.potential(j, search.point, search.seen[j].place)[0]
             + search.seen[j].value(0 * weight, v * part, search.point.prices[j])
             for j, part in ((1, rho), (2, 1.0 - rho))]

    def value(theta: Array) -> Array:
        return np.asarray(-weight * entropy(theta) + sum(
            (part + (weight * share)[:, None] * search.seen[j].ground).max(1)
            for j, part, share in ((1, fixed[0], theta), (2, fixed[1], 1.0 - theta))))
    return golden(value, 0 * weight, np.ones_like(weight), 16)


def _dot(leaks: Array, v: Array) -> Array:
    """Return sum_e v_e leaks, (G, C), for leaks (G, C, E) and v (G, E)."""
    return np.asarray(np.matmul(leaks, v[..., None])[..., 0])


def golden(value: Callable[[Array], Array], low: Array, high: Array, steps: int = 20) -> Array:
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
