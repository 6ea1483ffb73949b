"""The flight of a plan, and the limit of the speed at which the plan is played."""

from dataclasses import replace
import math
from typing import NamedTuple

import numpy as np

from .playback import Moment, Playback
from ..mission.scenario import Array

VELOCITY_JUMP = 1e-3
"""Change of velocity [m/s] that is allowed beyond the acceleration limit, for rounding."""

_BRAKING_STEP = 0.05  # Time step [s] of the integration of braking.
_STOP_STEPS = 200  # Largest number of time steps of a stop with constant acceleration.
_MOST_BRAKING_STEPS = 1000  # Time steps of an integration, which takes at most 10 ms.
_ROUNDING = 1e-8  # Tolerance of a time [s], because stamps are whole ns.


class Flight(NamedTuple):
    """
    The flight of a plan.

    :ivar time: present time of the plan [s], from point 0.
    :ivar time_scale: playback speed; 1 is real time, 0 is a hold.
    :ivar is_reported: whether the follower reports now. While it is silent, `time` stands still.
    """

    playback: Playback
    time: float
    time_scale: float
    is_reported: bool = True

    @property
    def state(self) -> str:
        """State: 'waiting' at the begin, 'ended' at the end, else 'held' (paused) or 'flying'."""
        if self.time >= self.playback.duration - _ROUNDING:
            return 'ended'
        if self.time <= self.playback.begin + _ROUNDING:
            return 'waiting'
        return 'flying' if self.time_scale > 0 else 'held'

    @property
    def is_under_way(self) -> bool:
        """Whether the flight has begun and not ended."""
        return self.state in ('flying', 'held')

    def lateness(self, now: float) -> float:
        """
        Return the delay of the flight behind the schedule of its promise [s].

        Receivers are predicted for the schedule time = (now - start - promise_delay) *
        promise_speed. The delay is negative for a flight that is early, and at least 0 before the
        flight begins. It is infinite for a plan without a start.

        :param now: time of the clock [s].
        """
        plan = self.playback.plan
        if plan.start_ns is None:
            return math.inf
        due = (now - plan.start_ns * 1e-9 - plan.promise_delay) * plan.promise_speed
        return max(0.0, due - self.time) if self.state == 'waiting' else due - self.time

    @property
    def moment(self) -> Moment:
        """
        Setpoints now: the plan's velocities times time_scale, its accelerations times its square.

        A held flight sends no power, because the plan's powers are chosen for receivers that
        move on.
        """
        moment = self.playback.at(self.time)
        return replace(moment, velocities=moment.velocities * self.time_scale,
                       accelerations=moment.accelerations * self.time_scale**2,
                       powers=moment.powers if self.time_scale else np.zeros_like(moment.powers))


class TimeScaleLimit:
    """Limits the playback speed so that no UAV exceeds its acceleration."""

    def __init__(self, playback: Playback) -> None:
        self.playback = playback
        self._limits = playback.plan.scenario.max_accelerations
        self._fastest = 0.0  # Playback speed at which the braking curve below begins.
        self._braking_times, self._braking_scales = np.empty(0), np.empty(0)

    def approach(self, target: float, flight: Flight, velocities: Array, elapsed: float) -> float:
        """
        Return the playback speed nearest to a target that keeps all acceleration limits.

        The target is first lowered to a playback speed from which the flight can stop at its end.
        Without acceleration limits it is returned as it is. If the target or the present playback
        speed r exceeds 1, the limits are r^2 times the UAVs' own.

        :param target: the wanted playback speed.
        :param flight: the flight at the last setpoint.
        :param velocities: velocities of the last setpoint, (U, 2) in m/s.
        :param elapsed: time since the last setpoint [s].
        """
        time, scale = flight.time, flight.time_scale
        if not self.playback.plan.scenario.limits_acceleration:
            return target
        target = self._brake_in_time(target, max(target, scale), time + scale * elapsed)
        most_change = self._limits * max(1.0, target, scale)**2 * elapsed * (1 + 1e-9) + 1e-9

        def is_allowed(scale: float) -> bool:
            new = self.playback.at(time + scale * elapsed).velocities * scale
            change = np.linalg.norm(new - velocities, axis=-1)
            return bool((change <= most_change).all())

        if is_allowed(target):
            return target
        # Bisection. An unchanged playback speed keeps the limits, since the plan keeps them.
        allowed, rejected = scale, target
        for _ in range(20):
            middle = (allowed + rejected) / 2
            allowed, rejected = (
                (middle, rejected) if is_allowed(middle) else (allowed, middle))
        return allowed

    def _brake_in_time(self, target: float, fastest: float, time: float) -> float:
        """
        Return a target playback speed, lowered so that the flight at `time` can stop at its end.

        :param fastest: largest playback speed that may occur; a larger one renews the curve.
        """
        if self._fastest < fastest:
            self._fastest = fastest
            self._braking_times, self._braking_scales = self._integrate_braking(fastest)
        if not len(self._braking_times):
            return target
        # Before the curve begins, its first playback speed holds.
        return min(target, float(np.interp(time, self._braking_times, self._braking_scales)))

    def _integrate_braking(self, fastest: float) -> tuple[Array, Array]:
        """
        Integrate the largest playback speeds from which the flight can stop at its goals.

        The integration runs backwards from the end, where the playback speed is 0, until it
        reaches the playback speed `fastest` or the begin, or for _MOST_BRAKING_STEPS.

        :return: increasing times [s] and playback speeds there; empty if all UAVs arrive at rest.
        """
        playback, limits = self.playback, self._limits
        speeds = np.linalg.norm(playback.at(playback.duration).velocities, axis=-1)
        if (speeds < VELOCITY_JUMP).all():
            return np.empty(0), np.empty(0)
        step = max(min(_BRAKING_STEP, playback.plan.scenario.slot_duration / 10),
                   float((speeds / limits).max()) / _STOP_STEPS)
        count = min(math.ceil((playback.duration - playback.begin) / step), _MOST_BRAKING_STEPS)
        times = playback.duration - step * np.arange(count + 1)
        motion = playback.curve.at(times)
        products = (motion.velocities * motion.accelerations).sum(axis=-1).T
        norms = (motion.velocities**2).sum(axis=-1).T + 1e-12
        bends = (motion.accelerations**2).sum(axis=-1).T
        # The square s^2 of the playback speed s falls at the rate d(s^2)/dt = -2 slowing.
        squares = [0.0]
        for product, norm, bend in zip(products[:-1], norms, bends):
            square = squares[-1]
            if square >= fastest**2:
                break
            # Playback speeds are interpolated linearly, which near rest doubles the slowing.
            allowed = limits * max(1.0, square) * (0.4 if square < 0.2 else 0.9)
            # The largest slowing d with |s^2 acceleration - d velocity| <= allowed for every UAV.
            root = (product * square)**2 - norm * (bend * square**2 - allowed**2)
            slowing = float(((product * square + np.sqrt(np.maximum(root, 0.0))) / norm).min())
            # A plan that takes over 0.9 of a limit leaves no slowing. Playback speed 1 is safe.
            squares.append(square + 2 * step * slowing if slowing > 0 else max(1.0, square))
        return times[:len(squares)][::-1], np.sqrt(squares[::-1])
