"""
The limits that a plan keeps, one class each; LIMITS names them all.

A limit provides what base.Limit says: the check of a plan, the retraction of an iterate, and its
terms in the method `joint`.
"""

from .base import AveragePower, Limit, PeakPower
from .energy import EnergyLimit, lift_limits, measure_energies, reduce_budgets
from .lines import LineLimit
from .motion import AccelerationLimit, NormLimit, SpeedLimit
from .zones import FenceLimit, SeparationLimit, ZoneLimit
from ..grid import Grid

LIMITS: tuple[type[Limit], ...] = (
    SpeedLimit, AccelerationLimit, EnergyLimit, FenceLimit, ZoneLimit, SeparationLimit, PeakPower,
    AveragePower)
"""All limits, in the order in which a plan is checked and an iterate retracted."""


def build_limits(grid: Grid) -> tuple[Limit, ...]:
    """Return the limits that the scenario of a grid has, on the grid."""
    return tuple(limit(grid) for limit in LIMITS if limit.applies_to(grid.airspace))


__all__ = ['AccelerationLimit', 'AveragePower', 'EnergyLimit', 'FenceLimit', 'LIMITS', 'Limit',
           'LineLimit', 'NormLimit', 'PeakPower', 'SeparationLimit', 'SpeedLimit', 'ZoneLimit',
           'build_limits', 'lift_limits', 'measure_energies', 'reduce_budgets']
