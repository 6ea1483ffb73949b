"""When the plan of a request begins."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from ..errors import LateError

_RESERVE = 1.0  # For what follows a solve, in s; at most half of the time there is.
_SHORTEST_SOLVE = 0.01


@dataclass(frozen=True)
class StartTime:
    """
    When the plan of a request begins.

    :param is_delayed: whether it begins at a time that is known before the solve.
    :param asked_ns: the time of the request in ns.
    :param start_ns: the time of point 0 in ns.
    :param effect_ns: when setpoints pass over to the plan, in ns: half a slot before point 0 if
        any UAV has a limit of acceleration, for then it leaves its start.
    """

    is_delayed: bool
    asked_ns: int
    start_ns: int
    effect_ns: int

    @classmethod
    def of(cls, parameters: Mapping[str, Any], now_ns: int, is_flying: bool = False
           ) -> 'StartTime':
        """
        Return the StartTime of a request.

        :param parameters: values of the planner's parameters by name.
        :param now_ns: the node's time in ns.
        :param is_flying: whether UAVs fly on another plan; the new one then takes effect
            replan_lead ahead, or later.
        """
        is_smooth = any(parameters[f'{name}.max_acceleration'] for name in parameters['uavs'])
        lead_in = parameters['duration'] / parameters['slots'] / 2 if is_smooth else 0.0
        delay = parameters['start_delay']
        if is_flying:
            delay = max(delay, parameters['replan_lead'] + lead_in)
        start_ns = now_ns + round(max(delay, lead_in) * 1e9)
        return cls(delay > 0, now_ns, start_ns, start_ns - round(lead_in * 1e9))

    def time_limit(self, limit: float | None) -> float | None:
        """
        Return the time limit of the solve in s, or None for none.

        :param limit: that of the parameters.
        """
        if not self.is_delayed:
            return limit
        ahead = (self.effect_ns - self.asked_ns) * 1e-9
        ahead = max(_SHORTEST_SOLVE, ahead - min(_RESERVE, ahead / 2))
        return ahead if limit is None else min(limit, ahead)

    def start_of(self, now_ns: int) -> int:
        """Return the time in ns of point 0 of a plan that has been solved now."""
        if self.is_delayed:
            return self.start_ns
        return now_ns + self.start_ns - self.effect_ns

    def check_in_time(self, now_ns: int) -> None:
        """
        Check that the plan may still be published.

        :raises LateError: if the time at which it takes effect has passed.
        """
        if self.is_delayed and now_ns > self.effect_ns:
            raise LateError('the new plan came after the moment it was to take effect; a longer '
                            'start_delay gives it more time, and in flight a longer replan_lead')
