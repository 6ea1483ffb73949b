"""The limit of energy, by the model of the propulsion, and its price in the kernel."""

from dataclasses import replace

import numpy as np

from .base import compile_vectors, Limit
from ..airspace import Airspace
from ..curve import add_end_moves, integrate_powers
from ..grid import Grid
from ..kernel import core
from ...errors import PlanError
from ...mission.fields import find_range
from ...mission.scenario import Array, Scenario, Uav

TOLERANCE = 1e-6
"""Share by which the energy of a plan may exceed its limit."""


class EnergyLimit(Limit):
    """The energy of a flight along its curve is at most its limit."""

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
    Return the energy of each UAV's flight, (U,) in J, 0 for a UAV without a propulsion.

    In the slot around a point, the velocity changes from the move before to the move after it.

    :param positions: points of the flights, (U, N+2, 2) in m, for any N. All UAVs have a limit of
        acceleration.
    """
    step = scenario.slot_duration * (scenario.slots + 1) / (positions.shape[1] - 1)
    velocities = add_end_moves(np.diff(positions, axis=1) / step, scenario.end_velocities)
    return np.asarray(integrate_powers(  # The sum is over hovering and flying.
        scenario.uavs, velocities[:, :-1], velocities[:, 1:], step).sum(axis=1))


def reduce_budgets(scenario: Scenario, positions: Array, point: int) -> tuple[Uav, ...]:
    """
    Return the UAVs with max_energy less the energy of the beginning of their flights.

    The new max_energy is at least the smallest one that a Uav may have.

    :param positions: points of the beginning, (U, >= point + 1, 2) in m.
    :param point: index of the first point of the rest of the flight. The beginning ends half a
        slot before this point. At point 0 nothing is subtracted.
    """
    if point == 0 or not scenario.limits_energy:
        return scenario.uavs
    velocities = add_end_moves(np.diff(positions[:, :point + 1], axis=1) / scenario.slot_duration,
                               scenario.end_velocities)
    energies = integrate_powers(  # The sum is over hovering and flying.
        scenario.uavs, velocities[:, :-2], velocities[:, 1:-1], scenario.slot_duration).sum(axis=1)
    least = find_range(Uav, 'max_energy').low
    return tuple(uav if uav.max_energy is None else replace(
        uav, max_energy=max(uav.max_energy - energy, least))
        for uav, energy in zip(scenario.uavs, energies.tolist(), strict=True))


def compile_energies(grid: Grid, positions: Array) -> core.Energies:
    """
    Return the kernel's form of the energies, in shares of max_energy, by Simpson's rule.

    A constant for each UAV makes its energy exact for one flight: in slots of 4 s Simpson's rule
    may be 0.4% off. The velocity of a slot changes from the move before its point to the move
    after its point, and is the mean of both moves in its middle.

    :param positions: the flights whose energies are exact, (U, N+2, 2) in m.
    """
    moves, weights = _compile_moves(grid)
    terms, uavs = _list_power_terms(grid), len(grid.scenario.uavs)
    by_simpson = np.empty(uavs)
    path = np.ascontiguousarray((positions.swapaxes(0, 1) - grid.origin) / grid.length)
    core.Energies(moves, weights, terms, np.zeros(uavs)).find(path, by_simpson)
    exact = measure_energies(grid.scenario, positions) / grid.scenario.max_energies
    return core.Energies(moves, weights, terms, exact - by_simpson)


def _list_power_terms(grid: Grid) -> Array:
    """
    Return the coefficients (a, b, c, d) of each UAV's power curve, (U, 4).

    The power for a move of squared length s [grid.length^2] a slot, in shares of max_energy a
    slot, is a s + b / sqrt(sqrt(1 + r^2) + r) + d s^1.5 plus a constant, with r = c s. The terms
    are the blades', the induced and the drag's. Without propulsion all coefficients are 0.
    """
    scenario = grid.scenario
    unit = (grid.length / grid.slot_duration)**2  # The unit of squared speeds.
    terms = np.zeros((len(scenario.uavs), 4))
    for row, uav, budget in zip(terms, scenario.uavs, scenario.max_energies, strict=True):
        wing = uav.propulsion
        if wing is not None:
            row[:] = grid.slot_duration / budget * np.array([
                3 * wing.blade_power * unit / wing.tip_speed**2, wing.induced_power, 0.0,
                wing.drag * unit**1.5])
            row[2] = unit / (2 * wing.induced_velocity**2)
    return terms


def _compile_moves(grid: Grid) -> tuple[core.Vectors, Array]:
    """
    Return the kernel's form of the S = 2 N + 3 moves of Simpson's rule, and their weights, (U, S).

    A move is share * (end - begin) plus a constant. First come the N + 1 moves of the path, then
    the N mean moves in the middle of slots, then the mean moves in the first and last slot, whose
    outer moves are the end velocities. If such a velocity is free, the mean move is the path's
    first or last move. Powers at given end velocities are constants, and left out.
    """
    uavs, slots = len(grid.scenario.uavs), grid.slots
    begin = np.concatenate([np.arange(slots + 1), np.arange(slots), [0, slots]])
    end = np.concatenate([np.arange(1, slots + 2), np.arange(2, slots + 2), [1, slots + 1]])
    share = np.tile(np.repeat([1.0, 0.5], [slots + 1, slots + 2]), (uavs, 1))
    weights = np.tile(np.repeat([1 / 3, 2 / 3], [slots + 1, slots + 2]), (uavs, 1))
    constants = np.zeros((*share.shape, 2))
    end_moves = (grid.scenario.end_velocities * grid.slot_duration / grid.length).swapaxes(0, 1)
    constants[:, -2:] = 0.5 * np.nan_to_num(end_moves)
    free = np.isnan(end_moves[..., 0])
    share[:, -2:][free], weights[:, -2:][free] = 1.0, 5 / 6
    points = np.stack([begin, end], axis=-1) * uavs + np.arange(uavs)[:, None, None]
    return compile_vectors(
        grid, points, share[..., None] * [-1.0, 1.0], constants, differences=True), weights
