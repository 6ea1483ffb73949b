"""A flown flight against its plan: errors, clearances, rates achieved and slots that broke."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
import math
from typing import Any, NamedTuple, TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
import scipy

from .alignment import STEP_S
from .closest import Closest, find_fence, find_separation, find_zone
from .flight import FlownFlight
from ...errors import name_missing_package, OptionError
from ...mission import OBJECTIVES
from ...mission.fields import check_argument, checked_truth, Choice
from ...mission.scenario import Array, read_only
from ...mission.validation import checked_kind
from ...model import channel
from ...model.channel.rates import find_least_rate
from ...model.curve import GAUSS_LEGENDRE, integrate_powers
from ...output.flown_table import comparison_table
from ...plan.plan import Plan

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from pandas import DataFrame

BROKEN, NEGLIGIBLE = 0.05, 0.01
"""
A broken slot has less than planned by BROKEN of the slot's rate plus NEGLIGIBLE of the mean rate.

A delay of 0.3 s changes the rates of slots by up to 2% where UAVs fly fast.
"""

_LONGEST_DELAY_S = 5.0
_MOVING = 0.05  # Share of the largest speed below which an error has no direction.
_WINDOW_S = 0.5  # Accelerations are differences of velocities over this time.
_CONSTANT_DELAY_S = 0.2  # Delay above which start_delay is advised.
_LAGGING = 0.5  # Correlation of error and planned acceleration above which less is advised.


class UavErrors(NamedTuple):
    """
    Errors of one UAV against its plan.

    :ivar delay_s: time by which the UAV is behind its plan along its way.
    :ivar error_rms_m: horizontal distance from the plan at the same time, RMS.
    :ivar error_max_m: largest horizontal distance from the plan at the same time.
    :ivar error_max_time_s: time of the largest distance, from point 0.
    :ivar cross_track_rms_m: distance from the way of the plan, RMS.
    :ivar cross_track_95_m: 95% quantile of the distance from the way.
    :ivar cross_track_max_m: largest distance from the way.
    :ivar cross_track_99_m: 99% quantile of the distance from the way.
    :ivar height_error_max_m: largest difference of heights; NaN without heights.
    :ivar speed_max_m_s: largest speed that was flown.
    :ivar acceleration_max_m_s2: largest acceleration that was flown.
    :ivar gap_max_s: longest time without a position.
    :ivar energy_j: energy by the model of propulsion along the way flown; NaN without a model.
    :ivar planned_energy_j: energy of the plan by the same model.
    :ivar battery_j: energy taken from the battery; NaN where the log has none.
    :ivar setpoint_error_rms_m: RMS distance of the autopilot's targets from the plan; NaN if the
        log has no targets.
    """

    delay_s: float
    error_rms_m: float
    error_max_m: float
    error_max_time_s: float
    cross_track_rms_m: float
    cross_track_95_m: float
    cross_track_max_m: float
    cross_track_99_m: float
    height_error_max_m: float
    speed_max_m_s: float
    acceleration_max_m_s2: float
    gap_max_s: float
    energy_j: float
    planned_energy_j: float
    battery_j: float
    setpoint_error_rms_m: float


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
    :ivar achieved: by objective, the rates of the ground nodes in their shares that were achieved,
        (G, N) in bit/s/Hz.
    :ivar planned: by objective, the planned rates of the ground nodes, (G, N) in bit/s/Hz.
    :ivar errors: distance of each UAV from the way of its plan at flight.times, (U, K) in m.
    """

    flight: FlownFlight
    uavs: dict[str, UavErrors]
    separation: Closest | None
    zones: Closest | None
    fence: Closest | None
    covered: NDArray[np.bool_]
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
        """Planned less achieved rate of the objective in each slot, (N,); NaN if not covered."""
        objective = self.plan.objective
        missing = (self.planned[objective] - self.achieved[objective]).sum(axis=0)
        return np.where(self.covered, missing, np.nan)

    @property
    def broken(self) -> NDArray[np.bool_]:
        """Promised slots whose rate was lower than planned, (N,); see BROKEN."""
        planned = self.planned[self.plan.objective].sum(axis=0)
        return self.plan.promised_slots & (np.nan_to_num(self.shortfalls) > (
            BROKEN * planned + NEGLIGIBLE * planned.mean()))

    def rate(self, objective: str, is_planned: bool = False) -> float:
        """Return the mean rate of an objective over the covered slots, in bit/s/Hz."""
        check_argument('objective', objective, Choice(OBJECTIVES))
        is_planned = check_argument('is_planned', is_planned, checked_truth)
        if not self.covered.any():
            return math.nan
        rates = (self.planned if is_planned else self.achieved)[objective][:, self.covered]
        return find_least_rate(self.plan.scenario, rates.mean(axis=1))

    def delivered(self, is_planned: bool = False) -> Array:
        """Return what each node got in secret in the covered slots, (G,) in bit/Hz."""
        is_planned = check_argument('is_planned', is_planned, checked_truth)
        rates = (self.planned if is_planned else self.achieved)[self.plan.objective]
        return np.asarray(rates[:, self.covered].sum(axis=1) * self.plan.scenario.slot_duration)

    @property
    def advice(self) -> list[str]:
        """Parameters and options to type next."""
        words = []
        worst = max(errors.cross_track_99_m for errors in self.uavs.values())
        margin = self.plan.scenario.tracking_margin
        if worst > margin:
            words.append(f'tracking_margin: {math.ceil(worst * 10) / 10:g} (99% of the errors are '
                         f'below {worst:.2f} m; the plan has {margin:g} m)')
        spread = math.sqrt(np.mean([errors.error_rms_m**2 for errors in self.uavs.values()]) / 2)
        words.append(f'assess --tracking-std {spread:.2f}')
        for name, errors in self.uavs.items():
            if abs(errors.delay_s) > _CONSTANT_DELAY_S:
                words.append(f'start_delay: {name} is {errors.delay_s:.2f} s behind its plan')
        return [*words, *self._find_lagging()]

    def _find_lagging(self) -> list[str]:
        """Return advice for UAVs whose errors grow with the acceleration of the plan."""
        times = self.flight.times
        planned = np.linalg.norm(self.plan.curve.at(times).accelerations, axis=-1)
        words = []
        for uav, errors, steep in zip(self.plan.scenario.uavs, self.errors, planned, strict=True):
            known = np.isfinite(errors)
            if uav.max_acceleration is None or np.ptp(steep[known]) == 0 or (
                    errors[known].max(initial=0.0) < 1.0):
                continue
            if np.corrcoef(errors[known], steep[known])[0, 1] > _LAGGING:
                words.append(f'{uav.name}.max_acceleration below {uav.max_acceleration:g}: errors '
                             'grow with the acceleration')
        return words

    def to_dict(self) -> dict[str, Any]:
        """Return the numbers by name; None for an unknown number."""
        node_names = self.plan.scenario.ground_node_names

        def plain(value: float) -> float | None:
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
            'slots_promised': int(self.plan.promised_slots.sum()),
            'slots_broken': int(self.broken.sum()),
            'broken_slots': (np.flatnonzero(self.broken) + 1).tolist(),
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
        Return a picture: the map with both ways, errors over time, rates planned and achieved.

        :raises MissingPackageError: when Matplotlib is not installed.
        """
        with name_missing_package():
            from ...output.flown_picture import draw_comparison
        return draw_comparison(self)

    def to_dataframe(self) -> 'DataFrame':
        """
        Return a row for each slot: time, rates achieved and planned, promised, covered, broken.

        :raises MissingPackageError: when pandas is not installed.
        """
        with name_missing_package():
            import pandas
        return pandas.DataFrame({
            'slot': np.arange(1, self.plan.scenario.slots + 1), 'time': self.plan.times[1:-1],
            **{f'{kind}_rate': rates.sum(axis=0) for kind, rates in self.achieved.items()},
            **{f'planned_{kind}_rate': rates.sum(axis=0) for kind, rates in self.planned.items()},
            'promised': self.plan.promised_slots, 'covered': self.covered, 'broken': self.broken})


def compare(plan: Plan, flight: FlownFlight) -> Comparison:
    """
    Compare a flight with its plan.

    :param plan: a Plan.
    :param flight: a FlownFlight by read_flight. Its plan is compared: the last one of a bag.
    :raises OptionError: for anything else.
    """
    checked_kind('plan', plan, Plan)
    checked_kind('flight', flight, FlownFlight)
    if len(flight.positions) != len(plan.scenario.uavs):
        raise OptionError(f'flight has {len(flight.positions)} UAVs; it must have '
                          f'{len(plan.scenario.uavs)}', ('flight',))
    plan, scenario = flight.plan, flight.plan.scenario
    errors, ways = {}, []
    for index, uav in enumerate(scenario.uavs):
        errors[uav.name], way = _measure_errors(flight, index)
        ways.append(way)
    slots = np.arange(1, scenario.slots + 1) * scenario.slot_duration
    known = np.isfinite(flight.positions).all(axis=(0, 2)).astype(float)
    begin, end = (np.interp(times, flight.times, np.append(0.0, np.cumsum(1 - known[1:])))
                  for times in (slots, slots + scenario.slot_duration))
    covered = (end - begin < 0.5) & (np.interp(slots, flight.times, known) > 0.5)
    achieved, planned = {}, {}
    for kind, find_rates in (('guaranteed', channel.guaranteed_node_rates),
                             ('worst_case', channel.worst_case_node_rates)):
        planned[kind] = _mean_rates(plan, find_rates, lambda times: plan.curve.at(times).positions)
        achieved[kind] = _mean_rates(plan, find_rates, flight.at, flight, covered)
    return Comparison(flight, errors, find_separation(flight), find_zone(flight),
                      find_fence(flight), covered, achieved, planned, read_only(np.stack(ways)))


def _mean_rates(plan: Plan, find_rates: Callable[..., Array], locate: Callable[[Array], Array],
                flight: FlownFlight | None = None,
                covered: NDArray[np.bool_] | None = None) -> Array:
    """Return the mean rates of the nodes in their shares in each slot, (G, N) in bit/s/Hz."""
    scenario = plan.scenario
    chosen = np.arange(scenario.slots) if covered is None else np.flatnonzero(covered)
    rates = np.zeros((len(scenario.ground_nodes), scenario.slots))
    for place, weight in GAUSS_LEGENDRE:
        times = np.asarray((chosen + 1.5 + place) * scenario.slot_duration, float)
        powers = plan.powers[:, chosen]
        if flight is not None and flight.powers is not None:
            last = np.searchsorted(flight.times, times + 1e-9, 'right') - 1
            powers = flight.powers[:, np.maximum(last, 0)]
        positions = np.pad(locate(times), ((0, 0), (1, 1), (0, 0)))
        if len(chosen):
            rates[:, chosen] += weight * find_rates(scenario, positions, powers, times=times)
    return read_only(plan.shares * np.maximum(rates, 0.0))


def _measure_errors(flight: FlownFlight, index: int) -> tuple[UavErrors, Array]:
    """Return the errors of a UAV, and its distances from its way at flight.times, (K,) in m."""
    plan, times = flight.plan, flight.times
    uav, flown = plan.scenario.uavs[index], flight.positions[index]
    known = np.isfinite(flown).all(axis=1)

    def offsets(delay: float) -> Array:
        return np.asarray(flown[:, :2] - plan.curve.at(times - delay).positions[index])

    def measure(delay: float) -> float:
        return float((offsets(delay)[known]**2).sum())

    way = np.full(len(times), np.nan)
    if not known.any():
        return UavErrors(*[math.nan] * len(UavErrors._fields)), way
    coarse = np.arange(-_LONGEST_DELAY_S, _LONGEST_DELAY_S + STEP_S, 0.25)
    nearest = float(coarse[np.argmin([measure(delay) for delay in coarse])])
    delay = float(scipy.optimize.minimize_scalar(
        measure, bounds=(nearest - 0.25, nearest + 0.25), method='bounded',
        options={'xatol': 1e-4}).x)
    error = np.linalg.norm(offsets(0.0), axis=1)
    late = offsets(delay)
    velocity = plan.curve.at(times - delay).velocities[index]
    speed = np.linalg.norm(velocity, axis=1)
    across = np.abs(late[:, 0] * velocity[:, 1] - late[:, 1] * velocity[:, 0]) / np.maximum(
        speed, 1e-9)
    moving = speed > _MOVING * uav.max_speed
    way = np.where(moving, across, np.linalg.norm(late, axis=1))
    kept = way[known]
    has_height = np.abs(flown[known, 2]).max() > 0
    window = max(1, round(_WINDOW_S / STEP_S))
    changes = flight.velocities[index][window:] - flight.velocities[index][:-window]
    accelerations = np.linalg.norm(changes, axis=1) / (window * STEP_S)
    worst = int(np.nanargmax(np.where(known, error, np.nan)))
    energy = plan.energies[index]
    return UavErrors(
        delay, float(np.sqrt((error[known]**2).mean())), float(error[worst]), float(times[worst]),
        float(np.sqrt((kept**2).mean())), float(np.quantile(kept, 0.95)), float(kept.max()),
        float(np.quantile(kept, 0.99)),
        float(np.abs(flown[known, 2] - uav.altitude).max()) if has_height else math.nan,
        float(np.nanmax(np.linalg.norm(flight.velocities[index], axis=1))),
        float(np.nanmax(accelerations)), _find_gap(times, known),
        _integrate_energy(flight, index), math.nan if energy is None else energy.total,
        flight.battery.get(uav.name, math.nan),
        flight.setpoint_errors.get(uav.name, math.nan)), read_only(np.where(known, way, np.nan))


def _find_gap(times: Array, known: Array) -> float:
    """Return the longest time without a position in s."""
    edges = np.flatnonzero(np.diff(np.concatenate([[True], known, [True]]).astype(int)))
    return float(max((last - first for first, last in edges.reshape(-1, 2)), default=0) * STEP_S)


def _integrate_energy(flight: FlownFlight, index: int) -> float:
    """Return the energy of the way flown by the model of propulsion, in J."""
    scenario = flight.plan.scenario
    if scenario.uavs[index].propulsion is None:
        return math.nan
    velocities = np.nan_to_num(flight.velocities)
    return float(integrate_powers(
        scenario, velocities[:, :-1], velocities[:, 1:], STEP_S)[index].sum())
