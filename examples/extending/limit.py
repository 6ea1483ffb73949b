"""
A limit of your own, without a change of the package: no UAV leaves the reach of a base.

It checks plans and retracts iterates by itself, and says which vectors the kernel keeps short: the
offsets of the points of flights from the base. Run it by `python -m examples.extending.limit`.
"""

import numpy as np
from secure_uav_planner import Eavesdropper, Scenario, solve, Uav
from secure_uav_planner.errors import PlanError
from secure_uav_planner.model import limits
from secure_uav_planner.model.kernel import core
from secure_uav_planner.model.limits.base import compile_vectors, Limit

BASE, REACH = np.array([200.0, 0.0]), 150.0  # m


class RangeLimit(Limit):
    """No UAV is farther from the base than its reach."""

    def validate(self, positions, powers):
        """Raise a PlanError if a point of the flight is out of reach."""
        farthest = np.linalg.norm(positions - BASE, axis=-1).max()
        if farthest > REACH + 1e-6:
            raise PlanError(f'a UAV is {farthest:.9g} m away; at most {REACH} m are allowed')

    def shape_start(self, positions):
        """Keep a first flight, such as fly-hover-fly, in reach."""
        return self.retract(positions)

    def retract(self, positions):
        """Move points that are out of reach to the edge."""
        offsets = positions - BASE
        excess = np.linalg.norm(offsets, axis=-1, keepdims=True) / REACH
        return BASE + offsets / np.maximum(excess, 1.0)

    @property
    def compiled(self):
        """Make the kernel's limit of the length of offsets from the base, in the grid's units."""
        grid = self.grid
        points = np.arange(len(grid.fixed), (grid.slots + 1) * len(grid.fixed))[:, None]
        base = (BASE - grid.origin) / grid.length
        vectors = compile_vectors(grid, points, 1.0, np.tile(-base, (len(points), 1)))
        return core.Limit(vectors, np.tile(grid.fixed, grid.slots),
                          np.full(len(points), (REACH / grid.length)**2))


def distance_from_base(duration):
    """Plan a mission beside the base; return the largest distance from it in m."""
    plan = solve(Scenario(
        ground_node=(0.0, 0.0), eavesdroppers=(Eavesdropper((200.0, 0.0), error_radius=10.0),),
        uavs=tuple(Uav(name, (150.0, 100.0), (150.0, -100.0), altitude, max_speed=10.0)
                   for name, altitude in (('sender', 100.0), ('jammer', 110.0))),
        duration=duration, slots=60))
    return np.linalg.norm(plan.positions - BASE, axis=-1).max()


if __name__ == '__main__':
    print(f'without the limit: {distance_from_base(60.0):.1f} m from the base')
    limits.LIMITS = (*limits.LIMITS, RangeLimit)
    print(f'with the limit: {distance_from_base(61.0):.1f} m from the base')
