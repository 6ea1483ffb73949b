"""
The limits that a plan keeps, one class each; LIMITS names them all.

A limit answers everything that its users ask of it, as base.Limit says: the check of a plan, the
repair of an iterate, and its terms in the method `joint`.
"""

from collections.abc import Callable
from functools import lru_cache

from .base import Limit
from .fence import FenceLimit
from .lines import LineLimit
from .motion import AccelerationLimit, SpeedLimit
from .power import AveragePower, PeakPower
from .separation import SeparationLimit
from .zones import ZoneLimit
from ..airspace import airspace_of
from ..clearance import Clearance
from ..curve import Curve
from ..grid import Grid
from ...errors import PlanError
from ...mission.scenario import Array, Scenario

LIMITS: tuple[type[Limit], ...] = (
    SpeedLimit, AccelerationLimit, FenceLimit, ZoneLimit, SeparationLimit, PeakPower,
    AveragePower)
"""All limits, in the order in which a plan is checked and an iterate repaired."""


def limits_of(scenario: Scenario, grid: Grid | None = None) -> tuple[Limit, ...]:
    """Return the limits that a scenario has, on a grid, by default its own."""
    return tuple(limit(scenario, grid) for limit in LIMITS if limit.applies_to(scenario))


def is_open(scenario: Scenario) -> bool:
    """Return whether flights have no limits but those of speed and acceleration."""
    return not any(issubclass(limit, LineLimit) and limit.applies_to(scenario)
                   for limit in LIMITS)


@lru_cache(maxsize=4)
def _known_limits(scenario: Scenario) -> tuple[Limit, ...]:
    """Return limits that are only asked about plans, for which every iterate asks them."""
    return limits_of(scenario)


def repaired(scenario: Scenario, positions: Array, powers: Array) -> tuple[Array, Array]:
    """Return positions (U, N+2, 2) in m and powers (U, N) in W that every limit has repaired."""
    for limit in _known_limits(scenario):
        positions, powers = limit.repair(positions, powers)
    return positions, powers


def repaired_powers(scenario: Scenario, positions: Array, powers: Array) -> Array:
    """Return powers (U, N) in W that every limit of powers has repaired; see repaired."""
    for limit in _known_limits(scenario):
        if not limit.of_flights:
            _, powers = limit.repair(positions, powers)
    return powers


def is_clear(scenario: Scenario, positions: Array,
             check: Callable[[], None] = lambda: None) -> bool:
    """
    Return whether flights (U, N+2, 2) in m clear zones, fence and each other at any time.

    :param check: called now and then; what it raises is passed on.
    """
    limits = [limit for limit in _known_limits(scenario) if isinstance(limit, LineLimit)]
    clear = not airspace_of(scenario).far
    for limit in limits:
        check()
        clear = clear and limit.is_clear(positions)
    if clear:
        return True
    # Curves may be clear while their control points are not, and zones that are far away have no
    # limits.
    try:
        Clearance(scenario, Curve(scenario, positions)).check()
    except PlanError:
        return False
    return True


__all__ = ['AccelerationLimit', 'AveragePower', 'FenceLimit', 'LIMITS', 'Limit', 'PeakPower',
           'SeparationLimit', 'SpeedLimit', 'ZoneLimit', 'is_clear', 'is_open', 'limits_of',
           'repaired', 'repaired_powers']
