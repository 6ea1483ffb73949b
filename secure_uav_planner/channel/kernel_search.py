"""The searches of disc_search by the compiled kernel, where it is there."""

import numpy as np

from . import disc_search
from .disc_search import DiscSearch, Found
from .inverse_sinr import Indices, Pairs
from ..kernel import compiled
from ..scenario import Array


def likely_places(pairs: Pairs) -> Found:
    """Return the places of disc_search.likely_places."""
    kernel = compiled()
    if kernel is None:
        return disc_search.likely_places(pairs)
    v, x, y = found = np.empty((3, len(pairs)))
    kernel.likely_places(_plain(pairs), found)
    return v, x, y


def search_of(pairs: Pairs, slot: Indices, most: Array) -> DiscSearch:
    """Return a DiscSearch, by the kernel where that is possible."""
    return (DiscSearch if compiled() is None else KernelDiscSearch)(pairs, slot, most)


class KernelDiscSearch(DiscSearch):
    """The same as DiscSearch, which states the method, slot by slot."""

    def proven_leaks(self) -> Array:
        """Return what no place of a slot's discs leaks more than; see DiscSearch."""
        leaks = np.zeros(len(self.pair))
        pair = np.zeros(len(self.pair), np.int64)
        compiled().prove(
            _plain(self._pairs), np.ascontiguousarray(self._slot, np.int64),
            np.ascontiguousarray(self._most), disc_search.MOST_SECTORS, leaks, pair, self.place)
        self.pair = pair.astype(np.intp)
        return leaks


def _plain(pairs: Pairs) -> dict[str, Array]:
    """Return pairs as the kernel takes them."""
    return {name: np.ascontiguousarray(getattr(pairs, name)) for name in (
        'x', 'y', 'squared_altitudes', 'noise', 'jamming', 'radius')}
