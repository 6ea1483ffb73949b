"""
Pictures of plans, drawn by a process of its own.

Matplotlib holds Python's interpreter lock for half a second a picture, in which a node would send
no setpoint; autopilots leave their offboard mode after as long.
"""

from collections.abc import Callable
import os
import pickle
import subprocess
import sys

from .latest import Latest
from .text import brief
from ..plan import Plan


class Drawing:
    """
    Draws plans in the background, one after another; of those that wait, only the newest.

    :param on_failure: called in another thread with the reason when one cannot be drawn.
    """

    def __init__(self, on_failure: Callable[[str], None]) -> None:
        self._on_failure = on_failure
        self._latest = Latest(self._run)
        self._process: subprocess.Popen[bytes] | None = None
        self._closed = False

    def draw(self, plan: Plan, file: str) -> None:
        """Have a plan drawn to a file."""
        self._latest.put((plan, file))

    def close(self, timeout: float) -> bool:
        """Stop drawing; return whether nothing is left running."""
        self._closed = True
        process = self._process
        if process is not None:
            process.terminate()
        return self._latest.close(timeout)

    def _run(self, item: tuple[Plan, str]) -> None:
        plan, file = item
        if self._closed:
            return
        try:
            # In a session of its own, so that Ctrl-C in a terminal is not its concern.
            self._process = subprocess.Popen(
                [sys.executable, '-m', __name__, file], stdin=subprocess.PIPE,
                stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, start_new_session=True)
            _, errors = self._process.communicate(pickle.dumps(plan))
            reason = errors.decode(errors='replace').strip().rpartition('\n')[2]
            failed = self._process.returncode != 0
        except (OSError, ValueError) as error:
            failed, reason = True, str(error)
        if failed and not self._closed:
            self._on_failure(brief(reason or 'it cannot be drawn'))


def main() -> None:
    """Draw the pickled plan of the standard input to the file of the command line."""
    os.nice(10)  # Setpoints come first.
    plan = pickle.load(sys.stdin.buffer)
    try:
        from ..view.picture import save_picture  # Only now: Matplotlib need not be there.
        save_picture(plan, sys.argv[1])
    except (ImportError, OSError, ValueError) as error:
        sys.exit(brief(error))


if __name__ == '__main__':
    main()
