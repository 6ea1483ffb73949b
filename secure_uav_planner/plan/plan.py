"""What is answered: trajectories and powers, what they achieve, and how they were found."""

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property
from hashlib import blake2b
import math
import os
from typing import Any, TYPE_CHECKING

import numpy as np

from . import file
from .bound import Bound
from .iteration import Iteration, Status, STATUS_TEXTS, STATUSES
from ..errors import OptionError, PlanError, shown
from ..mission import Objective, OBJECTIVES
from ..mission.kinematics import shortened
from ..mission.scenario import Array, Point, POSITION_TOLERANCE, RANGES, read_only, Scenario, Uav
from ..mission.validation import checked_array, checked_kind
from ..mission.views import view
from ..model import channel
from ..model.clearance import Clearance
from ..model.curve import Curve, mean_guaranteed_rates
from ..model.energy import energies, Energy
from ..model.limits import limits_of
from ..model.limits.power import TOLERANCE as POWER_TOLERANCE

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from pandas import DataFrame

_LAST_SECOND = 2**31 - 1  # The last that a builtin_interfaces/Time can hold.

__all__ = ['Iteration', 'OBJECTIVES', 'Objective', 'POSITION_TOLERANCE', 'POWER_TOLERANCE',
           'Plan', 'STATUSES', 'STATUS_TEXTS', 'Status']


@dataclass(frozen=True, eq=False)
class Plan:
    """
    A feasible flight and power plan of a scenario.

    :param scenario: what the plan is for.
    :param positions: q_i[n], (U, N+2, 2) in m, start and goal included. Kept read-only.
    :param powers: p_i[n], (U, N) in W. Kept read-only.
    :param method: what made the plan.
    :param status: one of STATUSES.
    :param history: the iterations of the method.
    :param solve_time: in s.
    :param start_ns: time of point 0 in ns on the clock of those who fly it, or None before a
        time has been set.
    :param objective: what the method maximised.
    :param bound: a Bound of the scenario by upper_bound, or None.
    :raises PlanError: for a plan that breaks a limit of the scenario, naming UAV, slot, value
        and limit; or for another field with a wrong value.
    """

    scenario: Scenario
    positions: Array
    powers: Array
    method: str = 'given'
    status: Status = 'given'
    history: tuple[Iteration, ...] = ()
    solve_time: float = 0.0
    start_ns: int | None = None
    objective: Objective = 'guaranteed'
    bound: Bound | None = None

    def __post_init__(self) -> None:
        self._check_kinds()
        count, slots = len(self.scenario.uavs), self.scenario.slots
        for field, shape in (('positions', (count, slots + 2, 2)), ('powers', (count, slots))):
            object.__setattr__(self, field, _checked_array(field, getattr(self, field), shape))
        for name, value, allowed in (('status', self.status, STATUSES),
                                     ('objective', self.objective, OBJECTIVES)):
            if value not in allowed:
                raise PlanError(f'{name} is {shown(value)}; it must be one of {allowed}', (name,))
        if self.bound is not None and (
                not isinstance(self.bound, Bound) or self.bound.scenario != self.scenario):
            raise PlanError(f'bound is {shown(self.bound)}; it must be None or a Bound of the '
                            "plan's scenario", ('bound',))
        if self.start_ns is not None:
            self._check_start(self.start_ns)
        self._check_ends()
        for limit in limits_of(self.scenario):
            limit.check(self.positions, self.powers)
        self.clearance.check()

    def _check_kinds(self) -> None:
        if not isinstance(self.scenario, Scenario):
            raise PlanError(f'scenario is {shown(self.scenario)}; it must be a Scenario',
                            ('scenario',))
        if not isinstance(self.method, str):
            raise PlanError(f'method is {shown(self.method)}; it must be a string', ('method',))
        if not isinstance(self.history, (tuple, list)) or not all(
                isinstance(one, Iteration) for one in self.history):
            raise PlanError(f'history is {shown(self.history)}; it must be a tuple of Iterations',
                            ('history',))
        object.__setattr__(self, 'history', tuple(self.history))
        if (isinstance(self.solve_time, bool)
                or not isinstance(self.solve_time, (int, float, np.integer))
                or not abs(self.solve_time) < 1e300):
            raise PlanError(f'solve_time is {shown(self.solve_time)}; it must be a finite number '
                            'in s', ('solve_time',))

    def _check_start(self, start_ns: object) -> None:
        last = (_LAST_SECOND - math.ceil(self.times[-1])) * 10**9
        if (isinstance(start_ns, bool) or not isinstance(start_ns, (int, np.integer))
                or not 0 <= start_ns <= last):
            raise PlanError(f'start_ns is {shown(start_ns)}; it must be None or a whole number '
                            f'from 0 to {last}, so that ROS can stamp the whole flight',
                            ('start_ns',))
        object.__setattr__(self, 'start_ns', int(start_ns))

    def _check_ends(self) -> None:
        for uav, path in zip(self.scenario.uavs, self.positions, strict=True):
            for field, point in (('start', path[0]), ('goal', path[-1])):
                if np.abs(point - getattr(uav, field)).max() > POSITION_TOLERANCE:
                    raise PlanError(f'the {field} of {uav.name} is {tuple(point.tolist())}; '
                                    f'it must be {getattr(uav, field)}', ('positions',))

    def __repr__(self) -> str:
        return (f'<Plan: {self.scenario.channel.rate_name(self.objective)} {self.rate:.4f} '
                f'bit/s/Hz by {self.method}, {self.status}; UAVs: {len(self.scenario.uavs)}, '
                f'slots: {self.scenario.slots}{self.claim and "; " + self.claim}>')

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, Plan):
            return NotImplemented
        return all(np.array_equal(mine, yours) if isinstance(mine, np.ndarray) else mine == yours
                   for mine, yours in zip(_values(self), _values(other), strict=True))

    def __hash__(self) -> int:
        return hash((self.scenario, self.identity))

    def __getstate__(self) -> dict[str, Any]:
        return {name: value for name, value in self.__dict__.items()
                if name not in ('curve', 'clearance')}

    def __setstate__(self, state: dict[str, Any]) -> None:
        # Arrays come back from a copy or a pickle writable.
        for value in state.values():
            if isinstance(value, np.ndarray):
                value.setflags(write=False)
        self.__dict__.update(state)

    @property
    def message(self) -> str:
        """Why the method stopped, in words."""
        return STATUS_TEXTS[self.status]

    @cached_property
    def identity(self) -> str:
        """Identity of the plan: 8 digits made of its time, positions and powers."""
        content = (str(self.start_ns).encode(), self.positions.tobytes(), self.powers.tobytes())
        return blake2b(b' '.join(content), digest_size=4).hexdigest()

    @property
    def times(self) -> Array:
        """Time of every point from the start, (N+2,) in s."""
        return np.arange(self.scenario.slots + 2.0) * self.scenario.slot_duration

    @cached_property
    def guaranteed_rates(self) -> Array:
        """Guaranteed rate [R-bar]^+ of every slot, (N,) in bit/s/Hz; see channel."""
        return _secret(channel.guaranteed_rates(self.scenario, self.positions, self.powers))

    @cached_property
    def worst_case_rates(self) -> Array:
        """Worst-case rate R of every slot, equation (6), (N,) in bit/s/Hz; see channel."""
        return _secret(channel.worst_case_rates(self.scenario, self.positions, self.powers))

    @cached_property
    def curve(self) -> Curve:
        """Flight as a function of time."""
        return Curve(self.scenario, self.positions)

    @cached_property
    def clearance(self) -> Clearance:
        """How close the curve comes to zones and UAVs to each other."""
        return Clearance(self.scenario, self.curve)

    @cached_property
    def curve_rates(self) -> Array:
        """
        Guaranteed rates along the curve, as means over each slot, (N,) in bit/s/Hz.

        They differ from guaranteed_rates, which are those at the points, by the discretisation.
        """
        return _secret(mean_guaranteed_rates(self.scenario, self.curve, self.powers))

    @cached_property
    def energies(self) -> tuple[Energy | None, ...]:
        """Energy that the flight of each UAV takes, None for one without a propulsion."""
        return energies(self.scenario, self.curve)

    @property
    def curve_rate(self) -> float:
        """Mean of curve_rates in bit/s/Hz: what is delivered per second on average."""
        return float(self.curve_rates.mean())

    @property
    def guaranteed_rate(self) -> float:
        """Mean of guaranteed_rates, the objective of (P2) with [x]^+, in bit/s/Hz."""
        return float(self.guaranteed_rates.mean())

    @property
    def worst_case_rate(self) -> float:
        """Mean of worst_case_rates, the objective of problem (P1), in bit/s/Hz."""
        return float(self.worst_case_rates.mean())

    @property
    def rate(self) -> float:
        """Mean of the rates that were to be maximised, in bit/s/Hz."""
        return self.guaranteed_rate if self.objective == 'guaranteed' else self.worst_case_rate

    @property
    def claim(self) -> str:
        """Return in words what the bound proves of the rate, or nothing without a bound."""
        if self.bound is None:
            return ''
        return (f'{self.scenario.channel.rate_name(self.bound.objective)} '
                f'{self.bound.claim(self)}')

    def with_bound(self, bound: Bound | None) -> 'Plan':
        """
        Return this plan with a bound, which is saved and shown with it.

        :param bound: a Bound of the plan's scenario by upper_bound, or None.
        :raises PlanError: for anything else.
        """
        plan = replace(self, bound=bound)
        # Rates that have been evaluated are kept.
        plan.__dict__.update({name: value for name, value in self.__dict__.items()
                              if name in ('guaranteed_rates', 'worst_case_rates')})
        return plan

    def evaluated(self) -> 'Plan':
        """Return this plan after its rates have been evaluated, which it then keeps."""
        for rates in ('guaranteed_rates', 'worst_case_rates'):
            getattr(self, rates)
        return self

    def tail(self, point: int) -> 'Plan':
        """
        Return the rest of the plan from a point, as the plan of what is left of the mission.

        Its powers may use what the slots before have left of the average. A UAV with a limit of
        acceleration keeps the velocity it has.

        :param point: where to start, from 0 to slots - 1.
        :raises OptionError: for another point.
        """
        self._check_point(point)
        slots = self.scenario.slots - point
        left = self.scenario.slots * self.scenario.average_powers - (
            self.powers[:, :point].sum(axis=1))
        step = self.scenario.slot_duration
        uavs = tuple(
            replace(uav, start=tuple(path[point].tolist()),
                    start_velocity=_velocity(uav, path, point, step), average_power=min(
                        uav.peak_power, max(energy / slots, RANGES['average_power'][0])))
            for uav, path, energy in zip(
                self.scenario.uavs, self.positions, left.tolist(), strict=True))
        return replace(
            self, scenario=replace(self.scenario, uavs=uavs, slots=slots, duration=slots * step),
            positions=self.positions[:, point:], powers=self.powers[:, point:], history=(),
            bound=None,
            start_ns=(None if self.start_ns is None else
                      self.start_ns + round(point * step * 1e9)))

    def continued(self, point: int, tail: 'Plan',
                  beginning: tuple[Array, Array] | None = None) -> 'Plan':
        """
        Return this plan up to a point and another one of what was left from there.

        :param point: where the other begins, as given to tail.
        :param tail: a Plan for what tail(point) leaves, perhaps against other eavesdroppers.
        :param beginning: positions and powers up to the point, where they are not this plan's.
        :return: a Plan of the whole mission against those.
        """
        self._check_point(point)
        checked_kind('tail', tail, Plan)
        positions, powers = self.positions, self.powers
        if beginning is not None:
            positions, powers = (
                checked_array('beginning', one, (len(powers), None, *rest))
                for one, rest in zip(checked_kind('beginning', beginning, tuple), ((2,), ())))
        return replace(
            tail, scenario=replace(self.scenario, ground_node=tail.scenario.ground_node,
                                   eavesdroppers=tail.scenario.eavesdroppers),
            positions=np.concatenate([positions[:, :point], tail.positions], axis=1),
            powers=np.concatenate([powers[:, :point], tail.powers], axis=1),
            start_ns=self.start_ns, bound=None)

    def _check_point(self, point: int) -> None:
        if (isinstance(point, bool) or not isinstance(point, (int, np.integer))
                or not 0 <= point < self.scenario.slots):
            raise OptionError(f'point is {shown(point)}; it must be a whole number from 0 to '
                              f'{self.scenario.slots - 1}', ('point',))

    def plot(self, baselines: 'Sequence[Plan]' = ()) -> 'Figure':
        """
        Return a picture of the plan: a map, and powers and rates over time.

        :param baselines: Plans for the same mission, which are drawn in grey.
        :return: a matplotlib Figure, which notebooks show and whose savefig writes it to a file.
        :raises MissingPackageError: when Matplotlib is not installed.
        """
        if not isinstance(baselines, Sequence):
            raise OptionError(f'baselines is {shown(baselines)}; it must be a sequence of Plans',
                              ('baselines',))
        for one in baselines:
            checked_kind('baselines', one, Plan)
        return view('plot_plan', self, baselines)

    def to_dataframe(self) -> 'DataFrame':
        """
        Return the flight as a table with the columns and rows of `plan.csv`.

        :return: a pandas DataFrame with a row for every point of every UAV: uav, point, time in
            s, x, y and z in m, velocity_x and velocity_y in m/s, and power in W.
        :raises MissingPackageError: when pandas is not installed.
        """
        return view('plan_to_dataframe', self)

    def save_mcap(self, path: str | os.PathLike[str]) -> None:
        """
        Write the messages of a flight of the plan to an MCAP file, for Foxglove and `ros2 bag`.

        :raises MissingPackageError: when ROS's Python packages or mcap are not installed.
        :raises OSError: when the file cannot be written; an old one is left as it was.
        """
        view('save_mcap', self, path)

    def save(self, path: str | os.PathLike[str], evaluate: bool = True) -> None:
        """
        Write the plan to a JSON file, atomically: a reader sees the old file or the new one.

        :param evaluate: whether to write the worst-case rate, too, which for many slots takes
            seconds to evaluate; it is for readers of the file, and load does not need it.
        :raises OSError: when the file cannot be written; an old one is left as it was.
        """
        file.write_plan(self, path, evaluate)

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> 'Plan':
        """
        Return the plan that save wrote, in this or an earlier version.

        Fields that are missing take their defaults, so that files of earlier versions load.

        :raises PlanFileError: when the file cannot be read or is too large, or is damaged, of
            another kind or of a newer version, or breaks its own scenario; it names the path.
        """
        return file.read_plan(path, cls)


def _values(plan: Plan) -> tuple[Any, ...]:
    return tuple(getattr(plan, field.name) for field in fields(plan))


def _secret(rates: Array) -> Array:
    """Return [x]^+ of rates: in a slot that would lose nothing secret need be sent."""
    return read_only(np.maximum(rates, 0.0))


def _checked_array(field: str, value: Any, shape: tuple[int, ...]) -> Array:
    try:
        array = read_only(value)
    except (TypeError, ValueError, OverflowError) as error:
        raise PlanError(
            f'{field} must be an array of numbers: {str(error)[:200]}', (field,)) from None
    if array.shape != shape or not np.isfinite(array).all():
        raise PlanError(
            f'{field} has the shape {array.shape} and '
            f'{np.count_nonzero(~np.isfinite(array))} values that are not finite; '
            f'it must be finite with the shape {shape}', (field,))
    return array


def _velocity(uav: Uav, path: Array, point: int, step: float) -> Point | None:
    """Return the velocity with which a UAV comes to a point of its path, (N+2, 2), in m/s."""
    if point == 0:
        return uav.start_velocity
    x, y = ((path[point] - path[point - 1]) / step).tolist()
    # A plan may exceed the speed by its tolerance.
    return shortened(x, y, uav.max_speed)
