"""A plan in continuous time: the motion and powers of the UAVs, and the secrecy rate."""

from dataclasses import dataclass
import math

import numpy as np
from numpy.typing import ArrayLike

from .plan import Plan
from ..mission.fields import check_argument, checked_truth, TIME
from ..mission.scenario import Array
from ..mission.validation import checked_array, checked_kind
from ..model import channel


@dataclass(frozen=True)
class Moment:
    """
    The state of all UAVs at a moment of a flight.

    :param positions: (U, 2) in m.
    :param velocities: (U, 2) in m/s.
    :param headings: (U,) in rad, counter-clockwise from x.
    :param powers: powers of the present slot, (U,) in W; zero outside the slots.
    :param accelerations: (U, 2) in m/s^2, zero for UAVs without a limit of acceleration.
    :param shares: fraction of the present slot for each ground node, (G,).
    """

    positions: Array
    velocities: Array
    headings: Array
    powers: Array
    accelerations: Array
    shares: Array


class Playback:
    """
    A plan as a function of time, along the flown curve.

    :param plan: a Plan.
    :param mutes_unpromised: whether all powers are 0 in slots that are not promised.
    :ivar begin: time in s from point 0 at which the UAVs leave their starts: 0, or half a slot
        earlier with a limit of acceleration.
    :ivar duration: time in s from point 0 at which the UAVs reach their goals.
    """

    def __init__(self, plan: Plan, mutes_unpromised: bool = False) -> None:
        self.plan = checked_kind('plan', plan, Plan)
        is_muted = check_argument('mutes_unpromised', mutes_unpromised, checked_truth)
        self._powers = plan.powers * plan.promised_slots if is_muted else plan.powers
        self.curve = plan.curve
        self.begin, self.duration = self.curve.begin, self.curve.end

    @property
    def begin_ns(self) -> int | None:
        """Time of `begin` in ns on the clock of the plan's start, or None without a start."""
        start_ns = self.plan.start_ns
        return None if start_ns is None else start_ns + round(self.begin * 1e9)

    def at(self, time: float) -> Moment:
        """
        Return the Moment at a time [s] from point 0; before and after the flight the UAVs rest.

        Power n holds from the time of point n until the time of point n + 1. Powers before point
        1 and from point N + 1 on are 0.
        """
        time = check_argument('time', time, TIME)
        motion = self.curve.at([time])
        return Moment(motion.positions[:, 0], motion.velocities[:, 0], motion.headings[:, 0],
                      self._powers_at(np.array([time]))[:, 0], motion.accelerations[:, 0],
                      self.shares_at([time])[:, 0])

    def find_slot(self, time: float) -> int:
        """Return the number, 1 to N, of the slot at a time [s], 0 if it is in none."""
        time = check_argument('time', time, TIME)
        slot = math.floor(time / self.plan.scenario.slot_duration + 1e-9)
        return slot if 1 <= slot <= self.plan.scenario.slots else 0

    def shares_at(self, times: ArrayLike) -> Array:
        """
        Return the fraction of the slot for each ground node at times (K,) in s, (G, K).

        Slot n lasts from the time of point n to point n + 1. Other times take the nearest slot.
        """
        times = checked_array('times', times, (None,))
        slots = np.floor(times / self.plan.scenario.slot_duration + 1e-9).astype(int)
        return np.asarray(
            self.plan.shares[:, np.clip(slots - 1, 0, self.plan.scenario.slots - 1)])

    def _powers_at(self, times: Array) -> Array:
        """Return the powers at times (K,) in s, (U, K) in W; zero outside the slots."""
        slots = np.floor(times / self.plan.scenario.slot_duration + 1e-9)
        padded = np.pad(self._powers, ((0, 0), (1, 1)))
        return padded[:, np.clip(slots, 0, self.plan.scenario.slots + 1).astype(int)]

    @property
    def guaranteed_rates(self) -> Array:
        """Guaranteed rates in continuous time, (N,) in bit/s/Hz; see Plan.curve_rates."""
        return self.plan.curve_rates

    def secrecy_rate(self, time: float, eavesdropper: ArrayLike | None = None) -> float:
        """
        Return the secrecy rate [r_0 - r_e]^+ at a time, summed over the ground nodes [bit/s/Hz].

        The rate of each ground node, at its place at that time, is weighted with its fraction of
        the slot. The rate is exact for an eavesdropper at the given place. It bounds nothing for
        other places; see guaranteed_rates.

        :param time: time from point 0 [s].
        :param eavesdropper: true position of the eavesdropper, (2,) in m. None for no
            eavesdropper: then only ground nodes that are not trusted listen.
        """
        return float(self.secrecy_rates([check_argument('time', time, TIME)], eavesdropper)[0])

    def secrecy_rates(self, times: ArrayLike, eavesdropper: ArrayLike | None = None) -> Array:
        """Return the secrecy rates at times (K,) in s, (K,) in bit/s/Hz; see secrecy_rate."""
        times = checked_array('times', times, (None,))
        # The rates ignore the first and the last point, which are padding here.
        points = np.pad(self.curve.at(times).positions, ((0, 0), (1, 1), (0, 0)))
        scenario, powers = self.plan.scenario, self._powers_at(times)
        rates = (channel.find_node_rates(scenario, points, powers, np.zeros(len(times)), times)
                 if eavesdropper is None else channel.secrecy_node_rates(
                     scenario, points, powers, eavesdropper, times=times))
        together: Array = (self.shares_at(times) * np.maximum(0.0, rates)).sum(axis=0)
        return together
