"""
The search for multipliers: Newton steps on columns at falling temperatures.

The dual function has one breakpoint of w0 in every stage; the certificate's multipliers are then
made for several, each with its own v.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from .dual import Dual
from .variables import (
    COARSE_GRID, Columns, DualPoint, GRID, InitialMultipliers, pack_columns, PotentialLayout, RIM,
    sample_grid, sample_powers, sample_rings, SILENT_GRID, split_potentials)
from ..proof.certificate import bound_pieces, entropy, maximise_power, Multipliers, piece_ends
from ..proof.reachable_set import ReachableSet, Team
from ..proof.relaxation import unit_circle
from ..proof.terms import Potential
from ...mission.validation import Array
from ...model.kernel import core

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

BREAKPOINTS = (0.5, 0.8, 0.93, 0.98, 0.995, 1.0)
"""Breakpoints w0 of the certificate; the w0 of the search is added to them."""

SLACK = 0.5
"""Share of the slack of a maximum that its branch and bound may use."""

SWEEP_COLUMNS, SWEEPS = 60, (2, 5)
"""Columns that join before each sweep of v, and sweeps with one eavesdropper and with more."""

TOLERANCE = 2e-4
"""Tolerance of every maximum, in nats."""


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
        core.evaluate_columns(
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


def build_multipliers(search: MultiplierSearch) -> Multipliers:
    """Return the multipliers of the certificate, with breakpoints of w0 in every stage."""
    team, point, uavs = search.team, search.point, range(len(search.team.regions))
    weights = np.sort([*(np.full(len(search.weight), w0) for w0 in BREAKPOINTS), search.weight],
                      axis=0)
    columns = search.recent_columns
    constant = np.array([_potential_constant(search, i) for i in uavs])
    minima = [_minimise_shares(search, columns, weight) for weight in weights]
    shares = np.array([v for v, _ in minima])
    incumbents = np.array([terms for _, terms in minima]).swapaxes(0, 1) + constant[:, None]
    silent_incumbents = constant + [
        search.evaluate(i, search.silent_columns(i)).max(1) for i in uavs]
    slacks = _find_slacks(team, silent_incumbents.sum(0), incumbents.sum(0), weights, shares,
                          point.prices[0])
    return Multipliers(
        *split_potentials(point.potentials.transpose(1, 0, 2)), point.prices, weights, shares,
        silent_incumbents, incumbents, TOLERANCE + SLACK / len(uavs) * slacks)


def _potential_constant(search: MultiplierSearch, uav: int) -> Array:
    """Return the part of a UAV's potential that its columns' values leave out, (G,)."""
    potential = search.potential(uav)
    return potential.constant() if potential.is_quadratic else potential.acceleration_cost()


def _find_slacks(team: Team, silent: Array, joint: Array, weights: Array, shares: Array,
                 price: float) -> Array:
    """
    Return the rise of silence and of every breakpoint that leaves B as it is, (K + 1, G) in nats.

    :param silent: estimate of all terms where nothing is sent, (G,).
    :param joint: estimate of all terms at the breakpoints, (K, G).
    """
    value = bound_pieces(team, silent, joint, weights, shares, price)
    best = np.maximum(silent, value.max((0, 1)))
    slacks = np.concatenate([(best - silent)[None], np.full(weights.shape, np.inf)])
    # A breakpoint lifts the pieces on both sides, in proportion to how near they are.
    x = piece_ends()[:, None, None]
    for breakpoints, share in ((slice(-1), 1 - x[:-1]), (slice(1, None), x[1:])):
        slack = ((best - value) / np.maximum(share, 1e-9)).min(0)
        slacks[breakpoints] = np.minimum(slacks[breakpoints], slack)
    return slacks


def _slot_constant(team: Team, price: float, weight: Array, v: Array) -> Array:
    """Return the part of a slot's bound that depends on w0 and v alone, m(w0 - s) - H(v)."""
    slack = np.maximum(weight - v.sum(-1), 0.0)
    return (maximise_power(slack, price, team.regions[0].peak)[0]
            - entropy(*team.sum_groups(v)))


def _minimise_shares(search: MultiplierSearch, columns: list[Columns],
                     weight: Array) -> tuple[Array, list[Array]]:
    """
    Minimise a slot's bound on given columns over v, nearly, at w0.

    :param columns: of every UAV.
    :param weight: w0, (G,).
    :return: v, (G, E), and the terms of every UAV there, (G,) each.
    """
    team, point = search.team, search.point
    v = point.shares * (weight / search.weight)[:, None]
    zero = np.zeros_like(v)
    # The constant part of every column's value, and its factors of v. The columns that are best at
    # the present v join before every sweep: on a fixed list, v exploits what is missing in it.
    # Measured: with one list a mission of one jammer is 24% above its plan instead of 5%.
    parts = [(search.evaluate(i, part, weight, zero), part.leaks)
             for i, part in enumerate(columns)]
    chosen = [np.zeros((len(v), 0), int) for _ in parts]
    row = np.arange(len(v))[:, None]

    def restrict(start: Array, direction: Array) -> Callable[[Array], Array]:
        """Return the slot's bound along a line from v = start, a function of the length (G,)."""
        lines = [(base[row, few] + _weigh_leaks(leaks[row, few], start),
                  _weigh_leaks(leaks[row, few], direction))
                 for (base, leaks), few in zip(parts, chosen)]

        def value(x: Array) -> Array:
            constant = _slot_constant(
                team, point.prices[0], weight, start + x[:, None] * direction)
            return np.asarray(constant + sum(
                (base + x[:, None] * slope).max(1) for base, slope in lines))
        return value

    count = v.shape[-1]
    for sweep in range(SWEEPS[count > 1]):
        chosen = [np.concatenate([few, np.argpartition(
            base + _weigh_leaks(leaks, v), -min(SWEEP_COLUMNS, base.shape[1]), 1)[
                :, -SWEEP_COLUMNS:]], 1) for few, (base, leaks) in zip(chosen, parts)]
        share = v / np.maximum(v.sum(-1, keepdims=True), 1e-300)
        v = share * _minimise_convex(restrict(zero, share), 0 * weight, weight)[:, None]
        for e in range(count if sweep < SWEEPS[1] - 1 else 0):
            for f in range(e):
                direction = np.zeros_like(v)
                direction[:, e], direction[:, f] = 1.0, -1.0
                length = _minimise_convex(restrict(v, direction), -v[:, e], v[:, f])
                v = np.maximum(v + direction * length[:, None], 0.0)
    return v, [(base + _weigh_leaks(leaks, v)).max(1) for base, leaks in parts]


def _minimise_convex(value: Callable[[Array], Array], low: Array, high: Array,
                     steps: int = 20) -> Array:
    """Return the minimisers of one convex function per stage by golden section, (G,)."""
    gold = (5**0.5 - 1) / 2
    x1, x2 = high - gold * (high - low), low + gold * (high - low)
    f1, f2 = value(x1), value(x2)
    for _ in range(steps):
        left = f1 < f2
        low, high = np.where(left, low, x1), np.where(left, x2, high)
        new = np.where(left, high - gold * (high - low), low + gold * (high - low))
        f = value(new)
        x1, x2, f1, f2 = (np.where(left, new, x2), np.where(left, x1, new),
                          np.where(left, f, f2), np.where(left, f1, f))
    return (low + high) / 2


def _weigh_leaks(leaks: Array, v: Array) -> Array:
    """Return sum_e v_e leaks, (G, C), for leaks (G, C, E) and v (G, E)."""
    return np.asarray(np.matmul(leaks, v[..., None])[..., 0])
