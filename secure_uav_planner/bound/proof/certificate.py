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
H(w0) is attained at w0 = phi'(slope), or at the nearer end of the piece. At w0 = 0 every v is 0. A
breakpoint that is not needed is put on the chord of its neighbours, where M is below that chord.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
import math

import numpy as np
from numpy.typing import NDArray

from .boxes import Index, Terms
from .chords import interpolated, on_chords, over_pieces
from .conjugate import Array, mixing, softplus
from .jammer_shares import corners, distinct, Division, over_boxes, share_boxes
from .potential import Potential
from .reachable_set import ReachableSet
from .rounding import margin
from .team import Team
from ...plan.plan import POWER_TOLERANCE

FLOOR = 1e-6
"""Received SNR below which a jammer's power counts by the most that it can do."""

EVERY_POWER = np.array([[-np.inf], [np.inf]])
"""Both ends of the logarithms of powers."""


@dataclass(frozen=True, eq=False)
class Multipliers:
    """
    What the certificate is made from: any numbers are valid, good ones make it tight.

    :param slope: u of every UAV's potential, (U, G + 1, 2) in nats per unit of its set.
    :param bend: S of every UAV's potential, (U, G + 1, 3) in nats per unit^2.
    :param turn: w of every UAV, (U, G + 1, 2) in nats per unit.
    :param prices: lam, (U,) in nats per W, not negative.
    :param helpers: lam of the helpers, in nats per W.
    :param weights: w0 at the breakpoints, rising, (K, G), within (0, 1].
    :param shares: v at the breakpoints, (K, G, E), not negative, with a sum of at most w0.
    :param needed: whether a breakpoint has maxima of its own, (K, G), the last one always; the
        others are put on the chords of their neighbours.
    :param boxes: of the jammers' shares and powers, at each of the M breakpoints that are needed,
        in the order of np.nonzero(needed).
    :param still: what the terms come close to where nothing is sent, (U, G) in nats.
    :param known: the same of the transmitter at the breakpoints, (K, G).
    :param slack: what the maxima may be too large, where nothing is sent and at every breakpoint,
        (K + 1, G) in nats.
    """

    slope: Array
    bend: Array
    turn: Array
    prices: Array
    helpers: Array
    weights: Array
    shares: Array
    needed: NDArray[np.bool_]
    boxes: Division
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
    potentials = tuple(Potential(slope, bend, turn, team.stages, region)
                       for slope, bend, turn, region in zip(
                           given.slope, given.bend, given.turn, team.regions))
    prices, helper_prices = np.maximum(given.prices, 0.0), np.maximum(given.helpers, 0.0)
    if not given.needed[-1].all():
        raise AssertionError('the last breakpoint of w0 is always needed')
    if (np.diff(given.weights, axis=0) < 0).any() or (given.weights[-1] != 1).any():
        raise AssertionError('the breakpoints of w0 must rise to 1')
    weights = np.clip(given.weights, 1e-12, 1.0)
    shares = np.maximum(given.shares, 0.0)
    total = shares.sum(-1, keepdims=True)
    shares = shares * np.minimum(1.0, weights[..., None] / np.maximum(total, 1e-300) * (1 - 1e-12))
    k, g = np.nonzero(given.needed)
    counted = np.zeros(shares[k, g].shape, bool)
    np.put_along_axis(counted, given.boxes.listeners, True, 1)
    shares[k, g] = np.where(counted, shares[k, g], 0.0)
    shares = on_chords(weights, shares, given.needed)
    # A jammer's silence is part of all of its maxima, the transmitter's only of one.
    still = [_still(potential, price, known, given.slack.min(0) if i else given.slack[0], stop)
             for i, (potential, price, known) in enumerate(zip(potentials, prices, given.still))]
    joint = np.zeros(weights.shape)
    joint[k, g] = _maxima(team, potentials[0], 0, still[0], g, weights[k, g], shares[k, g],
                          prices[0], given.known[k, g], given.slack[k + 1, g], stop)
    joint += team.spill * weights + sum(
        _help(region, shares.sum(-1), price) for region, price in zip(team.helpers, helper_prices))
    if team.jammers:
        joint[k, g] += _jammed(team, potentials, prices, still, g, weights[k, g], shares[k, g],
                               given, stop)
    silent = sum(still) + team.negative + helper_prices.sum() * POWER_TOLERANCE
    joint = interpolated(joint[None], silent, weights, given.needed)[0]
    pieces = over_pieces(team, silent, joint, weights, shares.sum(-1), prices[0])
    slots = np.maximum(silent, pieces.max((0, 1)))
    slots = slots + 4 * sum(margin(p.region.altitude, p.size()) for p in potentials) + 4 * sum(
        margin(region.altitude, np.zeros(1)) for region in team.helpers)
    ends = sum(potential.ends() for potential in potentials)
    powers = [team.stages.slots * price * region.average for price, region in zip(
        [*prices, *helper_prices], [*team.regions, *team.helpers])]
    offset = math.fsum([ends, *powers])
    terms = [*(team.stages.count * slots), ends, *powers]
    total = math.fsum(terms) + 1e-14 * math.fsum(map(abs, terms))
    rate = total / team.stages.slots / math.log(2.0) * (1 + 1e-14)
    return Certificate(rate if not math.isnan(rate) else math.inf, slots, offset, potentials,
                       np.concatenate([prices, helper_prices]))


def _jammed(team: Team, potentials: tuple[Potential, ...], prices: Array, still: list[Array],
            stage: Index, weights: Array, shares: Array, given: Multipliers,
            stop: Callable[[], bool]) -> Array:
    """Return what the jammers' terms are at most together, (M,): lemma 8."""
    division = given.boxes
    simplices, powers, exists = share_boxes(
        division.splits, division.listeners.shape[1], team.jammers)
    rho, theta = corners(simplices), corners(division.theta).sum(3)
    heard = np.take_along_axis(shares, division.listeners, 1)
    theta = np.concatenate([theta, 1.0 - theta.sum(-1, keepdims=True)], -1)
    if not ((theta >= 0) & (theta <= 1)).all():
        raise AssertionError('theta must be from 0 to 1 in every box')
    values = np.where(exists[:, :, None], -weights[:, None] * mixing(np.moveaxis(theta, -1, 0)),
                      -np.inf)
    at = np.nonzero(np.broadcast_to(exists[:, :, None], values.shape))
    box, m, _ = at
    for j in range(team.jammers):
        own, part, within = rho[at][:, :, j] * heard[m], weights[m] * theta[at][:, j], (
            powers[:, box, m, j])
        # Boxes have corners in common.
        first, which = distinct(np.column_stack([m, part, *within, own]))
        some, v = m[first], np.zeros((len(first), team.eavesdroppers))
        np.put_along_axis(v, division.listeners[some], own[first], 1)
        slack = np.full(len(first), np.inf)
        np.minimum.at(slack, which, division.slack[at])
        values[at] += _maxima(
            team, potentials[j + 1], j + 1, still[j + 1], stage[some], part[first], v,
            prices[j + 1], division.known[j][at][first], slack, stop, within[:, first])[which]
    return np.asarray(over_boxes(values, rho, division.mean, heard).max((0, 2)))


def _help(region: ReachableSet, total: Array, price: float) -> Array:
    """Return max over p of s log(1 + b p) - lam p, b the gain from the nearest place, (K, G)."""
    gain = region.largest_gain()
    power = np.clip(total / max(price, 1e-300) - np.exp(-gain), 0.0, region.peak)
    return np.asarray(total * softplus(gain + np.log(np.maximum(power, 1e-300)))
                      - price * power + price * POWER_TOLERANCE)


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
    """Return the logarithms of a jammer's powers from which one below counts as silence."""
    region, top = team.regions[uav], math.log(team.regions[uav].peak)
    largest = region.log_gain + math.log(team.copies) + max(
        0.0, float(region.log_advantages.max()))
    return min(math.log(FLOOR) + 2 * math.log(region.altitude) - largest, top), top


def terms_of(team: Team, potential: Potential, uav: int, stage: Index, weights: Array,
             shares: Array, price: float,
             within: Array = EVERY_POWER) -> tuple[Terms, Array]:
    """
    Return M functions whose maxima are M_i at breakpoints, but for a constant, and that.

    :param stage: of every function, (M,).
    :param weights: w0 or w0 theta, (M,).
    :param shares: v or v rho, (M, E).
    :param within: both ends of a jammer's log p, (2, M).
    :return: the functions, and what to add to each, (M,).
    """
    region = potential.region
    slope, bend = potential.change
    spare = margin(region.altitude, potential.size() + price * region.peak)
    gain, powers = region.log_gain, None
    if uav:
        gain += math.log(team.copies)
        low, high = np.clip(within, *powers_of(team, uav))
        powers = low, high
    terms = Terms(region, stage, weights, shares, slope, bend, potential.tilt(), spare, price,
                  gain, powers)
    return terms, potential.constant()[stage]


def _maxima(team: Team, potential: Potential, uav: int, still: Array, stage: Index, weights: Array,
            shares: Array, price: float, known: Array, tolerance: Array,
            stop: Callable[[], bool], within: Array = EVERY_POWER) -> Array:
    """
    Return M_i of (w0, v), (M,), in given stages.

    A jammer's powers below FLOOR / (its largest gain) are covered by one term: there the
    potential is at most `still`, and the rates' part at most v log(1 + FLOOR) for a positive
    power and -w0 log(1 - delta) for one of -POWER_TOLERANCE. Only functions of powers that begin
    above that are without it.

    :param within: both ends of a jammer's log p, (2, M).
    """
    terms, extra = terms_of(team, potential, uav, stage, weights, shares, price, within)
    least = np.full(len(terms), -np.inf)
    if uav:
        below = team.copies * team.delta[uav]
        least = (still[stage] + math.log1p(FLOOR) * terms.shares.sum(-1) + terms.margin[stage]
                 + (-terms.weight * math.log1p(-below) if below < 1 else math.inf))
        least = np.where(within[0] > powers_of(team, uav)[0], -np.inf, least)
    wanted = np.maximum(known, least - tolerance) - extra
    found = terms.maxima(wanted, tolerance, stop=stop) + extra
    return np.asarray(np.maximum(found, least))
