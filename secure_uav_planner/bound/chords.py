"""Lemma 4 at work: from maxima at a few nodes of w0, and of rho, to a bound between them."""

from __future__ import annotations

from collections.abc import Iterator
import math

import numpy as np
from numpy.typing import NDArray

from .boxes import Index
from .conjugate import Array, entropy, sigmoid, transmit_power
from .team import Team

Flags = NDArray[np.bool_]

PIECES = 24
"""Pieces of the entropies between two nodes of w0."""

RHO_PIECES = 10
"""Pieces of the entropy between two nodes of rho."""


def on_chords(weights: Array, shares: Array, needed: Flags) -> Array:
    """Return v at the nodes, (K, G, E), of which those that are not needed lie on chords."""
    moved = chords(shares.transpose(2, 0, 1), np.zeros(weights.shape[1]), weights, needed)
    return moved.transpose(1, 2, 0)


def neighbours(needed: Flags) -> tuple[Index, Index]:
    """Return the nearest needed nodes at or below and at or above, from 1, (K, G); 0 is w0 = 0."""
    count = len(needed)
    node = np.arange(1, count + 1)[:, None]
    last = np.maximum.accumulate(np.where(needed, node, 0), axis=0)
    above = np.minimum.accumulate(np.where(needed, node, count)[::-1], axis=0)[::-1]
    return np.concatenate([0 * last[:1], last[:-1]]), above


def chords(values: Array, first: Array, weights: Array, needed: Flags) -> Array:
    """
    Return values at the nodes, (R, K, G), linear between those that are needed.

    :param first: the value at w0 = 0, (G,).
    """
    below, above = neighbours(needed)
    column = np.arange(weights.shape[1])
    at = np.concatenate([0 * weights[:1], weights])
    every = np.concatenate([np.broadcast_to(first, (len(values), 1, len(first))), values], axis=1)
    width = at[above, column] - at[below, column]
    share = np.clip((weights - at[below, column]) / np.maximum(width, 1e-300), 0.0, 1.0)
    low, high = every[:, below, column], every[:, above, column]
    return np.where(needed, values, low * (1 - share) + high * share)


def over_pieces(team: Team, divisions: Array, silent: Array, jammed: Array, weights: Array,
                total: Array, price: float) -> Array:
    """Return a bound over every piece of w0, (PIECES, K, G), from M at the nodes."""
    zero = np.zeros((1, len(silent)))
    weights, total = np.concatenate([zero, weights]), np.concatenate([zero, total])
    values = np.concatenate([np.broadcast_to(silent, (len(jammed), 1, len(silent))), jammed],
                            axis=1)
    x = pieces()[:, None, None]
    fine, s = (part[:-1] * (1 - x) + part[1:] * x for part in (weights, total))
    known = transmit_power(np.maximum(fine - s, 0.0), price, team.lenses[0].peak)[0] - entropy(s)
    width = fine[1:] - fine[:-1]
    best = np.full(width.shape, -np.inf)
    for linear in _over_divisions(values, divisions, x, s):
        convex = linear + known
        slope = (convex[1:] - convex[:-1]) / np.maximum(width, 1e-300)
        at = np.clip(sigmoid(slope), fine[:-1], fine[1:])
        value = convex[:-1] + slope * (at - fine[:-1]) + entropy(at)
        narrow = np.maximum(convex[1:], convex[:-1]) + entropy(
            np.clip(0.5, fine[:-1], fine[1:]))
        value = np.where(width > 1e-9, np.minimum(value, narrow), narrow)
        best = np.maximum(best, value)
    return best


def pieces() -> Array:
    """Return where the pieces between two nodes begin and end, from 0 to 1, (PIECES + 1,)."""
    x = np.linspace(0.0, 1.0, PIECES + 1)
    return np.asarray(x * x * (3 - 2 * x))


def _over_divisions(values: Array, divisions: Array, x: Array, total: Array) -> Iterator[Array]:
    """
    Return functions of w0 on the pieces, (PIECES + 1, K, G), whose maximum bounds M + s H(rho).

    On a piece of rho the concave entropy lies below its tangent, so the sum lies below a
    linear function of rho and its maximum is at an end.
    """
    fine = [value[:-1] * (1 - x) + value[1:] * x for value in values]
    if len(fine) == 1:
        yield fine[0]
        return
    for low, high, first, last in zip(fine[:-1], fine[1:], divisions[:-1], divisions[1:]):
        step = np.linspace(0.0, 1.0, RHO_PIECES + 1)
        step = step * step * (3 - 2 * step)
        for t0, t1 in zip(step[:-1], step[1:]):
            middle = first + (last - first) * (t0 + t1) / 2
            slope = math.log((1 - middle) / middle)
            height = float(entropy(np.array(middle)))
            yield np.maximum(*(
                low * (1 - t) + high * t
                + total * (height + slope * (first + (last - first) * t - middle) + 1e-12)
                for t in (t0, t1)))
