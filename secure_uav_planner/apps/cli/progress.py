"""One line on a terminal that says how far the work has come."""

import sys
import time

_PERIOD = 0.1


class ProgressLine:
    """
    A line that is written over and over; nothing where the output is no terminal.

    It is a context: at its end the line is gone.
    """

    def __init__(self) -> None:
        self._shown = sys.stderr.isatty()
        self._last = -_PERIOD
        self._length = 0

    def __enter__(self) -> 'ProgressLine':
        return self

    def __exit__(self, *_: object) -> None:
        self.say('', force=True)

    def say(self, text: str, force: bool = False) -> None:
        """Show a text in place of the last one, at most ten times a second."""
        now = time.monotonic()
        if not self._shown or not force and now - self._last < _PERIOD:
            return
        self._last = now
        sys.stderr.write(f'\r{text}{" " * (self._length - len(text))}')
        if not text:
            sys.stderr.write('\r')
        sys.stderr.flush()
        self._length = len(text)
