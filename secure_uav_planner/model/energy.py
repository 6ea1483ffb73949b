"""The energy of a flight, along the flown curve."""

from typing import NamedTuple

import numpy as np

from .curve import Curve
from ..mission.scenario import Scenario

HOVERING_SPEED = 0.1
"""Slower than this share of its largest speed, a UAV counts as hovering. At 1 m/s the power of the
default rotary wing is 1% below that of hovering, and a UAV that circles in place does so too."""

# In a piece the velocity is linear in time, and its power a smooth function of it.
_PLACES, _WEIGHTS = np.polynomial.legendre.leggauss(16)
_MOST_TIMES = 2**15  # So many at once, for the memory.


class Energy(NamedTuple):
    """
    What the flight of one UAV takes, from when the first UAV leaves until the last one arrives.

    :ivar total: in J.
    :ivar hovering: while it is slower than HOVERING_SPEED times its max_speed, in J.
    :ivar flying: while it is not, in J.
    """

    total: float
    hovering: float
    flying: float


def energies(scenario: Scenario, curve: Curve) -> tuple[Energy | None, ...]:
    """
    Return the Energy of each UAV along a curve, None for one without a propulsion.

    It is the integral of Propulsion.power over the speed of the curve: what changes of velocity
    and the radio take is not in it.
    """
    members = [(index, uav.propulsion, HOVERING_SPEED * uav.max_speed)
               for index, uav in enumerate(scenario.uavs) if uav.propulsion is not None]
    sums = np.zeros((len(scenario.uavs), 2))
    count = round((curve.end - curve.begin) / curve.piece) if members else 0
    at_once = max(1, _MOST_TIMES // (len(_PLACES) * len(scenario.uavs)))
    for first in range(0, count, at_once):
        pieces = np.arange(first, min(first + at_once, count))
        times = curve.begin + (pieces[:, None] + (_PLACES + 1) / 2) * curve.piece
        velocities = curve.at(times.ravel()).velocities
        speeds = np.linalg.norm(velocities, axis=-1).reshape(-1, *times.shape)
        for index, propulsion, slow in members:
            joules = propulsion.power(speeds[index]) * _WEIGHTS * (curve.piece / 2)
            hovers = speeds[index] < slow
            sums[index] += joules[hovers].sum(), joules[~hovers].sum()
    return tuple(
        None if uav.propulsion is None else Energy(hovering + flying, hovering, flying)
        for uav, (hovering, flying) in zip(scenario.uavs, sums.tolist(), strict=True))
