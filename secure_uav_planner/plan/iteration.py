"""How a method went: its iterations, and why it stopped."""

from dataclasses import dataclass
from typing import get_args, Literal, TypeAlias

Status: TypeAlias = Literal['given', 'converged', 'iteration_limit', 'time_limit', 'cancelled',
                            'numerical_trouble']
"""Why a method stopped; the plan is feasible whatever the reason."""

STATUS_TEXTS: dict[Status, str] = {
    'given': 'made by hand',
    'converged': 'converged',
    'iteration_limit': 'stopped at the iteration limit',
    'time_limit': 'stopped at time_limit with the best feasible plan so far',
    'cancelled': 'cancelled, with the best feasible plan so far',
    'numerical_trouble': 'a step of the solver failed, the best feasible plan is kept',
}
"""What each status means, in words."""

STATUSES: tuple[Status, ...] = get_args(Status)


@dataclass(frozen=True)
class Iteration:
    """
    One iteration of a method, for callbacks and Plan.history.

    :param number: counts from 1; 0 is the starting point.
    :param step: what was optimised: 'start', 'power', 'trajectory' or 'joint'.
    :param rate: the objective of the best feasible plan so far, mean over slots, bit/s/Hz.
    :param elapsed: since the call of solve, in s.
    :param solver_time: of `elapsed`, spent so far inside Clarabel, or for 'joint' on solving for
        Newton steps, in s.
    """

    number: int
    step: str
    rate: float
    elapsed: float
    solver_time: float

    @property
    def guaranteed_rate(self) -> float:
        """Rate under its name of version 0.1."""
        return self.rate
