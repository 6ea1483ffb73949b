"""A plan in continuous time: where the UAVs are between its points, and what is delivered."""

from dataclasses import dataclass
import math

import numpy as np
from numpy.typing import ArrayLike

from . import channel
from .errors import OptionError
from .plan import Plan
from .scenario import Array

# Slower than this share of the largest speed, a direction of travel is numerical noise.
_HOVERING = 1e-3


@dataclass(frozen=True)
class Moment:
    """
    One moment of a flight.

    :param positions: (U, 2) in m.
    :param velocities: (U, 2) in m/s.
    :param headings: (U,) in rad, counter-clockwise from x.
    :param powers: (U,) in W, those of the slot; zero outside the slots.
    """

    positions: Array
    velocities: Array
    headings: Array
    powers: Array


def velocities(plan: Plan) -> Array:
    """Return the velocity from every point to the next, (U, N+2, 2) in m/s; the last is zero."""
    moves = np.diff(plan.positions, axis=1) / plan.scenario.slot_duration
    return np.concatenate([moves, np.zeros_like(moves[:, :1])], axis=1)


def headings(plan: Plan) -> Array:
    """Return the direction of travel at every point, (U, N+2) in rad, held while hovering."""
    moves = velocities(plan)
    speed = np.linalg.norm(moves, axis=-1)
    limit = _HOVERING * plan.scenario.max_speeds[:, None]
    moving = speed > limit
    # The index of the last point at which the UAV moved; before the first, that of the first.
    index = np.where(moving, np.arange(speed.shape[1]), -1)
    last = np.maximum.accumulate(index, axis=1)
    first = np.argmax(moving, axis=1)[:, None]
    angle = np.arctan2(moves[..., 1], moves[..., 0])
    held = np.take_along_axis(angle, np.where(last < 0, first, last), axis=1)
    return np.where(moving.any(axis=1, keepdims=True), held, 0.0)


class Playback:
    """
    A plan as a function of time.

    :param plan: a Plan.
    """

    def __init__(self, plan: Plan) -> None:
        self.plan = plan
        self.duration = float(plan.times[-1])
        self._velocities = velocities(plan)
        self._headings = headings(plan)

    def at(self, time: float) -> Moment:
        """
        Return the Moment at a time from the start in s, held before it and after the end.

        Positions are interpolated; power n holds from point n to point n + 1.
        """
        slots = self.plan.scenario.slots
        step = self.plan.scenario.slot_duration
        time = min(max(time, 0.0), self.duration)
        point = min(int(time / step + 1e-9), slots + 1)
        share = 0.0 if point > slots else time / step - point
        before, after = self.plan.positions[:, point], self.plan.positions[
            :, min(point + 1, slots + 1)]
        powers = (self.plan.powers[:, point - 1] if 1 <= point <= slots
                  else np.zeros(len(before)))
        return Moment(before + share * (after - before), self._velocities[:, point],
                      self._headings[:, point], powers)

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
        self.time = self.delivered = self.largest_step = 0.0
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
        if time >= 0 or self.finished:
            self.playback, self._next = self._next, None
            self.time = min(max(time, 0.0), self.playback.duration)


def _delivered(playback: Playback, begin: float, end: float,
               eavesdropper: ArrayLike | None) -> float:
    """Return the secrecy rate integrated from one time to another, slot by slot, in bit/Hz."""
    step = playback.plan.scenario.slot_duration
    inside = np.arange(np.floor(begin / step) + 1, np.ceil(end / step)) * step
    edges = [begin, *inside.tolist(), end]
    return math.fsum((after - before) * playback.secrecy_rate(
        playback.at((before + after) / 2), eavesdropper)
        for before, after in zip(edges, edges[1:], strict=False))
