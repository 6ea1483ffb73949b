"""
The certificate: from multipliers to a bound, with nothing taken on trust.

With lemmas 1 to 3 the mean rate, in nats, of every plan is at most

    (1/N) [ sum over slots of B + sum over UAVs of Potential.ends ] + sum_i lam_i average_i,
    B   = max over w0 of H(w0) - H(s) + m(w0 - s) + M(w0, v),   s = sum_e v_e, v = v(w0),
    M   = M_0 + sum over jammers of M_j,
    M_0 = max over q of w0 A_0(q) - sum_e v_e A_e(q) + potential(q),
    M_j = max over q, p of -w0 log(1 + b_0(q) p) + sum_e v_e log(1 + b_e(q) p) - lam p
          + potential(q),

A being the logarithm of a gain of the transmitter, b a gain of a jammer, m that of
transmit_power. M_0 and M_j are bounded by branch and bound (boxes.py) at a few nodes w0.

Lemma 4. M is a maximum of functions that are linear in (w0, v). So it is convex, and with v
interpolated linearly between the nodes it lies below the chord from node to node. The entropies
and m are known exactly and are therefore taken on PIECES finer pieces: there, the convex part
-H(s) + m + chord lies below its own chord, and max over w0 of slope w0 + H(w0) is attained at
w0 = phi'(slope), or at the nearer end of the piece. At w0 = 0 every v is 0. A node that is not
needed is put on the chord of its neighbours, where M is below that chord.

Lemma 8 (two jammers and more). The logarithm of a sum is not a sum, but by Gibbs' inequality, with
y_j = 1/J + x_j, log(1 + sum x_j) = max over rho of sum_j rho_j log(y_j / rho_j), rho on the
simplex. At the ground node any theta is an upper bound of -log(1 + sum x_j), and at the
eavesdropper rho is maximised over like w0: M is convex in rho, too, so it lies below its
interpolation between nodes of rho, while the entropy of rho is taken on pieces. With
log(J y_j) = log(1 + J x_j) every jammer's maximum is that of one jammer with the weights
w0 theta_j, v rho_j and J times the gain.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
import math

import numpy as np

from .boxes import Index, Terms
from .chords import chords, on_chords, over_pieces
from .conjugate import Array, entropy, softplus
from .lens import Lens
from .multipliers import Multipliers
from .potential import Potential
from .rounding import margin
from .team import Team
from ..plan import POWER_TOLERANCE

FLOOR = 1e-6
"""Received SNR below which a jammer's power counts by the most that it can do."""


@dataclass(frozen=True, eq=False)
class Certificate:
    """
    A proven bound, and what it is made of.

    :param rate: mean over the slots that no plan exceeds, in bit/s/Hz.
    :param stages: B of every stage, (G,) in nats.
    :param offset: the rest, so that rate log 2 = (sum of count B + offset) / N.
    :param potentials: of every UAV.
    :param prices: lam, of those that are followed, then of the helpers, in nats per W.
    """

    rate: float
    stages: Array
    offset: float
    potentials: tuple[Potential, ...]
    prices: Array


def certify(team: Team, given: Multipliers,
            stop: Callable[[], bool] = lambda: False) -> Certificate:
    """
    Return the bound that the multipliers prove, whatever they are.

    :param team: the UAVs of the scenario.
    :param given: the multipliers.
    :param stop: asked now and then; True ends the search, and the bound is valid but larger.
    """
    potentials = tuple(Potential(slope, bend, team.stages, lens)
                       for slope, bend, lens in zip(given.slope, given.bend, team.lenses))
    prices, helper_prices = np.maximum(given.prices, 0.0), np.maximum(given.helpers, 0.0)
    divisions = given.divisions if team.jammers == 2 else np.ones(1)
    if team.jammers == 2 and (divisions[0] != 0 or divisions[-1] != 1
                              or (np.diff(divisions) <= 0).any()):
        raise AssertionError('the nodes of rho must rise from 0 to 1')
    if not given.needed[-1].all():
        raise AssertionError('the last node of w0 is always needed')
    if (np.diff(given.weights, axis=0) < 0).any() or (given.weights[-1] != 1).any():
        raise AssertionError('the nodes of w0 must rise to 1')
    if ((given.theta < 0) | (given.theta > 1)).any():
        raise AssertionError('theta must be from 0 to 1')
    weights = np.clip(given.weights, 1e-12, 1.0)
    shares = np.maximum(given.shares, 0.0)
    total = shares.sum(-1, keepdims=True)
    shares = shares * np.minimum(1.0, weights[..., None] / np.maximum(total, 1e-300) * (1 - 1e-12))
    shares = on_chords(weights, shares, given.needed)
    # A jammer's silence is part of all of its maxima, the transmitter's only of one.
    still = [_still(potential, price, known, given.slack.min(0) if i else given.slack[0], stop)
             for i, (potential, price, known) in enumerate(zip(potentials, prices, given.still))]
    first = _maxima(team, potentials[0], 0, still[0], weights, shares, prices[0],
                    given.known[0, :, 0], given, stop)
    helped = team.spill * weights + sum(
        (_help(lens, shares.sum(-1), price) for lens, price in zip(team.helpers, helper_prices)),
        np.zeros(weights.shape))
    jammed = []
    for r, rho in enumerate(divisions):
        value = first + helped
        for j, potential in enumerate(potentials[1:]):
            theta = given.theta[:, r] if j == 0 else 1.0 - given.theta[:, r]
            part = rho if j == 0 else 1.0 - rho
            value = value + _maxima(
                team, potential, j + 1, still[j + 1], weights * theta, shares * part,
                prices[j + 1], given.known[j + 1, :, r], given, stop)
        jammed.append(value + gibbs(team, weights, given.theta[:, r], shares.sum(-1)))
    silent = sum(still) + team.negative + helper_prices.sum() * POWER_TOLERANCE
    values = chords(np.array(jammed), silent, weights, given.needed)
    slots = _over_weights(team, divisions, silent, values, weights, shares.sum(-1), prices[0])
    slots = slots + 4 * sum(margin(lens.altitude, np.zeros(1)) for lens in team.helpers) + 4 * sum(
        margin(p.lens.altitude, p.size()) for p in potentials)
    ends = sum(potential.ends() for potential in potentials)
    powers = [team.stages.slots * price * lens.average for price, lens in zip(
        [*prices, *helper_prices], [*team.lenses, *team.helpers])]
    offset = math.fsum([ends, *powers])
    terms = [*(team.stages.count * slots), ends, *powers]
    total = math.fsum(terms) + 1e-14 * math.fsum(map(abs, terms))
    rate = total / team.stages.slots / math.log(2.0) * (1 + 1e-14)
    return Certificate(rate if not math.isnan(rate) else math.inf, slots, offset, potentials,
                       np.concatenate([prices, helper_prices]))


def gibbs(team: Team, weights: Array, theta: Array, total: Array) -> Array | float:
    """Return what Gibbs' inequality adds with log(J y_j) in place of log(y_j), two jammers."""
    if team.jammers < 2:
        return 0.0
    return np.asarray(weights * (math.log(2) - entropy(theta)) - total * math.log(2))


def _help(lens: Lens, total: Array, price: float) -> Array:
    """Return max over p of s log(1 + b p) - lam p, b the gain from the nearest place, (K, G)."""
    gain = np.max([lens.log_gain + advantage - np.log(
        (lens.nearest(place) + radius)**2 + lens.altitude**2)
        for place, radius, advantage in zip(
            lens.eavesdroppers, lens.radii, lens.log_advantages)], axis=0)
    power = np.clip(total / max(price, 1e-300) - np.exp(-gain), 0.0, lens.peak)
    return np.asarray(total * softplus(gain + np.log(np.maximum(power, 1e-300)))
                      - price * power + price * POWER_TOLERANCE)


def _still(potential: Potential, price: float, known: Array, tolerance: Array,
           stop: Callable[[], bool]) -> Array:
    """Return the maximum of a UAV's potential less lam p over its lens and powers, (G,)."""
    lens = potential.lens
    slope, bend = potential.change
    index = np.arange(len(slope))
    extra = potential.constant() + price * POWER_TOLERANCE
    spare = margin(lens.altitude, potential.size())
    if not potential.curved:
        return np.asarray(lens.support(slope, index) + extra + spare)
    none = np.zeros(len(slope))
    terms = Terms(lens, index, none, np.zeros((len(slope), len(lens.radii))), slope, bend,
                  potential.tilts(), spare)
    return np.asarray(terms.maxima(known - extra, tolerance, stop=stop) + extra)


def terms_of(team: Team, potential: Potential, uav: int, stage: Index, weights: Array,
             shares: Array, price: float) -> tuple[Terms, Array]:
    """
    Return M functions whose maxima are M_i at nodes, but for a constant, and that.

    :param stage: of every function, (M,).
    :param weights: w0 or w0 theta, (M,).
    :param shares: v or v rho, (M, E).
    :return: the functions, and what to add to each, (M,).
    """
    lens = potential.lens
    slope, bend = potential.change
    spare = margin(lens.altitude, potential.size() + price * lens.peak)
    tilts = [(factor[stage], u[stage], s[stage]) for factor, u, s in potential.tilts()]
    gain, powers = lens.log_gain, None
    if uav:
        gain += math.log(team.copies)
        top = math.log(lens.peak)
        largest = gain + max(0.0, float(lens.log_advantages.max()))
        powers = (min(math.log(FLOOR) + 2 * math.log(lens.altitude) - largest, top), top)
    terms = Terms(lens, stage, weights, shares, slope[stage], bend[stage], tilts, spare[stage],
                  price, gain, powers)
    return terms, potential.constant()[stage]


def _maxima(team: Team, potential: Potential, uav: int, still: Array, weights: Array,
            shares: Array, price: float, known: Array, given: Multipliers,
            stop: Callable[[], bool]) -> Array:
    """
    Return M_i at every node that is needed, (K, G), and 0 at the others.

    A jammer's powers below FLOOR / (its largest gain) are covered by one term: there the
    potential is at most `still`, and the rates' part at most v log(1 + FLOOR) for a positive
    power and -w0 log(1 - delta) for one of -POWER_TOLERANCE.
    """
    node, stage = np.nonzero(given.needed)
    terms, extra = terms_of(team, potential, uav, stage, weights[node, stage],
                            shares[node, stage], price)
    tolerance = given.slack[node + 1, stage]
    least = np.full(len(terms), -np.inf)
    if uav:
        below = team.copies * team.delta[uav]
        least = (still[stage] + math.log1p(FLOOR) * terms.shares.sum(-1) + terms.margin
                 + (-terms.weight * math.log1p(-below) if below < 1 else math.inf))
    wanted = np.maximum(known[node, stage], least - tolerance) - extra
    found = terms.maxima(wanted, tolerance, stop=stop) + extra
    result = np.zeros(weights.shape)
    result[node, stage] = np.maximum(found, least)
    return result


def _over_weights(team: Team, divisions: Array, silent: Array, jammed: Array, weights: Array,
                  total: Array, price: float) -> Array:
    """Return B of every stage, (G,): lemma 4, from M at the nodes, (R, K, G)."""
    value = over_pieces(team, divisions, silent, jammed, weights, total, price)
    return np.asarray(np.maximum(silent, value.max((0, 1))))
