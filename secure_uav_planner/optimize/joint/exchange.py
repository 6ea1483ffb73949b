"""
The exchange method for problem (P1), in which the worst place of every disc counts.

Discs have infinitely many places (semi-infinite programming): a few stand for each disc, and are
exchanged for worse places between the Newton steps.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from .barrier import (
    Barrier, Discs, MOST_STEPS, Stepper, Stop, TRY_EVERY, WARM_MU, WARM_SHARE)
from .starts import make_strictly_feasible
from ...mission.scenario import Array
from ...model.channel import leak_maximisers
from ...model.grid import Grid, Receivers
from ...plan.plan import Status

WORSE = 1e-7  # The least leak, in nats, by which a place is worse.
PLACES_MU = 0.02  # The barrier parameter at the beginning
PLACES_FINAL_MU = 1e-7  # and at the end,
PATIENCE = 8  # and the most steps at the end.
WORTH = 0.01  # The relative gain that is worth a second round,
MORE_STEPS = 40  # and its most steps.

_ANGLES = (0.0, 2.0, 4.0)  # Of the first places of a disc, from the worst one, in rad.
_NEAR = 0.5  # In radii of the disc.


def improve_by_exchange(stepper: Stepper) -> Status:
    """Improve the incumbent against the worst places of the discs, problem (P1)."""
    incumbent = stepper.incumbent
    before = incumbent.rate
    status, at_rest = _improve_once(stepper, MOST_STEPS)
    # Where places oscillated and the first round gained much, a second may gain more.
    if not (at_rest or incumbent.warm or incumbent.rate < (1 + WORTH) * before):
        _improve_once(stepper, MORE_STEPS)
    return status


def _improve_once(stepper: Stepper, steps: int) -> tuple[Status, bool]:
    """Improve the incumbent in one round; return also True if places came to rest."""
    incumbent, grid = stepper.incumbent, stepper.grid
    x = make_strictly_feasible(grid, incumbent.positions, incumbent.powers, WARM_SHARE,
                               stepper.check)
    places = WorstPlaces(grid, x)
    barrier = Barrier(grid, x[None], WARM_MU if incumbent.warm else PLACES_MU,
                      stepper.check, places.receivers, places.discs)
    # The proof of a worst case pays only for iterates that seem better than the incumbent.
    best, rate, tried = x, places.rate, incumbent.rate * np.log(2)
    last_steps = 0
    for step in range(1, steps + 1):
        try:
            stepper.step(barrier, PLACES_FINAL_MU)
        except Stop:
            stepper.try_variables(best)
            raise
        last_steps += int(barrier.mu[0] <= PLACES_FINAL_MU)
        worse = places.exchange(barrier.x[0], WORSE)
        barrier.exchange(places.receivers, places.discs, worse)
        if places.rate > rate:
            best, rate = barrier.x[0].copy(), places.rate
        at_rest = bool(barrier.finished.all())
        # Places may oscillate, by ever less.
        done = at_rest or last_steps >= PATIENCE
        if rate > tried and (done or step == steps or step % TRY_EVERY == 0):
            stepper.try_variables(best)
            tried = rate
        if done:
            incumbent.report('joint')
            return 'converged', at_rest
    return 'iteration_limit', False


class WorstPlaces:
    """
    A few places of every disc in every slot, exchanged for worse ones.

    Problem (P1) has the largest leak to any place of a disc. A few places are enough at an iterate
    when no place of the disc has a larger leak than the worst of them.

    :param grid: of the scenario's own slots.
    :param x: the first iterate, (N, U, 3).
    :ivar receivers: the ground node, and eavesdroppers at the places.
    :ivar rate: against the worst places at the last x, losing slots silenced, mean in nats.
    """

    def __init__(self, grid: Grid, x: Array) -> None:
        self._grid = grid
        self._scenario = grid.scenario
        _, self._centres, self._radii = self._scenario.receivers
        self._guarantee = Receivers.of(grid)
        worst, leaks = self._find_worst(x)
        offset = worst - self._centres
        # The SINRs of colluding eavesdroppers add up over all places: each has a single one.
        angles = _ANGLES[:1] if self._scenario.colluding else _ANGLES
        rotations = np.array([[[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]
                              for angle in angles])
        # (E, N, P, 2), P places for each disc.
        self._places = self._centres[:, :, None] + np.einsum('aij,enj->enai', rotations, offset)
        # The places with the largest leak at the last x, (E, N, P).
        self._largest: NDArray[np.bool_] = np.zeros(self._places.shape[:-1], bool)
        self._largest[..., 0] = True
        self.receivers = self._build_receivers()
        self.rate = self._compute_rate(*self.receivers.rates(x), leaks)

    def exchange(self, x: Array, tolerance: float) -> bool:
        """
        Exchange places for the worst of every disc and slot at x, (N, U, 3).

        The worst place replaces a near one, whose dual is nearly its own and which so follows the
        UAVs. If none is near, it replaces the place with the smallest leak, but only if its own
        exceeds all leaks that count by a tolerance in nats.

        :return: True if any worst place exceeds the leaks that count by the tolerance.
        """
        worst, leaks = self._find_worst(x)
        ground, place_leaks = self.receivers.rates(x)
        self.rate = self._compute_rate(ground, place_leaks, leaks)
        counted = np.moveaxis(place_leaks.reshape(len(x), len(worst), -1), 1, 0)
        # Without collusion, only the worst place of all discs counts.
        worse = leaks > counted.max(axis=2 if self._scenario.colluding else (0, 2)) + tolerance
        distances = np.linalg.norm(self._places - worst[:, :, None], axis=-1)
        near = distances.min(axis=-1) < _NEAR * self._radii
        replaced = np.where(near, distances.argmin(axis=-1), counted.argmin(axis=-1))
        eve, slot = np.nonzero(near | worse)
        replaced = replaced[eve, slot]
        self._places[eve, slot, replaced] = worst[eve, slot]
        self._largest[:] = False
        self._largest[eve, slot, replaced] = True
        self.receivers = self._build_receivers()
        return bool(worse.any())

    @property
    def discs(self) -> Discs:
        """
        Discs of the places, by the names of core.pyi, in units of the grid.

        Radii (N, E P), the places relative to the centres, (N, E P, 2), and True for places that
        follow the UAVs, (N, E P).
        """
        radii = np.repeat(self._radii.T / self._grid.length, self._places.shape[2], axis=1)
        offsets = self._by_slots(self._places - self._centres[:, :, None]) / self._grid.length
        return {'radii': radii, 'offsets': offsets,
                'followed': self._by_slots(self._largest) & (radii > 0)}

    def _find_worst(self, x: Array) -> tuple[Array, Array]:
        """Return the worst places (E, N, 2) in m, and their leaks (E, N) in nats."""
        places, leaks = leak_maximisers(
            self._scenario, self._grid.positions(x)[:, 1:-1], self._grid.powers(x))
        return places, leaks * np.log(2)

    def _build_receivers(self) -> Receivers:
        places = self._by_slots(self._places)
        return self._guarantee.at_places((places - self._grid.origin) / self._grid.length)

    @staticmethod
    def _by_slots(values: NDArray[Any]) -> NDArray[Any]:
        """Return (N, E P, ...) of (E, N, P, ...)."""
        values = np.swapaxes(values, 0, 1)
        return values.reshape(len(values), -1, *values.shape[3:])

    def _compute_rate(self, ground: Array, place_leaks: Array, leaks: Array) -> float:
        if self._scenario.colluding:
            most: Array = np.log1p(np.expm1(np.maximum(leaks, place_leaks.T)).sum(axis=0))
        else:
            most = np.maximum(leaks.max(axis=0), place_leaks.max(axis=-1))
        return float(np.maximum(ground - most, 0.0).mean())
