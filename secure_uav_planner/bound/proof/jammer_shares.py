"""
Lemma 8: two jammers, by their powers and the first one's shares of what the eavesdroppers hear.

The logarithm of a sum is not a sum, but by Gibbs' inequality it is the largest one of many: with
y_j = 1/2 + x_j, log(1 + x_1 + x_2) = max over rho of rho log(y_1 / rho)
+ (1 - rho) log(y_2 / (1 - rho)). Hence, with a rho for every eavesdropper, and for any theta(rho),

    max over places and powers of -w0 log(1 + x_10 + x_20) + sum_e v_e log(1 + x_1e + x_2e) + ...
        <= max over rho of F(rho) + sum_e v_e (H(rho_e) - log 2),
    F(rho) = M_1(w0 theta, v rho) + M_2(w0 (1 - theta), v (1 - rho)) - w0 (H(theta) - log 2),

M_j being the maximum of one jammer with twice the gain. The shares, a cube, are divided into boxes
together with the powers: every rho and every pair of powers is in one of them. In a box M_j is the
maximum over jammer j's powers of its interval alone, and theta an affine function of rho with
values from 0 to 1, so that a jammer that is off need not do with the theta of one that is on. M_j
is a maximum of linear functions, so F is convex there, and below any plane that is not below it at
the box's corners. With the plane in the place of F the maximum over rho is one for each
eavesdropper: of rho mu + v H(rho), at rho = phi'(mu / v) or the nearer end of its interval.
"""

from __future__ import annotations

from itertools import product

import numpy as np
from numpy.typing import NDArray

from .conjugate import Array, entropy, sigmoid

Splits = tuple[NDArray[np.intp], NDArray[np.intp], Array]
"""Which box is cut, along which side, and where: (S, K, G) each."""

STEEPEST = 100.0
"""Slope of a plane in units of v: no column is steeper than the logarithm of a gain."""


def no_splits(shape: tuple[int, ...]) -> Splits:
    """Return splits that leave one box."""
    none = np.zeros((0, *shape), np.intp)
    return none, none, np.zeros((0, *shape))


def share_boxes(splits: Splits, eavesdroppers: int) -> tuple[Array, Array, Array]:
    """
    Return the boxes that splits leave: together they are everything, whatever the splits are.

    Their sides are the shares, one for each eavesdropper, and log p of both jammers. A cut leaves
    what is below it to the box that is cut, and the rest to a new box.

    :return: lower and upper corners of the shares, (B, E, K, G), and both ends of the logarithms
        of powers, (2, B, 2, K, G).
    """
    count, *shape = splits[0].shape
    low = np.zeros((count + 1, eavesdroppers + 2, *shape))
    high = np.ones_like(low)
    low[:, eavesdroppers:], high[:, eavesdroppers:] = -np.inf, np.inf
    k, g = np.indices(shape)
    for new, (box, side, at) in enumerate(zip(*splits), 1):
        box = np.clip(box, 0, new - 1)
        at = np.clip(at, low[box, side, k, g], high[box, side, k, g])
        for part in (low, high):
            part[new] = np.moveaxis(part[box, :, k, g], -1, 0)
        low[new, side, k, g] = at
        high[box, side, k, g] = at
    return (low[:, :eavesdroppers], high[:, :eavesdroppers],
            np.stack([low[:, eavesdroppers:], high[:, eavesdroppers:]]))


def corners(low: Array, high: Array) -> Array:
    """Return the corners of all boxes, (B, V, E, K, G), V being 2^E."""
    which = np.array(list(product((0, 1), repeat=low.shape[1])))[:, :, None, None]
    return np.where(which, high[:, None], low[:, None])


def affine(low: Array, high: Array, values: Array) -> Array:
    """
    Return slopes of planes near values at the corners of boxes, (B, E, K, G).

    :param values: (B, V, K, G).
    """
    which = np.array(list(product((0, 1), repeat=low.shape[1])), bool)
    rise = np.stack([values[:, which[:, e]].mean(1) - values[:, ~which[:, e]].mean(1)
                     for e in range(low.shape[1])], 1)
    return np.where(high - low > 1e-9, rise / np.maximum(high - low, 1e-9), 0.0)


def over_boxes(values: Array, low: Array, high: Array, shares: Array) -> Array:
    """
    Return a bound of F(rho) + sum_e v_e (H(rho_e) - log 2) in every box, (B, K, G).

    :param values: F at the boxes' corners, (B, V, K, G).
    :param shares: v, (K, G, E).
    """
    v = np.moveaxis(shares, -1, 0)  # (E, K, G)
    slope = affine(low, high, values) / np.maximum(v, 1e-300)
    # Any slope is valid.
    slope = np.clip(np.nan_to_num(slope), -STEEPEST, STEEPEST)
    plane = (values - (corners(low, high) * (v * slope)[:, None]).sum(2)).max(1)
    rho = np.clip(sigmoid(slope), low, high)
    return np.asarray(plane + (v * (rho * slope + entropy(rho) - np.log(2.0))).sum(1))
