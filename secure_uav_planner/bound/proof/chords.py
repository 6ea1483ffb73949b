"""Lemma 4 at work: from maxima at a few breakpoints of w0 to a bound between them."""

from __future__ import annotations

import numpy as np

from .conjugate import Array, entropy, sigmoid, transmit_power
from .team import Team

PIECES = 24
"""Pieces of the entropies between two breakpoints of w0."""


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
