"""
Shares of the slots for several ground nodes: a linear program, solved by an interior-point method.

The least mean over weight is maximised. In its dual a node has a price l, prices sum to 1, and a
slot is worth max_k l_k r_k. A step of Newton's method on both costs G^2 N for G nodes and N slots.
"""

from collections.abc import Iterable

import numpy as np

from ...mission.scenario import Array, Scenario

_GAP = 1e-11  # Relative distance between the program and its dual at the end.
_MOST_STEPS = 100  # About 15 are taken, 30 where nodes' rates differ by 1e6.
_CENTRING = 0.1  # Ratio of the barrier parameters of two steps.
_BOUNDARY = 0.99  # Share of the way to the boundary that a step goes at most.
_LEAST_MEAN = 1e-3  # Share of the largest mean that counts for a node's first price at least.
_NEGLIGIBLE = 1e-9  # Rate in a share of a slot, over the least mean, below which it is 0.
_RIDGE = 1e-14  # Part of the identity in the scaled matrix of Newton's method.
_IDLE = 1e-6  # Relative surplus over the least mean above which a node has no price.


def find_shares(scenario: Scenario, rates: Array, unit: float = 1.0) -> Array:
    """
    Return the shares of the slots, (G, N), with the largest least mean over weight.

    They are a vertex of a linear program, so that at most G - 1 slots are divided. Slots of rate 0
    have share 0; a single node owns all slots.

    :param rates: of each ground node, (G, N), at least 0.
    :param unit: of the rates, in bit/s/Hz.
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
    """Return the shares (G, N) with the largest least mean, where means have offsets (G,)."""
    shares, used = np.zeros(rates.shape), np.flatnonzero(rates.any(axis=0))
    if len(used):
        scale = rates.max()
        method = (_take_all, _divide_between_two, _divide_between_many)[min(len(rates), 3) - 1]
        shares[:, used] = method(
            rates[:, used] / scale, offsets * (rates.shape[1] / len(used) / scale))
    return shares


def _take_all(rates: Array, offsets: Array) -> Array:
    """Return shares of 1 for a single node."""
    return np.ones(rates.shape)


def _divide_between_two(rates: Array, offsets: Array) -> Array:
    """Return the shares of two nodes: of the first, the slots worth most to it, until both tie."""
    total = np.maximum(rates.sum(axis=0), 1e-100)
    order = np.argsort(-rates[0] / total, kind='stable')
    ends = np.cumsum(total[order])
    # The second node has it over the first if it owns all slots.
    lead = rates[1].sum() + len(order) * (offsets[1] - offsets[0])
    first = np.empty(len(order))
    first[order] = np.clip(1.0 + (lead - ends) / total[order], 0.0, 1.0)
    return np.stack([first, 1.0 - first])


def _divide_between_many(rates: Array, offsets: Array) -> Array:
    """
    Return the shares of three and more nodes; nodes above the least mean divide the other slots.

    Both programs stay strictly feasible: shares and each node's surplus over the least mean,
    prices and each slot's excess of its worth over l_k r_k.
    """
    nodes, slots = rates.shape
    means = rates.mean(axis=1)
    prices = 1 / np.maximum(means, _LEAST_MEAN * means.max())
    prices /= prices.sum()
    worth = prices[:, None] * rates
    most = worth.max(axis=0)
    excess = most + most.mean() - worth
    shares = np.full(rates.shape, 1 / nodes)
    least = float((means / nodes + offsets).min() / 2)
    surplus = slots * (means / nodes + offsets - least)
    for _ in range(_MOST_STEPS):
        gap = float((shares * excess).sum() + prices @ surplus)
        if gap <= _GAP * slots * least:
            break
        mu = _CENTRING * gap / (shares.size + nodes)
        slopes, centring = shares / excess, mu / excess - shares
        total = slopes.sum(axis=0)
        pull, gains = centring.sum(axis=0) / total, slopes * rates
        diagonal = (gains * rates).sum(axis=1) + surplus / prices
        if not diagonal.all():
            break  # What is left is rounding.
        matrix = np.diag(diagonal) - gains / total @ gains.T
        right = mu / prices - surplus - (rates * centring - gains * pull).sum(axis=1)
        # Prices keep their sum; the matrix is scaled and kept regular.
        size = 1 / np.sqrt(diagonal)
        steps = size[:, None] * np.linalg.solve(
            size * matrix * size[:, None] + _RIDGE * np.eye(nodes),
            size[:, None] * np.stack([right, np.ones(nodes)], axis=1))
        change = steps[:, 0].sum() / steps[:, 1].sum()
        step = steps[:, 0] - change * steps[:, 1]
        excess_step = pull + step @ gains / total - step[:, None] * rates
        shares_step = centring - slopes * excess_step
        surplus_step = mu / prices - surplus * (1 + step / prices)
        length = min(_find_length(shares, shares_step), _find_length(surplus, surplus_step))
        shares, surplus = shares + length * shares_step, surplus + length * surplus_step
        least -= length * change / slots
        length = min(_find_length(excess, excess_step), _find_length(prices, step))
        excess, prices = excess + length * excess_step, prices + length * step
    idle = surplus > _IDLE * slots * least
    idle &= not idle.all()  # After the last of _MOST_STEPS no surplus may be 0.
    useful = np.where(rates > 0, shares, 0.0)
    own = useful[~idle].sum(axis=0) >= useful[idle].sum(axis=0)
    kept = own & (shares[~idle] * rates[~idle] > _NEGLIGIBLE * least)
    divided = np.zeros(rates.shape)
    divided[~idle] = _unite(np.where(kept, shares[~idle], 0.0), rates[~idle])
    if idle.any() and not own.all():
        divided[np.ix_(idle, ~own)] = _divide(
            rates[np.ix_(idle, ~own)], offsets[idle] * (slots / (~own).sum()))
    return divided


def _find_length(values: Array, step: Array) -> float:
    """Return the length of a step, at most 1, with which positive values stay positive."""
    return _BOUNDARY / max(_BOUNDARY, float((-step / values).max()))


def _unite(shares: Array, rates: Array) -> Array:
    """
    Return shares (G, N) that divide at most G - 1 slots; no node's mean falls.

    Where nodes are linked by divided slots in a circle, shares are passed round until one is 0.
    """
    total = shares.sum(axis=0)
    united = np.divide(shares, total, out=np.zeros(shares.shape), where=total > 0)
    parts: dict[int, dict[int, float]] = {}  # Shares of divided slots for their nodes.
    links: list[set[int]] = [set() for _ in shares]  # Divided slots of each node, without circles.
    for slot in np.flatnonzero((united > 0).sum(axis=0) > 1).tolist():
        nodes = np.flatnonzero(united[:, slot]).tolist()
        parts[slot] = {node: float(united[node, slot]) for node in nodes}
        for node in nodes:
            while node in parts[slot] and (path := _find_path(links, parts[slot], slot, node)):
                _pass_round(parts, links, [(slot, node, path[0][1]), *path], rates)
            if node in parts[slot]:
                links[node].add(slot)
    for slot, part in parts.items():
        united[:, slot] = 0.0
        united[list(part), slot] = np.array(list(part.values())) / sum(part.values())
    return united


def _pass_round(parts: dict[int, dict[int, float]], links: list[set[int]],
                circle: list[tuple[int, int, int]], rates: Array) -> None:
    """
    Pass shares round a circle of links (slot, giver, taker) until a share is 0.

    Every node but the first takes as much rate as it gives. The first node gains, because the
    circle is reversed if it would lose.
    """
    gain, given = 1.0, []
    for slot, giver, taker in circle:
        given.append(gain / rates[giver, slot])
        gain *= rates[taker, slot] / rates[giver, slot]
    if gain < 1:
        circle = [(slot, taker, giver) for slot, giver, taker in reversed(circle)]
        gain, given = 1.0, []
        for slot, giver, taker in circle:
            given.append(gain / rates[giver, slot])
            gain *= rates[taker, slot] / rates[giver, slot]
    left = [parts[slot][giver] / share for (slot, giver, _), share in zip(circle, given)]
    for number, ((slot, giver, taker), share) in enumerate(zip(circle, given)):
        parts[slot][taker] += min(left) * share
        parts[slot][giver] -= min(left) * share
        if number == left.index(min(left)):
            del parts[slot][giver]
            for node in (giver, *(parts[slot] if len(parts[slot]) == 1 else ())):
                links[node].discard(slot)


def _find_path(links: list[set[int]], begins: Iterable[int], new: int,
               end: int) -> list[tuple[int, int, int]]:
    """
    Return the shortest path of links (slot, from, to) from nodes with a new slot to a node.

    :param links: divided slots of each node; two nodes with a common slot are linked.
    :param begins: nodes of the new slot.
    """
    before: dict[int, tuple[int, int]] = {}
    queue = [node for node in begins if new in links[node]]
    reached = set(queue)
    for node in queue:
        for other in range(len(links)):
            if other not in reached and (shared := links[node] & links[other]):
                before[other] = min(shared), node
                reached.add(other)
                queue.append(other)
    path: list[tuple[int, int, int]] = []
    while end in before:
        slot, node = before[end]
        path.insert(0, (slot, node, end))
        end = node
    return path
