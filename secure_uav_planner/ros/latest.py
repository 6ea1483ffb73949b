"""Background work of which only the newest item matters."""

from collections.abc import Callable
import threading
from typing import Any


class Latest:
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
