"""What is answered: trajectories and powers, what they achieve, and how they were found."""

from dataclasses import asdict, dataclass, fields, replace
from functools import cached_property
import json
from pathlib import Path

import numpy as np

from . import channel
from .files import atomic_file
from .scenario import LIMITS, Scenario

POSITION_TOLERANCE = 1e-6
"""How far in m a plan may exceed the largest step or miss its ends."""

POWER_TOLERANCE = 1e-9
"""How far in W a plan may exceed a limit of power."""

STATUSES = ('converged', 'iteration_limit', 'time_limit', 'cancelled', 'numerical_trouble')
"""
Why a method stopped; the plan is feasible whatever the reason.

`numerical_trouble` says that a convex subproblem or a Newton step could not be solved, so the
best iterate before it was kept.
"""

_FORMAT = {'format': 'secure_uav_planner/plan', 'version': 1}


@dataclass(frozen=True)
class Iteration:
    """
    One iteration of a method, for callbacks and Plan.history.

    :param number: counts from 1; 0 is the starting point.
    :param step: what was optimised: 'start', 'power', 'trajectory' or 'joint'.
    :param guaranteed_rate: of the best feasible plan so far, mean over slots, bit/s/Hz.
    :param elapsed: since the call of solve, in s.
    :param solver_time: of `elapsed`, spent so far inside Clarabel, or for 'joint' on solving for
        Newton steps, in s.
    """

    number: int
    step: str
    guaranteed_rate: float
    elapsed: float
    solver_time: float


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
    :raises ValueError: for a plan that breaks a limit of the scenario, naming UAV, slot, value
        and limit.
    """

    scenario: Scenario
    positions: np.ndarray
    powers: np.ndarray
    method: str = 'given'
    status: str = 'converged'
    history: tuple[Iteration, ...] = ()
    solve_time: float = 0.0
    start_ns: int | None = None

    def __post_init__(self):
        count, slots = len(self.scenario.uavs), self.scenario.slots
        for field, shape in (('positions', (count, slots + 2, 2)), ('powers', (count, slots))):
            try:
                array = np.array(getattr(self, field), dtype=float)
            except (TypeError, ValueError) as error:
                raise ValueError(f'{field} must be an array of numbers: {error}') from None
            if array.shape != shape or not np.isfinite(array).all():
                raise ValueError(
                    f'{field} has the shape {array.shape} and '
                    f'{np.count_nonzero(~np.isfinite(array))} values that are not finite; '
                    f'it must be finite with the shape {shape}')
            array.setflags(write=False)
            object.__setattr__(self, field, array)
        if self.status not in STATUSES:
            raise ValueError(f'status is {self.status!r}; it must be one of {STATUSES}')
        object.__setattr__(self, 'history', tuple(self.history))
        self._check_feasible()

    def _check_feasible(self):
        steps = np.linalg.norm(np.diff(self.positions, axis=1), axis=-1)
        for uav, path, length, limit, power in zip(
                self.scenario.uavs, self.positions, steps, self.scenario.max_step, self.powers):
            for field, point in (('start', path[0]), ('goal', path[-1])):
                if np.abs(point - getattr(uav, field)).max() > POSITION_TOLERANCE:
                    raise ValueError(f'the {field} of {uav.name} is {tuple(point.tolist())}; '
                                     f'it must be {getattr(uav, field)}')
            if length.max() > limit + POSITION_TOLERANCE:
                raise ValueError(f'{uav.name} moves {length.max():.9g} m after point '
                                 f'{length.argmax()}; at most {limit:.9g} m are allowed')
            if power.min() < -POWER_TOLERANCE:
                raise ValueError(f'the power of {uav.name} is {power.min():.9g} W in slot '
                                 f'{power.argmin() + 1}; it must not be negative')
            if power.max() > uav.peak_power + POWER_TOLERANCE:
                raise ValueError(f'the power of {uav.name} is {power.max():.9g} W in slot '
                                 f'{power.argmax() + 1}; at most {uav.peak_power:g} W are allowed')
            if power.mean() > uav.average_power + POWER_TOLERANCE:
                raise ValueError(f'the average power of {uav.name} is {power.mean():.9g} W; '
                                 f'at most {uav.average_power:g} W are allowed')

    @property
    def times(self):
        """Time of every point from the start, (N+2,) in s."""
        return np.arange(self.scenario.slots + 2) * self.scenario.slot_duration

    @cached_property
    def guaranteed_rates(self):
        """Guaranteed rate R-bar of every slot, (N,) in bit/s/Hz; see channel."""
        return channel.guaranteed_rates(self.scenario, self.positions, self.powers)

    @cached_property
    def worst_case_rates(self):
        """Worst-case rate R of every slot, (N,) in bit/s/Hz; see channel."""
        return channel.worst_case_rates(self.scenario, self.positions, self.powers)

    @property
    def guaranteed_rate(self):
        """Mean of guaranteed_rates, the objective of problem (P2), in bit/s/Hz."""
        return float(self.guaranteed_rates.mean())

    @property
    def worst_case_rate(self):
        """Mean of worst_case_rates, the objective of problem (P1), in bit/s/Hz."""
        return float(self.worst_case_rates.mean())

    def tail(self, point):
        """
        Return the rest of the plan from a point, as the plan of what is left of the mission.

        Its powers may use what the slots before have left of the average.

        :param point: where to start, from 0 to slots - 1.
        :raises ValueError: for another point.
        """
        if not 0 <= point < self.scenario.slots:
            raise ValueError(f'point is {point!r}; it must be from 0 to {self.scenario.slots - 1}')
        slots = self.scenario.slots - point
        left = [self.scenario.slots * uav.average_power - power[:point].sum()
                for uav, power in zip(self.scenario.uavs, self.powers)]
        uavs = tuple(
            replace(uav, start=tuple(path[point].tolist()), average_power=min(
                uav.peak_power, max(energy / slots, LIMITS['average_power'][0])))
            for uav, path, energy in zip(self.scenario.uavs, self.positions, left))
        step = self.scenario.slot_duration
        return replace(
            self, scenario=replace(self.scenario, uavs=uavs, slots=slots, duration=slots * step),
            positions=self.positions[:, point:], powers=self.powers[:, point:], history=(),
            start_ns=(None if self.start_ns is None else
                      self.start_ns + round(point * step * 1e9)))

    def continued(self, point, tail):
        """
        Return this plan up to a point and another one of what was left from there.

        :param point: where the other begins, as given to tail.
        :param tail: a Plan for what tail(point) leaves, perhaps against other eavesdroppers.
        :return: a Plan of the whole mission against those.
        """
        return replace(
            tail, scenario=replace(self.scenario, ground_node=tail.scenario.ground_node,
                                   eavesdroppers=tail.scenario.eavesdroppers),
            positions=np.concatenate([self.positions[:, :point], tail.positions], axis=1),
            powers=np.concatenate([self.powers[:, :point], tail.powers], axis=1),
            start_ns=self.start_ns)

    def save(self, path):
        """
        Write the plan to a JSON file, atomically: a reader sees the old file or the new one.

        :raises OSError: when the file cannot be written; an old one is left as it was.
        """
        document = {
            **_FORMAT,
            'scenario': self.scenario.to_dict(),
            'positions': self.positions.tolist(),
            'powers': self.powers.tolist(),
            'method': self.method,
            'status': self.status,
            'history': [asdict(iteration) for iteration in self.history],
            'solve_time': self.solve_time,
            'start_ns': self.start_ns,
            # For readers of the file; load computes them anew.
            'guaranteed_rate': self.guaranteed_rate,
            'worst_case_rate': self.worst_case_rate,
        }
        with atomic_file(path) as file:
            json.dump(document, file, allow_nan=False)

    @classmethod
    def load(cls, path):
        """
        Return the plan that save wrote.

        :raises OSError: when the file cannot be read.
        :raises ValueError: when it is damaged, of another kind, or breaks its own scenario.
        """
        try:
            document = json.loads(Path(path).read_text(encoding='utf-8'))
            if not isinstance(document, dict) or any(
                    document.get(key) != value for key, value in _FORMAT.items()):
                raise ValueError(f'it is not a {_FORMAT["format"]} of version 1')
            return cls(
                scenario=Scenario.from_dict(document['scenario']),
                positions=document['positions'], powers=document['powers'],
                method=str(document['method']), status=document['status'],
                history=tuple(_iteration(entry) for entry in document['history']),
                solve_time=float(document['solve_time']),
                start_ns=None if document['start_ns'] is None else int(document['start_ns']))
        except KeyError as error:
            raise ValueError(f'{path} is not a plan: {error} is missing') from None
        except (TypeError, ValueError, RecursionError) as error:
            raise ValueError(f'{path} is not a plan: {error}') from None


def _iteration(entry):
    if not isinstance(entry, dict) or set(entry) != {field.name for field in fields(Iteration)}:
        raise ValueError(f'history has the entry {entry!r}')
    return Iteration(**entry)
