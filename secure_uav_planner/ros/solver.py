"""The thread in which the planner solves, one job after another."""

from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor, wait
from dataclasses import dataclass, field
from functools import partial
import threading
from typing import Any, TypeAlias

from ..errors import StoppedError
from ..plan.plan import Iteration


@dataclass(eq=False)
class Job:
    """
    A solve, or the proof of a bound.

    :param cancelled: the text of its error after a cancel.
    :param is_solve: otherwise it is the proof of a bound.
    :ivar stop: set when its result is no longer wanted.
    :ivar progress: the last iteration of a solve.
    """

    cancelled: str
    is_solve: bool
    stop: threading.Event = field(default_factory=threading.Event)
    progress: Iteration | None = None

    def check(self) -> None:
        """Raise a StoppedError if the result is no longer wanted."""
        if self.stop.is_set():
            raise StoppedError(self.cancelled)


Work: TypeAlias = Callable[[Job], Any]
"""Called in the solver's thread; what it returns is the result of its job."""

Result: TypeAlias = Callable[[], Any]
"""Returns what the work of a job has returned, or raises what it has raised."""


class SolverThread:
    """
    Runs the newest job; an older one is stopped first, and its result is dropped.

    All methods and `job` belong to the state thread.

    :param post: called with a function that is to run in the state thread.
    :ivar job: the Job that is under way, or None.
    """

    def __init__(self, post: Callable[[Callable[[], None]], None]) -> None:
        self._post = post
        self._pool = ThreadPoolExecutor(1, 'solver')
        self._last: 'Future[Any]' = Future()
        self._last.set_result(None)
        self.job: Job | None = None

    @property
    def is_solving(self) -> bool:
        """Whether a solve is under way."""
        return self.job is not None and self.job.is_solve

    def start(self, work: Work, then: Callable[[Result], None], cancelled: str = 'cancelled',
              is_solve: bool = True) -> None:
        """
        Start a job, after the one that is under way has stopped.

        :param then: called with the Result in the state thread, unless a later job was started.
        """
        self.stop()
        job = self.job = Job(cancelled, is_solve)

        def finish(future: 'Future[Any]') -> None:
            def result() -> Any:
                job.check()  # A cancel that came after the work, too.
                return future.result()

            if job is self.job:
                self.job = None
                then(result)

        self.run(partial(work, job)).add_done_callback(
            lambda future: self._post(partial(finish, future)))

    def run(self, work: Callable[[], Any]) -> 'Future[Any]':
        """Run a function in the solver's thread, after what was started before."""
        self._last = self._pool.submit(work)
        return self._last

    def stop(self) -> None:
        """Stop the job that is under way, and drop its result."""
        if self.job is not None:
            self.job.stop.set()
            self.job = None

    def close(self, timeout: float) -> bool:
        """Stop for good; return whether the thread has ended within the timeout in s."""
        self.stop()
        self._pool.shutdown(wait=False)
        return not wait([self._last], timeout).not_done
