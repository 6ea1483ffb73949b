"""How the jammers' shares and powers are divided into boxes, for the certificate; see lemma 8."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from .multiplier_search import MultiplierSearch
from ..proof.conjugate import Array, mixing
from ..proof.jammer_shares import corners, Division, over_boxes, share_boxes
from ...model.kernel import core

SPLITS = {2: 20, 3: 40}
"""How often that is cut at most at a breakpoint, by the number of jammers."""

ENOUGH = 2e-3
"""By how much, in nats, a breakpoint may be above what combinations are worth without a cut."""

AT_ONCE = 50
"""Breakpoints between two questions whether to stop."""


def share_division(search: MultiplierSearch, stage: NDArray[np.intp], weights: Array,
                   shares: Array, worth: Array, slack: Array,
                   stop: Callable[[], bool]) -> tuple[Division, Array]:
    """
    Return boxes of what the jammers can do, the one with the largest bound cut again and again.

    :param stage: of every breakpoint, (M,).
    :param weights: w0, (M,).
    :param shares: v, (M, E).
    :param worth: about what all jammers' terms are worth, (M,).
    :param slack: how much more they may be, (M,).
    :param stop: asked now and then; True leaves the rest without a cut.
    :return: the boxes, and about the bounds over them at every corner, (B, M, V) in nats.
    """
    team = search.team
    m, e, j = len(stage), team.eavesdroppers, team.copies
    count = SPLITS.get(j, 0)
    box, side = np.full((m, count), -1), np.zeros((m, count), np.int64)
    at, theta = np.zeros((m, count)), np.zeros((m, count + 1, e, j, j)) + 1 / (j * e)
    mean, known = np.ones((m, count + 1, e, j)), np.zeros((m, count + 1, j, j**e))
    if j == 1:
        known[:, 0, 0, 0] = worth
    if j > 1:
        fields, every = search.fields(search.candidates), {
            'stage': stage.astype(np.int64), 'weight': weights, 'shares': shares,
            'enough': worth + ENOUGH + slack, 'box': box, 'side': side, 'at': at, 'theta': theta,
            'mean': mean, 'known': known}
        for first in range(0, m, AT_ONCE):
            if stop():
                break
            core.bound_share_boxes({**fields, **{
                name: array[first:first + AT_ONCE] for name, array in every.items()}})
    splits = box.T, side.T, at.T
    # Not below zero, by rounding either.
    theta, mean = np.swapaxes(theta, 0, 1), np.swapaxes(mean, 0, 1)
    theta = theta * (1 - 1e-9) + 1e-9 / (j * e)
    known = known.transpose(2, 1, 0, 3)
    simplices, _, exists = share_boxes(splits, e, j)
    values = known.sum(0) - weights[:, None] * mixing(np.moveaxis(corners(theta).sum(3), -1, 0))
    bounds = over_boxes(values, corners(simplices), mean, shares)
    return (Division(splits, theta[..., :-1], mean, known),
            np.where(exists[:, :, None], bounds, -np.inf))
