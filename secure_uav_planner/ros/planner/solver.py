"""The thread in which the planner solves and proves bounds, one job after another."""

from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor, wait
from dataclasses import dataclass, field
from functools import partial
import threading
import time
from typing import Any, TypeAlias

from .settings import PlannerSettings
from ...bound import shortest_duration, upper_bound
from ...errors import StoppedError
from ...mission.scenario import Scenario
from ...optimize import solve
from ...plan.plan import Iteration, Plan
from ...plan.results import Bound

_PROGRESS_PERIOD = 0.1  # Least time [s] between two calls of on_progress.


@dataclass(eq=False)
class Job:
    """
    A solve, or the proof of a bound.

    :param on_progress: called from time to time during a solve.
    :param cancelled: text of the job's error after a cancel.
    :param is_solve: True for a solve, False for the proof of a bound.
    :ivar stop: set when the result of the job is no longer wanted.
    :ivar progress: the last Iteration of a solve.
    """

    on_progress: Callable[[], object]
    cancelled: str
    is_solve: bool
    stop: threading.Event = field(default_factory=threading.Event)
    progress: Iteration | None = None
    _posted: float = 0.0  # Time [s] of the last call of on_progress, by time.monotonic.

    def raise_if_cancelled(self) -> None:
        """Raise a StoppedError if the result is no longer wanted."""
        if self.stop.is_set():
            raise StoppedError(self.cancelled)

    def solve(self, scenario: Scenario, settings: PlannerSettings, time_limit: float | None,
              initial: Plan | None, bits: float = 0.0) -> Plan:
        """
        Return the plan of a mission by the method and for the objective of the parameters.

        :param initial: a Plan from which the method begins, or None; not used with `bits`.
        :param bits: amount [bit/Hz] that the shortest flight is to deliver, found without the
            parameter `method`; 0 keeps the duration of the scenario.
        :raises StoppedError: if the job was stopped.
        """
        def on_iteration(iteration: Iteration) -> bool:
            """Keep the progress, and report it at intervals; return True to stop the solve."""
            self.progress, now = iteration, time.monotonic()
            if iteration.number == 0 or now - self._posted > _PROGRESS_PERIOD:
                self._posted = now
                self.on_progress()
            return self.stop.is_set()

        objective = settings.objective
        if bits:
            plan = shortest_duration(scenario, bits, objective=objective, time_limit=time_limit,
                                     on_progress=on_iteration)
        else:
            plan = solve(scenario, method=settings.method, objective=objective,
                         time_limit=time_limit, initial=initial, on_iteration=on_iteration)
        self.raise_if_cancelled()
        return plan

    def prove_bound(self, plan: Plan) -> Bound:
        """Return a proved upper bound of the rates of all plans for the mission of `plan`."""
        return upper_bound(plan.scenario, objective=plan.objective, plan=plan,
                           on_progress=lambda _: self.stop.is_set())


Work: TypeAlias = Callable[[Job], Any]
"""Called in the solver's thread; returns the result of the job."""

Result: TypeAlias = Callable[[], Any]
"""Returns the result of a job, or raises its error."""


class SolverThread:
    """
    Runs the newest job; an older one is stopped first, and its result is dropped.

    Files are saved in a second thread, so that a save does not wait for a solve. All methods and
    `job` belong to the state thread.

    :param post: called with a function that is to run in the state thread.
    :param on_progress: called in the state thread from time to time during a solve.
    :ivar job: the present Job, or None.
    """

    def __init__(self, post: Callable[[Callable[[], None]], None],
                 on_progress: Callable[[], None]) -> None:
        self._post, self._on_progress = post, partial(post, on_progress)
        self._pool = ThreadPoolExecutor(1, 'solver')
        self._saver = ThreadPoolExecutor(1, 'saver')
        self._last: 'Future[Any]' = Future()  # Future of the newest work.
        self._last.set_result(None)
        self._last_save = self._last
        self.job: Job | None = None

    @property
    def is_solving(self) -> bool:
        """Whether the present job is a solve."""
        return self.job is not None and self.job.is_solve

    @property
    def progress(self) -> Iteration | None:
        """Last iteration of the present solve, or None."""
        return None if self.job is None else self.job.progress

    def cancel(self) -> bool:
        """Cancel the present solve, whose result is then an error; return False if none runs."""
        if self.job is None or not self.job.is_solve:
            return False
        self.job.stop.set()
        return True

    def start(self, work: Work, then: Callable[[Result], None], cancelled: str = 'cancelled',
              is_solve: bool = True) -> None:
        """
        Stop the present job and drop its result; then start a new job in the solver's thread.

        :param work: called with the Job in the solver's thread.
        :param then: called in the state thread with the Result, a function that returns the result
            or raises its error, unless this job was stopped or a later one started.
        :param cancelled: text of the job's error after a cancel.
        :param is_solve: True for a solve, which can be cancelled; False for the proof of a bound.
        """
        self.stop()
        job = self.job = Job(self._on_progress, cancelled, is_solve)

        def finish(future: 'Future[Any]') -> None:
            """Call `then`, unless this job was stopped or a later one started."""
            def result() -> Any:
                job.raise_if_cancelled()  # A cancel may come after the work and before this.
                return future.result()

            if job is self.job:
                self.job = None
                then(result)

        self._last = self._pool.submit(partial(work, job))
        self._last.add_done_callback(lambda future: self._post(partial(finish, future)))

    def save(self, work: Callable[[], None]) -> None:
        """Run a function that writes a file, after all earlier ones, beside a solve."""
        self._last_save = self._saver.submit(work)

    def stop(self) -> None:
        """Stop the present job, and drop its result."""
        if self.job is not None:
            self.job.stop.set()
            self.job = None

    def close(self, timeout: float) -> bool:
        """Stop for good; return True if both threads have ended within the timeout [s]."""
        self.stop()
        for pool in (self._pool, self._saver):
            pool.shutdown(wait=False)
        return not wait([self._last, self._last_save], timeout).not_done
