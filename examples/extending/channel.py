"""
A channel of your own in both its forms, in Python and in C++: they are compared, and planned for.

The gain is that of free space times exp(-d^2 / length^2). It needs a C++ compiler and what
examples/requirements.txt names. Run it by `python -m examples.extending.channel`.
"""

from dataclasses import dataclass

import numpy as np
from secure_uav_planner import Scenario, solve
from secure_uav_planner.model.channel import guaranteed_rates, links
from secure_uav_planner.model.channel.links import FreeSpace

from .compiling import compile_module


@dataclass(frozen=True, eq=False)
class Absorbed(FreeSpace):
    """The link of which the gain is free space's times exp(-d^2 / length^2), length in m."""

    length: float = 1000.0

    def gain(self, squared):
        """Return the gain over the noise power at squared horizontal distances."""
        return super().gain(squared) * np.exp(-squared / self.length**2)

    def compiled(self, receivers, uavs):
        """Return the kernel's form of the links from every UAV to every receiver."""
        arrays = (np.broadcast_to(values, (receivers, uavs)).ravel().tolist()
                  for values in (self.reference_snr, self.squared_altitudes))
        return compile_module('absorbed').Absorbed(*arrays, self.length)


LENGTH = 400.0  # m


def make_absorbed(scenario, kinds, shape, snr, altitudes, elevation_offset=0.0):
    """Return the link of a scenario in this channel; see links._link, in whose place it is."""
    unit = np.ravel(altitudes)[0] / scenario.altitudes[0]  # Of lengths, in 1 / m.
    return Absorbed(snr, altitudes**2, LENGTH * unit)


if __name__ == '__main__':
    link = Absorbed(1e8, np.array([100.0**2]), 800.0)
    channel = link.compiled(receivers=1, uavs=1)
    for squared in (0.0, 1e4, 1e6):
        gain, _, first, second = channel.gain(0, squared)
        np.testing.assert_allclose(gain, link.gain(squared))
        above, below = (channel.gain(0, squared + step) for step in (1.0, -1.0))
        np.testing.assert_allclose((above[0] - below[0]) / 2, first, rtol=1e-6)
        np.testing.assert_allclose((above[2] - below[2]) / 2, second, rtol=1e-6)
        print(f'{squared**0.5:.0f} m: gain {gain:.1f} per W')
    mission = Scenario.paper(duration=120.0, slots=24)
    free_space = solve(mission, objective='guaranteed')
    links._link = make_absorbed
    absorbed = solve(mission, objective='guaranteed')
    for name, plan in (('free space', free_space), ('this channel', absorbed)):
        rates = guaranteed_rates(mission, plan.positions, plan.powers)
        print(f'planned for {name}: {np.maximum(rates, 0.0).mean():.4f} bit/s/Hz')
