"""Solves off the executor's threads, one at a time."""

from collections.abc import Callable, Iterator
from concurrent.futures import Future, InvalidStateError
from contextlib import contextmanager
import threading
import time
from typing import Any

from ..errors import BusyError, StoppedError, SupersededError
from ..optimize import solve
from ..plan import Iteration, Plan
from ..scenario import Scenario

_POLL = 0.02


class _Job:
    """One solve and the thread it runs in."""

    def __init__(self, cancel: threading.Event) -> None:
        self.cancel = cancel
        self.future: 'Future[Plan]' = Future()
        self.progress: Iteration | None = None
        self.thread: threading.Thread | None = None


class Worker:
    """
    Runs one solve at a time: those of requests, and in between those in the background.

    A request reserves the worker, which stops a solve in the background; while it is reserved,
    none in the background begins.

    :param on_iteration: called in the solver's thread after every iteration.
    """

    def __init__(self, on_iteration: Callable[[], None]) -> None:
        self._on_iteration = on_iteration
        self._reservation = threading.Lock()
        self._request_cancel = threading.Event()
        self._closed = threading.Event()
        self._lock = threading.Lock()
        self._job: _Job | None = None

    @property
    def busy(self) -> bool:
        """Return whether a solve is under way, or a request has not been answered yet."""
        return self._reservation.locked() or self._solving

    @property
    def _solving(self) -> bool:
        job = self._job
        return job is not None and not job.future.done()

    @property
    def progress(self) -> Iteration | None:
        """Return the latest iteration of the solve under way, or None."""
        job = self._job
        return None if job is None or job.future.done() else job.progress

    @contextmanager
    def reserved(self, patience: float | None = None) -> Iterator[None]:
        """
        Keep all other solves away within the with block, and stop the one under way.

        :param patience: how long to wait for that one's thread, in s, or None for no limit.
        :raises BusyError: when the worker is reserved already, or the patience has run out.
        :raises StoppedError: when cancelled while waiting.
        """
        if not self._reservation.acquire(blocking=False):
            raise BusyError('a solve is under way')
        try:
            self._request_cancel = threading.Event()
            self._stop_background(patience)
            yield
        finally:
            self._reservation.release()

    def start(self, scenario: Scenario, then: Callable[['Future[Plan]'], None] | None = None,
              **options: Any) -> 'Future[Plan]':
        """
        Start a solve: that of the reservation, or one in the background if `then` is given.

        :param then: called with the future in the solver's thread, so that whoever waits for
            the thread waits for this, too; not when the node is stopping.
        :param options: of solve: method, time_limit, initial.
        :return: a concurrent.futures.Future of the Plan.
        :raises BusyError: when one is under way, or a request keeps those in the background away.
        :raises StoppedError: when the request has been cancelled, or the node is stopping.
        """
        with self._lock:
            if self._closed.is_set():
                raise StoppedError('the planner is stopping')
            if self._job is not None and self._job.thread.is_alive() or (
                    then is not None and self._reservation.locked()):
                raise BusyError('a solve is under way')
            job = _Job(self._request_cancel if then is None else threading.Event())
            if job.cancel.is_set():
                raise StoppedError('cancelled')
            # A daemon, so that a solver deep in its work cannot keep a stopped node alive.
            job.thread = threading.Thread(
                target=self._run, args=(job, scenario, then, options), daemon=True,
                name='solver')
            self._job = job
            job.thread.start()
            return job.future

    def cancel(self) -> bool:
        """Ask the solve under way to stop; return whether there is one."""
        with self._lock:
            busy = self._solving
            self._request_cancel.set()
            if self._job is not None:
                self._job.cancel.set()
        return busy

    def close(self, timeout: float) -> bool:
        """Stop for good: whoever waits gets StoppedError; return whether the thread ended."""
        self._closed.set()
        with self._lock:
            job = self._job
            if job is None:
                return True
            job.cancel.set()
            _settle(job.future.set_exception, StoppedError('the planner is stopping'))
        job.thread.join(timeout)
        return not job.thread.is_alive()

    def _stop_background(self, patience: float | None) -> None:
        with self._lock:
            job = self._job
            if job is None:
                return
            job.cancel.set()
            _settle(job.future.set_exception, SupersededError('a request stopped the replan'))
        until = None if patience is None else time.monotonic() + patience
        while job.thread.is_alive():
            job.thread.join(_POLL)
            if self._closed.is_set():
                raise StoppedError('the planner is stopping')
            if self._request_cancel.is_set():
                raise StoppedError('cancelled')
            if until is not None and time.monotonic() > until:
                raise BusyError('the solve of a replan has not stopped in time; ask again')

    def _run(self, job: _Job, scenario: Scenario,
             then: Callable[['Future[Plan]'], None] | None, options: dict[str, Any]) -> None:
        def on_iteration(iteration: Iteration) -> bool:
            if not job.cancel.is_set():
                job.progress = iteration
                self._on_iteration()
            return job.cancel.is_set()

        try:
            plan = solve(scenario, on_iteration=on_iteration, **options)
        except Exception as error:
            _settle(job.future.set_exception, error)
        else:
            _settle(job.future.set_result, plan)
        if then is not None and not self._closed.is_set():
            then(job.future)


def _settle(settle: Callable[[Any], None], value: Any) -> None:
    try:
        settle(value)
    except InvalidStateError:
        pass  # it is settled already
