"""
Signals that come while Clarabel runs.

Python runs the handler of a signal in the main thread, as soon as that runs Python. While Clarabel
runs this is in its callback, also before the callback's first statement, and Clarabel drops what a
callback raises: the KeyboardInterrupt of Ctrl-C would be lost.
"""

from collections.abc import Iterator
from contextlib import contextmanager
import signal
import threading
from types import FrameType
from typing import Any


@contextmanager
def deferred_signals() -> Iterator[list[int]]:
    """
    Give a list of the numbers of signals that come, whose handlers run at the end instead.

    In another thread than the main one, which no handlers run in, it stays empty.
    """
    came: list[int] = []
    if threading.current_thread() is not threading.main_thread():
        yield came
        return

    def record(number: int, _frame: FrameType | None) -> None:
        came.append(number)

    # Those that are ignored stay so, as do those whose handlers are not Python's, None.
    before = {number: handler for number in (signal.SIGINT, signal.SIGTERM)
              if (handler := signal.getsignal(number)) not in (None, signal.SIG_IGN)}
    try:
        try:
            for number in before:
                signal.signal(number, record)
            yield came
        finally:
            _restore(before, signal.SIGTERM)
    finally:  # Also when a handler that is back has raised an error in between.
        _restore(before, signal.SIGINT)
    for deferred in sorted(came, reverse=True):  # SIGTERM first, which may end the process.
        signal.raise_signal(deferred)


def _restore(before: dict[signal.Signals, Any], number: signal.Signals) -> None:
    if number in before:
        signal.signal(number, before[number])
