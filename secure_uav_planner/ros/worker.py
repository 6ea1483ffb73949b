"""Solving in a separate thread, one scenario at a time."""

from collections.abc import Callable, Iterator
from concurrent.futures import Future, InvalidStateError
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
import math
import threading
import time
from typing import Any, TypeAlias

from ..errors import BusyError, StoppedError, SupersededError
from ..mission.scenario import Scenario
from ..optimize import solve
from ..plan.plan import Iteration, Plan

_POLL = 0.02

Task: TypeAlias = Callable[[Callable[..., Plan]], Any]
"""Called in the solver's thread with the function solve; what it returns is the job's result."""


@dataclass
class _Job:
    """One solve, its thread and what comes of it."""

    cancel: threading.Event
    cancelled: str
    thread: threading.Thread | None = None
    progress: Iteration | None = None
    future: 'Future[Any]' = field(default_factory=Future)

    def stop(self, error: Exception) -> None:
        """Let the thread end soon; its future has the error at once."""
        self.cancel.set()
        with suppress(InvalidStateError):  # It already has a result or an error.
            self.future.set_exception(error)


class Worker:
    """
    Runs one solve at a time: for requests, and between them in the background.

    A request reserves the worker. This stops a solve in the background, and none starts there
    until it is answered. on_iteration is called in the solver's thread, at first before it solves.
    """

    def __init__(self, on_iteration: Callable[[], None]) -> None:
        self._on_iteration = on_iteration
        self._reservation = threading.Lock()
        self._request_cancel = threading.Event()
        self._closed = False
        self._lock = threading.Lock()
        self._job: _Job | None = None

    @property
    def busy(self) -> bool:
        """Return whether a solve is under way, or a request has not been answered yet."""
        job = self._job
        return self._reservation.locked() or job is not None and not job.future.done()

    @property
    def progress(self) -> Iteration | None:
        """Return the latest iteration of the solve that is under way, or None."""
        job = self._job
        return None if job is None or job.future.done() else job.progress

    @contextmanager
    def reserved(self, patience: float | None = None) -> Iterator[None]:
        """
        Reserve the worker within the with block, and stop a solve in the background.

        :raises BusyError: if it is already reserved, or that solve does not stop in `patience` s.
        :raises StoppedError: if the request is cancelled during the wait.
        """
        if not self._reservation.acquire(blocking=False):
            raise BusyError('a solve is under way')
        try:
            self._request_cancel = threading.Event()
            with self._lock:
                job = self._job
                if job is not None:
                    job.stop(SupersededError('a request stopped the replan'))
            until = math.inf if patience is None else time.monotonic() + patience
            while job is not None and job.thread.is_alive():
                job.thread.join(_POLL)
                if self._closed:
                    raise StoppedError('the planner is stopping')
                if self._request_cancel.is_set():
                    raise StoppedError('cancelled')
                if time.monotonic() > until:
                    raise BusyError('the solve of a replan has not stopped in time; ask again')
            yield
        finally:
            self._reservation.release()

    def start(self, task: Task, then: Callable[['Future[Any]'], None] | None = None
              ) -> 'Future[Any]':
        """
        Start a solve for the reservation, or in the background if `then` is given.

        :param then: called with the future at the end of the solver's thread, except when the node
            is stopping. A join of the thread therefore also waits for this call.
        :raises BusyError: if a solve is under way, or in the background the worker is reserved.
        :raises StoppedError: if the request has been cancelled, or the node is stopping.
        """
        with self._lock:
            if self._closed:
                raise StoppedError('the planner is stopping')
            if self._job is not None and self._job.thread.is_alive() or (
                    then is not None and self._reservation.locked()):
                raise BusyError('a solve is under way')
            job = (_Job(self._request_cancel, 'cancelled') if then is None else
                   _Job(threading.Event(), 'the replan was cancelled'))
            if job.cancel.is_set():
                raise StoppedError(job.cancelled)
            # A daemon thread does not keep a stopped node running.
            job.thread = threading.Thread(
                target=self._run, args=(job, task, then), daemon=True, name='solver')
            self._job = job
            job.thread.start()
            return job.future

    def cancel(self) -> bool:
        """Stop the solve or the request that is under way; return whether there is one."""
        with self._lock:
            busy = self.busy
            self._request_cancel.set()
            if self._job is not None:
                self._job.cancel.set()
        return busy

    def close(self, timeout: float) -> bool:
        """Stop finally; futures get a StoppedError. Return whether the thread has ended."""
        with self._lock:
            self._closed = True
            job = self._job
            if job is None:
                return True
            job.stop(StoppedError('the planner is stopping'))
        job.thread.join(timeout)
        return not job.thread.is_alive()

    def _run(self, job: _Job, task: Task, then: Callable[['Future[Any]'], None] | None) -> None:
        def on_iteration(iteration: Iteration) -> bool:
            if not job.cancel.is_set():
                job.progress = iteration
                self._on_iteration()
            return job.cancel.is_set()

        def solved(scenario: Scenario, **options: Any) -> Plan:
            plan = solve(scenario, on_iteration=on_iteration, **options)
            if plan.status == 'cancelled':
                raise StoppedError(job.cancelled)
            return plan

        try:
            self._on_iteration()
            settle, value = job.future.set_result, task(solved)
        except Exception as error:
            settle, value = job.future.set_exception, error
        with suppress(InvalidStateError):
            settle(value)
        if then is not None and not self._closed:
            then(job.future)
