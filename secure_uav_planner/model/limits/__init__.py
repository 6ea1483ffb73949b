"""
The limits that a plan keeps, one class each; LIMITS names them all.

A limit provides what base.Limit says: the check of a plan, the repair of an iterate, and its
terms in the method `joint`.
"""

from collections.abc import Callable
from functools import lru_cache

from .base import Limit
from .energy import EnergyLimit, lift_limits, measure_energies, reduce_budgets
from .lines import LineLimit
from .motion import AccelerationLimit, NormLimit, SpeedLimit
from .power import AveragePower, PeakPower
from .separation import SeparationLimit
from .zones import FenceLimit, ZoneLimit
from ..airspace import get_airspace
from ..clearance import Clearance
from ..curve import Curve
from ..grid import Grid
from ...errors import PlanError
from ...mission.kinematics import EFFORT_TOLERANCE
from ...mission.scenario import Array, Scenario

LIMITS: tuple[type[Limit], ...] = (
    SpeedLimit, AccelerationLimit, EnergyLimit, FenceLimit, ZoneLimit, SeparationLimit, PeakPower,
    AveragePower)
"""All limits, in the order in which a plan is checked and an iterate repaired."""


def build_limits(scenario: Scenario, grid: Grid | None = None) -> tuple[Limit, ...]:
    """Return the limits that a scenario has, on a grid, by default its own."""
    return tuple(limit(scenario, grid) for limit in LIMITS if limit.applies_to(scenario))


def check_limits(scenario: Scenario, positions: Array, powers: Array) -> None:
    """Raise a PlanError if a plan breaks a limit, but those of lines; see Limit.check."""
    for limit in LIMITS:
        if not issubclass(limit, LineLimit) and limit.applies_to(scenario):
            limit(scenario).check(positions, powers)


def keeps_motion(scenario: Scenario, positions: Array) -> bool:
    """Return True if flights (U, N+2, 2) in m keep the limits of speed and acceleration."""
    return all((limit.efforts(positions) <= 1 + EFFORT_TOLERANCE).all()
               for limit in _get_limits(scenario) if isinstance(limit, NormLimit))


def keeps_energy(scenario: Scenario, positions: Array) -> bool:
    """Return True if flights (U, N+2, 2) in m keep the limits of energy."""
    return not EnergyLimit.applies_to(scenario) or bool(
        (measure_energies(scenario, positions) <= scenario.max_energies).all())


@lru_cache(maxsize=4)
def _get_limits(scenario: Scenario) -> tuple[Limit, ...]:
    """Return the limits on the scenario's own grid, cached: every iterate is repaired by them."""
    return build_limits(scenario)


def is_open(scenario: Scenario) -> bool:
    """Return True if flights have no limits but those of speed and acceleration."""
    return not any(issubclass(limit, LineLimit) and limit.applies_to(scenario)
                   for limit in LIMITS)


def repair(scenario: Scenario, positions: Array, powers: Array) -> tuple[Array, Array]:
    """Return positions (U, N+2, 2) in m and powers (U, N) in W, repaired by every limit."""
    for limit in _get_limits(scenario):
        positions, powers = limit.repair(positions, powers)
    return positions, powers


def repair_powers(scenario: Scenario, positions: Array, powers: Array) -> Array:
    """Return powers (U, N) in W, repaired by every limit of powers."""
    for limit in _get_limits(scenario):
        if not limit.constrains_positions:
            _, powers = limit.repair(positions, powers)
    return powers


def is_clear(scenario: Scenario, positions: Array,
             check: Callable[[], None] = lambda: None) -> bool:
    """
    Return True if flights (U, N+2, 2) in m clear zones, fence and each other at any time.

    :param check: called now and then; what it raises is passed on.
    """
    clear = not get_airspace(scenario).far
    for limit in _get_limits(scenario):
        if isinstance(limit, LineLimit):
            check()
            clear = clear and limit.is_clear(positions)
    if clear:
        return True
    # Curves may be clear while their control points are not, and far zones have no limits.
    try:
        Clearance(scenario, Curve(scenario, positions)).check()
    except PlanError:
        return False
    return True


__all__ = ['AccelerationLimit', 'AveragePower', 'EnergyLimit', 'FenceLimit', 'LIMITS', 'Limit',
           'PeakPower', 'SeparationLimit', 'SpeedLimit', 'ZoneLimit', 'build_limits',
           'check_limits', 'is_clear', 'is_open', 'keeps_energy', 'keeps_motion', 'lift_limits',
           'measure_energies', 'reduce_budgets', 'repair', 'repair_powers']
