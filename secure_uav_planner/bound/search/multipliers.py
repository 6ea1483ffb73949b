"""
The search for multipliers: Newton steps on columns at falling temperatures.

The dual function has one breakpoint of w0 in every group; the certificate's multipliers are then
made for several, each with its own v.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np

from .columns import ColumnPool, Columns, pack_columns
from .dual import Dual
from .variables import DualPoint, PotentialLayout
from ..proof.certificate import entropy, maximise_power, Multipliers, sigmoid
from ..proof.reachable_set import Team
from ..proof.terms import Potential
from ...mission.validation import Array
from ...model.channel.rates import compute_sinr
from ...model.kernel import core
from ...optimize.deadline import DeadlineCheck

AUDIBLE = 1e-3
"""Share of the average power above which a slot counts as one with a transmission."""

LEAK_SHARE, FIRST_PRICE, JAMMER_PRICE = 0.7, 1e-2, 1e-5
"""
Sum of the first v over w0, and the first prices of power in nats per W.

Measured: bounds of 87 random missions are no closer with v and prices that a plan suggests.
"""

MAX_DAMPING = 1e4
"""Damping above which a Newton step is given up."""

BREAKPOINTS = (0.5, 0.8, 0.93, 0.98, 0.995, 1.0)
"""Breakpoints w0 of the certificate; the w0 of the search is added to them."""

SWEEP_COLUMNS, SWEEPS = 60, (2, 5)
"""Columns that join before each sweep of v, and sweeps with one eavesdropper and with more."""


class MultiplierSearch:
    """
    The state of a search for the multipliers of a team.

    :param team: the UAVs.
    :param positions: of a plan, (U, N + 2, 2) in m, around which columns lie.
    :param powers: likewise, (U, N) in W; in silent groups those of the nearest group with a
        transmission.
    :param raise_if_over: called before every Newton step; what it raises ends the search.
    :ivar weight: w0, the derivative of the rate by log SINR at the ground node, (G,).
    :ivar point: the present multipliers.
    """

    def __init__(self, team: Team, positions: Array, powers: Array,
                 raise_if_over: DeadlineCheck = lambda: None) -> None:
        self.team, self.raise_if_over, self._damping = team, raise_if_over, 1e-6
        regions, groups = team.regions, team.groups
        middle = (groups.first + groups.last) // 2
        places = [region.local(path[middle]) for region, path in zip(regions, positions)]
        watts = np.maximum(powers[:, middle - 1], 0.0)
        sending = np.flatnonzero(watts[0] > AUDIBLE * regions[0].average)
        if len(sending):
            group = np.arange(len(middle))[:, None]
            watts = watts[:, sending[np.abs(sending - group).argmin(1)]]
        else:
            watts = np.repeat([[region.average] for region in regions], len(middle), axis=1)
        sinrs = compute_sinr(np.array([
            power * np.exp(region.log_gain - region.log_squares(place)[0])
            for region, place, power in zip(regions, places, watts)]))
        self.weight = np.clip(sigmoid(np.log(np.maximum(sinrs, 1e-9))), 0.3, 1 - 1e-6)
        self.pools = [ColumnPool(*parts) for parts in zip(regions, places, watts)]
        layout, count = PotentialLayout.of(False, team.accelerates), len(regions[0].radii)
        self.point = DualPoint(
            layout, np.zeros((len(groups.edges), len(regions), layout.acceleration.stop)),
            np.repeat(LEAK_SHARE / count * self.weight[:, None], count, axis=1),
            np.array([FIRST_PRICE, JAMMER_PRICE])[:len(regions)])

    def begin_from(self, coarse: MultiplierSearch) -> None:
        """Take the multipliers of a search on longer groups, with linear potentials."""
        point, old, new = coarse.point, coarse.team.groups, self.team.groups
        x = point.potentials.reshape(len(old.edges), -1)
        x = np.stack([np.interp(new.edges, old.edges, column) for column in x.T], -1)
        group = np.searchsorted(old.last, (new.first + new.last) // 2)
        # The slack w0 - s, which may be tiny, stays the same.
        v = point.v[group]
        total = v.sum(-1)
        new_total = np.clip(self.weight - (coarse.weight[group] - total), 0.02,
                            self.weight * (1 - 1e-7))
        self.point = replace(point, potentials=x.reshape(-1, *point.potentials.shape[1:]),
                             v=v * (new_total / total)[..., None])

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

    def dual(self, tau: float) -> Dual:
        """Return the dual function on the best columns for the present multipliers."""
        slopes = np.diff(self.point.potentials[..., self.point.layout.slope], axis=0)
        for i, pool in enumerate(self.pools):
            pool.add_round(partial(self.evaluate, i, weight=self.weight, v=self.point.v))
            pool.add_silent_places(None if self.point.layout.quadratic else slopes[:, i],
                                   partial(self.evaluate, i))
        return Dual(self.team, self.weight, [pool.latest for pool in self.pools],
                    [pool.silent for pool in self.pools], tau)

    def add_quadratic_part(self) -> None:
        """Make the potentials quadratic, with S = 0."""
        self.point = replace(
            self.point, layout=PotentialLayout.of(True, self.team.accelerates),
            potentials=np.insert(self.point.potentials, [2, 2, 2], 0.0, 2))

    def potential(self, uav: int) -> Potential:
        """Return the present potential of a UAV."""
        return Potential(*self.point.layout.split(self.point.potentials[:, uav]), self.team.groups,
                         self.team.regions[uav])

    def minimise(self, tau: float, iterations: int) -> None:
        """Take Newton steps at a temperature on the best columns."""
        dual = self.dual(tau)
        for _ in range(iterations):
            self.raise_if_over()
            if -self._descend(dual) < 1e-3 * tau * self.team.groups.slots**0.5:
                break

    def _descend(self, dual: Dual) -> float:
        """
        Take a Newton step, damped until it pays; return the slope along it, or 0 without a step.

        The dual function is flat in many directions and sharp in others, see
        ArrowSystem.solve. The next step begins with the damping of this one.
        """
        value, system = dual.derivatives(self.point)
        while self._damping < MAX_DAMPING:
            try:
                step = system.solve(self._damping)
            except np.linalg.LinAlgError:
                self._damping *= 100
                continue
            step = step.shorten(self.point, dual.slack(self.point.v))
            slope = min(system.slope(step), 0.0)
            for length, factor in ((1.0, 0.1), (0.3, 1.0), (0.1, 1.0)):
                trial = self.point.move(step, length)
                if dual.value(trial) < value + 0.1 * length * slope:
                    self._damping = max(factor * self._damping, 1e-9)
                    self.point = trial
                    return slope
            self._damping *= 10
        self._damping = 1.0
        return 0.0


def build_multipliers(search: MultiplierSearch) -> Multipliers:
    """Return the multipliers of the certificate, with breakpoints of w0 in every group."""
    uavs = range(len(search.team.regions))
    weights = np.sort([*(np.full(len(search.weight), w0) for w0 in BREAKPOINTS), search.weight],
                      axis=0)
    columns = [pool.recent for pool in search.pools]
    potentials = tuple(map(search.potential, uavs))
    # The part of the potentials that the columns' values leave out.
    constant = np.array([
        potential.constant() if potential.is_quadratic else potential.acceleration_cost()
        for potential in potentials])
    minima = [_minimise_v(search, columns, weight) for weight in weights]
    v = np.array([v for v, _ in minima])
    incumbents = np.array([terms for _, terms in minima]).swapaxes(0, 1) + constant[:, None]
    silent_incumbents = constant + [
        search.evaluate(i, search.pools[i].silent).max(1) for i in uavs]
    return Multipliers(
        potentials, search.point.prices, weights, v, silent_incumbents, incumbents)


def _slot_constant(team: Team, price: float, weight: Array, v: Array) -> Array:
    """Return the part of a slot's bound that depends on w0 and v alone, m(w0 - s) - H(v)."""
    slack = np.maximum(weight - v.sum(-1), 0.0)
    return (maximise_power(slack, price, team.regions[0].peak)[0]
            - entropy(*team.sum_listeners(v)))


def _minimise_v(search: MultiplierSearch, columns: list[Columns],
                weight: Array) -> tuple[Array, list[Array]]:
    """
    Minimise a slot's bound on given columns over v, nearly, at w0.

    :param columns: of every UAV.
    :param weight: w0, (G,).
    :return: v, (G, E), and the terms of every UAV there, (G,) each.
    """
    team, point = search.team, search.point
    v = point.v * (weight / search.weight)[:, None]
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
    """Return the minimisers of one convex function per group by golden section, (G,)."""
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
