"""Plan how two or more UAVs fly and radiate so that a transmission stays secret."""

from .errors import PlanningError
from .optimize import fly_hover_fly, METHODS, solve
from .plan import Iteration, Plan
from .scenario import Eavesdropper, Scenario, Uav

__all__ = ['Eavesdropper', 'Iteration', 'METHODS', 'Plan', 'PlanningError', 'Scenario', 'Uav',
           'fly_hover_fly', 'solve']
