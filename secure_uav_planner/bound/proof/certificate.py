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
transmit_power. M_0 and M_j are bounded by branch and bound (boxes.py) at a few breakpoints w0.

Lemma 4. M is a maximum of functions that are linear in (w0, v). So it is convex, and with v
interpolated linearly between the breakpoints it lies below the chord from breakpoint to
breakpoint. The entropies and m are known exactly and are therefore taken on PIECES finer pieces:
there, the convex part -H(s) + m + chord lies below its own chord, and max over w0 of slope w0 +
H(w0) is attained at w0 = phi'(slope), or at the nearer end of the piece. At w0 = 0 every v is 0.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
import math

import numpy as np

from .boxes import Index, Terms
from .chords import over_pieces
from .conjugate import Array
from .potential import Potential
from .reachable_set import ReachableSet
from .rounding import margin
from .team import Team
from ...plan.plan import POWER_TOLERANCE

FLOOR = 1e-6
"""Received SNR below which a jammer's power counts by the most that it can do."""


@dataclass(frozen=True, eq=False)
class Multipliers:
    """
    What the certificate is made from: any numbers are valid, good ones make it tight.

    :param slope: u of every UAV's potential, (U, G + 1, 2) in nats per unit of its set.
    :param bend: S of every UAV's potential, (U, G + 1, 3) in nats per unit^2.
    :param turn: w of every UAV, (U, G + 1, 2) in nats per unit.
    :param prices: lam, (U,) in nats per W, not negative.
    :param weights: w0 at the breakpoints, rising, (K, G), within (0, 1].
    :param shares: v at the breakpoints, (K, G, E), not negative, with a sum of at most w0.
    :param still: what the terms come close to where nothing is sent, (U, G) in nats.
    :param known: the same at the breakpoints, (U, K, G).
    :param slack: what the maxima may be too large, where nothing is sent and at every breakpoint,
        (K + 1, G) in nats.
    """

    slope: Array
    bend: Array
    turn: Array
    prices: Array
    weights: Array
    shares: Array
    still: Array
    known: Array
    slack: Array


@dataclass(frozen=True, eq=False)
class Certificate:
    """
    A proven bound, and what it is made of.

    :param rate: mean over the slots that no plan exceeds, in bit/s/Hz.
    :param stages: B of every stage, (G,) in nats.
    :param offset: the rest, so that rate log 2 = (sum of count B + offset) / N.
    :param potentials: of every UAV.
    :param prices: lam, (U,) in nats per W.
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
    potentials = tuple(Potential(slope, bend, turn, team.stages, region)
                       for slope, bend, turn, region in zip(
                           given.slope, given.bend, given.turn, team.regions))
    prices = np.maximum(given.prices, 0.0)
    if (np.diff(given.weights, axis=0) < 0).any() or (given.weights[-1] != 1).any():
        raise AssertionError('the breakpoints of w0 must rise to 1')
    weights = np.clip(given.weights, 1e-12, 1.0)
    shares = np.maximum(given.shares, 0.0)
    total = shares.sum(-1, keepdims=True)
    shares = shares * np.minimum(1.0, weights[..., None] / np.maximum(total, 1e-300) * (1 - 1e-12))
    # The jammer's silence is part of all of its maxima, the transmitter's only of one.
    still = [_still(potential, price, known, given.slack.min(0) if i else given.slack[0], stop)
             for i, (potential, price, known) in enumerate(zip(potentials, prices, given.still))]
    stage = np.tile(np.arange(weights.shape[1]), len(weights))
    joint = np.sum([_maxima(
        team, potential, i, still[i], stage, weights.ravel(), shares.reshape(-1, shares.shape[2]),
        prices[i], given.known[i].ravel(), given.slack[1:].ravel(), stop)
        for i, potential in enumerate(potentials)], axis=0).reshape(weights.shape)
    silent = sum(still) + team.negative
    pieces = over_pieces(team, silent, joint, weights, shares.sum(-1), prices[0])
    slots = np.maximum(silent, pieces.max((0, 1)))
    slots = slots + 4 * sum(margin(p.region.altitude, p.size()) for p in potentials)
    ends = sum(potential.ends() for potential in potentials)
    powers = [team.stages.slots * price * region.average
              for price, region in zip(prices, team.regions)]
    offset = math.fsum([ends, *powers])
    terms = [*(team.stages.count * slots), ends, *powers]
    total = math.fsum(terms) + 1e-14 * math.fsum(map(abs, terms))
    rate = total / team.stages.slots / math.log(2.0) * (1 + 1e-14)
    return Certificate(rate if not math.isnan(rate) else math.inf, slots, offset, potentials,
                       prices)


def _still(potential: Potential, price: float, known: Array, tolerance: Array,
           stop: Callable[[], bool]) -> Array:
    """Return the maximum of a UAV's potential less lam p over its places and powers, (G,)."""
    region = potential.region
    slope, bend = potential.change
    index = np.arange(len(slope))
    extra = potential.constant() + price * POWER_TOLERANCE
    spare = margin(region.altitude, potential.size())
    if not potential.curved and region.detours is None:
        return np.asarray(region.support(slope, index) + extra + spare)
    none = np.zeros(len(slope))
    terms = Terms(region, index, none, np.zeros((len(slope), len(region.radii))), slope, bend,
                  potential.tilt(), spare)
    return np.asarray(terms.maxima(known - extra, tolerance, stop=stop) + extra)


def powers_of(team: Team, uav: int) -> tuple[float, float]:
    """Return both ends of the logarithms of a jammer's powers; below, they count as silence."""
    region, top = team.regions[uav], math.log(team.regions[uav].peak)
    largest = region.log_gain + max(0.0, float(region.log_advantages.max()))
    return min(math.log(FLOOR) + 2 * math.log(region.altitude) - largest, top), top


def terms_of(team: Team, potential: Potential, uav: int, stage: Index, weights: Array,
             shares: Array, price: float) -> tuple[Terms, Array]:
    """
    Return M functions whose maxima are M_i at breakpoints, but for a constant, and that.

    :param stage: of every function, (M,).
    :param weights: w0, (M,).
    :param shares: v, (M, E).
    :return: the functions, and what to add to each, (M,).
    """
    region = potential.region
    slope, bend = potential.change
    spare = margin(region.altitude, potential.size() + price * region.peak)
    terms = Terms(region, stage, weights, shares, slope, bend, potential.tilt(), spare, price,
                  powers_of(team, uav) if uav else None)
    return terms, potential.constant()[stage]


def _maxima(team: Team, potential: Potential, uav: int, still: Array, stage: Index, weights: Array,
            shares: Array, price: float, known: Array, tolerance: Array,
            stop: Callable[[], bool]) -> Array:
    """
    Return M_i of (w0, v), (M,), in given stages.

    A jammer's powers below FLOOR / (its largest gain) are covered by one term: there the
    potential is at most `still`, and the rates' part at most v log(1 + FLOOR) for a positive
    power and -w0 log(1 - delta) for one of -POWER_TOLERANCE.
    """
    terms, extra = terms_of(team, potential, uav, stage, weights, shares, price)
    least = np.full(len(terms), -np.inf)
    if uav:
        below = team.delta[uav]
        least = (still[stage] + math.log1p(FLOOR) * terms.shares.sum(-1) + terms.margin[stage]
                 + (-terms.weight * math.log1p(-below) if below < 1 else math.inf))
    wanted = np.maximum(known, least - tolerance) - extra
    found = terms.maxima(wanted, tolerance, stop=stop) + extra
    return np.asarray(np.maximum(found, least))
