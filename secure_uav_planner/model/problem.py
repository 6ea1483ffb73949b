"""A scenario with what follows from it: the first thing that a call makes."""

from collections.abc import Callable
from functools import cached_property

from .airspace import Airspace, Routes
from .clearance import Clearance
from .curve import Curve
from .grid import Grid
from .limits import build_limits, Limit, LineLimit, measure_energies, NormLimit
from ..errors import PlanError
from ..mission.kinematics import UTILISATION_TOLERANCE
from ..mission.scenario import Array, Scenario


class Problem:
    """
    A scenario with what follows from it, computed when it is first asked for, and then kept.

    :param scenario: the mission.
    :ivar airspace: its obstacles.
    :ivar grid: of its own slots.
    """

    def __init__(self, scenario: Scenario) -> None:
        self.scenario = scenario
        self.airspace = Airspace(scenario)
        self.grid = Grid(self.airspace, scenario.slots)

    @cached_property
    def limits(self) -> tuple[Limit, ...]:
        """Limits of the scenario, on its own grid."""
        return build_limits(self.grid)

    @cached_property
    def routes(self) -> Routes:
        """Routes around the obstacles."""
        return Routes(self.airspace, self.grid.step_lengths)

    def validate(self, positions: Array, powers: Array) -> None:
        """Raise a PlanError if a plan breaks a limit, but those of lines; see Limit.validate."""
        for limit in self.limits:
            limit.validate(positions, powers)

    def keeps_motion(self, positions: Array) -> bool:
        """Return True if flights (U, N+2, 2) in m keep the limits of speed and acceleration."""
        return all((limit.utilisations(positions) <= 1 + UTILISATION_TOLERANCE).all()
                   for limit in self.limits if isinstance(limit, NormLimit))

    def keeps_energy(self, positions: Array) -> bool:
        """Return True if flights (U, N+2, 2) in m keep the limits of energy."""
        return not self.scenario.limits_energy or bool(
            (measure_energies(self.scenario, positions) <= self.scenario.max_energies).all())

    def is_clear(self, positions: Array, raise_if_over: Callable[[], None] = lambda: None) -> bool:
        """
        Return True if flights (U, N+2, 2) in m clear zones, fence and each other at any time.

        :param raise_if_over: called now and then; what it raises is passed on.
        """
        clear = not self.airspace.far
        for limit in self.limits:
            if isinstance(limit, LineLimit):
                raise_if_over()
                clear = clear and limit.is_clear(positions)
        if clear:
            return True
        # Curves may be clear while their control points are not, and far zones have no limits.
        try:
            Clearance(self.scenario, Curve(self.scenario, positions)).validate()
        except PlanError:
            return False
        return True

    def retract(self, positions: Array, powers: Array) -> tuple[Array, Array]:
        """Return positions (U, N+2, 2) in m and powers (U, N) in W, retracted by every limit."""
        for limit in self.limits:
            positions, powers = limit.retract(positions, powers)
        return positions, powers

    def retract_powers(self, positions: Array, powers: Array) -> Array:
        """Return powers (U, N) in W, retracted by every limit of powers."""
        for limit in self.limits:
            if not limit.constrains_positions:
                _, powers = limit.retract(positions, powers)
        return powers
