"""The course that a flight was to fly: the plan in force at each time."""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...mission.scenario import Array
from ...model.curve import Motion
from ...plan.plan import Plan


class Course(NamedTuple):
    """
    Plans of one flight, each in force until the next one.

    :ivar plans: plans with the same point 0 and the same slots.
    :ivar begins: time in s from point 0 at which each plan came into force; the first is -inf.
    """

    plans: tuple[Plan, ...]
    begins: tuple[float, ...] = (-np.inf,)

    @property
    def last(self) -> Plan:
        """Plan in force at the end."""
        return self.plans[-1]

    @property
    def begin(self) -> float:
        """Time in s from point 0 at which the first UAV leaves its start."""
        return self.last.curve.begin

    @property
    def end(self) -> float:
        """Time in s from point 0 at which the last UAV reaches its goal."""
        return self.last.curve.end

    def at(self, times: Array) -> Motion:
        """Return the Motion of the plan in force at each of times (K,) in s from point 0."""
        numbers = self._find_numbers(times)
        parts = [np.where(numbers == number)[0] for number in range(len(self.plans))]
        pieces = [plan.curve.at(times[part])
                  for plan, part in zip(self.plans, parts, strict=True)]
        order = np.argsort(np.concatenate(parts), kind='stable')
        return Motion(*(np.concatenate(arrays, axis=1)[:, order]
                        for arrays in zip(*pieces, strict=True)))

    def split_slots(self) -> Iterator[tuple[Plan, NDArray[np.intp]]]:
        """Yield each plan with the indices of the slots in whose middle it is in force."""
        scenario = self.last.scenario
        numbers = self._find_numbers(scenario.times[1:-1] + scenario.slot_duration / 2)
        for number, plan in enumerate(self.plans):
            yield plan, np.flatnonzero(numbers == number)

    def _find_numbers(self, times: Array) -> NDArray[np.intp]:
        """Return the index in `plans` of the plan in force at times (K,) in s from point 0."""
        return np.searchsorted(self.begins, times, 'right') - 1
