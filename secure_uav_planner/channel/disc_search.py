"""
The largest leak over discs: a quick search for it, and the proof that no place leaks more.

Both work on the inverse SINR v of all pairs of a slot and an eavesdropper at once, in flat arrays.
"""

from typing import TypeAlias

import numpy as np

from .inverse_sinr import Indices, Pairs, Sectors
from ..scenario import Array

Found: TypeAlias = tuple[Array, Array, Array]
"""Places seen from the centres of their discs: v, x in m and y in m, (P,) each."""

TOLERANCE = 8e-7
"""How far in bit/s/Hz a proven leak may lie above the largest one found."""

MOST_SECTORS = 50000
"""
About the most sectors that are examined in a slot; what is proven until then counts.

Of 36000 slots of random scenarios, among them all extremes that a Scenario allows, none needed
20000, 99 of 100 needed less than 1200, half of them 20. With two UAVs 50000 take 0.02 s.
"""

_AT_ONCE = 2**16  # Pairs of a sector and a UAV that are examined together: 20 MB.
_STEPS = 30  # Newton steps of a search, which mostly ends after 5.
_RAYS = 6  # Sectors of the first ring, and of the places where the search may start.
_POINT = 1e-12  # Radius in m up to which a disc is searched at one place.
_TINY = 1e-300


def leak_of(inverse: Array) -> Array:
    """Return the leak log2(1 + 1 / v) in bit/s/Hz."""
    leak: Array = np.log1p(1.0 / inverse) / np.log(2.0)
    return leak


def inverse_of(leak: Array) -> Array:
    """Return v of a leak above zero in bit/s/Hz."""
    inverse: Array = 1.0 / np.expm1(leak * np.log(2.0))
    return inverse


def nearest_places(pairs: Pairs) -> Found:
    """Return the places of the discs that are nearest to the transmitter."""
    return _found(pairs, pairs.x[0], pairs.y[0])


def likely_places(pairs: Pairs) -> Found:
    """
    Return a place of each disc where v has a local minimum, and that probably is the least.

    Newton's method from the best of the place nearest to the transmitter, the centre, six on a
    circle half as wide and six on the edge.
    """
    best = nearest_places(pairs)
    zero = np.zeros(len(pairs))
    for x, y in ((zero, zero), *(
            (share * pairs.radius * np.cos(angle), share * pairs.radius * np.sin(angle))
            for share in (0.5, 1.0) for angle in np.arange(_RAYS) * (2 * np.pi / _RAYS))):
        best = _better(best, _found(pairs, x, y))
    return descend(pairs, best)


def descend(pairs: Pairs, start: Found) -> Found:
    """
    Return places of the discs where v has a local minimum, or all but has.

    Newton's method in the disc, and along its edge where v falls outwards; each step is limited,
    and moves against the slope also where v is not convex.
    """
    v, x, y = (array.copy() for array in start)
    longest = 0.5 * pairs.radius
    alive = np.flatnonzero(pairs.radius > _POINT)
    for _ in range(_STEPS):
        if not alive.size:
            break
        some = pairs[alive]
        old = v[alive], x[alive], y[alive]
        new = _found(some, *_newton_step(some, old[1], old[2], longest[alive]))
        v[alive], x[alive], y[alive] = _better(old, new)
        fallen = new[0] < old[0]
        longest[alive] *= np.where(fallen, 2.0, 0.25)
        # Newton's next gain is of the order of the square of this one.
        alive = alive[np.where(fallen, old[0] - new[0] > 1e-7 * old[0],
                               longest[alive] > 1e-4 * some.radius)]
    return v, x, y


def _newton_step(pairs: Pairs, x: Array, y: Array, longest: Array) -> tuple[Array, Array]:
    """Return the places to which a step of at most some length leads, before the disc counts."""
    v = pairs.derivatives(x, y)
    pull = (v.x * x + v.y * y) / pairs.radius
    edge = (np.hypot(x, y) >= (1 - 1e-9) * pairs.radius) & (pull < 0)
    # Along the eigenvectors of the Hessian, or only along the edge, whose curvature counts too.
    angle = np.where(edge, np.arctan2(x, -y), 0.5 * np.arctan2(2.0 * v.xy, v.xx - v.yy))
    cosine, sine = np.cos(angle), np.sin(angle)
    for along, across, free, extra in (
            (cosine, sine, 1.0, np.where(edge, pull / pairs.radius, 0.0)),
            (-sine, cosine, np.where(edge, 0.0, 1.0), 0.0)):
        slope = (v.x * along + v.y * across) * free
        bend = along**2 * v.xx + 2.0 * along * across * v.xy + across**2 * v.yy - extra
        step = -slope / np.maximum(np.maximum(np.abs(bend), np.abs(slope) / longest), _TINY)
        x, y = x + step * along, y + step * across
    return x, y


class DiscSearch:
    """
    The least v over the discs of every slot.

    :param pairs: P of them, sorted by their slots.
    :param slot: of each pair, (P,); every one from 0 to M - 1 has some.
    :param most: that each leaks by the formula of the guarantee, (P,) in bit/s/Hz.
    :ivar pair: which has the least v found in each slot, (M,).
    :ivar place: where, seen from the centre of its disc, (M, 2) in m.
    """

    def __init__(self, pairs: Pairs, slot: Indices, most: Array) -> None:
        self._pairs, self._slot, self._most = pairs, slot, most
        slots = int(slot[-1]) + 1
        self.pair: Indices = np.zeros(slots, np.intp)
        self.place: Array = np.zeros((slots, 2))
        self._least = np.full(slots, np.inf)
        self._enough = np.full(slots, np.inf)
        self._proven = np.full(slots, np.inf)
        self._examined = np.zeros(slots, np.intp)

    def proven_leaks(self) -> Array:
        """
        Return what no place of a slot's discs leaks more than, (M,) in bit/s/Hz.

        A branch and bound: discs are divided into sectors of rings, and sectors whose bound shows
        that the leak in them is at most TOLERANCE above the largest one found are dropped. It
        ends when none is left, or in a slot after MOST_SECTORS; what those that are left might
        leak is part of the result, which then is further from the largest leak, and as sure.
        """
        alive = np.arange(len(self._pairs))
        for search in (nearest_places, likely_places):
            self._offer(alive, search(self._pairs[alive]))
            alive = alive[self._most[alive] > leak_of(self._least)[self._slot[alive]] + TOLERANCE]
            if not alive.size:
                break
        skipped = self._most.copy()
        skipped[alive] = 0.0
        leaks = np.maximum.reduceat(skipped, _firsts(self._slot))
        bound = inverse_of(self._most[alive])
        waiting = [(Sectors.of(alive, self._pairs.radius[alive]), bound)]
        while waiting:
            sectors, bound = waiting.pop()
            half = len(sectors) // 2
            if half * len(self._pairs.x) > _AT_ONCE:
                waiting += [(sectors[:half], bound[:half]), (sectors[half:], bound[half:])]
            elif len(sectors):
                waiting.append(self._divide(sectors, bound))
        return np.maximum(leaks, leak_of(np.minimum(self._proven, self._least)))

    def _offer(self, pair: Indices, found: Found) -> None:
        """Take note of places in the discs of pairs, which are sorted by their slots."""
        slot = self._slot[pair]
        first = _firsts(slot)
        lowest = np.repeat(np.minimum.reduceat(found[0], first), np.diff(first, append=len(slot)))
        best = np.flatnonzero((found[0] == lowest) & (lowest < self._least[slot]))
        best = best[_firsts(slot[best])]
        slot = slot[best]
        v, x, y = (array[best] for array in found)
        self.pair[slot], self._least[slot] = pair[best], v
        self.place[slot] = np.stack([x, y], axis=-1)
        self._enough[slot] = inverse_of(leak_of(v) + TOLERANCE)

    def _divide(self, sectors: Sectors, bound: Array) -> tuple[Sectors, Array]:
        """Bound v in sectors, and return the parts of those that are not dropped."""
        slot = self._slot[sectors.pair]
        bounds, *found = self._pairs.least_in(sectors)
        # A part has no smaller v than the whole.
        bound = np.maximum(bound, bounds)
        first = _firsts(slot)
        count = np.diff(first, append=len(slot))
        least = np.repeat(np.minimum.reduceat(found[0], first), count)
        better = np.flatnonzero((found[0] == least) & (least < self._least[slot]))
        if better.size:
            pair = sectors.pair[better]
            v, x, y = (array[better] for array in found)
            self._offer(pair, descend(self._pairs[pair], (v, x, y)))
        present = slot[first]
        self._examined[present] += count
        left = (bound < self._enough[slot]) & (self._examined < MOST_SECTORS)[slot]
        self._proven[present] = np.minimum(self._proven[present], np.minimum.reduceat(
            np.where(left, np.inf, bound), first))
        return _divided(sectors[left], bound[left])


def _divided(sectors: Sectors, bound: Array) -> tuple[Sectors, Array]:
    """Return the parts of sectors: of a disc its inner half and six more, else four."""
    whole = sectors.half > 0.5 * np.pi
    count = np.where(whole, _RAYS + 1, 4)
    parts = sectors[np.repeat(np.arange(len(sectors)), count)]
    last = np.repeat(np.cumsum(count), count)
    number = np.arange(len(parts)) + np.repeat(count, count) - last
    of_whole = np.repeat(whole, count)
    middle = 0.5 * (parts.inner + parts.outer)
    outer_half = np.where(of_whole, number > 0, number % 2 == 1)
    half = np.where(of_whole, np.where(outer_half, np.pi / _RAYS, np.pi), 0.5 * parts.half)
    turn = np.where(of_whole, outer_half * (2.0 * number * half), (number // 2 * 2 - 1) * half)
    return Sectors(parts.pair, np.where(outer_half, middle, parts.inner),
                   np.where(outer_half, parts.outer, middle),
                   parts.middle + turn, half), np.repeat(bound, count)


def _firsts(slot: Indices) -> Indices:
    """Return where in sorted numbers a new one begins."""
    return np.flatnonzero(np.diff(slot, prepend=-1))


def _found(pairs: Pairs, x: Array, y: Array) -> Found:
    """Return the places of the discs that are nearest to some."""
    share = np.minimum(1.0, pairs.radius / np.maximum(np.hypot(x, y), _TINY))
    x, y = share * x, share * y
    return pairs.at(x, y), x, y


def _better(one: Found, other: Found) -> Found:
    fallen = other[0] < one[0]
    v, x, y = (np.where(fallen, new, old) for old, new in zip(one, other, strict=True))
    return v, x, y
