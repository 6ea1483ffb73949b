"""Refusals of missions that cannot be flown, with durations that suffice."""

from collections.abc import Iterable
import math

from .participants import Uav
from .validation import RANGES
from ..errors import InfeasibleMissionError


def refuse_slow_uavs(duration: float, slow: Iterable[tuple[Uav, float | None]]
                     ) -> list[InfeasibleMissionError]:
    """
    Return the errors of UAVs that need more time, the slowest first.

    :param duration: the mission's in s.
    :param slow: each UAV with a duration in s that suffices, NaN for an unknown one, and None if
        no allowed one does.
    """
    order = sorted(slow, key=lambda item: -(math.inf if item[1] is None else item[1]))
    return [refuse_duration(duration, uav, shortest) for uav, shortest in order]


def refuse_duration(duration: float, uav: Uav, shortest: float | None, way: str = ''
                    ) -> InfeasibleMissionError:
    """Return the error of a UAV; its `way` may be such as ' around tower'."""
    if shortest is None:
        needs = f'none of up to {RANGES["duration"][1]:g} s takes {uav.name}'
    else:
        time = 'longer' if math.isnan(shortest) else f'at least {shortest:g} s'
        needs = f'{uav.name} needs {time}'
    return InfeasibleMissionError(
        f'duration is {duration:g} s; {needs} from start to goal{way} at {uav.limits_text}',
        ('duration',))
