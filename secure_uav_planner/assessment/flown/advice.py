"""Parameters and options to type next, by the errors of a flight."""

from collections.abc import Mapping
import math

import numpy as np

from .alignment import find_delay
from .errors import UavErrors
from .flight import FlownFlight
from ...mission.scenario import Array

_DELAY_S = 0.2  # Delay above which start_delay is advised.
_CONSTANT_S = 0.1  # A delay is constant if both halves of the flight have it within this time.
_LARGE_M = 1.0  # Largest error above which a lower acceleration may be advised.
_LAGGING = 0.5  # Correlation of error and planned acceleration above which it is advised.


def advise(flight: FlownFlight, uavs: Mapping[str, UavErrors], cross_tracks: Array
           ) -> list[str]:
    """
    Return advice such as 'tracking_margin: 1.2 (reason)': fields, parameters and options to set.

    Without a measured UAV there is none.

    :param uavs: errors by UAV; a UAV with a finite error_rms_m is measured.
    :param cross_tracks: distance of each UAV from its planned path at flight.times, (U, K) in m.
    """
    measured = [errors for errors in uavs.values() if math.isfinite(errors.error_rms_m)]
    if not measured:
        return []
    advice, margin = [], flight.plan.scenario.tracking_margin
    worst = max(errors.cross_track_99_m for errors in measured)
    if worst > margin:
        advice.append(f'tracking_margin: {math.ceil(worst * 10) / 10:g} (99% of the errors are '
                      f'below {worst:.2f} m; the plan has {margin:g} m)')
    # The mean square of the distance is the sum of the variances in x and in y.
    spread = math.sqrt(np.mean([errors.error_rms_m**2 for errors in measured]) / 2)
    advice.append(f'--tracking-std {spread:.2f}: assess says what such errors cost')
    late = {name: errors.delay_s for index, (name, errors) in enumerate(uavs.items())
            if errors.delay_s > _DELAY_S and _has_constant_delay(flight, index)}
    if late:
        behind = ', '.join(f'{name} {delay:.2f} s' for name, delay in late.items())
        advice.append(f'start_delay: {max(late.values()):.2f} more (behind the plan all the way: '
                      f'{behind})')
    return [*advice, *_find_lagging(flight, cross_tracks)]


def _has_constant_delay(flight: FlownFlight, index: int) -> bool:
    """Return whether the delays of a UAV in both halves of its flight differ by < _CONSTANT_S."""
    path = flight.positions[index, :, :2]
    middle = len(path) // 2
    halves = [find_delay(half, flight.course, index) for half in (
        np.where(np.arange(len(path))[:, None] < middle, path, np.nan),
        np.where(np.arange(len(path))[:, None] < middle, np.nan, path))]
    return abs(halves[0] - halves[1]) < _CONSTANT_S


def _find_lagging(flight: FlownFlight, cross_tracks: Array) -> list[str]:
    """
    Return advice to lower a max_acceleration if a UAV's errors follow its planned acceleration.

    Errors follow it if their correlation is above _LAGGING and the largest is _LARGE_M or more.
    """
    accelerations = np.linalg.norm(flight.course.at(flight.times).accelerations, axis=-1)
    advice = []
    for uav, errors, planned in zip(
            flight.plan.scenario.uavs, cross_tracks, accelerations, strict=True):
        inside = np.isfinite(errors)
        if uav.max_acceleration is None or errors[inside].max(initial=0.0) < _LARGE_M or (
                np.ptp(planned[inside]) == 0):
            continue
        if np.corrcoef(errors[inside], planned[inside])[0, 1] > _LAGGING:
            advice.append(f'{uav.name}.max_acceleration below {uav.max_acceleration:g}: errors '
                          'grow with the acceleration')
    return advice
