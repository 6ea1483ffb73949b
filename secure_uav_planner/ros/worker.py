"""Solves off the executor's threads, one at a time."""

from concurrent.futures import CancelledError, Future, InvalidStateError
import threading

from ..optimize import solve


class Busy(RuntimeError):
    """A solve is under way."""


class Worker:
    """
    One solve at a time in a thread of its own.

    :param on_iteration: called in that thread with every Iteration.
    """

    def __init__(self, on_iteration):
        self._on_iteration = on_iteration
        self._lock = threading.Lock()
        self._cancel = threading.Event()
        self._future = None
        self._thread = None

    @property
    def busy(self):
        """Whether a solve is under way."""
        return self._future is not None and not self._future.done()

    def start(self, scenario, **options):
        """
        Start a solve.

        :param options: of solve: method, time_limit, initial.
        :return: a concurrent.futures.Future of the Plan.
        :raises Busy: when one is under way.
        """
        with self._lock:
            if self._thread is not None and self._thread.is_alive():
                raise Busy('a solve is under way')
            self._cancel.clear()
            self._future = Future()
            # A daemon, so that a solver deep in its work cannot keep a stopped node alive.
            self._thread = threading.Thread(
                target=self._run, args=(self._future, scenario, options), daemon=True,
                name='solver')
            self._thread.start()
            return self._future

    def cancel(self):
        """Ask the solve under way to stop; return whether there is one."""
        busy = self.busy
        self._cancel.set()
        return busy

    def close(self, timeout):
        """Stop for good: whoever waits gets CancelledError; return whether the thread ended."""
        self._cancel.set()
        with self._lock:
            if self.busy:
                _settle(self._future.set_exception, CancelledError('the planner is stopping'))
            if self._thread is None:
                return True
            self._thread.join(timeout)
            return not self._thread.is_alive()

    def _run(self, future, scenario, options):
        def on_iteration(iteration):
            if not self._cancel.is_set():
                self._on_iteration(iteration)
            return self._cancel.is_set()

        try:
            plan = solve(scenario, on_iteration=on_iteration, **options)
        except Exception as error:
            _settle(future.set_exception, error)
        else:
            _settle(future.set_result, plan)


def _settle(settle, value):
    try:
        settle(value)
    except InvalidStateError:
        pass  # close() was first
