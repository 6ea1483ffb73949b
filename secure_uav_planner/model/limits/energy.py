"""The limit of energy, by the model of the propulsion, and its price in the kernel."""

from dataclasses import replace

import numpy as np

from .base import Limit
from ..airspace import Airspace
from ..curve import add_end_moves, integrate_powers
from ..grid import Grid
from ...errors import PlanError
from ...mission.fields import find_range
from ...mission.scenario import Array, Scenario, Uav

TOLERANCE = 1e-6
"""Share by which the energy of a plan may exceed its limit."""


class EnergyLimit(Limit):
    """The energy of a flight, by Simpson's rule in each slot, is at most its limit."""

    @classmethod
    def applies_to(cls, airspace: Airspace) -> bool:
        return airspace.scenario.limits_energy

    def validate(self, positions: Array, powers: Array) -> None:
        for uav, energy in zip(self.scenario.uavs, measure_energies(self.scenario, positions),
                               strict=True):
            if uav.max_energy is not None and energy > uav.max_energy * (1 + TOLERANCE):
                raise PlanError(
                    f'the flight of {uav.name} takes {energy:.9g} J by the model of its '
                    f'propulsion; at most {uav.max_energy:.9g} J are allowed')


def lift_limits(scenario: Scenario) -> Scenario:
    """Return a scenario without limits of energy."""
    return replace(scenario, uavs=tuple(replace(uav, max_energy=None) for uav in scenario.uavs))


def measure_energies(scenario: Scenario, positions: Array) -> Array:
    """
    Return the energies of flights, (U,) in J, 0 for a UAV without a propulsion.

    :param positions: of UAVs with a limit of acceleration, (U, N+2, 2) in m, for any N.
    """
    step = scenario.slot_duration * (scenario.slots + 1) / (positions.shape[1] - 1)
    velocities = add_end_moves(np.diff(positions, axis=1) / step, scenario.end_velocities)
    return np.asarray(integrate_powers(
        scenario, velocities[:, :-1], velocities[:, 1:], step).sum(axis=1))


def reduce_budgets(scenario: Scenario, positions: Array, point: int) -> tuple[Uav, ...]:
    """
    Return the UAVs with what a beginning of their flights leaves of their limits of energy.

    :param positions: of the beginning at least, (U, >= point + 1, 2) in m.
    :param point: up to half a slot before which energies count: there a rest of the flight from
        this point on begins.
    """
    if point == 0 or not scenario.limits_energy:
        return scenario.uavs
    velocities = add_end_moves(np.diff(positions[:, :point + 1], axis=1) / scenario.slot_duration,
                               scenario.end_velocities)
    energies = integrate_powers(
        scenario, velocities[:, :-2], velocities[:, 1:-1], scenario.slot_duration).sum(axis=1)
    least = find_range(Uav, 'max_energy').low
    return tuple(uav if uav.max_energy is None else replace(
        uav, max_energy=max(uav.max_energy - energy, least))
        for uav, energy in zip(scenario.uavs, energies.tolist(), strict=True))


def price_energies(grid: Grid, prices: Array) -> dict[str, Array]:
    """
    Return the arguments of the kernel's EnergyCost.

    :param prices: in nats per J, (U,); 0 for a UAV without a propulsion.
    """
    unit = (grid.length / grid.slot_duration)**2  # Of squared speeds.
    terms = np.zeros((len(prices), 4))
    for index, (uav, price) in enumerate(zip(grid.scenario.uavs, prices, strict=True)):
        wing = uav.propulsion
        if wing is not None:
            terms[index] = price * grid.slot_duration * np.array([
                3 * wing.blade_power * unit / wing.tip_speed**2, wing.induced_power, 0.0,
                wing.drag * unit**1.5])
            terms[index, 2] = unit / (2 * wing.induced_velocity**2)
    return {'terms': terms,
            'end_moves': grid.scenario.end_velocities * grid.slot_duration / grid.length}
