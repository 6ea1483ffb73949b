"""
Lemma 8: several jammers, by their powers and their shares of what the eavesdroppers hear.

The logarithm of a sum is not a sum, but by Gibbs' inequality it is the largest one of many: with
y_j = 1/J + x_j, log(1 + sum_j x_j) is the largest sum_j rho_j log(y_j / rho_j) over the shares
rho, which are not negative and have the sum 1. Hence, with shares rho_e for every eavesdropper,
and for any shares theta(rho) at the ground node,

    max over places and powers of -w0 log(1 + sum_j x_j0) + sum_e v_e log(1 + sum_j x_je) + ...
        <= max over rho of F(rho) + sum_e v_e (H(rho_e) - log J),
    F(rho) = sum_j M_j(w0 theta_j, v rho_j) - w0 (H(theta) - log J),

M_j being the maximum of one jammer with J times its gain, and H the entropy of J shares. The
shares of every eavesdropper are a simplex with J corners. These simplices are divided, each by a
point on one of its edges, into smaller ones, together with the jammers' powers: all rho with all
powers are in one of the boxes so found. In a box M_j is the maximum over jammer j's powers of its
interval alone, and theta an affine function of rho with values from 0 to 1, so that a jammer that
is off need not do with the theta of one that is on. M_j is a maximum of linear functions, so F is
convex there. And H(rho_e) is at most -sum_j rho_ej log q_ej for any q_e > 0 with the sum 1, which
is linear in rho. So the largest value is that at one of the box's corners, where every rho_e is at
a corner of its simplex.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.typing import NDArray

from .conjugate import Array

Splits = tuple[NDArray[np.int64], NDArray[np.int64], Array]
"""Which box is cut, -1 for none, along which side, and where: (S, M) each."""


@dataclass(frozen=True, eq=False)
class Division:
    """
    The boxes at M breakpoints of w0, and the multipliers in each; any values are valid.

    :param listeners: the eavesdroppers that count there, (M, E'); for all others v is 0.
    :param splits: what the boxes are, see share_boxes.
    :param theta: the shares of all jammers but the last one at the ground node: the sum over the
        listeners of what belongs to the corners of their simplices, (B, M, E', J, J - 1).
    :param mean: q of every box up to a factor, (B, M, E', J).
    :param known: what every jammer's term comes close to at the corners of the boxes,
        (J, B, M, V) in nats.
    :param slack: what it may be too large there, (B, M, V) in nats.
    """

    listeners: NDArray[np.int64]
    splits: Splits
    theta: Array
    mean: Array
    known: Array
    slack: Array


def share_boxes(splits: Splits, eavesdroppers: int,
                jammers: int) -> tuple[Array, Array, NDArray[np.bool_]]:
    """
    Return the boxes that splits leave: together they are everything, whatever the splits are.

    Sides with numbers from (e J + i) J + k on are the edges from corner i to corner k of
    eavesdropper e's simplex, which are cut at a share of their length; then come the jammers' log
    p. A cut leaves one part to the box that is cut, and the other to a new box.

    :return: the corners of the simplices, (B, M, E, J, J), the shares along the last axis, both
        ends of the logarithms of powers, (2, B, M, J), and whether there is such a box, (B, M).
    """
    count, many = splits[0].shape
    simplices = np.zeros((count + 1, many, eavesdroppers, jammers, jammers)) + np.eye(jammers)
    powers = np.zeros((2, count + 1, many, jammers))
    powers[0], powers[1] = -np.inf, np.inf
    exists = np.zeros((count + 1, many), bool)
    exists[0] = True
    shape = (eavesdroppers, jammers, jammers)
    for new, (box, side, at) in enumerate(zip(*splits), 1):
        cut = np.flatnonzero((box >= 0) & (box < new))
        exists[new, cut] = True
        box, side, at = box[cut], side[cut], at[cut]
        simplices[new, cut], powers[:, new, cut] = simplices[box, cut], powers[:, box, cut]
        edge = side < np.prod(shape)
        e, i, k = np.unravel_index(side[edge], shape)
        old, column = box[edge], cut[edge]
        first, second = simplices[old, column, e, i], simplices[old, column, e, k]
        middle = np.maximum(first + np.clip(at[edge], 0, 1)[:, None] * (second - first), 0.0)
        simplices[new, column, e, i] = middle
        simplices[old, column, e, k] = middle
        old, column, jammer = box[~edge], cut[~edge], side[~edge] - np.prod(shape)
        middle = np.clip(at[~edge], *powers[:, old, column, jammer])
        powers[0, new, column, jammer] = middle
        powers[1, old, column, jammer] = middle
    return simplices, powers, exists


def distinct(rows: Array) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return where each different row of (n, k) is first, and of every row which one it is."""
    key = np.ascontiguousarray(rows).view(f'V{rows.itemsize * rows.shape[1]}').ravel()
    _, first, which = np.unique(key, return_index=True, return_inverse=True)
    return first, which


def corners(simplices: Array) -> Array:
    """Return what belongs to the corners of all boxes, (B, M, V, E, ...), V being J^E."""
    eavesdroppers, jammers = simplices.shape[2:4]
    which = np.array(list(product(range(jammers), repeat=eavesdroppers)))
    return np.asarray(simplices[:, :, np.arange(eavesdroppers), which])


def over_boxes(values: Array, rho: Array, mean: Array, shares: Array) -> Array:
    """
    Return bounds of F(rho) + sum_e v_e (H(rho_e) - log J) at the corners of boxes, (B, M, V).

    The largest at a box's corners is a bound over the box.

    :param values: F at the corners, (B, M, V).
    :param rho: the corners, (B, M, V, E, J).
    :param mean: q up to a factor, (B, M, E, J).
    :param shares: v, (M, E).
    """
    # Any q is valid: without a number a jammer has all of it.
    mean = np.nan_to_num(np.maximum(mean, 1e-300), nan=1.0, posinf=1.0)
    mean = mean / mean.sum(-1, keepdims=True) * (1 - 1e-15)
    cross = -(rho * np.log(mean)[:, :, None]).sum(-1) - np.log(mean.shape[-1])
    return np.asarray(values + (cross * shares[:, None]).sum(-1))
