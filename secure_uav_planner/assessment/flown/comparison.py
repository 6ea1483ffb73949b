"""A flown flight against its plan: errors, clearances, rates achieved and slots that broke."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
import math
from typing import Any, TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from .advice import advise
from .alignment import STEP_S
from .bag import find_starts
from .closest import Closest, find_fence, find_separation, find_zone
from .errors import measure_errors, UavErrors
from .flight import FlownFlight
from ...errors import name_missing_package, OptionError
from ...mission import OBJECTIVES
from ...mission.fields import check_argument, checked_truth, Choice
from ...mission.scenario import Array, read_only
from ...mission.validation import checked_kind
from ...model.channel import NODE_RATES
from ...model.channel.rates import find_least_rate
from ...model.curve import average_node_rates, mean_node_rates
from ...output.flown_table import comparison_table
from ...plan.plan import Plan
from ...plan.tracking import PUNCTUAL

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from pandas import DataFrame

BROKEN, NEGLIGIBLE = 0.05, 0.01
"""
A broken slot has less than planned by BROKEN of the slot's rate plus NEGLIGIBLE of the mean rate.

A delay of 0.3 s changes the rates of slots by up to 2% where UAVs fly fast.
"""


@dataclass(frozen=True, eq=False)
class Comparison:
    """
    What a flight kept of its plan.

    Rates are means over each slot, continuous in time, at the places that were flown. Their powers
    are the powers that were set, or the plan's powers if the logs have none.

    :ivar flight: the FlownFlight.
    :ivar uavs: errors by UAV.
    :ivar separation: smallest distance between UAVs in space, or None for a single UAV.
    :ivar zones: smallest distance of a UAV to a zone at its altitude, negative inside, or None.
    :ivar fence: smallest distance to the geofence from inside, or None without one.
    :ivar covered: True for slots that all logs cover, (N,).
    :ivar promised: True for slots whose rate was promised when it was flown, (N,).
    :ivar achieved: achieved rates of the ground nodes times their shares of the slots, by
        objective, (G, N) in bit/s/Hz; NaN in slots that are not covered.
    :ivar planned: planned rates of the ground nodes times their shares, by objective, (G, N) in
        bit/s/Hz.
    :ivar errors: distance of each UAV from its planned path at flight.times, (U, K) in m.
    """

    flight: FlownFlight
    uavs: dict[str, UavErrors]
    separation: Closest | None
    zones: Closest | None
    fence: Closest | None
    covered: NDArray[np.bool_]
    promised: NDArray[np.bool_]
    achieved: dict[str, Array]
    planned: dict[str, Array]
    errors: Array

    @property
    def plan(self) -> Plan:
        """Plan that was flown."""
        return self.flight.plan

    @property
    def coverage(self) -> float:
        """Share of the slots that all logs cover."""
        return float(self.covered.mean())

    @cached_property
    def shortfalls(self) -> Array:
        """Sum over nodes of [planned - achieved rate]^+ of each slot, (N,); NaN if not covered."""
        objective = self.plan.objective
        missing = np.maximum(self.planned[objective] - self.achieved[objective], 0.0)
        return np.where(self.covered, missing.sum(axis=0), np.nan)

    @property
    def broken(self) -> NDArray[np.bool_]:
        """Promised slots with shortfall > BROKEN * planned + NEGLIGIBLE * mean planned, (N,)."""
        planned = self.planned[self.plan.objective].sum(axis=0)
        return self.promised & (np.nan_to_num(self.shortfalls) > (
            BROKEN * planned + NEGLIGIBLE * planned.mean()))

    def rate(self, objective: str, is_planned: bool = False) -> float:
        """Return min over nodes of (mean in covered slots + offset) / weight [bit/s/Hz] or NaN."""
        check_argument('objective', objective, Choice(OBJECTIVES))
        is_planned = check_argument('is_planned', is_planned, checked_truth)
        if not self.covered.any():
            return math.nan
        rates = (self.planned if is_planned else self.achieved)[objective][:, self.covered]
        return find_least_rate(self.plan.scenario, rates.mean(axis=1))

    def delivered(self, is_planned: bool = False) -> Array:
        """Return what each ground node got in secret in the covered slots, (G,) in bit/Hz."""
        is_planned = check_argument('is_planned', is_planned, checked_truth)
        rates = (self.planned if is_planned else self.achieved)[self.plan.objective]
        return np.asarray(rates[:, self.covered].sum(axis=1) * self.plan.scenario.slot_duration)

    @property
    def advice(self) -> list[str]:
        """Parameters and options to type next, each with its reason."""
        return advise(self.flight, self.uavs, self.errors)

    def to_dict(self) -> dict[str, Any]:
        """Return the numbers by name; None for an unknown number."""
        node_names = self.plan.scenario.ground_node_names

        def plain(value: Any) -> Any:
            if isinstance(value, tuple):
                return [plain(item) for item in value]
            return float(value) if math.isfinite(value) else None

        def describe(closest: Closest | None) -> dict[str, Any] | None:
            return None if closest is None else closest._asdict()

        shifts = self.flight.shifts
        return {
            'time_from': self.flight.time_from,
            'shift_s': plain(next(iter(shifts.values())).seconds),
            'coverage': self.coverage,
            'uavs': {name: {
                'shift_s': plain(shifts[name].seconds),
                'shift_uncertainty_s': plain(shifts[name].uncertainty),
                **{key: plain(value) for key, value in errors._asdict().items()}}
                for name, errors in self.uavs.items()},
            'separation_min_m': None if self.separation is None else self.separation.distance,
            'separation': describe(self.separation), 'zones': describe(self.zones),
            'fence': describe(self.fence),
            'powers_from': 'plan' if self.flight.powers is None else 'log',
            'slots': self.plan.scenario.slots,
            'slots_promised': int(self.promised.sum()),
            'slots_broken': int(self.broken.sum()),
            'broken_slots': (np.flatnonzero(self.broken) + 1).tolist(),
            'uncovered_slots': (np.flatnonzero(~self.covered) + 1).tolist(),
            'shortfall_max': plain(np.nanmax(self.shortfalls)) if self.covered.any() else None,
            **{f'{kind}_rate': plain(self.rate(kind)) for kind in self.achieved},
            **{f'planned_{kind}_rate': plain(self.rate(kind, True)) for kind in self.achieved},
            'delivered_bit_per_hz': float(self.delivered().sum()),
            'planned_bit_per_hz': float(self.delivered(True).sum()),
            'nodes': dict(zip(node_names, self.delivered().tolist(), strict=True)),
            'notes': list(self.flight.notes), 'advice': self.advice}

    def summary(self) -> str:
        """Return one page of text."""
        return comparison_table(self)

    def plot(self) -> 'Figure':
        """
        Return a picture: the map with both paths, errors over time, rates planned and achieved.

        :raises MissingPackageError: when Matplotlib is not installed.
        """
        with name_missing_package():
            from ...output.flown_picture import draw_comparison
        return draw_comparison(self)

    def to_dataframe(self) -> 'DataFrame':
        """
        Return a row for each slot: time, rates achieved and planned, promised, covered, broken.

        Rates are sums over the ground nodes in bit/s/Hz, by objective; the time [s] is the begin.

        :raises MissingPackageError: when pandas is not installed.
        """
        with name_missing_package():
            import pandas
        return pandas.DataFrame({
            'slot': np.arange(1, self.plan.scenario.slots + 1), 'time': self.plan.times[1:-1],
            **{f'{kind}_rate': rates.sum(axis=0) for kind, rates in self.achieved.items()},
            **{f'planned_{kind}_rate': rates.sum(axis=0) for kind, rates in self.planned.items()},
            'promised': self.promised, 'covered': self.covered, 'broken': self.broken})


def compare(plan: Plan, flight: FlownFlight) -> Comparison:
    """
    Return the Comparison of a flight with its plan: errors, distances, rates and broken slots.

    :param plan: the Plan that the flight was read for, or a replan in the same flight.
    :param flight: a FlownFlight by read_flight. Each slot of a flight with replans is compared
        with the plan that was in force.
    :raises OptionError: for anything else.
    """
    checked_kind('plan', plan, Plan)
    checked_kind('flight', flight, FlownFlight)
    if (flight.plan.start_ns or 0) not in find_starts(plan) or not np.array_equal(
            plan.times, flight.plan.times) or [*flight.logs] != [
                uav.name for uav in plan.scenario.uavs]:
        raise OptionError(f'flight is of the plan {flight.plan.identity}; it must be of '
                          f'{plan.identity} or of a replan', ('flight',))
    measured = {uav.name: measure_errors(flight, index)
                for index, uav in enumerate(plan.scenario.uavs)}
    covered = _find_covered(flight)
    # Rates of each ground node times its shares, (G, N) in bit/s/Hz, by objective.
    achieved, planned = ({kind: np.full(plan.shares.shape, np.nan) for kind in OBJECTIVES}
                         for _ in range(2))
    promised, notes = np.zeros(plan.scenario.slots, bool), list[str]()
    # `revision` is the plan that was in force in `slots`.
    for revision, slots in flight.course.split_slots():
        promised[slots], flown = revision.promised_slots[slots], slots[covered[slots]]
        # Reports on plan_time have already ended the promise of a late flight.
        if flight.time_from != 'plan_time' and (
                revision.promised_until is not None or revision.scenario.has_tracks):
            begins = revision.times[1:-1][slots]
            is_late = np.abs(flight.due_at(begins, revision) - begins) > PUNCTUAL
            promised[slots] &= ~np.maximum.accumulate(is_late)
            if is_late.any():
                notes.append(f'the promise of {revision.identity} ends at '
                             f'{begins[np.argmax(is_late)]:.1f} s: the flight was early or late '
                             'for receivers that move')
        for kind, find_rates in NODE_RATES.items():
            for rates, chosen, means in (
                    (planned, slots, mean_node_rates(
                        revision.scenario, find_rates, _make_planned_state(revision, slots),
                        slots)),
                    (achieved, flown, _find_flown_means(flight, revision, flown, find_rates))):
                rates[kind][:, chosen] = revision.shares[:, chosen] * np.maximum(means, 0.0)
    # The rate of a short slot at a gap may need a position inside the gap.
    covered &= np.isfinite(achieved['guaranteed']).all(axis=0)
    return Comparison(
        replace(flight, notes=(*flight.notes, *notes)),
        {name: errors for name, (errors, _) in measured.items()},
        find_separation(flight), find_zone(flight), find_fence(flight), covered,
        promised, {kind: read_only(rates) for kind, rates in achieved.items()},
        {kind: read_only(rates) for kind, rates in planned.items()},
        read_only(np.stack([cross_track for _, cross_track in measured.values()])))


def _make_planned_state(plan: Plan, slots: NDArray[np.intp]
                        ) -> Callable[[Array], tuple[Array, Array, Array]]:
    """
    Return a function of times that plans positions (U, K, 2) [m] and powers (U, K) [W].

    The function's third value is the times (K,) [s] of the receivers' places, which are the same.

    :param slots: indices (K,) of slots; time k [s from point 0] must lie in slot `slots[k]`.
    """
    return lambda times: (plan.curve.at(times).positions, plan.powers[:, slots], times)


def _find_flown_means(flight: FlownFlight, plan: Plan, slots: NDArray[np.intp],
                      find_rates: Callable[..., Array]) -> Array:
    """
    Return each node's mean rate over each of M flown slots, (G, M) in bit/s/Hz.

    Slots are divided where a power changes, since rates jump there. The powers are the planned
    ones if a log lacks them. Receivers are where they are at the time that is due.

    :param slots: increasing indices (M,) of the slots.
    """
    scenario, means = plan.scenario, np.zeros((len(plan.shares), len(slots)))
    step = scenario.slot_duration
    edges = np.unique(np.concatenate(
        [(slots + 1) * step, (slots + 2) * step, flight.find_power_changes()]))
    middles, lengths = (edges[1:] + edges[:-1]) / 2, np.diff(edges)
    piece_slots = np.floor(middles / step).astype(int) - 1
    is_flown = np.isin(piece_slots, slots)
    middles, lengths, piece_slots = middles[is_flown], lengths[is_flown], piece_slots[is_flown]

    def find_state(times: Array) -> tuple[Array, Array, Array]:
        """Return positions [m], powers [W], and the times [s] of the receivers' places."""
        powers = flight.powers_at(times)
        return (flight.at(times), plan.powers[:, piece_slots] if powers is None else powers,
                flight.due_at(times, plan))

    rates = average_node_rates(
        scenario, find_rates, find_state, lambda place: middles + place * lengths)
    np.add.at(means.T, np.searchsorted(slots, piece_slots), (lengths / step * rates).T)
    return means


def _find_covered(flight: FlownFlight) -> NDArray[np.bool_]:
    """Return for each slot, (N,), whether all logs have positions at all flight.times in it."""
    scenario = flight.plan.scenario
    # Slot n goes from edge n to edge n + 1. A time STEP_S / 10 before an edge is rounded onto it.
    edges = scenario.slot_duration * np.arange(1, scenario.slots + 2)
    first = np.searchsorted(flight.times, edges - STEP_S / 10)
    # Whether all logs have a position at each of flight.times; after the end, as at the last one.
    in_all = np.append(flight.covered.all(axis=0), flight.covered[:, -1].all())
    covered: NDArray[np.bool_] = np.logical_and.reduceat(
        in_all, np.minimum(first, len(in_all) - 1))[:-1]
    return covered
