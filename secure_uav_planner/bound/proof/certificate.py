"""
The certificate: from multipliers to a bound, with nothing taken on trust.

With lemmas 1 to 3 the mean rate, in nats, of every plan is at most

    (1/N) [ sum over slots of B + sum over UAVs of Potential.end_cost ] + sum_i lam_i average_i,
    B   = max over w0 of H(w0) - H(v) + m(w0 - s) + M(w0, v),   s = sum_e v_e, v = v(w0),
    M   = M_0 + M_1,
    M_0 = max over q of w0 A_0(q) - sum_e v_e A_e(q) + potential(q),
    M_1 = max over q, p of -w0 log(1 + b_0(q) p) + sum_e v_e log(1 + b_e(q) p) - lam p
          + potential(q),

where A is the logarithm of a gain of the transmitter, b a gain of the jammer, and m the value of
maximise_power. M_0 and M_1 are bounded by branch and bound (terms.py) at a few breakpoints w0.

Lemma 4. M is a maximum of functions that are linear in (w0, v). So it is convex, and with v
interpolated linearly between the breakpoints it lies below the chord from breakpoint to
breakpoint. The entropies and m are known exactly and are therefore taken on PIECES finer pieces:
there, the convex part -H(v) + m + chord lies below its own chord, and max over w0 of slope w0 +
H(w0) is attained at w0 = phi'(slope), or at the nearer end of the piece. At w0 = 0 every v is 0.

Lemma 10. Lemma 1 holds for any v, so v may also depend on the place of a UAV. Let cells cover the
reachable set of the last UAV in a slot. In each cell v(w0) is chosen anew, and M of the last UAV
is a maximum over the cell. B is then at most its largest value of all cells. A single v for all
cells would let a jammer be near several eavesdroppers, near each for a part of the slot.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
import math

import numpy as np

from .reachable_set import Cells, Team
from .relaxation import margin
from .terms import Index, Potential, Terms, TOLERANCE
from ...mission.validation import Array

FLOOR = 1e-6
"""Received SNR of a jammer's power below which the largest effect of this power is taken."""

PIECES = 24
"""Pieces of the entropies between two breakpoints of w0."""


def sigmoid(z: Array) -> Array:
    """Return 1 / (1 + exp(-z)), the derivative of phi(z) = log(1 + exp(z)), without overflow."""
    return 1.0 / (1.0 + np.exp(-np.clip(z, -700.0, 700.0)))


def entropy(*weights: Array) -> Array:
    """
    Return the entropy H of a distribution of weights w_1, w_2, .. and their rest, in nats.

    Lemma 1. Let z0 be the logarithm of the SINR at the ground node, and z_e the logarithm of the
    SINR at place e. With colluding eavesdroppers all places of one disc form an adversary;
    otherwise all places of all discs form a single adversary.
    The leak is log(1 + sum_j exp(y_j)), y_j being the largest z_e of adversary j: only the worst
    place of a disc counts, so places of one disc do not add up. With phi(z) = log(1 + e^z),

        log(1 + sum_j exp(y_j)) = max over w >= 0, sum_j w_j <= 1 of sum_j w_j y_j + H(w),

    attained at w_j = exp(y_j) / (1 + sum_k exp(y_k)): the logarithm is concave, so with the rest
    r = 1 - sum_j w_j the sum r log(1 / r) + sum_j w_j log(exp(y_j) / w_j) is at most the logarithm
    of the mean. For one adversary this is phi(z) = max over w of w z + H(w). For every v >= 0 with
    s = sum_e v_e <= 1 let H(v) be the entropy of the sums w_j of v over every adversary. Then

        log(1 + sum_j exp(y_j)) >= sum_e v_e z_e + H(v),

    as w_j y_j >= sum of v_e z_e over adversary j. Hence, for any v(w0) >= 0 with s(w0) <= w0, the
    rate of a slot is

        phi(z0) - log(1 + sum_j exp(y_j))
            <= max over w0 in [0, 1] of w0 z0 + H(w0) - sum_e v_e(w0) z_e - H(v(w0)).

    z0 and z_e are sums of one term for each UAV, and so is the bracket: the UAVs separate.
    """
    weights = tuple(np.clip(weight, 0.0, 1.0) for weight in weights)
    rest = np.maximum(1.0 - sum(weights), 0.0)
    return -np.sum([part * np.log(np.maximum(part, 1e-300)) for part in (*weights, rest)], axis=0)


def maximise_power(weight: Array, price: float, peak: float) -> tuple[Array, Array]:
    """
    Return max over 0 < p <= peak of weight log p - price p, and the p where it is attained.

    Lemma 3. In lemma 1 the logarithm of the transmit power has the factor w0 - s >= 0, and the
    mean power over the slots is limited. So for every price lam >= 0 this maximum is the
    Lagrangian's term. It is attained at p = min(weight / lam, peak). For weight = 0 the supremum
    is 0, as p goes to 0.

    :param weight: w0 - s, at least 0.
    :param price: lam in nats per W, at least 0.
    :param peak: largest power [W].
    """
    # The logarithm needs p >= 1e-300. A smaller p has a weight below 1e-300 price, and the value
    # is then 0 in this arithmetic.
    power = np.minimum(weight / max(price, 1e-300), peak)
    return weight * np.log(np.maximum(power, 1e-300)) - price * power, power


@dataclass(frozen=True, eq=False)
class Multipliers:
    """
    The multipliers of a certificate: any numbers are valid, good ones make it tight.

    :param potentials: potential of each UAV.
    :param prices: lam, (U,) in nats per W, not negative.
    :param cells: C cells that cover the reachable sets of the last UAV.
    :param weights: w0 at the breakpoints, rising, (K, C), within (0, 1].
    :param v: eavesdropper multipliers at the breakpoints, (K, C, E), not negative, with a sum of
        at most w0.
    :param silent_incumbents: values near the maxima of a silent UAV's terms, (U, C) in nats.
    :param incumbents: values near the maxima of the terms at the breakpoints, (U, K, C) in nats.
    """

    potentials: tuple[Potential, ...]
    prices: Array
    cells: Cells
    weights: Array
    v: Array
    silent_incumbents: Array
    incumbents: Array


@dataclass(frozen=True, eq=False)
class Certificate:
    """
    A proven bound and its parts.

    :param rate: mean rate over the slots that no plan exceeds [bit/s/Hz].
    :param groups: B of every group, (G,) in nats.
    :param offset: the terms of the ends and of average powers [nats], so that
        rate log 2 = (sum of count B + offset) / N.
    :param potentials: potential of each UAV.
    :param prices: lam, (U,) in nats per W.
    """

    rate: float
    groups: Array
    offset: float
    potentials: tuple[Potential, ...]
    prices: Array


def certify(team: Team, multipliers: Multipliers,
            stop: Callable[[], bool] = lambda: False) -> Certificate:
    """
    Return the certificate that multipliers give.

    It is valid for any multipliers and whenever it is stopped. Negative prices and v are replaced
    by 0; v whose sum exceeds w0 are scaled down. The rate is infinite if a value is not a number.
    It holds for the objective and the scenario of the team's reachable sets only.

    :param stop: asked now and then; True ends the branch and bound, and the rate is larger.
    :raises AssertionError: unless w0 rises to 1 over the breakpoints.
    """
    potentials, cells = multipliers.potentials, multipliers.cells
    prices = np.maximum(multipliers.prices, 0.0)
    weights, v = _make_valid(multipliers)
    # Bounds of the sum of the UAVs' terms: in silence, (C,), and at every breakpoint, (K, C).
    silent, joint = np.zeros(len(cells.group)), np.zeros(weights.shape)
    for i, potential in enumerate(potentials):
        # Only the last UAV is restricted to cells, see lemma 10.
        own, cell = (cells, np.arange(len(cells.group))) if i == len(potentials) - 1 else (
            Cells.whole(potential.region), cells.group)
        own_silent = bound_silence(potential, own, cell, multipliers.silent_incumbents[i], stop)
        silent += own_silent
        joint += bound_terms(
            team, potential, i, own, np.tile(cell, len(weights)),
            np.tile(own_silent, len(weights)), weights.ravel(), v.reshape(-1, v.shape[2]),
            prices[i], multipliers.incumbents[i].ravel(), stop).reshape(weights.shape)
    pieces = bound_pieces(team, silent, joint, weights, v, prices[0])
    # B of a group is the largest bound of its cells and pieces of w0, plus rounding errors.
    bounds = np.full(len(team.groups.count), -np.inf)
    np.maximum.at(bounds, cells.group, np.maximum(silent, pieces.max((0, 1))))
    bounds = bounds + 4 * sum(margin(p.region.altitude, p.magnitude()) for p in potentials)
    ends = sum(potential.end_cost() for potential in potentials)
    powers = [team.groups.slots * price * region.average
              for price, region in zip(prices, team.regions)]
    offset = math.fsum([ends, *powers])
    terms = [*(team.groups.count * bounds), ends, *powers]
    total = math.fsum(terms) + 1e-14 * math.fsum(map(abs, terms))
    rate = total / team.groups.slots / math.log(2.0) * (1 + 1e-14)
    return Certificate(rate if not math.isnan(rate) else math.inf, bounds, offset, potentials,
                       prices)


def _make_valid(multipliers: Multipliers) -> tuple[Array, Array]:
    """
    Return w0 (K, C) clipped to [1e-12, 1], and v (K, C, E) >= 0 scaled so that sum v < w0.

    :raises AssertionError: unless w0 rises to 1.
    """
    if (np.diff(multipliers.weights, axis=0) < 0).any() or (multipliers.weights[-1] != 1).any():
        raise AssertionError('the breakpoints of w0 must rise to 1')
    weights = np.clip(multipliers.weights, 1e-12, 1.0)
    v = np.maximum(multipliers.v, 0.0)
    total = v.sum(-1, keepdims=True)
    return weights, v * np.minimum(
        1.0, weights[..., None] / np.maximum(total, 1e-300) * (1 - 1e-12))


def bound_silence(potential: Potential, cells: Cells, cell: Index, incumbents: Array,
                  stop: Callable[[], bool]) -> Array:
    """Return upper bounds of a silent UAV's term (w0 = 0, v = 0) in cells, (M,) in nats."""
    none = np.zeros((len(cell), len(potential.region.radii)))
    return Terms(potential, cells, cell, none[:, 0], none).bound_maxima(incumbents, stop)


def find_power_range(team: Team, uav: int) -> tuple[float, float]:
    """
    Return the lower and the upper limit of log p of a jammer, p being its power [W].

    The upper limit is log peak. At powers below the lower limit the received SNR is less than
    FLOOR everywhere; bound_terms covers these powers.
    """
    region, top = team.regions[uav], math.log(team.regions[uav].peak)
    largest = region.log_gain + max(0.0, float(region.log_advantages.max()))
    return min(math.log(FLOOR) + 2 * math.log(region.altitude) - largest, top), top


def bound_terms(team: Team, potential: Potential, uav: int, cells: Cells, cell: Index,
                silent: Array, weights: Array, v: Array, price: float, incumbents: Array,
                stop: Callable[[], bool]) -> Array:
    """
    Return upper bounds of M_i, UAV i's largest term at (w0, v) in given cells, (M,) in nats.

    A jammer's powers below FLOOR / (its largest gain) are not searched: there its term is at most
    silent + log(1 + FLOOR) sum of v + a margin for rounding.

    :param uav: index i of the UAV.
    :param cell: indices of the cells, (M,).
    :param silent: upper bounds of the UAV's term in silence, (M,) in nats.
    """
    if not uav:
        return Terms(potential, cells, cell, weights, v, price).bound_maxima(incumbents, stop)
    terms = Terms(potential, cells, cell, weights, v, price, find_power_range(team, uav))
    least = silent + math.log1p(FLOOR) * v.sum(-1) + terms.margin[cells.group[cell]]
    bounds = terms.bound_maxima(np.maximum(incumbents, least - TOLERANCE), stop)
    return np.asarray(np.maximum(bounds, least))


def bound_pieces(team: Team, silent: Array, joint: Array, weights: Array, v: Array,
                 price: float) -> Array:
    """
    Return upper bounds of a slot's B on the pieces of w0 up to each breakpoint; see lemma 4.

    They are (PIECES, K, C) in nats. The first pieces begin at w0 = 0.

    :param silent: bound of all UAVs' terms in silence, (C,) in nats.
    :param joint: bounds of M at the breakpoints, (K, C) in nats.
    :param weights: w0 at the breakpoints, (K, C).
    :param v: eavesdropper multipliers at the breakpoints, (K, C, E).
    :param price: lam of the transmitter.
    """
    # Ends of the pieces between two breakpoints, as fractions; denser near the breakpoints.
    x = np.linspace(0.0, 1.0, PIECES + 1)[:, None, None]
    x = x * x * (3 - 2 * x)

    def interpolate(at_zero: Array, at_breakpoints: Array) -> Array:
        """Return values at the ends of all pieces, (PIECES + 1, K, C), linear in w0."""
        values = np.concatenate([at_zero[None], at_breakpoints])
        return np.asarray(values[:-1] * (1 - x) + values[1:] * x)

    zero = np.zeros(len(silent))
    w0, chord = interpolate(zero, weights), interpolate(silent, joint)
    totals = [interpolate(zero, total) for total in team.sum_adversaries(v)]
    convex = chord - entropy(*totals) + maximise_power(
        np.maximum(w0 - sum(totals), 0.0), price, team.regions[0].peak)[0]
    # On each piece the convex part is at most its chord, and at most its larger end.
    low, high = w0[:-1], w0[1:]
    width = high - low
    slope = (convex[1:] - convex[:-1]) / np.maximum(width, 1e-300)
    best = np.clip(sigmoid(slope), low, high)
    by_chord = convex[:-1] + slope * (best - low) + entropy(best)
    by_ends = np.maximum(convex[1:], convex[:-1]) + entropy(np.clip(0.5, low, high))
    return np.asarray(np.where(width > 1e-9, np.minimum(by_chord, by_ends), by_ends))
