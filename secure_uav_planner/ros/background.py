"""Work in threads of their own: of which only the newest counts, and the bound of a plan."""

from collections.abc import Callable
import threading
from typing import Any

from ..bound import upper_bound
from ..errors import with_type
from ..plan.bound import Bound, Progress
from ..plan.plan import Plan


class LatestOnlyWorker:
    """
    Processes one item at a time in a thread; of several waiting items only the newest is kept.

    :param work: called in the thread with each item; it must not raise.
    """

    def __init__(self, work: Callable[[Any], None]) -> None:
        self._work = work
        self._changed = threading.Condition()
        self._waiting: list[tuple[Any, threading.Event]] = []
        self._closed = False
        self._thread: threading.Thread | None = None

    def put(self, item: Any) -> threading.Event:
        """Queue an item; return an event that is set when it is done, never if it is replaced."""
        done = threading.Event()
        with self._changed:
            self._waiting = [(item, done)]
            if self._thread is None and not self._closed:
                # A daemon thread does not keep a stopped node running.
                self._thread = threading.Thread(target=self._run, daemon=True, name='latest')
                self._thread.start()
            self._changed.notify()
        return done

    def close(self, timeout: float) -> bool:
        """Start no further item; return whether the thread has ended within the timeout in s."""
        with self._changed:
            self._closed = True
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
                (item, done), = self._waiting
                self._waiting = []
            self._work(item)
            done.set()


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
        self._thread = LatestOnlyWorker(self._bound)

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
