"""Wind with gusts, by the Dryden model of MIL-F-8785C at low altitude."""

import math

import numpy as np

_FOOT = 0.3048  # m


class Gusts:
    """
    A steady wind and gusts of it, the same for every run with one seed.

    The gusts are those at a place that the wind carries past: white noise through the forming
    filter of the Dryden model, first order, with its length scale at the altitude.

    :param steady: the steady wind, (x, y) in m/s; not zero.
    :param deviation: the standard deviation of each horizontal component of the gusts, in m/s;
        that of the vertical one is half of it.
    :param altitude: in m above ground.
    :param step: time between two calls of step, in s.
    :param seed: of the noise.
    """

    def __init__(self, steady, deviation, altitude, step, seed):
        feet = altitude / _FOOT
        vertical = min(max(feet, 10.0), 1000.0)
        level = vertical / (0.177 + 0.000823 * vertical)**1.2
        scales = _FOOT * np.array([level, level, vertical])
        self._steady = np.array([*steady, 0.0])
        self._deviations = deviation * np.array([1.0, 1.0, 0.5])
        # Exact at the steps: a first-order process of the length scale over the wind speed.
        self._kept = np.exp(-step * math.hypot(*steady) / scales)
        self._noise = np.random.default_rng(seed)
        self._gust = self._deviations * self._noise.standard_normal(3)

    def step(self):
        """Return the wind of the next step, (3,) in m/s."""
        new = self._deviations * np.sqrt(1 - self._kept**2)
        self._gust = self._kept * self._gust + new * self._noise.standard_normal(3)
        return self._steady + self._gust
