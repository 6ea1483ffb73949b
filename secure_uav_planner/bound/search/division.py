"""How what several jammers can do is divided into boxes, for lemma 8 of the certificate."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .columns import Columns, grid
from .multiplier_search import MultiplierSearch
from ..proof.conjugate import Array, mixing
from ..proof.jammer_shares import corners, Division, over_boxes, share_boxes
from ...model.kernel import core

LISTENERS = {2: 4, 3: 3}
"""Eavesdroppers that count at a breakpoint at most, where several jam: each stage has its own."""

SPLITS = {(2, 1): 8000, (2, 2): 20000, (2, 3): 10000, (2, 4): 6000, (3, 1): 16000,
          (3, 2): 16000, (3, 3): 3500}
"""How often that is cut at all breakpoints, by the numbers of jammers and of those who count."""

MOST_SPLITS = 200
"""How often that is cut at one breakpoint at most."""

SPREAD, FAINT = (3, 3), 1e-4
"""
Places all over a jammer's set that are tried too, and at what share of its peak, beside that.

A jammer whose power is above 0 in a box may do the least harm far from where it is of use.
"""

SLACK = 0.5
"""Share of what a node's maximum could be too large without raising its stage's bound."""

ENOUGH = 2e-3
"""By how much, in nats, a breakpoint may be above what combinations are worth without a cut."""

AT_ONCE = 10
"""Breakpoints between two questions whether to stop."""


def divided(search: MultiplierSearch, fields: dict[str, Any], stage: NDArray[np.intp],
            weights: Array, shares: Array, worth: Array, slack: Array, stop: Callable[[], bool],
            share: float = 1.0) -> tuple[Division, Array]:
    """
    Return boxes of what the jammers can do, the one with the largest bound cut again and again.

    :param fields: what fields_of returns.
    :param stage: of every breakpoint, (M,).
    :param weights: w0, (M,).
    :param shares: v, (M, E).
    :param worth: about what all jammers' terms are worth, (M,).
    :param slack: how much more they may be, (M,).
    :param stop: asked now and then; True leaves the rest without a cut.
    :param share: of all cuts.
    :return: the boxes, and about the largest bound at every breakpoint, (M,) in nats.
    """
    team = search.team
    m, j = len(stage), team.copies
    counted = np.clip((shares > 0).sum(1), 1, LISTENERS.get(j))
    e = int(counted.max())
    cuts = np.array([min(MOST_SPLITS, share * SPLITS.get((j, n), 0) // m)
                     for n in counted.tolist()], np.int64)
    count = cuts.max()
    box, side = np.full((m, count), -1), np.zeros((m, count), np.int64)
    at, theta = np.zeros((m, count)), np.zeros((m, count + 1, e, j, j)) + 1 / (j * e)
    mean, known = np.ones((m, count + 1, e, j)), np.zeros((m, count + 1, j, j**e))
    listeners = np.sort(np.argsort(shares, 1)[:, -e:], 1).astype(np.int64)
    heard = np.take_along_axis(shares, listeners, 1)
    if j == 1:
        known[:, 0, 0, 0] = worth
    else:
        every = {
            'stage': stage.astype(np.int64), 'weight': weights, 'listeners': listeners,
            'shares': heard, 'enough': worth + ENOUGH + slack, 'cuts': cuts, 'box': box,
            'side': side, 'at': at, 'theta': theta, 'mean': mean, 'known': known}
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
    rho = corners(simplices)
    values = known.sum(0) - weights[:, None] * mixing(np.moveaxis(corners(theta).sum(3), -1, 0))
    bounds = np.where(exists[:, :, None], over_boxes(values, rho, mean, heard), -np.inf)
    worst = bounds.max((0, 2))
    return (Division(listeners, splits, theta[..., :-1], mean, known,
                     SLACK / j * (worst[:, None] - bounds)), worst)


def fields_of(search: MultiplierSearch) -> dict[str, Any]:
    """Return what the kernel reads of all jammers, and of columns to begin with; empty for one."""
    if search.team.copies == 1:
        return {}
    columns = []
    for region, some in zip(search.team.regions[1:], search.candidates):
        place = grid(region, *SPREAD)
        power = np.tile(region.peak * np.array([FAINT, 1.0]), (len(place), 1))
        columns.append(Columns.joined([
            some, Columns.product(region, place, power, search.team.copies)]))
    return search.fields(columns)
