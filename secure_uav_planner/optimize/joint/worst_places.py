"""The places in the discs that stand for them where the true worst case is the objective."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...mission.scenario import Array
from ...model.channel import leak_maximisers
from ...model.channel.receivers import Receivers
from ...model.grid import Grid

_ANGLES = (0.0, 2.0, 4.0)  # Of the first places of a disc, from the worst one, in rad.
_NEAR = 0.5  # In radii of the disc.


class WorstPlaces:
    """
    A few places of every disc in every slot, exchanged against worse ones.

    Problem (P1) has the largest leak to any place of a disc. Counting with finitely many is
    right at an iterate when no other place has a larger leak than the worst of them.

    :param grid: of the scenario's own slots.
    :param x: where to begin, (N, U, 3).
    :ivar receivers: the ground node, and eavesdroppers at the places.
    :ivar rate: against the worst places at the last x, losing slots silenced, mean in nats.
    """

    def __init__(self, grid: Grid, x: Array) -> None:
        self._grid = grid
        self._scenario = grid.scenario
        self._centres = self._scenario.eavesdropper_positions
        self._guarantee = Receivers.of(grid)
        worst, leaks = self._worst(x)
        offset = worst - self._centres[:, None]
        # Of eavesdroppers that collude the SINRs of all places add up: each has one place.
        angles = _ANGLES[:1] if self._scenario.colluding else _ANGLES
        turns = np.array([[[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]
                          for angle in angles])
        # (E, N, P, 2), P places for each disc.
        self._places = self._centres[:, None, None] + np.einsum('aij,enj->enai', turns, offset)
        # Which are where the leak is largest at the last x, (E, N, P).
        self._largest: NDArray[np.bool_] = np.zeros(self._places.shape[:-1], bool)
        self._largest[..., 0] = True
        self.receivers = self._made()
        self.rate = self._rate(*self.receivers.rates(x), leaks)

    def exchange(self, x: Array, tolerance: float) -> bool:
        """
        Take up the worst place of every disc and slot at x (N, U, 3); return if any was worse.

        It takes the place of a near one, which so follows the UAVs and whose dual is nearly its
        own. If none is near, it counts only where it is worse than all that do by a tolerance in
        nats, and takes the place of the one with the smallest leak.
        """
        worst, leaks = self._worst(x)
        ground, leaks_known = self.receivers.rates(x)
        self.rate = self._rate(ground, leaks_known, leaks)
        known = np.moveaxis(leaks_known.reshape(len(x), len(worst), -1), 1, 0)
        # Only what is worse than all places of all discs matters.
        worse = leaks > known.max(axis=2 if self._scenario.colluding else (0, 2)) + tolerance
        apart = np.linalg.norm(self._places - worst[:, :, None], axis=-1)
        near = apart.min(axis=-1) < _NEAR * self._scenario.error_radii[:, None]
        left = np.where(near, apart.argmin(axis=-1), known.argmin(axis=-1))
        eve, slot = np.nonzero(near | worse)
        left = left[eve, slot]
        self._places[eve, slot, left] = worst[eve, slot]
        self._largest[:] = False
        self._largest[eve, slot, left] = True
        self.receivers = self._made()
        return bool(worse.any())

    @property
    def compiled(self) -> dict[str, NDArray[Any]]:
        """
        Return what the kernel asks for, by the names of problem.hpp.

        These are the radii of the discs of all places, (E P,) in units of the grid, the places
        from the centres of their discs, (N, E P, 2), and which move along with the UAVs, (N, E P).
        """
        radii = np.repeat(self._scenario.error_radii / self._grid.length, self._places.shape[2])
        offsets = self._by_slots(self._places - self._centres[:, None, None]) / self._grid.length
        return {'radii': radii, 'offsets': offsets,
                'followed': self._by_slots(self._largest) & (radii > 0)}

    def _worst(self, x: Array) -> tuple[Array, Array]:
        """Return the worst places (E, N, 2) in m, and their leaks (E, N) in nats."""
        places, leaks = leak_maximisers(
            self._scenario, self._grid.positions(x)[:, 1:-1], self._grid.powers(x))
        return places, leaks * np.log(2)

    def _made(self) -> Receivers:
        places = self._by_slots(self._places)
        return self._guarantee.at_places((places - self._grid.origin) / self._grid.length)

    @staticmethod
    def _by_slots(values: NDArray[Any]) -> NDArray[Any]:
        """Return (N, E P, ...) of (E, N, P, ...)."""
        values = np.swapaxes(values, 0, 1)
        return values.reshape(len(values), -1, *values.shape[3:])

    def _rate(self, ground: Array, known: Array, leaks: Array) -> float:
        if self._scenario.colluding:
            most: Array = np.log1p(np.expm1(np.maximum(leaks, known.T)).sum(axis=0))
        else:
            most = np.maximum(leaks.max(axis=0), known.max(axis=-1))
        return float(np.maximum(ground - most, 0.0).mean())
