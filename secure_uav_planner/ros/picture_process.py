"""
Pictures of plans, drawn in a separate process.

Matplotlib holds Python's interpreter lock for half a second for each picture. During that time the
node could not send a setpoint, and autopilots leave their offboard mode after such a gap.
"""

from collections.abc import Callable
import os
import pickle
import subprocess
import sys

from .background import LatestOnlyWorker
from ..errors import brief
from ..plan.plan import Plan


class Drawing(LatestOnlyWorker):
    """Draws plans in the background, each put with its file."""

    def __init__(self, on_failure: Callable[[str], None]) -> None:
        super().__init__(self._run_process)
        self._on_failure = on_failure
        self._process: subprocess.Popen[bytes] | None = None

    def close(self, timeout: float) -> bool:
        """Stop drawing; return whether nothing is left running."""
        self.cancel()
        if self._process is not None:
            self._process.terminate()
        return super().close(timeout)

    def _run_process(self, item: tuple[Plan, str]) -> None:
        plan, file = item
        try:
            # A new session, so that the process does not receive Ctrl-C from the terminal.
            self._process = subprocess.Popen(
                [sys.executable, '-m', __name__, file], stdin=subprocess.PIPE,
                stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, start_new_session=True)
            _, errors = self._process.communicate(pickle.dumps(plan))
            reason = errors.decode(errors='replace').strip().rpartition('\n')[2]
            failed = self._process.returncode != 0
        except (OSError, ValueError) as error:
            failed, reason = True, str(error)
        if failed and self.newest is not None:
            self._on_failure(brief(reason or 'it cannot be drawn'))


def main() -> None:
    """Draw the pickled plan from standard input to the file named on the command line."""
    os.nice(10)  # Setpoints are more important.
    plan = pickle.load(sys.stdin.buffer)
    try:
        from ..output.picture import save_picture  # Here, because Matplotlib is optional.
        save_picture(plan, sys.argv[1])
    except (ImportError, OSError, ValueError) as error:
        sys.exit(brief(error))


if __name__ == '__main__':
    main()
