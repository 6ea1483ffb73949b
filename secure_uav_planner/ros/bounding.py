"""The proof of how good the last plan is, in the background."""

from collections.abc import Callable

from .latest import Latest
from .text import with_type
from ..bound import upper_bound
from ..plan.bound import Bound, Progress
from ..plan.plan import Plan


class Bounding:
    """
    Computes the upper bound of one plan at a time, in a thread of its own.

    :param then: called in that thread with the plan and its bound, unless another plan is wanted
        by then, or none.
    :param failed: called in that thread with a text if the bound cannot be computed.
    """

    def __init__(self, then: Callable[[Plan, Bound], None], failed: Callable[[str], None]) -> None:
        self._then = then
        self._failed = failed
        self._wanted: Plan | None = None
        self._thread = Latest(self._bound)

    def start(self, plan: Plan) -> None:
        """Compute the bound of a plan, and no other one any more."""
        self._wanted = plan
        self._thread.put(plan)

    def cancel(self) -> None:
        """Stop the computation that is under way, if there is one, within about 0.5 s."""
        self._wanted = None

    def close(self, timeout: float) -> bool:
        """Stop finally; return whether the thread has ended within the timeout in s."""
        self.cancel()
        return self._thread.close(timeout)

    def _bound(self, plan: Plan) -> None:
        def is_unwanted(_: Progress) -> bool:
            return self._wanted is not plan

        if self._wanted is not plan:
            return
        try:
            bound = upper_bound(plan.scenario, objective=plan.objective, plan=plan,
                                on_progress=is_unwanted)
            if self._wanted is plan:
                self._then(plan, bound)
        except Exception as error:
            self._failed(f'the bound cannot be computed: {with_type(error)}')
