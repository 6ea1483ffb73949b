"""The answer: trajectories and powers, their rates, and the history of the method."""

from collections.abc import Sequence
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from hashlib import blake2b
import math
import os
from typing import Any, TYPE_CHECKING

import numpy as np

from . import file
from .promise import find_promised_slots, Mask, Promise
from .results import (
    Bound, check_bound, explain_zero_rate, Iteration, LEAST_RATE, RatedFlight, Status,
    STATUS_TEXTS, STATUSES)
from ..errors import name_missing_package, OptionError, PlanError, quote
from ..mission import Objective, OBJECTIVES
from ..mission.fields import (
    check_argument, check_items, checked_by, checked_text, Choice, Instance, Members, Number,
    number, refuse, TIME)
from ..mission.scenario import Array, POSITION_TOLERANCE, read_only, Scenario
from ..mission.tracks import LEFT_OUT
from ..mission.validation import checked_kind, is_sequence, rate_text
from ..model.airspace import Clearance
from ..model.channel.shares import find_shares
from ..model.curve import compute_energies, Energy
from ..model.limits.base import POWER_TOLERANCE
from ..model.problem import Problem
from ..output import geojson, tables

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from pandas import DataFrame

_LAST_SECOND = 2**31 - 1  # Largest value of `sec` in a builtin_interfaces/Time.
_ROUNDING = 1e-9  # Tolerance of a time [slots] and of a sum of shares.

__all__ = ['Iteration', 'OBJECTIVES', 'Objective', 'POSITION_TOLERANCE', 'POWER_TOLERANCE',
           'Plan', 'STATUSES', 'STATUS_TEXTS', 'Status']

_WIDTH = Number(2.5, 100.0, 'inches')  # Allowed widths of a picture.


def _checked_gaps(values: Any) -> tuple[tuple[float, float], ...]:
    """Return gaps as tuples (begin, end) [s]; refuse unsorted times. Equal ones are allowed."""
    def check(value: Any) -> tuple[float, float]:
        if not is_sequence(value) or len(value) != 2:
            raise refuse(value, 'a begin and an end')
        begin, end = map(TIME, value)
        return begin, end

    if not is_sequence(values):
        raise refuse(values, 'a list of intervals')
    gaps: tuple[tuple[float, float], ...] = check_items(values, check)
    times = [time for gap in gaps for time in gap]
    if times != sorted(times):
        raise refuse(values, 'intervals of times that increase')
    return gaps


@dataclass(frozen=True, eq=False)
class Plan(RatedFlight):
    """
    A feasible flight and power plan of a scenario.

    :param scenario: the mission.
    :param positions: q_i[n], (U, N+2, 2) in m, start and goal included. Kept read-only.
    :param powers: p_i[n], (U, N) in W. Kept read-only.
    :param method: name of the method that made the plan.
    :param status: one of STATUSES.
    :param history: the iterations of the method.
    :param solve_time: time that the method took [s].
    :param start_ns: time of point 0 [ns] on the clock of the followers, or None if not set.
    :param objective: the objective that the method maximised.
    :param bound: a Bound of the scenario by upper_bound, or None.
    :param promised_until: time [s] from point 0 until which the receivers were predicted. The
        rates are promised until then; None promises the whole flight.
    :param gaps: intervals (begin, end) [s] from point 0, before promised_until, whose rates are
        not promised. A gap lies between the end of a promise and the effect of a replan.
    :param promise_delay: delay [s] after start_ns at which point 0 must be flown for the promise.
    :param promise_speed: playback speed at which the plan must be flown for the promise.
    :param bits: amount [bit/Hz] that shortest_duration was asked to deliver, or None.
    :param too_short: duration [s] in which provably no flight delivers `bits`, or None.
    :param shares: a_k[n], fraction of slot n for ground node k, (G, N). The default fractions
        give the largest rate of the objective. Kept read-only.
    :raises PlanError: for a plan that breaks a limit of the scenario, naming UAV, slot, value
        and limit; or for another field with a wrong value.
    """

    scenario: Scenario = field(metadata=checked_by(Instance(Scenario)))
    positions: Array
    powers: Array
    method: str = field(default='given', metadata=checked_by(checked_text))
    status: Status = field(default='given', metadata=checked_by(Choice(STATUSES)))
    history: tuple[Iteration, ...] = field(
        default=(), metadata=checked_by(Members(Iteration, 0, 10**6)))
    solve_time: float = field(default=0.0, metadata=checked_by(TIME))
    start_ns: int | None = None
    objective: Objective = field(default='guaranteed', metadata=checked_by(Choice(OBJECTIVES)))
    bound: Bound | None = None
    promised_until: float | None = field(default=None, metadata=checked_by(TIME))
    gaps: tuple[tuple[float, float], ...] = field(
        default=(), metadata=checked_by(_checked_gaps))
    promise_delay: float = field(default=0.0, metadata=checked_by(TIME))
    promise_speed: float = field(default=1.0, metadata=number(1e-9, 1e9))
    bits: float | None = field(default=None, metadata=number(0.0, 1e15, 'bit/Hz'))
    too_short: float | None = field(default=None, metadata=checked_by(TIME))
    shares: Array = LEFT_OUT

    _ERROR = PlanError

    def __post_init__(self) -> None:
        """Check and convert all fields, check limits and clearances, then complete `shares`."""
        super().__post_init__()
        count, slots = len(self.scenario.uavs), self.scenario.slots
        for name, shape in (('positions', (count, slots + 2, 2)), ('powers', (count, slots))):
            object.__setattr__(self, name, _checked_array(name, getattr(self, name), shape))
        # A power below zero but within the tolerance becomes 0.0, and -0.0 becomes 0.0 too.
        object.__setattr__(self, 'powers', read_only(np.where(
            self.powers < -POWER_TOLERANCE, self.powers, np.maximum(self.powers, 0.0) + 0.0)))
        if self.bound is not None and (
                not isinstance(self.bound, Bound) or self.bound.scenario != self.scenario):
            raise PlanError(f'bound is {quote(self.bound)}; it must be None or a Bound of the '
                            "plan's scenario", ('bound',))
        if not all(math.isfinite(iteration.rate) for iteration in self.history):
            raise PlanError('history has an infinite rate; rates must be finite', ('history',))
        if self.start_ns is not None:
            self._check_start(self.start_ns)
        self._check_ends()
        Problem(self.scenario).validate(self.positions, self.powers)
        self.clearance.validate()
        self._complete_shares()

    def _check_start(self, start_ns: object) -> None:
        """Raise a PlanError unless start_ns can be stamped; make it an int."""
        last = (_LAST_SECOND - math.ceil(self.times[-1])) * 10**9
        if (isinstance(start_ns, bool) or not isinstance(start_ns, (int, np.integer))
                or not 0 <= start_ns <= last):
            raise PlanError(f'start_ns is {quote(start_ns)}; it must be None or a whole number '
                            f'from 0 to {last}, so that ROS can stamp the whole flight',
                            ('start_ns',))
        object.__setattr__(self, 'start_ns', int(start_ns))

    def _complete_shares(self) -> None:
        """
        Check `shares`, the fraction of each slot for each ground node, (G, N).

        If `shares` is None, compute the fractions that give the largest rate of the objective.
        """
        nodes, slots = len(self.scenario.ground_nodes), self.scenario.slots
        if self.shares is None:
            # A single node gets all slots, whatever its rates are.
            rates = np.zeros((1, slots)) if nodes == 1 else self._find_node_rates(self.objective)
            object.__setattr__(self, 'shares', find_shares(self.scenario, rates))
        shares = _checked_array('shares', self.shares, (nodes, slots))
        if shares.min() < 0 or shares.sum(axis=0).max() > 1 + _ROUNDING:
            raise PlanError(f'shares is {quote(self.shares)}; they must be at least 0, and at '
                            'most 1 together in each slot', ('shares',))
        object.__setattr__(self, 'shares', shares)

    def _check_ends(self) -> None:
        """Raise a PlanError unless paths begin at starts, end at goals, to POSITION_TOLERANCE."""
        for uav, path in zip(self.scenario.uavs, self.positions, strict=True):
            for end, point in (('start', path[0]), ('goal', path[-1])):
                if np.abs(point - getattr(uav, end)).max() > POSITION_TOLERANCE:
                    raise PlanError(f'the {end} of {uav.name} is {tuple(point.tolist())}; '
                                    f'it must be {getattr(uav, end)}', ('positions',))

    def __repr__(self) -> str:
        origin = f'by {self.method}, {self.status}'
        if self.method == self.status == 'given':
            origin = STATUS_TEXTS['given']
        promise = self.promise
        return (f'<Plan: {self.scenario.channel.rate_name(self.objective)} '
                f'{rate_text(promise.rate)} bit/s/Hz {origin}; '
                f'{promise.text and promise.text + "; "}UAVs: {len(self.scenario.uavs)}, '
                f'slots: {self.scenario.slots}{self.claim and "; " + self.claim}>')

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, Plan):
            return NotImplemented
        return all(np.array_equal(left, right) if isinstance(left, np.ndarray) else left == right
                   for left, right in zip(_values(self), _values(other), strict=True))

    def __hash__(self) -> int:
        return hash((self.scenario, self.identity))

    def __getstate__(self) -> dict[str, Any]:
        return {name: value for name, value in self.__dict__.items()
                if name not in ('curve', 'clearance')}

    def __setstate__(self, state: dict[str, Any]) -> None:
        # A copy or a pickle makes arrays writable.
        for value in state.values():
            if isinstance(value, np.ndarray):
                value.setflags(write=False)
        self.__dict__.update(state)

    @property
    def message(self) -> str:
        """Text: why the method stopped, whether `bits` are delivered, who gets nothing and why."""
        text = STATUS_TEXTS[self.status]
        if self.bits is not None and self.rate * self.scenario.duration >= self.bits:
            text += f'; this suffices for {self.bits:g} bit/Hz'
            if self.too_short is not None:
                proven = math.floor(10 * self.too_short) / 10
                text += f', and no flight of {proven:.1f} s does, which is proven'
            text += self.promise.text and f'; {self.promise.text}'
        if self.powers[0].any() and self.rate >= LEAST_RATE:
            return text
        served = (self.node_rates + self.scenario.node_offsets
                  >= LEAST_RATE * self.scenario.node_weights)
        silent = [name for name, is_served in zip(
            self.scenario.ground_node_names, served, strict=True) if not is_served]
        nodes = f' to {" and ".join(silent)}' if self.powers[0].any() and served.any() else ''
        return (f'{text}; no slot carries anything in secret{nodes}; '
                f'{explain_zero_rate(self.scenario)}')

    @cached_property
    def identity(self) -> str:
        """Hash of start, positions, powers and several nodes' shares: 8 hexadecimal digits."""
        content = [str(self.start_ns).encode(), self.positions.tobytes(), self.powers.tobytes()]
        if len(self.shares) > 1:
            content.append(self.shares.tobytes())
        return blake2b(b' '.join(content), digest_size=4).hexdigest()

    @cached_property
    def clearance(self) -> Clearance:
        """Distances of the curve from zones, and of the UAVs from each other."""
        return Clearance(self.scenario, self.curve)

    @cached_property
    def energies(self) -> tuple[Energy | None, ...]:
        """Energy of the flight of each UAV, None for a UAV without a propulsion."""
        return compute_energies(self.scenario, self.curve)

    @property
    def claim(self) -> str:
        """Name of the bounded rate and its Bound.claim as text; empty without a bound."""
        if self.bound is None:
            return ''
        return (f'{self.scenario.channel.rate_name(self.bound.objective)} '
                f'{self.bound.claim(self)}')

    @property
    def promise(self) -> Promise:
        """Slots whose rates are promised, and the mean rates of these slots."""
        return Promise(self, self.promised_slots)

    @cached_property
    def promised_slots(self) -> Mask:
        """Whether the rate of each slot is promised, (N,)."""
        return find_promised_slots(self)

    def end_promise(self, time: float) -> 'Plan':
        """
        Return a copy of this plan whose promise ends before the slot that is flown at a time.

        While slot n is flown it ends at point n - 1, and before slot 1 at point 0. A plan whose
        promise has ended there or earlier is returned itself.

        :param time: time from point 0 [s].
        """
        step = self.scenario.slot_duration
        until = max(0.0, (math.floor(check_argument('time', time, TIME) / step + _ROUNDING) - 1)
                    * step)
        if self.promised_until is not None and self.promised_until <= until:
            return self
        plan = self._replace_and_keep_rates(promised_until=until)
        plan.__dict__.pop('promised_slots', None)
        return plan

    def _replace_and_keep_rates(self, **changes: Any) -> 'Plan':
        """
        Return a copy of this plan with other values in some fields.

        Rates and other properties that this plan has computed are not computed again for the copy.
        So no such property may depend on the changed fields, or the caller must delete it.
        """
        plan, names = replace(self, **changes), {field.name for field in fields(self)}
        plan.__dict__.update({name: value for name, value in self.__dict__.items()
                              if name not in names})
        return plan

    def with_bound(self, bound: Bound | None) -> 'Plan':
        """
        Return a copy of this plan with a bound, which is saved and shown with it.

        :param bound: a Bound of the plan's scenario by upper_bound, or None.
        :raises PlanError: for anything else, and for a bound below the plan's own rate.
        """
        plan = self._replace_and_keep_rates(bound=bound)
        check_bound(plan, bound)
        return plan

    def evaluate(self) -> 'Plan':
        """Evaluate the rates now, which the plan then keeps; return the plan itself."""
        for rates in ('guaranteed_rates', 'worst_case_rates'):
            getattr(self, rates)
        return self

    def plot(self, baselines: 'Sequence[Plan]' = (),
             axes: 'Axes | Sequence[Axes] | None' = None, title: bool = True,
             width: float | None = None) -> 'Figure':
        """
        Return a picture of the plan: a map, and powers and rates over time.

        `plan.plot(title=False, width=3.5)` is for a column of a paper.

        :param baselines: Plans for the same mission, which are drawn in grey.
        :param axes: Matplotlib Axes to draw into: one Axes for the map, or a sequence of one to
            three Axes for the map, the powers and the rates. None for a new figure.
        :param title: whether the map has the rates as its title.
        :param width: width of a new figure for a paper [inches], from 2.5 to 100. Its texts are in
            a serif font of 8 pt, it shows no energies, and it is at most 9 inches high. None for
            a large figure in the user's font.
        :return: a matplotlib Figure, which notebooks show and whose savefig writes it to a file.
        :raises MissingPackageError: when Matplotlib is not installed.
        """
        if not isinstance(baselines, Sequence):
            raise OptionError(f'baselines is {quote(baselines)}; it must be a sequence of Plans',
                              ('baselines',))
        for baseline in baselines:
            checked_kind('baselines', baseline, Plan)
        if width is not None:
            width = check_argument('width', width, _WIDTH)
        with name_missing_package():
            from ..output.picture import checked_axes, draw_plan
        return draw_plan(self, baselines, checked_axes(axes), title, width)

    def to_dataframe(self) -> 'DataFrame':
        """
        Return the flight as a table with the columns and rows of `plan.csv`.

        :return: a pandas DataFrame with a row for each point of each UAV: uav, point, time in s,
            x, y and z in m, velocity_x and velocity_y in m/s, power in W, and guaranteed_rate and
            worst_case_rate of the slot in bit/s/Hz; of each eavesdropper's disc at that time
            <name>.x, <name>.y and <name>.radius in m; of several ground nodes <name>.share.
        :raises MissingPackageError: when pandas is not installed.
        """
        with name_missing_package():
            return tables.to_dataframe(self)

    def save_mat(self, path: str | os.PathLike[str]) -> None:
        """
        Write the plan to a MAT file, for MATLAB and Octave.

        With P = N+2 points it has times (P, 1), positions (U, P, 2), altitudes (U, 1), powers
        (U, N), guaranteed_rates and worst_case_rates (N, 1), ground_node (P, 2), eavesdroppers
        (E, P, 2), error_radii (E, P), uav_names and eavesdropper_names, in SI units and bit/s/Hz.
        Several ground nodes have ground_nodes (G, P, 2) and shares (G, N) instead of ground_node.

        :raises OSError: when the file cannot be written; an old one is left unchanged.
        """
        tables.save_mat(self, path)

    def to_geojson(self, path: str | os.PathLike[str]) -> None:
        """
        Write a map: paths with times and powers, receivers at point 0, tracks, zones and fence.

        :param path: path of a GeoJSON file, for geojson.io, QGIS and Foxglove.
        :raises OptionError: for a plan whose scenario has no origin.
        :raises OSError: when the file cannot be written; an old one is left unchanged.
        """
        geojson.save_geojson(self, path)

    def save(self, path: str | os.PathLike[str], evaluate: bool = True) -> None:
        """
        Write the plan to a JSON file, atomically: a reader sees the old file or the new one.

        :param evaluate: whether to write the worst-case rate for other readers of the file, which
            takes seconds to evaluate for many slots.
        :raises OSError: when the file cannot be written; an old one is left unchanged.
        """
        file.write_plan(self, path, evaluate)

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> 'Plan':
        """
        Read a plan that save wrote, in this or an earlier version.

        Missing fields take their defaults, so that files of earlier versions load.

        :raises PlanFileError: when the file cannot be read or is too large, or is damaged, of
            another kind or of a newer version, or breaks its own scenario; it names the path.
        """
        plan, _ = file.read_plan(path, cls)
        return plan


def _values(plan: Plan) -> tuple[Any, ...]:
    return tuple(getattr(plan, field.name) for field in fields(plan))


def _checked_array(field: str, value: Any, shape: tuple[int, ...]) -> Array:
    """Return a read-only array of a shape with finite numbers, or raise a PlanError."""
    try:
        if np.ma.is_masked(value):
            raise ValueError('some are masked')
        if np.asarray(value).dtype.kind in 'bc':
            raise ValueError('they are truth values or complex')
        array = read_only(np.asarray(value) + 0.0)  # Without -0.0, whose bytes differ.
    except (TypeError, ValueError, OverflowError) as error:
        raise PlanError(
            f'{field} must be an array of numbers: {str(error)[:200]}', (field,)) from None
    if array.shape != shape or not np.isfinite(array).all():
        raise PlanError(
            f'{field} has the shape {array.shape} and '
            f'{np.count_nonzero(~np.isfinite(array))} values that are not finite; '
            f'it must be finite with the shape {shape}', (field,))
    return array
