"""Reachable sets of the UAVs in every group of a mission, each in its own frame."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray
import scipy

from .detours import Detours, frame_axes, SIDE
from .relaxation import (
    COORDINATE_ROUNDING, EavesdropperSubset, end_tolerance, find_reference_snrs, MOST_GROUPS,
    SlotGroups)
from ...mission.scenario import Array, Scenario
from ...model.channel.links import guaranteed_squared_distance
from ...model.kernel import core
from ...plan.plan import POSITION_TOLERANCE, POWER_TOLERANCE


@dataclass(frozen=True, eq=False)
class ReachableSet:
    """
    One UAV in its own frame: its reachable set in every group, its channel and its powers.

    The origin is the start, the first axis points to the goal, and lengths are divided by
    `unit`, so that start, goal and receivers lie within a few units. In slot n a UAV is within n
    moves of its start and N + 1 - n moves of its goal. The reachable set is the intersection of
    these two discs. It contains the UAV's place in every feasible plan, tolerances included, but
    not every place in it can be reached. With an acceleration limit, moves are short near an end
    whose velocity is given: |d_n| <= |d_{-1}| + (n + 1) A, lemma 8 in terms.py.

    :param unit: length of one unit [m].
    :param origin: origin of the frame, (2,) in m.
    :param axes: the frame's axes as rows, (2, 2).
    :param distance: distance from start to goal, in units.
    :param step: largest move from one point to the next, tolerance included, in units.
    :param steps: largest move after a slot of every group, tolerance included, (G,) in units.
    :param max_move_change: A, the largest change of a move from one slot to the next, in units;
        two steps without a limit of acceleration.
    :param end_move_changes: A at the start and at the goal, (2,) in units. A free velocity is
        replaced by velocity zero with changes of up to a step.
    :param end_moves: d_{-1} and d_{N+1}, the moves before the start and after the goal, (2, 2).
    :param from_start: radius of the disc about the start in every group, (G,) in units.
    :param to_goal: radius of the disc about the goal in every group, (G,) in units.
    :param altitude: altitude of the UAV, in units.
    :param log_gain: logarithm of the SNR at the ground node at a distance of one unit and 1 W.
    :param ground: the ground node, (2,) in units.
    :param eavesdroppers: centres of the discs, (E, 2) in units.
    :param radii: error radii, (E,) in units.
    :param log_advantages: logarithm of each eavesdropper's SNR over the ground node's SNR at
        equal distance and power, (E,).
    :param transmits: True for the transmitter, UAV 0; False for a jammer.
    :param peak: largest power, tolerance included [W].
    :param average: largest mean power, tolerance included [W].
    :param detours: path lengths around zones and within the geofence, in units, or None.
    """

    unit: float
    origin: Array
    axes: Array
    distance: float
    step: float
    steps: Array
    max_move_change: float
    end_move_changes: Array
    end_moves: Array
    from_start: Array
    to_goal: Array
    altitude: float
    log_gain: float
    ground: Array
    eavesdroppers: Array
    radii: Array
    log_advantages: Array
    transmits: bool
    peak: float
    average: float
    detours: Detours | None

    @classmethod
    def of(cls, scenario: Scenario, index: int, groups: SlotGroups,
           subset: EavesdropperSubset, detours: Detours | None) -> ReachableSet:
        """
        Return the reachable set of UAV `index` in its own frame, widened by a Plan's tolerances.

        :param scenario: the mission.
        :param index: index of the UAV.
        :param groups: groups of the mission's slots.
        :param subset: places that represent the eavesdroppers.
        :param detours: detours of the UAV in m, or None to ignore its obstacles.
        """
        uav = scenario.uavs[index]
        start, goal = np.array(uav.start), np.array(uav.goal)
        receivers = np.concatenate([[scenario.ground_node], subset.places])
        places = np.concatenate([receivers, [start, goal]])
        unit = max(float(np.hypot(*np.ptp(places, axis=0))) / 2, uav.altitude)
        length = float(np.hypot(*(goal - start)))
        axes, miss = frame_axes(uav), end_tolerance(scenario)
        step = float(scenario.max_step[index]) + POSITION_TOLERANCE
        max_move_change, end_move_changes, end_moves = _limit_move_changes(scenario, index, step)
        moves = _find_longest_moves(
            scenario.slots, step, max_move_change, end_move_changes, end_moves)
        # Longest ways from the start to each point, and from each point to the goal, (N+2,). The
        # factors 1 + 1e-12 cover rounding, since moves are differences of rounded coordinates.
        ahead = np.concatenate([[0.0], np.cumsum(moves)]) * (1 + 1e-12)
        behind = np.concatenate([np.cumsum(moves[::-1])[::-1], [0.0]]) * (1 + 1e-12)
        in_frame = (receivers - start) @ axes.T / unit
        log_ground, log_eavesdropper = np.log(find_reference_snrs(scenario)[:, index])
        return cls(
            unit=unit, origin=start, axes=axes, distance=length / unit, step=step / unit,
            steps=np.maximum.reduceat(moves[1:], groups.edges[:-1]) / unit,
            max_move_change=max_move_change / unit, end_move_changes=end_move_changes / unit,
            end_moves=end_moves @ axes.T / unit,
            from_start=(ahead[groups.last] + miss) / unit * (1 + COORDINATE_ROUNDING),
            to_goal=(behind[groups.first] + miss) / unit * (1 + COORDINATE_ROUNDING),
            altitude=uav.altitude / unit,
            log_gain=float(log_ground - 2 * np.log(unit)),
            ground=in_frame[0], eavesdroppers=in_frame[1:],
            radii=subset.radii / unit,
            log_advantages=np.log(subset.advantages) + (log_eavesdropper - log_ground),
            transmits=index == 0,
            peak=uav.peak_power + POWER_TOLERANCE,
            average=uav.average_power * (1 + 1e-12) + POWER_TOLERANCE,
            detours=detours and detours.scale(unit))

    @cached_property
    def compiled_links(self) -> core.Links:
        """Return the kernel's form of the links."""
        ground, eavesdroppers, radii, log_advantages = (
            np.ascontiguousarray(values, float) for values in (
                self.ground, self.eavesdroppers, self.radii, self.log_advantages))
        return core.Links(self.altitude, self.log_gain, ground, eavesdroppers, radii,
                          log_advantages)

    def local(self, positions: Array) -> Array:
        """Return positions (..., 2) in m as places in the UAV's frame, (..., 2) in units."""
        return np.asarray((positions - self.origin) @ self.axes.T / self.unit)

    @cached_property
    def bounding_box(self) -> tuple[Array, Array]:
        """
        Return the lower and the upper corner of a rectangle about each group's set, (G, 2) each.

        The set is the overlap of the disc about the start (0, 0) with radius r1 and the disc about
        the goal (D, 0) with radius r2. If their circles cross between start and goal, at x = a,
        the set is widest in y there, with the half width sqrt(r1^2 - a^2). Otherwise it is as wide
        as the smaller disc. 1e-14 (r1^2 + D^2) is added to the radicand, more than its rounding
        error. With detours only the grid cells reached in time are within the rectangle.
        """
        r1, r2, distance = self.from_start, self.to_goal, self.distance
        crossing = self._crossing()
        between = (crossing >= 0) & (crossing <= distance)
        crossing = np.where(between, crossing, 0.0)
        half = np.where(between, np.sqrt(
            np.maximum((r1 - crossing) * (r1 + crossing), 0.0)
            + 1e-14 * (r1**2 + distance**2)), np.minimum(r1, r2))
        slack = COORDINATE_ROUNDING * (r1 + r2 + distance)
        low = np.stack([np.maximum(-r1, distance - r2) - slack, -half - slack], -1)
        high = np.stack([np.minimum(r1, distance + r2) + slack, half + slack], -1)
        if self.detours is None:
            return low, high
        first, end = self._find_cells_in_time()
        return (np.maximum(low, self.detours.low + (first - 1e-6) * self.detours.size),
                np.minimum(high, self.detours.low + (end + 1e-6) * self.detours.size))

    def _find_cells_in_time(self) -> tuple[Array, Array]:
        """
        Return the range of grid cells reached in time: first and one past the last, (G, 2) each.

        Indices are along x and along y in the SIDE x SIDE grid of the detours. A cell is in time
        if its _time_deficit is at most 0 or, in a group without such a cell, the least.
        """
        late = self._time_deficit()
        in_time = late <= np.maximum(0.0, late.min((1, 2), keepdims=True))
        columns, rows = in_time.any(2), in_time.any(1)
        first = [flags.argmax(1) for flags in (columns, rows)]
        end = [SIDE - flags[:, ::-1].argmax(1) for flags in (columns, rows)]
        return np.stack(first, -1), np.stack(end, -1)

    def _time_deficit(self) -> Array:
        """Return the larger excess of a cell's two paths over the radii, (G, SIDE, SIDE)."""
        assert self.detours is not None
        there, back = self.detours.lengths
        return np.maximum(there - self.from_start[:, None, None],
                          back - self.to_goal[:, None, None])

    def _crossing(self) -> Array:
        """
        Return the x at which the circles around the start and the goal cross, (G,) in units.

        Their radii are `from_start` and `to_goal`. A group whose circles do not cross has NaN.
        """
        r1, r2, distance = self.from_start, self.to_goal, self.distance
        if distance < 1e-9:
            return np.full(len(r1), np.nan)
        # x of x^2 + y^2 = r1^2 and (x - distance)^2 + y^2 = r2^2.
        x = (distance + (r1 - r2) * (r1 + r2) / distance) / 2
        return np.where(np.abs(x) < r1, x, np.nan)

    @cached_property
    def corner(self) -> Array:
        """
        Return the upper crossing of the circles, (G, 2), or zeros if they do not cross.

        Lemma 6. For any split g1 + g2 of a direction g, the maximum of g . q over both discs is at
        most r1 |g1| + r2 |g2| + g2 . goal, the sum of the two discs' maxima. This is attained by
        g2 = 0 or g1 = 0 if the maximum lies on one disc's arc. Otherwise it is attained by the
        multiples of the normals at a corner. The kernel computes the split from the corner, so
        that a badly rounded corner makes a bound larger, never wrong.
        """
        x = self._crossing()
        y = np.sqrt(np.maximum((self.from_start - x) * (self.from_start + x), 0.0))
        crosses = np.isfinite(x) & (y > 0)
        return np.where(crosses[:, None], np.stack([x, y], -1), 0.0)

    def contains(self, place: Array, group: NDArray[np.integer[Any]]) -> NDArray[np.bool_]:
        """Return True for places (..., 2) in both discs of their group (...), and _is_in_time."""
        across = place[..., 1]**2
        return np.asarray(
            (place[..., 0]**2 + across <= self.from_start[group]**2)
            & ((place[..., 0] - self.distance)**2 + across <= self.to_goal[group]**2)
            & self._is_in_time(place, group))

    def _is_in_time(self, place: Array, group: NDArray[np.integer[Any]]) -> NDArray[np.bool_]:
        """Return True for places (..., 2) whose paths around obstacles are within the radii."""
        if self.detours is None:
            return np.ones(place.shape[:-1], bool)
        there, back = self.detours.lengths[(slice(None), *self.detours.locate(place))]
        return np.asarray((there <= self.from_start[group]) & (back <= self.to_goal[group]))

    @cached_property
    def _closest_cells(self) -> NDArray[np.int16]:
        """Grid index of the closest cell reached in time, for each cell, (G, SIDE, SIDE, 2)."""
        assert self.detours is not None
        return np.array([np.moveaxis(scipy.ndimage.distance_transform_edt(
            late > max(0.0, late.min()), sampling=self.detours.size, return_distances=False,
            return_indices=True), 0, -1) for late in self._time_deficit()], np.int16)

    def clip(self, place: Array, group: NDArray[np.integer[Any]]) -> Array:
        """
        Return places (..., 2) moved into the reachable set of their group (...), approximately.

        A place moves straight towards the start into its disc, then towards the goal into that
        disc, which may leave the first. With detours, a place that is then not in time moves to
        the centre of the closest grid cell reached in time.
        """
        for centre, radius in ((0.0, self.from_start), (self.distance, self.to_goal)):
            offset = place - [centre, 0.0]
            length = np.sqrt((offset * offset).sum(-1))
            reach = radius[group] * (1 - 1e-9)
            ratio = np.minimum(1.0, reach / np.maximum(length, 1e-300))
            place = [centre, 0.0] + offset * ratio[..., None]
        if self.detours is None:
            return np.asarray(place)
        cell = self._closest_cells[(group, *self.detours.locate(place))]
        return np.where(
            self._is_in_time(place, group)[..., None], place, self.detours.find_centre(cell))

    def find_farthest(self, direction: Array) -> Array:
        """
        Return the reachable set's farthest places in K directions, (G, K, 2) in units.

        A place is the farthest one of either disc if the other disc contains it. Otherwise it is
        a crossing of the circles. With detours it moves to the closest cell reached in time.

        :param direction: (G, K, 2), or (1, K, 2) for the same directions in all groups.
        """
        norm = np.hypot(direction[..., 0], direction[..., 1])[..., None]
        unit = np.where(norm > 0, direction / np.maximum(norm, 1e-300), [1.0, 0.0])
        goal = np.array([self.distance, 0.0])
        at_start = self.from_start[:, None, None] * unit
        at_goal = goal + self.to_goal[:, None, None] * unit
        corner = self.corner[:, None] * np.stack(
            [np.ones_like(unit[..., 1]), np.sign(unit[..., 1])], -1)
        in_goal_disc = ((at_start - goal)**2).sum(-1) <= self.to_goal[:, None]**2
        in_start_disc = (at_goal**2).sum(-1) <= self.from_start[:, None]**2
        return self.clip(np.where(in_goal_disc[..., None], at_start, np.where(
            in_start_disc[..., None], at_goal, corner)), np.arange(len(at_start))[:, None])

    def log_squares(self, place: Array) -> tuple[Array, Array]:
        """
        Return log(d0^2 + H^2), (...), and log((de^2 + H^2) / a_e), (..., E), at places (..., 2).

        a_e is the eavesdropper's advantage. Subtracted from log_gain, each value gives the
        logarithm of a gain. d0 is the distance to the ground node. de is the distance from the
        eavesdropper's disc in problem (P2): the least one for the transmitter, the largest one
        for a jammer.
        """
        square = self.altitude**2
        ground = np.log(((place - self.ground)**2).sum(-1) + square)
        squared = guaranteed_squared_distance(
            ((place[..., None, :] - self.eavesdroppers)**2).sum(-1),
            -self.radii if self.transmits else self.radii)
        return ground, np.log(squared + square) - self.log_advantages


def _limit_move_changes(scenario: Scenario, index: int, step: float) -> tuple[float, Array, Array]:
    """
    Return A, (A_0, A_{N+1}) and (d_{-1}, d_{N+1}) of lemma 8 in m: scalar, (2,) and (2, 2).

    A_n is the largest change from move n - 1 to move n, d_{-1} and d_{N+1} are the moves before
    the start and after the goal. Without a limit of acceleration A is 2 step, A at the ends is the
    step and the moves are 0. An end whose velocity is free has A = step and the move 0, too.

    :param step: largest move [m].
    """
    uav = scenario.uavs[index]
    if uav.max_acceleration is None:
        return 2 * step, np.array([step, step]), np.zeros((2, 2))
    change = min(uav.max_acceleration * scenario.slot_duration**2 + POSITION_TOLERANCE, 2 * step)
    ends = (uav.start_velocity, uav.goal_velocity)
    return (change, np.array([step if velocity is None else change for velocity in ends]),
            scenario.slot_duration * np.array([velocity or (0.0, 0.0) for velocity in ends]))


def _find_longest_moves(slots: int, step: float, max_move_change: float, end_move_changes: Array,
                        end_moves: Array) -> Array:
    """
    Return the largest length of each move d_0..d_N, (N + 1,) in m; lemma 8.

    |d_n| is at most the step, |d_{-1}| + A_0 + n A, and |d_{N+1}| + A_{N+1} + (N - n) A.
    """
    ramps = (np.hypot(*end_moves.T)[:, None] + end_move_changes[:, None]
             + np.arange(slots + 1) * max_move_change)
    return np.minimum(step, np.minimum(ramps[0], ramps[1, ::-1]) * (1 + 1e-12))


@dataclass(frozen=True, eq=False)
class Cells:
    """
    Rectangles in a UAV's frame that cover its reachable set in every group, see lemma 10.

    :param group: index of every cell's group, (C,).
    :param low: lower corners, (C, 2) in units.
    :param high: upper corners, (C, 2) in units.
    """

    group: NDArray[np.int64]
    low: Array
    high: Array

    @classmethod
    def whole(cls, region: ReachableSet) -> Cells:
        """Return one cell for every group, in the order of the groups."""
        return cls(np.arange(len(region.steps)), *region.bounding_box)

    def take_part(self, number: int, size: int) -> Cells:
        """Return the cells from number * size to (number + 1) * size - 1."""
        part = slice(number * size, (number + 1) * size)
        return Cells(self.group[part], self.low[part], self.high[part])

    def quarter(self, chosen: NDArray[np.int64]) -> Cells:
        """Return C + 3 D cells: D chosen cells out of C are divided at their middles into four."""
        middle = (self.low + self.high)[chosen] / 2
        cells = self.cut(chosen, np.zeros_like(chosen), middle[:, 0])
        return cells.cut(np.append(chosen, np.arange(len(self.group), len(cells.group))),
                         np.ones(2 * len(chosen), int), np.tile(middle[:, 1], 2))

    def cut(self, chosen: NDArray[np.int64], axis: NDArray[np.int64],
            border: Array) -> Cells:
        """
        Return C + D cells: D chosen cells out of C are cut in two.

        The lower part of a chosen cell keeps its index; the upper parts are appended in order.

        :param chosen: indices of cells, (D,).
        :param axis: 0 to cut at an x, 1 to cut at a y, (D,).
        :param border: the coordinate of each cut, (D,) in units. A border outside a cell moves to
            its edge.
        """
        low, high = self.low.copy(), self.high.copy()
        upper_low, upper_high = low[chosen], high[chosen]
        # Both parts have the same rounded border, so that no gap is between them.
        high[chosen, axis] = upper_low[np.arange(len(chosen)), axis] = np.clip(
            border, low[chosen, axis], high[chosen, axis])
        return Cells(np.append(self.group, self.group[chosen]),
                     np.concatenate([low, upper_low]), np.concatenate([high, upper_high]))

    def contain(self, place: Array) -> NDArray[np.bool_]:
        """Return whether each of K places of every cell, (C, K, 2), is inside it, (C, K)."""
        return np.asarray(
            ((place >= self.low[:, None]) & (place <= self.high[:, None])).all(-1))

    def restrict(self, region: ReachableSet) -> core.ReachableSet:
        """Return the kernel's form of the reachable sets, each restricted to a cell."""
        from_start, to_goal, corner, low, high = (
            np.ascontiguousarray(values, float) for values in (
                region.from_start[self.group], region.to_goal[self.group],
                region.corner[self.group], self.low, self.high))
        return core.ReachableSet(
            region.distance, from_start, to_goal, corner, low, high,
            None if region.detours is None else region.detours.compiled)


@dataclass(frozen=True, eq=False)
class Team:
    """
    The reachable sets of the transmitter and of at most one jammer in all groups of a mission.

    :param groups: groups of the mission's slots.
    :param regions: reachable sets of the transmitter, and of the jammer if there is one.
    :param adversaries: for each adversary the indices of its places. An adversary is a group of
        eavesdroppers' places, and only its worst place counts: one disc with colluding
        eavesdroppers, otherwise all discs together. See certificate.entropy.
    """

    groups: SlotGroups
    regions: tuple[ReachableSet, ...]
    adversaries: tuple[NDArray[np.intp], ...]

    @classmethod
    def of(cls, scenario: Scenario, subset: EavesdropperSubset,
           detours: tuple[Detours | None, ...], most: int = MOST_GROUPS) -> Team:
        """
        Return the team of a scenario.

        If eavesdroppers collude, each disc is an adversary; otherwise all discs are a single one.

        :param subset: places that represent the eavesdroppers.
        :param detours: detours of each UAV in m, see DetourSearch.
        :param most: largest number of groups of slots.
        """
        groups = SlotGroups.of(scenario.slots, most)
        regions = tuple(ReachableSet.of(scenario, i, groups, subset, around)
                        for i, around in enumerate(detours))
        owners = subset.owners if scenario.colluding else np.zeros_like(subset.owners)
        return cls(groups, regions, tuple(
            np.flatnonzero(owners == owner) for owner in np.unique(owners)))

    def sum_adversaries(self, v: Array) -> list[Array]:
        """Return for each adversary the sum of v (..., E) over its places, (...)."""
        return [v[..., places].sum(-1) for places in self.adversaries]

    @property
    def accelerates(self) -> bool:
        """Return True if a UAV has a limit of acceleration."""
        return any(region.max_move_change < 2 * region.step for region in self.regions)
