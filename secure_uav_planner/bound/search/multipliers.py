"""The search for multipliers: from a plan, by Newton steps on columns at falling temperatures."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
import math

import numpy as np
from numpy.typing import NDArray

from .columns import (
    COARSE_GRID, Columns, GRID, RIM, sample_grid, sample_powers, sample_rings, SILENT_GRID)
from .dual import Dual, DualPoint, pack_columns, PotentialLayout, split_potentials
from ..proof.certificate import sigmoid
from ..proof.potential import Potential
from ..proof.reachable_set import MOST_STAGES, ReachableSet, Team
from ..proof.subset import unit_circle
from ...errors import PlanningError
from ...mission.scenario import Scenario
from ...mission.validation import Array
from ...model.kernel import core
from ...optimize import solve
from ...plan.plan import Plan

COARSE_POWERS = [0, 4]
"""Indices of a jammer's powers at the places of the coarse grid."""

KEPT = 45
"""Number of the best columns that a round uses."""

RECENT = 8
"""Latest rounds whose columns serve to choose v."""

BASE_RIM = 16
"""Places on the rim of the reachable set that every round uses, with a silent jammer."""

FRESH, OLD = 5, 15
"""Columns that a round improves by a compass search, and earlier ones that it keeps."""

SILENT = 24
"""Latest silent places that are kept beside the fixed ones."""

MAX_DAMPING = 1e4
"""Damping above which a Newton step is given up."""

AUDIBLE = 1e-3
"""Share of the average power above which a slot counts as one with a transmission."""


def find_start(scenario: Scenario, time_left: float, objective: str, plan: Plan | None,
               stop: Callable[[], bool]) -> tuple[Array, Array]:
    """
    Return positions (U, N + 2, 2) in m and powers (U, N) in W of a plan, or of straight lines.

    :param time_left: in s.
    :param plan: by default the one that solve finds in half of that time.
    :param stop: asked after every iteration of solve; True ends it.
    """
    if plan is not None:
        return plan.positions, plan.powers
    slots = min(scenario.slots, MOST_STAGES)
    try:
        plan = solve(replace(scenario, slots=slots), objective=objective,  # type: ignore[arg-type]
                     on_iteration=lambda _: stop(),
                     time_limit=None if math.isinf(time_left) else max(time_left / 2, 1e-3))
        positions, powers = plan.positions, plan.powers
    except PlanningError:
        # A mission that cannot be flown in so few slots, or not be planned before the search ends.
        start = np.array([[uav.start] for uav in scenario.uavs])
        goal = np.array([[uav.goal] for uav in scenario.uavs])
        positions = start + (goal - start) * np.linspace(0, 1, slots + 2)[:, None]
        powers = np.array([[uav.average_power] * slots for uav in scenario.uavs])
    point = np.round(np.linspace(0, slots + 1, scenario.slots + 2)).astype(int)
    return positions[:, point], powers[:, np.clip(point[1:-1] - 1, 0, slots - 1)]


@dataclass(frozen=True, eq=False)
class InitialMultipliers:
    """
    The multipliers with which a search begins.

    :param places: of every UAV in every stage, (U, G, 2) in units of its reachable set.
    :param powers: (U, G) in W; in silent stages those of the nearest stage with a transmission.
    :param weight: w0, the derivative of the rate by log SINR at the ground node, (G,).
    :param shares: v, (G, E).
    :param prices: lam, (U,) in nats per W.
    """

    places: Array
    powers: Array
    weight: Array
    shares: Array
    prices: Array

    @classmethod
    def of(cls, team: Team, positions: Array, powers: Array) -> InitialMultipliers:
        """
        Return the multipliers that a plan suggests.

        :param positions: (U, N + 2, 2) in m.
        :param powers: (U, N) in W.
        """
        middle = (team.stages.first + team.stages.last) // 2
        places = np.array([region.local(path[middle])
                           for region, path in zip(team.regions, positions)])
        power = np.maximum(powers[:, middle - 1], 0.0)
        on = power[0] > AUDIBLE * team.regions[0].average
        watts = np.repeat([[region.average] for region in team.regions], len(on), axis=1)
        if on.any():
            sending = np.flatnonzero(on)
            watts = power[:, sending[np.abs(sending - np.arange(len(on))[:, None]).argmin(1)]]
        ground, leaks = [], []
        for region, place, p in zip(team.regions, places, watts):
            log_ground, log_leaks = region.log_squares(place)
            ground.append(p * np.exp(region.log_gain - log_ground))
            leaks.append(p[:, None] * np.exp(region.log_gain - log_leaks))
        noise0 = 1.0 + sum(ground[1:], np.zeros_like(ground[0]))
        noise = 1.0 + sum(leaks[1:], np.zeros_like(leaks[0]))
        z0 = np.log(np.maximum(ground[0] / noise0, 1e-9))
        ze = np.log(np.maximum(leaks[0] / noise, 1e-9))
        weight = np.clip(sigmoid(z0), 0.3, 1 - 1e-6)
        loudest = sigmoid(ze.max(-1))
        prices = np.full(len(team.regions), 1e-5)
        prices[0] = 1e-2
        if on.any():
            slope = (sigmoid(z0) - loudest) / np.maximum(power[0], 1e-9)
            prices[0] = max(float(np.median(slope[on])), 1e-6)
        slack = prices[0] * np.maximum(watts[0], 0.1 * team.regions[0].average)
        total = np.clip(np.minimum(loudest, weight - slack), 0.05, weight * (1 - 1e-7))
        share = np.exp(8 * (ze - ze.max(-1, keepdims=True)))
        share = share / share.sum(-1, keepdims=True) + 0.02
        share /= share.sum(-1, keepdims=True)
        return cls(places, watts, weight, total[:, None] * share, prices)


class MultiplierSearch:
    """
    The state of a search for the multipliers of a team.

    :param team: the UAVs.
    :param initial: the first multipliers, and places and powers around which columns lie.
    :param point: multipliers that replace the initial ones, or None.
    :param stop: asked before every Newton step; True ends the search.
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
        self.base_columns: list[Columns] = []
        self.silent_places: list[Array] = []
        for i, region in enumerate(team.regions):
            # The places nearest to the receivers, too.
            nearest = region.clip(np.broadcast_to(
                np.concatenate([region.ground[None], region.eavesdroppers]),
                (count, 1 + len(region.eavesdroppers), 2)), np.arange(count)[:, None])
            place = np.concatenate(
                [sample_grid(region, *GRID),
                 sample_rings(region, initial.places[i]), nearest], 1)
            coarse = np.concatenate([sample_grid(region, *COARSE_GRID), nearest], 1)
            power = (np.zeros((count, 1)) if region.transmits
                     else sample_powers(region, initial.powers[i]))
            coarse_power = power if region.transmits else power[:, COARSE_POWERS]
            self.tables.append(Columns.product(region, place, power))
            self.grids.append(place)
            rim = region.find_farthest(unit_circle(BASE_RIM)[None])
            self.base_columns.append(Columns.concatenate([
                Columns.product(region, coarse, coarse_power),
                Columns.of(region, rim, np.zeros(rim.shape[:2]))]))
            self.silent_places.append(np.concatenate(
                [region.find_farthest(unit_circle(RIM)[None]),
                 sample_grid(region, *SILENT_GRID)], 1))
        self.improved: list[list[Columns]] = [[] for _ in team.regions]
        self._recent: list[list[Columns]] = []
        self._damping = 1e-6

    def evaluate(self, uav: int, columns: Columns, weight: Array | None = None,
                 v: Array | None = None) -> Array:
        """
        Return the values of a UAV's columns with the present multipliers, (G, C) in nats.

        :param weight: w0, (G,); 0 by default, for silence.
        :param v: (G, E), alike.
        """
        if weight is None or v is None:
            weight, v = np.zeros(len(columns.ground)), np.zeros(columns.leaks.shape[::2])
        values = np.empty(columns.ground.shape)
        core.bound_column_values(
            pack_columns(self.team, uav, self.point, columns, weight, v), values)
        return values

    @property
    def recent_columns(self) -> list[Columns]:
        """Return the columns of the latest rounds, of every UAV."""
        return [Columns.concatenate([*parts]) for parts in zip(self.base_columns, *self._recent)]

    def dual(self, tau: float) -> Dual:
        """Return the dual function on the best columns for the present multipliers."""
        self._recent = [*self._recent, [
            self._price_columns(i) for i in range(len(self.team.regions))]][-RECENT:]
        columns = [Columns.concatenate([*parts])
                   for parts in zip(self.base_columns, self._recent[-1])]
        for i in range(len(self.team.regions)):
            self._add_silent_places(i)
        silent = [self.silent_columns(i) for i in range(len(self.team.regions))]
        return Dual(self.team, self.weight, columns, silent, tau)

    def silent_columns(self, i: int) -> Columns:
        """Return the columns of UAV i at its silent places."""
        none = np.zeros(self.silent_places[i].shape[:2])
        return Columns(self.silent_places[i], none, none,
                       np.zeros(none.shape + self.point.shares.shape[1:]))

    def _add_silent_places(self, i: int) -> None:
        """Add the best silent places of UAV i; the oldest ones go."""
        region, place = self.team.regions[i], self.silent_places[i]
        if not PotentialLayout.of(self.point.potentials).quadratic:
            slope = np.diff(self.point.potentials[:, i, :2], axis=0)
            new = region.find_farthest(slope[:, None])
        else:
            pool = self.silent_columns(i)
            start = pool.take(_select_distinct(region, pool, self.evaluate(i, pool)))
            new = self._improve_columns(i, start, pool.ground[:, 0], pool.leaks[:, 0]).place
        fixed = RIM + SILENT_GRID[0] * SILENT_GRID[1]
        latest = np.concatenate([place[:, fixed:], new], 1)[:, -SILENT:]
        self.silent_places[i] = np.concatenate([place[:, :fixed], latest], 1)

    def _price_columns(self, i: int) -> Columns:
        """Return the best columns of UAV i for the present multipliers, some of them improved."""
        region, table = self.team.regions[i], self.tables[i].power.shape[1]
        # A UAV may best be silent in a slot in which the rest of the team sends.
        places = self.silent_places[i]
        silent = Columns.of(region, places, np.zeros(places.shape[:2]))
        pool = Columns.concatenate([self.tables[i], silent, *self.improved[i]])
        value = self.evaluate(i, pool, self.weight, self.point.shares)
        kept = min(KEPT, value.shape[1])
        chosen = pool.take(np.argpartition(value, -kept, axis=1)[:, -kept:])
        # Of every place of the table only its best power.
        count = self.grids[i].shape[1]
        powers = table // count
        best = value[:, :table].reshape(len(value), count, powers).argmax(2)
        best = np.concatenate([best + powers * np.arange(count), np.broadcast_to(
            np.arange(table, value.shape[1]), (len(value), value.shape[1] - table))], 1)
        candidates, value = pool.take(best), np.take_along_axis(value, best, 1)
        fresh = self._improve_columns(
            i, candidates.take(_select_distinct(region, candidates, value)), self.weight,
            self.point.shares)
        improved = Columns.concatenate([*self.improved[i], fresh])
        latest = np.arange(improved.power.shape[1])[-OLD - FRESH:]
        self.improved[i] = [improved.take(np.broadcast_to(latest, (len(value), len(latest))))]
        return Columns.concatenate([chosen, *self.improved[i]])

    def _improve_columns(self, i: int, start: Columns, weight: Array, v: Array) -> Columns:
        """Return the columns that a compass search reaches from given ones."""
        region = self.team.regions[i]
        count, many = start.power.shape
        low, high = region.bounding_box
        step = np.repeat(((high - low).max(1) / 12)[:, None], many, 1)
        ratio = np.full((count, many), 0.4)
        place, power = start.place, start.power
        moves = np.array([[0, 0, 0], [1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0],
                          [0, 0, 1], [0, 0, -1]][:5 if region.transmits else 7], float)
        stage = np.arange(count)[:, None, None]
        for _ in range(8):
            trial = place[:, :, None] + step[..., None, None] * moves[:, :2]
            trial = region.clip(trial, stage)
            trial = np.where(region.contains(trial, stage)[..., None], trial, place[:, :, None])
            watts = np.minimum(power[..., None] * np.exp(ratio[..., None] * moves[:, 2]),
                               region.peak)
            flat = Columns.of(region, trial.reshape(count, -1, 2), watts.reshape(count, -1))
            value = self.evaluate(i, flat, weight, v)
            pick = value.reshape(count, many, -1).argmax(-1)[..., None]
            place = np.take_along_axis(trial, pick[..., None], 2)[:, :, 0]
            power = np.take_along_axis(watts, pick, 2)[..., 0]
            stay = pick[..., 0] == 0
            step, ratio = (np.where(stay, size / 2.5, size) for size in (step, ratio))
        return Columns.of(region, place, power)

    def add_quadratic_part(self) -> None:
        """Make the potentials quadratic, with S = 0."""
        x = self.point.potentials
        none = np.zeros(x.shape[:2] + (3,))
        self.point = replace(self.point, potentials=np.concatenate(
            [x[..., :2], none, x[..., 2:]], 2))

    def potential(self, uav: int) -> Potential:
        """Return the present potential of a UAV."""
        return Potential(*split_potentials(self.point.potentials[:, uav]), self.team.stages,
                         self.team.regions[uav])

    def minimise(self, tau: float, iterations: int) -> None:
        """Take Newton steps at a temperature on the best columns."""
        dual = self.dual(tau)
        for _ in range(iterations):
            if self.stop():
                break
            if -self._descend(dual) < 1e-3 * tau * self.team.stages.slots**0.5:
                break

    def _descend(self, dual: Dual) -> float:
        """
        Take a Newton step, damped until it pays; return the slope along it, or 0 without a step.

        The dual function is flat in many directions and sharp in others, see
        DualDerivatives.solve. The next step begins with the damping of this one.
        """
        value, derivatives = dual.derivatives(self.point)
        while self._damping < MAX_DAMPING:
            try:
                step = derivatives.solve(self._damping)
            except np.linalg.LinAlgError:
                self._damping *= 100
                continue
            step = step.shorten(self.point, dual.slack(self.point.shares))
            slope = min(derivatives.slope(step), 0.0)
            for length, factor in ((1.0, 0.1), (0.3, 1.0), (0.1, 1.0)):
                trial = self.point.move(step, length)
                if dual.value(trial) < value + 0.1 * length * slope:
                    self._damping = max(factor * self._damping, 1e-9)
                    self.point = trial
                    return slope
            self._damping *= 10
        self._damping = 1.0
        return 0.0


def _select_distinct(region: ReachableSet, pool: Columns, value: Array) -> NDArray[np.intp]:
    """Return the indices of the best columns at distinct places, (G, FRESH)."""
    low, high = region.bounding_box
    far = ((high - low).max(1) / 8)[:, None]
    value = value.copy()
    row = np.arange(len(value))
    chosen = []
    for _ in range(FRESH):
        best = value.argmax(1)
        chosen.append(best)
        offset = np.abs(pool.place - pool.place[row, best][:, None])
        value[(offset[..., 0] < far) & (offset[..., 1] < far)] = -np.inf
    return np.stack(chosen, 1)
