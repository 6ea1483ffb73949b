"""
The search for multipliers: Newton steps on columns at falling temperatures.

The dual function has one breakpoint of w0 in every group. The certificate's multipliers are then
made for several breakpoints, each with its own v.
"""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from .columns import ColumnPool, Columns, pack_columns
from .dual import Dual
from .slot_bounds import SlotBounds
from .variables import DualPoint, PotentialLayout
from ..proof.certificate import find_power_range, Multipliers, sigmoid
from ..proof.reachable_set import Cells, Team
from ..proof.terms import Potential, Terms
from ...mission.validation import Array
from ...model.channel.rates import compute_sinr
from ...model.kernel import core
from ...optimize.deadline import DeadlineCheck

AUDIBLE = 1e-3
"""Fraction of the average power above which a slot has a transmission."""

FIRST_PRICE = 1e-2
"""First price of the transmitter's power [nats per W] if the plan never sends."""

JAMMER_PRICE = 1e-5
"""First price of a jammer's power [nats per W]."""

LEAST_LEAK = 0.05
"""Least sum of the first v."""

LEAST_SHARE = 0.02
"""Number added to the share of every eavesdropper's place in the first v."""

SHARPNESS = 8.0
"""Exponent of the SINR in the shares of one adversary's places in the first v."""

WORTHLESS = 1e6
"""Size of the value [nats] of a column outside its cell."""

PRICING_BUDGET = 2000
"""Largest number of boxes in a search for a better column."""

PRICING_ROUNDS = 2
"""Rounds of better columns before the v of a thorough search's certificate are final."""

MAX_DAMPING = 1e4
"""Damping above which a Newton step is given up."""

BREAKPOINTS = (0.5, 0.8, 0.93, 0.98, 0.995, 1.0)
"""Breakpoints w0 of the certificate in every group, besides the w0 of the search."""


class MultiplierSearch:
    """
    The state of a search for the multipliers of a team.

    :param team: the UAVs.
    :param positions: positions of a plan, (U, N + 2, 2) in m, around which columns lie.
    :param powers: powers of the plan, (U, N) in W. A group without a transmission takes the
        powers of the nearest group with one.
    :param raise_if_over: called often, at least before every Newton step; an error that it raises
        ends the search.
    :ivar thorough: whether to add the best columns of branch and bound, which takes long.
    :ivar weight: w0, the derivative of the rate by log SINR at the ground node, (G,).
    :ivar point: the present multipliers.
    :ivar cells: B cells of the last UAV's reachable set in every group, each with a v of its own.
        The first cells of all groups come first, then the second cells of all groups, and so on.
    :ivar pools: columns of each UAV for each of the B cells.
    """

    def __init__(self, team: Team, positions: Array, powers: Array,
                 raise_if_over: DeadlineCheck = lambda: None) -> None:
        """Begin with the multipliers that a plan suggests, and with columns around the plan."""
        self.team, self.raise_if_over, self._damping = team, raise_if_over, 1e-6
        self.thorough = False
        regions, groups = team.regions, team.groups
        # The point in the middle of each group represents the group.
        middle = (groups.first + groups.last) // 2
        places = [region.local(path[middle]) for region, path in zip(regions, positions)]
        watts = np.maximum(powers[:, middle - 1], 0.0)
        sends = watts[0] > AUDIBLE * regions[0].average
        watts = _fill_silent_groups(team, watts, sends)
        self.cells = Cells.whole(regions[-1])
        self.pools = [[ColumnPool(*parts) for parts in zip(regions, places, watts)]]
        self.weight, v, prices = suggest_multipliers(team, places, watts)
        if not sends.any():
            prices[0] = FIRST_PRICE
        # The search begins with linear potentials that are 0.
        layout = PotentialLayout.of(False, team.accelerates)
        self.point = DualPoint(
            layout, np.zeros((len(groups.edges), len(regions), layout.acceleration.stop)),
            v[:, None], prices)

    def begin_from(self, coarse: MultiplierSearch) -> None:
        """
        Take the multipliers of a search on longer groups, with linear potentials.

        Potentials are interpolated between edges. Each v is scaled so that the slack w0 - s, which
        may be tiny, stays the same while s is at least 0.02 and below w0.
        """
        point, old, new = coarse.point, coarse.team.groups, self.team.groups
        numbers = point.potentials.reshape(len(old.edges), -1)
        potentials = np.stack(
            [np.interp(new.edges, old.edges, number) for number in numbers.T], -1)
        group = np.searchsorted(old.last, (new.first + new.last) // 2)
        v, weight = point.v[group], self.weight[:, None]
        total = v.sum(-1)
        slack = coarse.weight[group, None] - total
        new_total = np.clip(weight - slack, 0.02, weight * (1 - 1e-7))
        self.point = replace(
            point, potentials=potentials.reshape(-1, *point.potentials.shape[1:]),
            v=v * (new_total / total)[..., None])

    def evaluate(self, uav: int, columns: Columns, weight: Array | None = None,
                 v: Array | None = None) -> Array:
        """
        Return the values of a UAV's columns with the present multipliers, (G, C) in nats.

        :param weight: w0, (G,); without it or without v both are 0, as in the branch of silence.
        :param v: eavesdropper multipliers, (G, E).
        """
        if weight is None or v is None:
            weight, v = np.zeros(len(columns.ground)), np.zeros(columns.leaks.shape[::2])
        values = np.empty(columns.ground.shape)
        core.evaluate_columns(
            pack_columns(self.team, uav, self.point, columns, weight, v), values)
        return values

    def build_dual(self, tau: float) -> Dual:
        """Add a round of columns; return the dual function at `tau` [nats] on the latest ones."""
        self._add_round()
        columns = [[self._restrict(cell, uav, pool.latest) for uav, pool in enumerate(pools)]
                   for cell, pools in enumerate(self.pools)]
        return Dual(self.team, self.weight, columns, [pool.silent for pool in self.pools[0]], tau)

    def _add_round(self) -> None:
        """
        Add a round to every pool, and the best silent places to the pools of the first cell.

        A thorough search also adds to every pool the best column of branch and bound.
        """
        for cell, pools in enumerate(self.pools):
            for uav, pool in enumerate(pools):
                pool.add_round(partial(self._evaluate_in_cell, cell, uav))
                if self.thorough:
                    incumbents = self._evaluate_in_cell(cell, uav, pool.latest).max(1)
                    pool.add_exact(self.find_better(
                        uav, self.cells.take_part(cell, len(self.weight)), self.weight,
                        self.point.v[:, cell], incumbents))
        slopes = np.diff(self.point.potentials[..., self.point.layout.slope], axis=0)
        for uav, pool in enumerate(self.pools[0]):
            pool.add_silent_places(None if self.point.layout.quadratic else slopes[:, uav],
                                   partial(self.evaluate, uav))

    def _evaluate_in_cell(self, cell: int, uav: int, columns: Columns) -> Array:
        """Return the values of a UAV's columns, (G, C) in nats, with the v of one cell."""
        return self.evaluate(uav, self._restrict(cell, uav, columns), self.weight,
                             self.point.v[:, cell])

    def _restrict(self, cell: int, uav: int, columns: Columns) -> Columns:
        """Return columns; the last UAV's outside a cell, of several, get `ground` -WORTHLESS."""
        if uav + 1 < len(self.team.regions) or len(self.pools) == 1:
            return columns
        inside = self.cells.take_part(cell, len(self.weight)).contain(columns.place)
        return replace(columns, ground=np.where(inside, columns.ground, -WORTHLESS))

    def find_better(self, uav: int, cells: Cells, weight: Array, v: Array,
                    incumbents: Array) -> Columns:
        """
        Return for every function the best column that branch and bound finds, (M, 1).

        A function is the value of the UAV's columns at one w0 and v, over one cell. The column's
        `ground` is -WORTHLESS if PRICING_BUDGET boxes show no column above the incumbent.

        :param cells: C cells of the last UAV; function m is over cell m modulo C, or for another
            UAV over the reachable set of this cell's group.
        :param weight: w0 of the functions, (M,).
        :param v: eavesdropper multipliers of the functions, (M, E).
        :param incumbents: largest values of known columns, (M,) in nats.
        """
        region, potential = self.team.regions[uav], self.potential(uav)
        cell = np.arange(len(weight)) % len(cells.group)
        if uav + 1 < len(self.team.regions):
            # Only the last UAV is restricted to cells.
            cells, cell = Cells.whole(region), cells.group[cell]
        group = cells.group[cell]
        terms = Terms(potential, cells, cell, weight, v, float(self.point.prices[uav]),
                      find_power_range(self.team, uav) if uav else None)
        # Place and log power of each function's best point; NaN if none beats its incumbent.
        points = np.full((len(weight), 3), np.nan)
        terms.bound_maxima(incumbents + _compute_constant(potential)[group], self._ask_to_go_on,
                           PRICING_BUDGET, points)
        is_better = np.isfinite(points[:, :1])
        place = np.where(is_better, points[:, :2], region.bounding_box[0][group])
        power = np.where(is_better, np.exp(points[:, 2:]), 0.0)
        columns = Columns.of(region, place[:, None], power if uav else np.zeros_like(power))
        return replace(columns, ground=np.where(is_better, columns.ground, -WORTHLESS))

    def _ask_to_go_on(self) -> bool:
        """Call raise_if_over; return False, so that branch and bound is not stopped."""
        self.raise_if_over()
        return False

    def cut_cells(self, tau: float) -> None:
        """
        Add a round of columns; cut the cell with the largest value in every group in two.

        The last UAV's columns have the shares exp(value / tau). The cut is at the mean of their
        places, across the axis along which the variance is larger. Each part begins with the
        cell's v and columns.

        :param tau: temperature [nats] of the shares.
        """
        dual, group = self.build_dual(tau), np.arange(len(self.weight))
        last = len(self.team.regions) - 1
        worst = dual.find_worst_cell(self.point)
        columns = Columns.choose([parts[last] for parts in dual.columns], worst)
        v = self.point.v[group, worst]
        value = self.evaluate(last, columns, self.weight, v)
        share = np.exp((value - value.max(1, keepdims=True)) / tau)[..., None]
        share /= share.sum(1, keepdims=True)
        mean = (share * columns.place).sum(1)
        variance = (share * (columns.place - mean[:, None])**2).sum(1)
        axis = variance.argmax(1)
        self.cells = self.cells.cut(worst * len(group) + group, axis, mean[group, axis])
        self.point = replace(self.point, v=np.concatenate([self.point.v, v[:, None]], 1))
        self.pools.append([ColumnPool.choose(list(pools), worst) for pools in zip(*self.pools)])

    def add_quadratic_part(self) -> None:
        """Make the potentials quadratic, beginning with S = 0."""
        self.point = replace(
            self.point, layout=PotentialLayout.of(True, self.team.accelerates),
            potentials=np.insert(self.point.potentials, [2, 2, 2], 0.0, 2))

    def potential(self, uav: int) -> Potential:
        """Return the present potential of a UAV."""
        return Potential(*self.point.layout.split(self.point.potentials[:, uav]), self.team.groups,
                         self.team.regions[uav])

    def minimise(self, tau: float, iterations: int) -> None:
        """Add a round of columns, then take at most `iterations` Newton steps at `tau` [nats]."""
        dual = self.build_dual(tau)
        for _ in range(iterations):
            self.raise_if_over()
            # The steps end when the slope along one is nearly 0.
            if -self._descend(dual) < 1e-3 * tau * self.team.groups.slots**0.5:
                break

    def _descend(self, dual: Dual) -> float:
        """
        Take a damped Newton step; return the dual's slope along it (<= 0), or 0 if none lowers it.

        A length of the step is accepted if value(trial) < value + 0.1 length slope. The lengths 1,
        0.3 and 0.1 are tried, then ten times the damping of ArrowSystem.solve, up to MAX_DAMPING.
        A Hessian that is not positive definite takes 100 times the damping. The next step begins
        with the accepted damping, times 0.1 after length 1, or with 1 if none was accepted.
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
            # Length 1 lowers the damping, shorter ones keep it; it rises if none is accepted.
            for length, factor in ((1.0, 0.1), (0.3, 1.0), (0.1, 1.0)):
                trial = self.point.move(step, length)
                if dual.value(trial) < value + 0.1 * length * slope:
                    self._damping = max(factor * self._damping, 1e-9)
                    self.point = trial
                    return slope
            self._damping *= 10
        self._damping = 1.0
        return 0.0


def _compute_constant(potential: Potential) -> Array:
    """Return A |w|, plus the curvature's cost if quadratic: what columns leave out, (G,)."""
    return potential.constant() if potential.is_quadratic else potential.acceleration_cost()


def _fill_silent_groups(team: Team, watts: Array, sends: NDArray[np.bool_]) -> Array:
    """
    Return powers (U, G) in W in which the transmitter sends in every group of slots.

    A silent group takes the powers of the nearest group in which the transmitter sends. If the
    transmitter never sends, all powers are the UAVs' average powers.

    :param watts: powers of a plan, (U, G) in W.
    :param sends: whether the transmitter sends in each group, (G,).
    """
    sending = np.flatnonzero(sends)
    if not len(sending):
        return np.repeat([[region.average] for region in team.regions], len(sends), axis=1)
    group = np.arange(len(sends))[:, None]
    return np.asarray(watts[:, sending[np.abs(sending - group).argmin(1)]])


def suggest_multipliers(team: Team, places: list[Array], watts: Array
                        ) -> tuple[Array, Array, Array]:
    """
    Return w0 (G,), v (G, E) and prices (U,) that a plan suggests.

    At the places and powers of the plan, w0 = phi'(z0), at least 0.3. The transmitter's price is
    the median over groups of (phi'(z0) - phi'(y)) / power, with y the log SINR of all adversaries.
    A jammer's price is JAMMER_PRICE. The sum of v is the smaller one of phi'(y) and w0 - price
    power, at least LEAST_LEAK. v_e is in proportion to the weight of place e, which
    _compute_place_shares makes larger for louder places.
    Measured: with v in equal shares, bounds of missions with several eavesdroppers are up to 2.8%
    above the plan instead of 0.1%.

    :param places: places of each UAV in its frame, (G, 2) in units.
    :param watts: powers of the UAVs, (U, G), above 0 for the transmitter.
    """
    # Received powers over noise from each UAV, (U, G) and (U, G, E).
    ground, leaks = [], []
    for region, place, power in zip(team.regions, places, watts):
        log_ground, log_leaks = region.log_squares(place)
        ground.append(power * np.exp(region.log_gain - log_ground))
        leaks.append(power[:, None] * np.exp(region.log_gain - log_leaks))
    z0, ze = (np.log(np.maximum(compute_sinr(np.array(received)), 1e-9))
              for received in (ground, leaks))
    weight = np.clip(sigmoid(z0), 0.3, 1 - 1e-6)
    # The largest log SINR of each adversary, (G, number of adversaries).
    largest = np.stack([ze[:, index].max(-1) for index in team.adversaries], -1)
    leak = sigmoid(np.logaddexp.reduce(largest, -1))
    prices = np.array([FIRST_PRICE, JAMMER_PRICE])[:len(watts)]
    prices[0] = max(float(np.median((sigmoid(z0) - leak) / np.maximum(watts[0], 1e-9))), 1e-6)
    slack = prices[0] * np.maximum(watts[0], 0.1 * team.regions[0].average)
    total = np.clip(np.minimum(leak, weight - slack), LEAST_LEAK, weight * (1 - 1e-7))
    share = _compute_place_shares(team, ze, largest)
    return weight, (total / share.sum(-1))[:, None] * share, prices


def _compute_place_shares(team: Team, ze: Array, largest: Array) -> Array:
    """
    Return weights of places, (G, E): a share that is larger for louder places, plus LEAST_SHARE.

    A share is in proportion to (adversary's largest SINR) (SINR^k / sum of SINR^k over the
    adversary's places), with k = SHARPNESS. The shares of a group add up to 1.

    :param ze: log SINR at the places, (G, E).
    :param largest: largest log SINR of each adversary, (G, number of adversaries).
    """
    share = np.empty_like(ze)
    for index, loudest in zip(team.adversaries, largest.T):
        in_adversary = np.exp(SHARPNESS * (ze[:, index] - loudest[:, None]))
        of_adversary = np.exp(loudest - largest.max(-1))[:, None]
        share[:, index] = in_adversary / in_adversary.sum(-1, keepdims=True) * of_adversary
    return share / share.sum(-1, keepdims=True) + LEAST_SHARE


def build_multipliers(search: MultiplierSearch) -> Multipliers:
    """
    Return the multipliers of the certificate, with cells and breakpoints of w0.

    The potentials and prices are the search's. v is chosen anew for each of K breakpoints in each
    of C cells on all columns of the search; a thorough search adds better columns.
    """
    groups, candidates = len(search.weight), map(list, zip(*search.pools))
    bounds = SlotBounds(
        search.team, [(part, search.evaluate(i, part))
                      for i, part in enumerate(map(ColumnPool.join, candidates))],
        float(search.point.prices[0]), search.raise_if_over)
    # The search's v of each cell, (C, E), and its ratio to w0 of the cell's group.
    v = np.concatenate(np.moveaxis(search.point.v, 1, 0))
    cells, ratio = bounds.divide(
        search.cells, search.weight, v / search.weight[search.cells.group, None])
    weights = np.sort([*(np.full(groups, w0) for w0 in BREAKPOINTS), search.weight],
                      axis=0)[:, cells.group]
    v, incumbents, _ = bounds.minimise(weights, cells, ratio)
    for _ in range(PRICING_ROUNDS if search.thorough else 0):
        _add_better_columns(bounds, search, cells, weights, v, incumbents)
        v, incumbents, _ = bounds.minimise(weights, cells, v / weights[..., None])
    potentials = tuple(map(search.potential, range(len(search.team.regions))))
    constant = np.array(list(map(_compute_constant, potentials)))[:, cells.group]
    return Multipliers(
        potentials, search.point.prices, cells, weights, v,
        constant + _find_silent_maxima(search, cells), incumbents + constant[:, None])


def _add_better_columns(bounds: SlotBounds, search: MultiplierSearch, cells: Cells,
                        weights: Array, v: Array, incumbents: Array) -> None:
    """
    Add to `bounds` a column of each UAV that is better than the incumbent, for every (K, C).

    :param weights: w0, (K, C).
    :param v: eavesdropper multipliers, (K, C, E).
    :param incumbents: largest values of the columns so far, (U, K, C) in nats.
    """
    for uav, values in enumerate(incumbents):
        better = search.find_better(
            uav, cells, weights.ravel(), v.reshape(-1, v.shape[-1]), values.ravel())
        columns = better.spread(np.tile(cells.group, len(weights)), len(search.weight))
        bounds.add(uav, columns, search.evaluate(uav, columns))


def _find_silent_maxima(search: MultiplierSearch, cells: Cells) -> Array:
    """Return the largest value of each UAV's silent columns in each of C cells, (U, C) in nats."""
    pools = search.pools[0]
    values = [search.evaluate(i, pool.silent)[cells.group] for i, pool in enumerate(pools)]
    # Only the last UAV is restricted to cells.
    places = pools[-1].silent.place[cells.group]
    values[-1] = np.where(cells.contain(places), values[-1], -np.inf)
    return np.array([value.max(1) for value in values])
