"""A scenario with what follows from it: the first thing that a call makes."""

from collections.abc import Callable, Sequence
from functools import cached_property
from itertools import pairwise

import numpy as np

from .airspace import Airspace, Clearance, VisibilityGraph
from .curve import Curve
from .grid import Grid
from .limits import build_limits, Limit, LineLimit, measure_energies, NormLimit
from ..errors import PlanError
from ..mission.kinematics import UTILISATION_TOLERANCE
from ..mission.scenario import Array, Scenario

_DISTANCES = (0.2, 0.01)  # Distances of routes from obstacles in steps, tried in this order.
_INSIDE = 0.1  # Distance of free places from the fence, in steps.


class Problem:
    """
    A scenario with data derived from it, each computed at its first use and then kept.

    :param scenario: the mission.
    :ivar airspace: obstacles of the mission.
    :ivar grid: grid with the mission's own slots.
    """

    def __init__(self, scenario: Scenario) -> None:
        self.scenario = scenario
        self.airspace = Airspace(scenario)
        self.grid = Grid(self.airspace, scenario.slots)
        self._graphs: dict[tuple[float, float], VisibilityGraph] = {}

    @cached_property
    def limits(self) -> tuple[Limit, ...]:
        """Limits of the scenario, on its own grid."""
        return build_limits(self.grid)

    def validate(self, positions: Array, powers: Array) -> None:
        """
        Validate all limits except zones, fence and separation, which Clearance checks.

        :raises PlanError: when the plan breaks a limit.
        """
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
        """Return True if flights (U, N+2, 2) in m always clear zones, fence and each other."""
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

    def retract(self, positions: Array) -> Array:
        """Return nearly feasible positions (U, N+2, 2) in m made feasible by limit after limit."""
        for limit in self.limits:
            positions = limit.retract(positions)
        return positions

    def retract_powers(self, powers: Array) -> Array:
        """Return nearly feasible powers (U, N) in W made feasible by limit after limit."""
        for limit in self.limits:
            powers = limit.retract_powers(powers)
        return powers

    def find_free_places(self, places: Array, raise_if_over: Callable[[], None]) -> Array:
        """
        Return places (..., U, 2) in m moved inside the fence's hull, then out of obstacles.

        Places are first kept _INSIDE steps inside the hull, then _DISTANCES[0] from obstacles.
        """
        normals, offsets = self.airspace.hull
        free = places.copy()
        for uav, step in enumerate(self.grid.step_lengths.tolist()):
            raise_if_over()
            graph = self._get_graph(uav, _DISTANCES[0])
            for index in np.ndindex(places.shape[:-2]):
                entry = (*index, uav)
                free[entry] = _move_inside(free[entry], normals, offsets - _INSIDE * step)
                if graph is not None:
                    free[entry] = graph.find_nearest_free(free[entry])
        return free

    def find_routes(self, uav: int, places: Sequence[Array],
                    most: int) -> tuple[VisibilityGraph | None, list[list[Array]]]:
        """
        Return the routes of a UAV from each place to the next.

        They keep the largest distance of _DISTANCES from obstacles at which each pair of places
        has a route. If there is none, some lists are empty.

        :param uav: index of the UAV, which flies between `places`, (2,) each in m.
        :param most: largest number of routes between two places.
        :return: the visibility graph and, for each pair of successive places, its routes by
            VisibilityGraph.find_routes. Without obstacles: None, and empty lists.
        """
        routes: list[list[Array]] = [[] for _ in places[1:]]
        for distance in _DISTANCES:
            graph = self._get_graph(uav, distance)
            if graph is None:
                break
            routes = [graph.find_routes(begin, end, most) for begin, end in pairwise(places)]
            if all(routes):
                break
        return graph, routes

    def _get_graph(self, uav: int, distance: float) -> VisibilityGraph | None:
        """Return a UAV's graph, `distance` step lengths from obstacles; None without obstacles."""
        if not self.airspace.obstacles[uav]:
            return None
        # UAVs that fly as high and as fast share a graph.
        key = self.scenario.uavs[uav].altitude, distance * float(self.grid.step_lengths[uav])
        if key not in self._graphs:
            self._graphs[key] = VisibilityGraph(self.airspace, uav, key[1])
        return self._graphs[key]


def _move_inside(place: Array, normals: Array, offsets: Array) -> Array:
    """Return a place (2,) after up to 100 projections into half-planes normals @ x <= offsets."""
    for _ in range(100):
        beyond = normals @ place - offsets
        if (beyond <= 0).all():
            break
        worst = int(beyond.argmax())
        place = place - beyond[worst] * normals[worst]
    return place
