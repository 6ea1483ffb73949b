"""The places in the discs that stand for them where the true worst case is the objective."""

import numpy as np

from ...channel import leak_maximisers
from ...channel.derivatives import Receivers, SlotRates
from ...grid import Grid
from ...scenario import Array

_ANGLES = (0.0, 3.0)  # Of the first places of a disc, from the worst one, in rad.
_NEAR = 0.5  # In radii of the disc.
PER_DISC = len(_ANGLES)


class WorstPlaces:
    """
    A few places of every disc in every slot, exchanged against worse ones.

    Problem (P1) has the largest leak to any place of a disc. Counting with finitely many is
    right at an iterate when no other place has a larger leak than the worst of them.

    :param grid: of the variables; it has the scenario's own slots.
    :param x: where to begin, (N, U, 3).
    :ivar receivers: the ground node, and eavesdroppers at the places.
    """

    def __init__(self, grid: Grid, x: Array) -> None:
        self._grid = grid
        scenario = grid.scenario
        self._guarantee = Receivers.of(grid)
        worst, _ = self._worst(x)
        offset = worst - scenario.eavesdropper_positions[:, None]
        turns = np.array([[[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]
                          for angle in _ANGLES])
        # (E, N, PER_DISC, 2)
        self._places = scenario.eavesdropper_positions[:, None, None] + np.einsum(
            'aij,enj->enai', turns, offset)
        self.receivers = self._made()

    def exchange(self, x: Array, tolerance: float) -> bool:
        """
        Take up the worst place of every disc and slot where it is worse than all that count.

        It takes the place of a near one, which it follows when the UAVs move and whose dual is
        nearly its own, or, if none is near, of the one with the smallest leak.

        :param x: (N, U, 3).
        :param tolerance: by which it must be worse, in nats.
        :return: whether any was taken up.
        """
        worst, leaks = self._worst(x)
        known = SlotRates(self.receivers, x).leaks
        known = np.moveaxis(known.reshape(len(x), len(worst), PER_DISC), 1, 0)
        # Only what is worse than all places of all discs matters.
        new = leaks > known.max(axis=(0, 2)) + tolerance
        eve, slot = np.nonzero(new)
        if not len(eve):
            return False
        apart = np.linalg.norm(self._places[eve, slot] - worst[eve, slot][:, None], axis=-1)
        near = apart.min(axis=-1) < _NEAR * self._grid.scenario.error_radii[eve]
        left = np.where(near, apart.argmin(axis=-1), known[eve, slot].argmin(axis=-1))
        self._places[eve, slot, left] = worst[eve, slot]
        self.receivers = self._made()
        return True

    def _worst(self, x: Array) -> tuple[Array, Array]:
        """Return the worst places (E, N, 2) in m, and their leaks (E, N) in nats."""
        places, leaks = leak_maximisers(
            self._grid.scenario, self._grid.positions(x)[:, 1:-1], self._grid.powers(x))
        return places, leaks * np.log(2)

    def _made(self) -> Receivers:
        places = np.moveaxis(self._places, 0, 1)  # (N, E, PER_DISC, 2)
        places = places.reshape(len(places), -1, 2)
        return self._guarantee.at_places((places - self._grid.origin) / self._grid.length)
