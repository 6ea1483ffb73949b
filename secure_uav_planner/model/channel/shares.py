"""Shares of the slots for several ground nodes: a linear program, solved by _find_vertex."""

from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from ...mission.scenario import Array, Scenario

_Mask: TypeAlias = NDArray[np.bool_]

_MOST_STEPS = 60  # The most steps for each node; about 5 are taken.
_NEGLIGIBLE = 1e-15  # Rate that replaces 0, in units of the node's mean rate.
_EQUAL = 1e-10  # Relative difference of equal rates.
_CHANGE = 1e-9  # Largest relative change of a rate.
_IDLE = 1e-6  # Relative surplus over the least mean above which a node has no price.
_SAME = 1e-14  # Logarithm of the ratio of equal worths, which is rounding.
_ROUNDING = 1e-12  # Size of a negative share that is rounding.


def find_shares(scenario: Scenario, rates: Array, unit: float = 1.0) -> Array:
    """
    Return the shares of the slots, (G, N), with the largest least mean over weight.

    The shares s maximise the least over the nodes k of (offset_k + mean_n s_kn r_kn) / weight_k.
    The shares of a slot add up to 1, or to 0 if all its rates are 0. They are a vertex of this
    linear program, so at most G - 1 slots are divided. A node has no share of a slot in which its
    rate is 0. A single node owns all slots, of any rate. If a node has neither rates nor an
    offset, the least is 0, and each slot goes to the node with its largest rate / weight.

    :param rates: rate of each ground node in each slot, (G, N), at least 0.
    :param unit: unit of the rates [bit/s/Hz].
    """
    nodes, slots = rates.shape
    if nodes == 1:
        return np.ones((1, slots))
    scaled, offsets = rates / scenario.node_weights[:, None], (
        scenario.node_offsets / scenario.node_weights / unit)
    if (scaled.any(axis=1) | (offsets > 0)).all():
        return _divide(scaled, offsets)
    best = np.eye(nodes)[scaled.argmax(axis=0)].T
    return np.where(scaled.any(axis=0), best, 0.0)


def _divide(rates: Array, offsets: Array) -> Array:
    """Return shares s (G, N) that maximise min over nodes k of mean_n(s_kn r_kn) + offset_k."""
    nodes, slots = rates.shape
    # An offset is the rate of a further slot of its node, and a negligible rate replaces 0. So
    # each node can pass slots on to each other node, and no price is 0.
    table = np.hstack([rates, np.diag(offsets * slots)])
    used = np.asarray(table.any(axis=0))
    table = table[:, used]
    table = np.maximum(table, _NEGLIGIBLE * table.mean(axis=1, keepdims=True))
    shares = np.zeros((nodes, len(used)))
    shares[:, used] = _divide_equal_slots(table)
    shares = np.where(rates > 0, shares[:, :slots], 0.0)
    total = shares.sum(axis=0)
    shares = shares / np.where(total > 0, total, 1.0)
    # Nodes above the least mean divide the slots that nodes at the least mean do not use.
    means = (shares * rates).mean(axis=1) + offsets
    idle = means > (1 + _IDLE) * means.min()
    unused = ~shares[~idle].any(axis=0) & rates[idle].any(axis=0)
    if unused.any():
        shares[:, unused] = 0.0
        means = (shares[idle] * rates[idle]).mean(axis=1) + offsets[idle]
        part = np.ix_(idle, unused)
        shares[part] = _divide(rates[part], means * (slots / unused.sum()))
    return shares


def _divide_equal_slots(rates: Array) -> Array:
    """
    Return the shares (G, N) by _find_vertex for positive rates (G, N), where slots may be equal.

    Slots with equal rates are joined into one with the sum of their rates. A joined slot that
    several nodes share gives each node consecutive slots, so at most one slot per node is divided.
    """
    _, slots = rates.shape
    # Sorted by a random combination of logarithms, equal slots are successive. `groups` has the
    # number of the joined slot of each slot, and `first` one slot of each joined slot.
    order = np.argsort(np.random.default_rng(0).random(len(rates)) @ np.log(rates), kind='stable')
    ahead, after = rates[:, order[:-1]], rates[:, order[1:]]
    groups = np.empty(slots, int)
    groups[order] = np.append(0, np.cumsum((np.abs(after - ahead) > _EQUAL * after).any(axis=0)))
    counts = np.bincount(groups)
    _, first = np.unique(groups, return_index=True)
    joined = _find_vertex(rates[:, first] * counts)
    shares = joined[:, groups]
    for group in np.flatnonzero(((joined > 0).sum(axis=0) > 1) & (counts > 1)):
        ends = np.append(0.0, np.cumsum(joined[:, group])) * counts[group]
        begins = np.arange(counts[group])
        shares[:, groups == group] = np.clip(
            ends[1:, None] - begins, 0, 1) - np.clip(ends[:-1, None] - begins, 0, 1)
    return shares


def _find_vertex(rates: Array) -> Array:
    """
    Return the shares s (G, N) that maximise min_k mean_n(s_kn r_kn); <= G - 1 slots are divided.

    This is a dual simplex method. Node k has a price p_k, and a slot goes to the node with the
    largest worth p_k r_kn. A slot worth as much to several nodes is tied and divided. At a vertex
    the tied slots link all nodes as a tree. A step cuts the tree at the most negative share, and
    scales the prices on one side until the dual is least and another slot ties. A step may pass
    any number of slots, so the number of steps hardly depends on the number of slots.

    :param rates: positive, (G, N).
    """
    nodes = len(rates)
    # Tiny changes of the rates, so that no two slots tie at the same prices.
    rates = rates * (1 + _CHANGE * np.random.default_rng(0).random(rates.shape))
    prices = 1 / rates.mean(axis=1)
    ties: dict[int, set[int]] = {}  # Nodes of each tied slot.
    cut = 0  # A node on the side of the cut whose prices are scaled.
    for _ in range(_MOST_STEPS * nodes):
        part = _find_linked(ties, cut, nodes)
        if not part.all():
            _scale_prices(rates, prices, ties, part)
            continue
        worth = prices[:, None] * rates
        owned = worth >= worth.max(axis=0)
        owned[:, list(ties)] = False
        parts = [(slot, node) for slot, tied in ties.items() for node in tied]
        values = _solve_ties(rates, (owned * rates).sum(axis=1), parts)
        if not (values < -_ROUNDING).any():
            break
        slot, cut = parts[int(values.argmin())]
        ties[slot].remove(cut)
        if len(ties[slot]) == 1:
            del ties[slot]
    shares = owned.astype(float)
    for (slot, node), value in zip(parts, values):
        shares[node, slot] = max(value, 0.0)
    return shares / shares.sum(axis=0)


def _scale_prices(rates: Array, prices: Array, ties: dict[int, set[int]], part: _Mask) -> None:
    """
    Scale the prices of a part of the nodes so that the dual is least, and add the tied slot.

    A slot's worth is the largest price times rate of a node. The dual is the sum of worths over
    the sum of prices. As the scale grows, the slots pass to the part one by one. The dual is least
    at the first slot with which the part's mean rate, weighted by prices, is at least the mean
    rate of the other nodes.

    :param prices: prices of the nodes, (G,), changed in place.
    :param ties: nodes of each tied slot, changed in place.
    :param part: whether each node is in the part, (G,).
    """
    worth = prices[:, None] * rates
    inside, outside = worth[part].max(axis=0), worth[~part].max(axis=0)
    scales = outside / inside
    order = np.argsort(scales)
    slopes = (np.cumsum(inside[order]) * prices[~part].sum()
              - (outside.sum() - np.cumsum(outside[order])) * prices[part].sum())
    slot = int(order[min(int(np.searchsorted(slopes, 0.0)), len(order) - 1)])
    # A tied slot on the way to that scale ends the step: it ties with the other side, too.
    logs: list[float] = np.log(scales).tolist()
    passed = [tied for tied in ties if (logs[tied] > 0) == (logs[slot] > 0)
              and _SAME < abs(logs[tied]) < abs(logs[slot])]
    slot = min(passed, key=lambda tied: abs(logs[tied]), default=slot)
    prices[part] *= scales[slot]
    tied = ties.setdefault(slot, set())
    for side in (part, ~part):
        if not any(side[node] for node in tied):
            tied.add(int(np.where(side, worth[:, slot], 0.0).argmax()))


def _find_linked(ties: dict[int, set[int]], node: int, nodes: int) -> _Mask:
    """Return True for `node` and all nodes linked to it by a chain of tied slots, (G,)."""
    linked = {node}
    while more := [tied for tied in ties.values() if linked & tied and not tied <= linked]:
        linked = linked.union(*more)
    return np.isin(np.arange(nodes), list(linked))


def _solve_ties(rates: Array, owned: Array, parts: list[tuple[int, int]]) -> Array:
    """
    Return the shares of tied slots, one for each of `parts`, that make all mean rates equal.

    The unknowns are the shares and the common sum of rates c. Each of G nodes has the equation
    owned + sum of share * rate - c = 0, and each tied slot has the equation sum of shares = 1.
    Shares may be negative.

    :param owned: sum of the rates of the slots that each node owns alone, (G,).
    :param parts: G + number of tied slots - 1 pairs (tied slot, node that shares the slot).
    """
    slots = {slot: len(rates) + row for row, slot in enumerate(dict(parts))}
    matrix = np.zeros((len(rates) + len(slots), len(parts) + 1))
    for column, (slot, node) in enumerate(parts):
        matrix[node, column] = rates[node, slot]
        matrix[slots[slot], column] = 1.0
    matrix[:len(rates), -1] = -1.0
    values = np.linalg.solve(matrix, np.append(-owned, np.ones(len(slots))))
    return np.asarray(values[:-1], float)
