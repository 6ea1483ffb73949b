"""The search for multipliers: columns, branches and temperatures around Newton's method."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from . import columns as lists
from .certificate import terms_of
from .columns import Columns
from .conjugate import Array, entropy, transmit_power
from .descent import Descent
from .dual import Branch, Dual
from .guess import Guess
from .lens import Lens
from .newton import Point
from .nodes import multipliers, theta_of
from .potential import Potential
from .team import Team

RHO_BRANCHES = (0.01, 0.1, 0.5, 0.9, 0.99)
"""Nodes rho that the multipliers have to be good for, beside the plan's."""

KEEP = 45
"""Columns that are kept in every branch."""

LATEST = 8
"""
From how many of the latest lists of columns theta and v are chosen.

Measured: with one list, theta goes to and fro between two answers, and bounds with two jammers
are 5 to 50% higher. With more than eight, nothing is gained.
"""

ROUND = 16
"""Places on the lens's rim that are always kept, where a jammer is silent."""

FRESH, OLD = 5, 15
"""Columns of every branch that are improved by a compass search, and earlier ones that stay."""

SILENT = 24
"""Places to be silent at that are kept, beside the fixed ones."""


class Search:
    """
    The state of a search for one team.

    :param team: the UAVs.
    :param guess: where to begin.
    :param point: multipliers to begin with, by default the guess's.
    :param stop: asked now and then; True ends the search.
    """

    def __init__(self, team: Team, guess: Guess, point: Point | None = None,
                 stop: Callable[[], bool] = lambda: False) -> None:
        self.team, self.guess, self.stop = team, guess, stop
        count, uavs = len(team.stages.count), len(team.lenses)
        self.point = point if point is not None else Point(
            np.zeros((count + 1, uavs, 2)), guess.shares[None], guess.prices)
        self.weights = [guess.weight]
        self.tables: list[Columns] = []
        self.grids: list[Array] = []
        self.base: list[Columns] = []
        self.places: list[Array] = []
        for i, lens in enumerate(team.lenses):
            place = np.concatenate(
                [lists.grid(lens, *lists.GRID), lists.rings(lens, guess.places[i])], 1)
            coarse = lists.grid(lens, *lists.COARSE)
            power = (np.zeros((count, 1)) if lens.transmits
                     else lists.levels(lens, guess.powers[i]))
            few = power if lens.transmits else power[:, [0, 4]]
            self.tables.append(Columns.product(lens, place, power, team.copies))
            self.grids.append(place)
            rim = lens.farthest(_compass(ROUND)[None])
            self.base.append(Columns.joined([
                Columns.product(lens, coarse, few, team.copies),
                Columns.of(lens, rim, np.zeros(rim.shape[:2]), team.copies)]))
            self.places.append(np.concatenate(
                [lens.farthest(_compass(lists.RIM)[None]), lists.grid(lens, *lists.STILL)], 1))
        self.found: list[list[Columns]] = [[] for _ in team.lenses]
        self.columns: list[Columns] = []
        self.seen: list[Columns] = []
        self._latest: list[list[Columns]] = []
        self._descent = Descent()

    # -- what the present multipliers ask for

    def branches(self) -> list[Branch]:
        """Return the branches that the multipliers have to be good for."""
        one = np.ones(len(self.team.stages.count))
        if self.team.jammers < 2:
            return [Branch(weight, k, one, one) for k, weight in enumerate(self.weights)]
        result = []
        for k, weight in enumerate(self.weights):
            result.append(Branch(weight, k, self.guess.theta, self.guess.rho))
            for rho in RHO_BRANCHES:
                v = self.point.shares[k]
                theta = (theta_of(self, weight, v, rho) if self.columns
                         else np.full(len(one), rho)).clip(1e-3, 1 - 1e-3)
                result.append(Branch(weight, k, theta, rho * one))
        return result

    def dual(self, tau: float) -> Dual:
        """Return the dual function on the columns that the present multipliers ask for."""
        branches = self.branches()
        dual = Dual(self.team, [], [], branches, tau)
        self.columns = [self._priced(dual, i, branches) for i in range(len(self.team.lenses))]
        self._latest = [*self._latest, self.columns][-LATEST:]
        self.seen = [Columns.joined([*same]) for same in zip(*self._latest)]
        silent = []
        for i in range(len(self.team.lenses)):
            self._look_for_silence(dual, i)
            place = self.places[i]
            none = np.zeros(place.shape[:2])
            silent.append(Columns(place, none, none, np.zeros(place.shape[:2] + (0,))))
        dual.columns = (self.columns, silent)
        return dual

    def _look_for_silence(self, dual: Dual, i: int) -> None:
        """Add the best places at which to be silent; the latest ones stay."""
        lens, place = self.team.lenses[i], self.places[i]
        if self.point.potentials.shape[2] == 2:
            pull = np.diff(self.point.potentials[:, i], axis=0)
            new = lens.farthest(pull[:, None])
        else:
            none = np.zeros(place.shape[:2])
            leaks = np.zeros(place.shape[:2] + self.point.shares.shape[2:])
            pool = Columns(place, none, none, leaks)
            start = pool.take(_apart(lens, pool, dual.potential(i, self.point, place)[0]))
            new = self._improved(dual, i, start, none[:, 0], leaks[:, 0]).place
        fixed = lists.RIM + lists.STILL[0] * lists.STILL[1]
        latest = np.concatenate([place[:, fixed:], new], 1)[:, -SILENT:]
        self.places[i] = np.concatenate([place[:, :fixed], latest], 1)

    def _priced(self, dual: Dual, i: int, branches: list[Branch]) -> Columns:
        """Return the columns of UAV i that are best for the present multipliers."""
        lens = self.team.lenses[i]
        # To be silent somewhere else is worth it even where the other UAV sends.
        rim = Columns.of(lens, self.places[i], np.zeros(self.places[i].shape[:2]),
                         self.team.copies)
        pool = Columns.joined([self.tables[i], rim, *self.found[i]])
        grid = dual.potential(i, self.point, self.grids[i])[0]
        potential = np.concatenate(
            [np.repeat(grid, self.tables[i].power.shape[1] // grid.shape[1], axis=1),
             *(dual.potential(i, self.point, more.place)[0] for more in (rim, *self.found[i]))],
            1)
        chosen: list[Columns] = [self.base[i]]
        fresh: list[Columns] = []
        done: set[int] = set()
        for branch in branches:
            if i == 0 and branch.group in done:
                continue
            done.add(branch.group)
            ground, leak = branch.parts(i)
            weight, v = branch.weight * ground, self.point.shares[branch.group] * leak[:, None]
            value = potential + pool.value(weight, v, self.point.prices[i])
            few = min(KEEP if len(chosen) == 1 else KEEP // 3, value.shape[1])
            chosen.append(pool.take(np.argpartition(value, -few, axis=1)[:, -few:]))
            if len(fresh) < 3:
                # Of every place of the table only its best power.
                table = value[:, :self.tables[i].power.shape[1]]
                powers = table.shape[1] // grid.shape[1]
                best = table.reshape(*grid.shape, powers).argmax(2)
                best = np.concatenate(
                    [best + powers * np.arange(grid.shape[1]),
                     np.broadcast_to(np.arange(table.shape[1], value.shape[1]),
                                     (len(value), value.shape[1] - table.shape[1]))], 1)
                listed, worth = pool.take(best), np.take_along_axis(value, best, 1)
                start = listed.take(_apart(lens, listed, worth))
                fresh.append(self._improved(dual, i, start, weight, v))
        self.found[i] = [Columns.joined([*self.found[i], *fresh])]
        extra = self.found[i][0].power.shape[1] - OLD - FRESH * len(fresh)
        if extra > 0:
            keep = np.arange(extra, self.found[i][0].power.shape[1])
            self.found[i] = [self.found[i][0].take(np.broadcast_to(
                keep, (len(pool.power), len(keep))))]
        return Columns.joined([*chosen, *fresh])

    def _improved(self, dual: Dual, i: int, start: Columns, weight: Array, v: Array) -> Columns:
        """Return columns after a compass search from others, all of them at once."""
        lens, price = self.team.lenses[i], self.point.prices[i]
        count, many = start.power.shape
        low, high = lens.sides
        step = np.repeat(((high - low).max(1) / 12)[:, None], many, 1)
        ratio = np.full((count, many), 0.4)
        place, power = start.place, start.power
        moves = np.array([[0, 0, 0], [1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0],
                          [0, 0, 1], [0, 0, -1]][:5 if lens.transmits else 7], float)
        stage = np.arange(count)[:, None, None]
        for _ in range(8):
            trial = place[:, :, None] + step[..., None, None] * moves[:, :2]
            trial = lens.drawn_in(trial, stage)
            trial = np.where(lens.inside(trial, stage)[..., None], trial, place[:, :, None])
            watts = np.minimum(power[..., None] * np.exp(ratio[..., None] * moves[:, 2]),
                               lens.peak)
            flat = Columns.of(lens, trial.reshape(count, -1, 2), watts.reshape(count, -1),
                              self.team.copies)
            value = dual.potential(i, self.point, flat.place)[0] + flat.value(weight, v, price)
            pick = value.reshape(count, many, -1).argmax(-1)[..., None]
            place = np.take_along_axis(trial, pick[..., None], 2)[:, :, 0]
            power = np.take_along_axis(watts, pick, 2)[..., 0]
            stay = pick[..., 0] == 0
            step, ratio = (np.where(stay, size / 2.5, size) for size in (step, ratio))
        return Columns.of(lens, place, power, self.team.copies)

    def sharpen(self, tolerance: float) -> None:
        """
        Find columns by branch and bound: nothing that pays is then overlooked.

        :param tolerance: how far from the largest a column may be, in nats.
        """
        branches = self.branches()
        dual = Dual(self.team, [], [], branches, 1e-9)
        row = np.arange(len(self.team.stages.count))
        for i, lens in enumerate(self.team.lenses):
            columns, price = self.columns[i], self.point.prices[i]
            parts = [branch.parts(i) for branch in branches]
            weights = np.array([branch.weight * part[0] for branch, part in zip(branches, parts)])
            shares = np.array([self.point.shares[branch.group] * part[1][:, None]
                               for branch, part in zip(branches, parts)])
            potential = self.potential(i)
            terms, _ = terms_of(self.team, potential, i, np.tile(row, len(weights)),
                                weights.ravel(), shares.reshape(-1, shares.shape[-1]), price)
            here = dual.potential(i, self.point, columns.place)[0]
            value = np.array([here + columns.value(weight, v, price)
                              for weight, v in zip(weights, shares)])
            best, known = value.argmax(2), value.max(2).ravel()
            _, points = terms.search(known, np.full(len(terms), tolerance), 2000, self.stop)
            points = points.reshape(len(points), *best.shape)
            met = np.isfinite(points[0])
            place = np.where(met[..., None], np.moveaxis(points[:2], 0, -1),
                             columns.place[row, best])
            power = columns.power[row, best]
            if len(points) == 3:
                power = np.where(met, np.exp(np.where(met, points[2], 0.0)), power)
            self.found[i].append(Columns.of(lens, place.transpose(1, 0, 2), power.T,
                                            self.team.copies))

    def curve(self) -> None:
        """Give the potentials a quadratic part, at first none."""
        x = self.point.potentials
        self.point = replace(self.point, potentials=np.concatenate(
            [x, np.zeros(x.shape[:2] + (3,))], 2))

    def potential(self, uav: int) -> Potential:
        """Return the present potential of a UAV."""
        x = self.point.potentials[:, uav]
        bend = x[:, 2:] if x.shape[1] == 5 else np.zeros((len(x), 3))
        return Potential(x[:, :2], bend, self.team.stages, self.team.lenses[uav])

    def second_node(self) -> None:
        """Add a node of w0 to those that the multipliers have to be good for: the next best."""
        given = multipliers(self)
        team, price = self.team, self.point.prices[0]
        total = given.shares.sum(-1)
        value = given.known.sum(0).max(1) - entropy(total) + entropy(given.weights) + (
            transmit_power(np.maximum(given.weights - total, 0.0), price,
                           team.lenses[0].peak)[0])
        first = self.weights[0]
        # Neighbours of the first node are as good as it is: what counts is a hump elsewhere.
        value[np.abs(given.weights - first) < 1e-9] = -np.inf
        best = value.argmax(0)
        row = np.arange(len(first))
        weight = np.minimum(given.weights[best, row], 1 - 1e-9)
        v = np.clip(given.shares[best, row], 1e-6, None)
        s = v.sum(-1)
        room = first - self.point.shares[0].sum(-1)
        v *= (np.minimum(s, weight - np.minimum(room, weight / 2)) / s)[:, None]
        self.weights.append(weight)
        self.point = replace(self.point, shares=np.concatenate([self.point.shares, v[None]]))

    # -- Newton's method

    def minimise(self, tau: float, iterations: int) -> None:
        """Take Newton steps at one temperature, on the columns that are best now."""
        dual = self.dual(tau)
        for _ in range(iterations):
            if self.stop():
                break
            value, derivatives = dual.derivatives(self.point)
            self.point, slope = self._descent.damped(dual, self.point, value, derivatives)
            if -slope < 1e-3 * tau * self.team.stages.slots**0.5:
                break


def _compass(count: int) -> Array:
    angle = np.arange(count) * 2 * np.pi / count
    return np.stack([np.cos(angle), np.sin(angle)], -1)


def _apart(lens: Lens, pool: Columns, value: Array) -> NDArray[np.intp]:
    """Return the indices of the best columns that lie apart from one another, (G, FRESH)."""
    low, high = lens.sides
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
