"""Where the UAVs are beside the last plan, and what they have achieved so far."""

from collections.abc import Mapping
import math
import threading
from typing import Any

import numpy as np

from .poses import PoseBook
from .scenarios import sighting_of
from ..plan import Plan
from ..playback import Playback
from ..scenario import Array
from ..tracking import deviation, Sighting, Track


class Whereabouts:
    """
    Compares the UAVs with the last plan.

    :param poses: the PoseBook.
    """

    def __init__(self, poses: PoseBook) -> None:
        self._poses = poses
        self._playback: Playback | None = None
        self._track = Track()
        self._lock = threading.Lock()

    def follow(self, plan: Plan) -> None:
        """Compare with another plan from now on."""
        self._playback = Playback(plan)

    def sightings(self, plan: Plan, settings: Mapping[str, Any], now: float
                  ) -> list[Sighting | None]:
        """
        Return the state of every UAV from which to plan, None where it is not known or not used.

        :param plan: the Plan from whose start times count.
        :param settings: values of the planner's parameters by name.
        :param now: the node's time in s.
        """
        return [sighting_of(name, settings, self._poses, now, plan.start_ns * 1e-9)
                if settings[f'{name}.use_pose'] else None for name in settings['uavs']]

    def distances(self, settings: Mapping[str, Any], now: float) -> dict[str, float]:
        """Return the distance of each UAV from its plan in m, by name, where it is known."""
        return {name: math.hypot(*offset)
                for name, offset in self._offsets(self._playback, settings, now).items()}

    def observe(self, settings: Mapping[str, Any], now: float) -> None:
        """Note where the UAVs are now, for the rate that they achieve."""
        playback = self._playback
        offsets = self._offsets(playback, settings, now)
        if playback is None or len(offsets) < len(settings['uavs']):
            return
        time = now - playback.plan.start_ns * 1e-9
        positions = playback.at(time).positions + np.array(list(offsets.values()))
        with self._lock:
            self._track.add(playback, time, positions)

    def report(self, settings: Mapping[str, Any], now: float) -> tuple[list[str], dict[str, Any]]:
        """
        Return what the status says of the UAVs.

        :return: a text about every UAV that flies farther from its plan than it should, and the
            values of the status by key.
        """
        playback, most = self._playback, settings['track_tolerance']
        if playback is None:
            return [], {}
        distances = self.distances(settings, now)
        flies = now >= playback.plan.start_ns * 1e-9 + playback.begin
        problems = [f'{name} is {distance:.1f} m from its plan and track_tolerance is {most:g} m'
                    for name, distance in distances.items() if flies and distance > most]
        found: dict[str, Any] = {f'track.distance.{name}': distances.get(name, 'none')
                                 for name in settings['uavs']}
        with self._lock:
            rates = self._track.rates or ('none', 'none')
        return problems, {
            **found, **dict(zip(('track.rate', 'track.planned_rate'), rates, strict=True))}

    def _offsets(self, playback: Playback | None, settings: Mapping[str, Any], now: float
                 ) -> dict[str, Array]:
        """Return the offset of each UAV from its plan in m, by name, where it is known."""
        if playback is None:
            return {}
        origin, found = playback.plan.start_ns * 1e-9, {}
        for index, name in enumerate(settings['uavs']):
            sighting = sighting_of(name, settings, self._poses, now, origin)
            if sighting is not None:
                found[name] = deviation(playback, index, sighting)
        return found
