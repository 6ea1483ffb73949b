"""
Power control on a fixed trajectory: the powers of problem (P2) alone, from several levels.

Powers have local optima, which differ in how much the jammers send. The levels are improved side
by side, on a grid of few slots and then on finer ones.
"""

from dataclasses import replace

import numpy as np

from .starts import strictly_feasible
from .stepper import COARSE_MU, COARSE_SLOTS, Stepper
from ..initial import constant_powers
from ...plan.plan import Status

LEVELS = (1.0, 0.1, 0.01, 0.001)  # Of jamming, in shares of the average power.
STEPS = 20  # Newton steps from each level on the coarse grid.
MU = 0.03  # The barrier parameter to begin with.
SHARE = 0.01  # By which powers are moved into the interior.


def improve_powers(stepper: Stepper, least: float = 0.0) -> Status:
    """
    Improve the powers of a Stepper's search, and nothing else; return the status of the best.

    :param least: a mean rate in nats; where no level reaches it on the coarse grid, and the full
        grid is finer, none is finished.
    :raises NumericalError: when no step can be computed from any level.
    """
    search = stepper.search
    search.try_less_jamming()
    stepper.grid = replace(stepper.grid, fixed=np.ones_like(stepper.grid.fixed))
    grid = stepper.grid.divided(min(stepper.grid.slots, COARSE_SLOTS))
    levels = [constant_powers(search.scenario, 1.0, share) for share in LEVELS]
    barrier = stepper.barrier(grid, np.array([
        strictly_feasible(grid, search.positions, powers, SHARE)
        for powers in (search.powers, *levels)]), MU)
    stepper.advance(barrier, STEPS, COARSE_MU)
    if grid.slots < stepper.grid.slots and barrier.rates().max() < least:
        return 'converged'
    return stepper.finish(stepper.on_full_grid(grid, barrier.x, barrier.mu))
