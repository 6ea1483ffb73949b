"""Lemma 4 at work: from maxima at a few breakpoints of w0 to a bound between them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from .boxes import Index
from .conjugate import Array, entropy, sigmoid, transmit_power
from .team import Team

Flags = NDArray[np.bool_]

PIECES = 24
"""Pieces of the entropies between two breakpoints of w0."""


def on_chords(weights: Array, shares: Array, needed: Flags) -> Array:
    """Return v at the breakpoints, (K, G, E), of which those that are not needed lie on chords."""
    moved = interpolated(shares.transpose(2, 0, 1), np.zeros(weights.shape[1]), weights, needed)
    return moved.transpose(1, 2, 0)


def neighbours(needed: Flags) -> tuple[Index, Index]:
    """Return the nearest needed breakpoints below and above, from 1, (K, G); 0 is w0 = 0."""
    count = len(needed)
    number = np.arange(1, count + 1)[:, None]
    last = np.maximum.accumulate(np.where(needed, number, 0), axis=0)
    above = np.minimum.accumulate(np.where(needed, number, count)[::-1], axis=0)[::-1]
    return np.concatenate([0 * last[:1], last[:-1]]), above


def interpolated(values: Array, first: Array, weights: Array, needed: Flags) -> Array:
    """
    Return values at the breakpoints, (R, K, G), linear between those that are needed.

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


def over_pieces(team: Team, silent: Array, joint: Array, weights: Array, total: Array,
                price: float) -> Array:
    """Return a bound over every piece of w0, (PIECES, K, G), from M at the breakpoints, (K, G)."""
    zero = np.zeros((1, len(silent)))
    weights, total = np.concatenate([zero, weights]), np.concatenate([zero, total])
    values = np.concatenate([silent[None], joint])
    x = pieces()[:, None, None]
    fine, s, linear = (part[:-1] * (1 - x) + part[1:] * x for part in (weights, total, values))
    convex = linear - entropy(s) + transmit_power(
        np.maximum(fine - s, 0.0), price, team.regions[0].peak)[0]
    width = fine[1:] - fine[:-1]
    slope = (convex[1:] - convex[:-1]) / np.maximum(width, 1e-300)
    at = np.clip(sigmoid(slope), fine[:-1], fine[1:])
    value = convex[:-1] + slope * (at - fine[:-1]) + entropy(at)
    narrow = np.maximum(convex[1:], convex[:-1]) + entropy(np.clip(0.5, fine[:-1], fine[1:]))
    return np.asarray(np.where(width > 1e-9, np.minimum(value, narrow), narrow))


def pieces() -> Array:
    """Return where the pieces between breakpoints begin and end, from 0 to 1, (PIECES + 1,)."""
    x = np.linspace(0.0, 1.0, PIECES + 1)
    return np.asarray(x * x * (3 - 2 * x))
