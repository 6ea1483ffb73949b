"""The poses that have arrived, until the state thread of the planner takes them."""

from collections import defaultdict
from collections.abc import Mapping
from typing import Any

from rclpy.impl.rcutils_logger import RcutilsLogger

from .poses import Arrival, PoseBook
from ..errors import brief, PoseError

_MOST_WARNINGS = 5  # About the poses of a topic, until a valid one arrives.


class PoseInputs:
    """The newest pose of each topic; a reason to refuse one is logged once."""

    def __init__(self, poses: PoseBook, log: RcutilsLogger) -> None:
        self._poses, self._log = poses, log
        self._arrived: dict[str, Arrival] = {}
        self._warnings: dict[str, set[str]] = defaultdict(set)  # About the poses of each topic.

    def put(self, arrival: Arrival) -> None:
        """Keep a pose that has arrived, from any thread."""
        self._arrived[arrival.topic] = arrival

    def take_all(self, settings: Mapping[str, Any], now: float) -> bool:
        """Keep the valid poses in the PoseBook; return True if any is the first of its topic."""
        firsts = [self._take(self._arrived.pop(topic), settings, now)
                  for topic in [*self._arrived]]
        return any(firsts)

    def _take(self, arrival: Arrival, settings: Mapping[str, Any], now: float) -> bool:
        topic = arrival.topic
        is_first, warnings = self._poses.get(topic) is None, self._warnings[topic]
        try:
            # With simulated time, a pose can arrive before the clock has come to its stamp.
            remark = self._poses.take(arrival, settings, now)
        except PoseError as error:
            reason = brief(error)
            if reason not in warnings and len(warnings) < _MOST_WARNINGS:
                warnings.add(reason)
                self._log.warning(f'{topic}: {reason}; it is not used')
            return False
        warnings.clear()
        if remark:
            self._log.warning(remark)
        return is_first
