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
        self._changed = threading.Condition()
        self._waiting: tuple[Any, threading.Event] | None = None
        self._closed = False
        self._thread: threading.Thread | None = None
        self.newest: Any = None

    def put(self, item: Any) -> threading.Event:
        """Queue an item; return an event that is set when it is done, never if it is replaced."""
        done = threading.Event()
        with self._changed:
            if self._closed:
                return done
            self.newest, self._waiting = item, (item, done)
            if self._thread is None:
                # A daemon thread does not keep a stopped node running.
                self._thread = threading.Thread(target=self._run, daemon=True, name='latest')
                self._thread.start()
            self._changed.notify()
        return done

    def cancel(self) -> None:
        """Note that no item is wanted any more."""
        self.newest = None

    def close(self, timeout: float) -> bool:
        """Start no further item; return whether the thread has ended within the timeout in s."""
        with self._changed:
            self._closed, self.newest = True, None
            self._changed.notify()
        if self._thread is None:
            return True
        self._thread.join(timeout)
        return not self._thread.is_alive()

    def _run(self) -> None:
        while True:
            with self._changed:
                self._changed.wait_for(lambda: self._waiting or self._closed)
                if self._closed:
                    return
                (item, done), self._waiting = self._waiting, None
            self._work(item)
            done.set()


class Bounding(LatestOnlyWorker):
    """Computes the upper bound of a plan, unless another one is put or it is cancelled."""

    def __init__(self, then: Callable[[Plan, Bound], None], failed: Callable[[str], None]) -> None:
        super().__init__(self._bound)
        self._then, self._failed = then, failed

    def _bound(self, plan: Plan) -> None:
        if self.newest is not plan:
            return
        try:
            bound = upper_bound(plan.scenario, objective=plan.objective, plan=plan,
                                on_progress=lambda _: self.newest is not plan)
            if self.newest is plan:
                self._then(plan, bound)
        except Exception as error:
            self._failed(f'the bound cannot be computed: {with_type(error)}')
