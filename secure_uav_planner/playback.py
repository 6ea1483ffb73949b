"""A plan in continuous time: where the UAVs are between its points, and what is delivered."""

from dataclasses import dataclass
import math

import numpy as np
from numpy.typing import ArrayLike

from . import channel
from .curve import GAUSS_LEGENDRE
from .errors import OptionError
from .plan import Plan
from .scenario import Array


@dataclass(frozen=True)
class Moment:
    """
    One moment of a flight.

    :param positions: (U, 2) in m.
    :param velocities: (U, 2) in m/s.
    :param headings: (U,) in rad, counter-clockwise from x.
    :param powers: (U,) in W, those of the slot; zero outside the slots.
    :param accelerations: (U, 2) in m/s^2, zero for UAVs without a limit of acceleration.
    """

    positions: Array
    velocities: Array
    headings: Array
    powers: Array
    accelerations: Array


class Playback:
    """
    A plan as a function of time, along the curve that is flown.

    :param plan: a Plan.
    :ivar begin: when the first UAV leaves its start, in s from point 0: 0, or half a slot
        earlier where a UAV has a limit of acceleration.
    :ivar duration: when the last UAV reaches its goal, likewise.
    """

    def __init__(self, plan: Plan) -> None:
        self.plan = plan
        self.curve = plan.curve
        self.begin, self.duration = self.curve.begin, self.curve.end

    def at(self, time: float) -> Moment:
        """
        Return the Moment at a time from point 0 in s; before and after the flight the UAVs rest.

        Power n holds from the time of point n to that of point n + 1.
        """
        motion = self.curve.at([time])
        slots = self.plan.scenario.slots
        slot = math.floor(time / self.plan.scenario.slot_duration + 1e-9)
        powers = (self.plan.powers[:, slot - 1] if 1 <= slot <= slots
                  else np.zeros(len(self.plan.powers)))
        return Moment(motion.positions[:, 0], motion.velocities[:, 0], motion.headings[:, 0],
                      powers, motion.accelerations[:, 0])

    @property
    def guaranteed_rates(self) -> Array:
        """Guaranteed rates in continuous time, (N,) in bit/s/Hz; see Plan.curve_rates."""
        return self.plan.curve_rates

    def secrecy_rate(self, moment: Moment, eavesdropper: ArrayLike | None = None) -> float:
        """
        Return the secrecy rate [r_0 - r_e]^+ of a moment in bit/s/Hz.

        :param eavesdropper: where it really is, (2,) in m, or None to leave it out.
        """
        positions = np.repeat(moment.positions[:, None], 3, axis=1)
        powers = moment.powers[:, None]
        if eavesdropper is None:
            return float(channel.ground_rates(self.plan.scenario, positions, powers)[0])
        rate = channel.secrecy_rates(self.plan.scenario, positions, powers, eavesdropper)[0]
        return max(0.0, float(rate))


class Player:
    """
    Plays plans one after another: holds what is played, since when, and what was delivered.

    :ivar playback: the Playback, or None before the first plan.
    :ivar time: in s from the start of the plan that is played.
    :ivar playing: whether time goes on.
    :ivar streaming: whether there is a setpoint to hold: from the start until a reset.
    :ivar delivered: secret information so far, bit/Hz.
    :ivar largest_step: between one setpoint and the next, in m.
    """

    def __init__(self) -> None:
        self.playback: Playback | None = None
        self._next: Playback | None = None
        self.reset()

    def load(self, plan: Plan) -> None:
        """Play a plan, now or, while another is played, when its start time has come."""
        playback = Playback(plan)
        if self.playback is None or not self.streaming or self.finished:
            self.playback = playback
            self.reset_time()
        else:
            self._next = playback
            self._switch()

    @property
    def finished(self) -> bool:
        """Whether the end of the plan has been reached."""
        return self.playback is not None and self.time >= self.playback.duration

    def start(self) -> None:
        """Play on, or from the start again at the end."""
        if self.finished:
            self.reset_time()
        self.playing = self.streaming = True

    def pause(self) -> None:
        """Hold the setpoint."""
        self.playing = False

    def reset(self) -> None:
        """Go back to the start and stop streaming."""
        self.playing = self.streaming = False
        self.reset_time()

    def reset_time(self) -> None:
        """Go back to the start."""
        self.time = 0.0 if self.playback is None else self.playback.begin
        self.delivered = self.largest_step = 0.0
        self._last: Array | None = None

    def advance(self, seconds: float, eavesdropper: ArrayLike | None = None) -> Moment:
        """
        Go on by a time in s if playing; return the Moment.

        :param eavesdropper: where it really is, (2,) in m, or None.
        :raises OptionError: before a plan has been loaded.
        """
        if self.playback is None:
            raise OptionError('no plan has been loaded; there is nothing to play')
        if self.playing:
            end = min(self.time + seconds, self.playback.duration)
            self.delivered += _delivered(self.playback, self.time, end, eavesdropper)
            self.time = end
            self._switch()
        moment = self.playback.at(self.time)
        if self._last is not None:
            steps = np.linalg.norm(moment.positions - self._last, axis=-1)
            self.largest_step = max(self.largest_step, float(steps.max()))
        self._last = moment.positions
        return moment

    def _switch(self) -> None:
        """Change to the next plan where its time has come, at the same moment of time."""
        if self.playback is None or self._next is None:
            return
        now, then = self.playback.plan.start_ns, self._next.plan.start_ns
        time = 0.0 if now is None or then is None else self.time - (then - now) * 1e-9
        if time >= self._next.begin or self.finished:
            self.playback, self._next = self._next, None
            self.time = min(max(time, self.playback.begin), self.playback.duration)


def _delivered(playback: Playback, begin: float, end: float,
               eavesdropper: ArrayLike | None) -> float:
    """Return the secrecy rate integrated from one time to another, slot by slot, in bit/Hz."""
    step = playback.plan.scenario.slot_duration
    inside = np.arange(np.floor(begin / step) + 1, np.ceil(end / step)) * step
    edges = [begin, *inside.tolist(), end]
    return math.fsum(
        (after - before) * weight * playback.secrecy_rate(
            playback.at((before + after) / 2 + place * (after - before)), eavesdropper)
        for before, after in zip(edges, edges[1:], strict=False)
        for place, weight in GAUSS_LEGENDRE)
