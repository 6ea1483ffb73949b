"""The search for multipliers: columns and temperatures around Newton's method."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from . import columns as candidates
from .columns import Columns
from .dual import column_fields, curved, Dual, unpacked
from .initial_multipliers import InitialMultipliers
from .newton import DualPoint
from ..proof.conjugate import Array
from ..proof.potential import Potential
from ..proof.reachable_set import ReachableSet
from ..proof.subset import circle
from ..proof.team import Team
from ...model.kernel import core

FEW = [0, 4]
"""Of a jammer's powers those that are kept at the coarse places."""

KEEP = 45
"""Columns that are kept of those that are best."""

LATEST = 8
"""How many of the latest lists of columns are used for v."""

ROUND = 16
"""Places on the reachable set's rim that are always kept, where a jammer is silent."""

FRESH, OLD = 5, 15
"""Columns that are improved by a compass search, and earlier ones that stay."""

SILENT = 24
"""Places to be silent at that are kept, beside the fixed ones."""

LONGEST = 1e4
"""Damping at which a Newton step is given up."""


class MultiplierSearch:
    """
    The state of a search for one team.

    :param team: the UAVs.
    :param initial: where to begin.
    :param point: multipliers to begin with, by default the initial ones.
    :param stop: asked now and then; True ends the search.
    """

    def __init__(self, team: Team, initial: InitialMultipliers, point: DualPoint | None = None,
                 stop: Callable[[], bool] = lambda: False) -> None:
        self.team, self.stop = team, stop
        count, uavs = len(team.stages.count), len(team.regions)
        self.point = point if point is not None else DualPoint(
            np.zeros((count + 1, uavs, 4 if team.accelerates else 2)), initial.shares,
            initial.prices)
        self.weight = initial.weight
        self.tables: list[Columns] = []
        self.grids: list[Array] = []
        self.base: list[Columns] = []
        self.places: list[Array] = []
        for i, region in enumerate(team.regions):
            # Nearest to people, too.
            people = region.drawn_in(np.broadcast_to(
                np.concatenate([region.ground[None], region.eavesdroppers]),
                (count, 1 + len(region.eavesdroppers), 2)), np.arange(count)[:, None])
            place = np.concatenate(
                [candidates.grid(region, *candidates.GRID),
                 candidates.rings(region, initial.places[i]), people], 1)
            coarse = np.concatenate([candidates.grid(region, *candidates.COARSE), people], 1)
            power = (np.zeros((count, 1)) if region.transmits
                     else candidates.levels(region, initial.powers[i]))
            few = power if region.transmits else power[:, FEW]
            self.tables.append(Columns.product(region, place, power))
            self.grids.append(place)
            rim = region.farthest(circle(ROUND)[None])
            self.base.append(Columns.joined([
                Columns.product(region, coarse, few),
                Columns.of(region, rim, np.zeros(rim.shape[:2]))]))
            self.places.append(np.concatenate(
                [region.farthest(circle(candidates.RIM)[None]),
                 candidates.grid(region, *candidates.STILL)], 1))
        self.found: list[list[Columns]] = [[] for _ in team.regions]
        self._latest: list[list[Columns]] = []
        self._damping = 1e-6

    # -- what the present multipliers ask for

    def values(self, uav: int, columns: Columns, weight: Array | None = None,
               v: Array | None = None) -> Array:
        """
        Return what columns of a UAV are worth now, (G, C) in nats.

        :param weight: w0 of this UAV, (G,); by default nothing is sent.
        :param v: of this UAV, (G, E).
        """
        if weight is None or v is None:
            weight, v = np.zeros(len(columns.ground)), np.zeros(columns.leaks.shape[::2])
        found = np.empty(columns.ground.shape)
        core.bound_column_values(
            column_fields(self.team, uav, self.point, columns, weight, v), found)
        return found

    @property
    def seen(self) -> list[Columns]:
        """Return the latest columns of every UAV."""
        return [Columns.joined([*same]) for same in zip(self.base, *self._latest)]

    def dual(self, tau: float) -> Dual:
        """Return the dual function on the columns that the present multipliers ask for."""
        self._latest = [*self._latest, [
            self._priced(i) for i in range(len(self.team.regions))]][-LATEST:]
        columns = [Columns.joined([*same]) for same in zip(self.base, self._latest[-1])]
        for i in range(len(self.team.regions)):
            self._look_for_silence(i)
        silent = [self.silent(i) for i in range(len(self.team.regions))]
        return Dual(self.team, self.weight, columns, silent, tau)

    def silent(self, i: int) -> Columns:
        """Return the places of UAV i at which nothing is sent."""
        none = np.zeros(self.places[i].shape[:2])
        return Columns(self.places[i], none, none,
                       np.zeros(none.shape + self.point.shares.shape[1:]))

    def _look_for_silence(self, i: int) -> None:
        """Add the best places at which to be silent; the latest ones stay."""
        region, place = self.team.regions[i], self.places[i]
        if not curved(self.point.potentials.shape[2]):
            pull = np.diff(self.point.potentials[:, i, :2], axis=0)
            new = region.farthest(pull[:, None])
        else:
            pool = self.silent(i)
            start = pool.take(_apart(region, pool, self.values(i, pool)))
            new = self._improved(i, start, pool.ground[:, 0], pool.leaks[:, 0]).place
        fixed = candidates.RIM + candidates.STILL[0] * candidates.STILL[1]
        latest = np.concatenate([place[:, fixed:], new], 1)[:, -SILENT:]
        self.places[i] = np.concatenate([place[:, :fixed], latest], 1)

    def _priced(self, i: int) -> Columns:
        """Return the columns of UAV i that are best for the present multipliers."""
        region, table = self.team.regions[i], self.tables[i].power.shape[1]
        # To be silent somewhere else is worth it even where the other UAV sends.
        rim = Columns.of(region, self.places[i], np.zeros(self.places[i].shape[:2]))
        pool = Columns.joined([self.tables[i], rim, *self.found[i]])
        value = self.values(i, pool, self.weight, self.point.shares)
        few = min(KEEP, value.shape[1])
        chosen = pool.take(np.argpartition(value, -few, axis=1)[:, -few:])
        # Of every place of the table only its best power.
        places = self.grids[i].shape[1]
        powers = table // places
        best = value[:, :table].reshape(len(value), places, powers).argmax(2)
        best = np.concatenate([best + powers * np.arange(places), np.broadcast_to(
            np.arange(table, value.shape[1]), (len(value), value.shape[1] - table))], 1)
        listed, worth = pool.take(best), np.take_along_axis(value, best, 1)
        fresh = self._improved(i, listed.take(_apart(region, listed, worth)), self.weight,
                               self.point.shares)
        found = Columns.joined([*self.found[i], fresh])
        latest = np.arange(found.power.shape[1])[-OLD - FRESH:]
        self.found[i] = [found.take(np.broadcast_to(latest, (len(value), len(latest))))]
        return Columns.joined([chosen, *self.found[i]])

    def _improved(self, i: int, start: Columns, weight: Array, v: Array) -> Columns:
        """Return columns after a compass search from others, all of them at once."""
        region = self.team.regions[i]
        count, many = start.power.shape
        low, high = region.sides
        step = np.repeat(((high - low).max(1) / 12)[:, None], many, 1)
        ratio = np.full((count, many), 0.4)
        place, power = start.place, start.power
        moves = np.array([[0, 0, 0], [1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0],
                          [0, 0, 1], [0, 0, -1]][:5 if region.transmits else 7], float)
        stage = np.arange(count)[:, None, None]
        for _ in range(8):
            trial = place[:, :, None] + step[..., None, None] * moves[:, :2]
            trial = region.drawn_in(trial, stage)
            trial = np.where(region.inside(trial, stage)[..., None], trial, place[:, :, None])
            watts = np.minimum(power[..., None] * np.exp(ratio[..., None] * moves[:, 2]),
                               region.peak)
            flat = Columns.of(region, trial.reshape(count, -1, 2), watts.reshape(count, -1))
            value = self.values(i, flat, weight, v)
            pick = value.reshape(count, many, -1).argmax(-1)[..., None]
            place = np.take_along_axis(trial, pick[..., None], 2)[:, :, 0]
            power = np.take_along_axis(watts, pick, 2)[..., 0]
            stay = pick[..., 0] == 0
            step, ratio = (np.where(stay, size / 2.5, size) for size in (step, ratio))
        return Columns.of(region, place, power)

    def curve(self) -> None:
        """Give the potentials a quadratic part, at first none."""
        x = self.point.potentials
        none = np.zeros(x.shape[:2] + (3,))
        self.point = replace(self.point, potentials=np.concatenate(
            [x[..., :2], none, x[..., 2:]], 2))

    def potential(self, uav: int) -> Potential:
        """Return the present potential of a UAV."""
        return Potential(*unpacked(self.point.potentials[:, uav]), self.team.stages,
                         self.team.regions[uav])

    # -- Newton's method

    def minimise(self, tau: float, iterations: int) -> None:
        """Take Newton steps at one temperature, on the columns that are best now."""
        dual = self.dual(tau)
        for _ in range(iterations):
            if self.stop():
                break
            if -self._descend(dual) < 1e-3 * tau * self.team.stages.slots**0.5:
                break

    def _descend(self, dual: Dual) -> float:
        """
        Take a Newton step once it pays, and return the slope along it, 0 where none does.

        The dual function is flat in many directions and sharp in others, see
        DualDerivatives.step. The damping is carried on from step to step.
        """
        value, derivatives = dual.derivatives(self.point)
        while self._damping < LONGEST:
            try:
                step = derivatives.step(self._damping)
            except np.linalg.LinAlgError:
                self._damping *= 100
                continue
            step = step.within(self.point, dual.room(self.point.shares))
            slope = min(derivatives.slope(step), 0.0)
            for length, factor in ((1.0, 0.1), (0.3, 1.0), (0.1, 1.0)):
                trial = self.point.moved(step, length)
                if dual.value(trial) < value + 0.1 * length * slope:
                    self._damping = max(factor * self._damping, 1e-9)
                    self.point = trial
                    return slope
            self._damping *= 10
        self._damping = 1.0
        return 0.0


def _apart(region: ReachableSet, pool: Columns, value: Array) -> NDArray[np.intp]:
    """Return the indices of the best columns that lie apart from one another, (G, FRESH)."""
    low, high = region.sides
    far = ((high - low).max(1) / 8)[:, None]
    value = value.copy()
    row = np.arange(len(value))
    found = []
    for _ in range(FRESH):
        best = value.argmax(1)
        found.append(best)
        offset = np.abs(pool.place - pool.place[row, best][:, None])
        value[(offset[..., 0] < far) & (offset[..., 1] < far)] = -np.inf
    return np.stack(found, 1)
