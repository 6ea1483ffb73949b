"""Work in threads of their own: of which only the newest counts, and the bound of a plan."""

from collections.abc import Callable
import threading
from typing import Any

from ..bound import upper_bound
from ..errors import with_type
from ..plan.bound import Bound
from ..plan.plan import Plan


class LatestOnlyWorker:
    """
    Processes one item at a time in a thread; of several waiting items only the newest is kept.

    The work must not raise. `newest` is the last item, or None if none is wanted any more.
    """

    def __init__(self, work: Callable[[Any], None]) -> None:
        self._work = work
        self._turn = threading.Lock()
        self._closed = False
        self.newest: Any = None

    def put(self, item: Any) -> threading.Thread:
        """Return the thread in which an item is processed, unless another one replaces it."""
        self.newest = item
        # A daemon thread does not keep a stopped node running.
        thread = threading.Thread(target=self._run, args=(item,), daemon=True, name='latest')
        thread.start()
        return thread

    def cancel(self) -> None:
        """Note that no item is wanted any more."""
        self.newest = None

    def close(self, timeout: float) -> bool:
        """Start no further item; return whether the last one has ended within the timeout in s."""
        self._closed, self.newest = True, None
        ended = self._turn.acquire(timeout=timeout)
        if ended:
            self._turn.release()
        return ended

    def _run(self, item: Any) -> None:
        with self._turn:
            if item is self.newest and not self._closed:
                self._work(item)


class Bounding(LatestOnlyWorker):
    """Computes the upper bound of a plan, unless another one is put or it is cancelled."""

    def __init__(self, then: Callable[[Plan, Bound], None], failed: Callable[[str], None]) -> None:
        super().__init__(self._bound)
        self._then, self._failed = then, failed

    def _bound(self, plan: Plan) -> None:
        try:
            bound = upper_bound(plan.scenario, objective=plan.objective, plan=plan,
                                on_progress=lambda _: self.newest is not plan)
            if self.newest is plan:
                self._then(plan, bound)
        except Exception as error:
            self._failed(f'the bound cannot be computed: {with_type(error)}')
