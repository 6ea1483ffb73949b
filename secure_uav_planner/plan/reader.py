"""
A process that reads the texts of long plans, so that setpoints are sent meanwhile.

Reading JSON of 20,000 slots holds the interpreter lock for 40 ms, in which no thread sends.
"""

import pickle
import subprocess
import sys

from .file import parse_text
from .plan import Plan
from ..errors import PlanFileError, PlanningError

_SERVE = f'from {__name__} import serve; serve()'


def serve() -> None:
    """Answer each pickled text on standard input with (plan, frame) or an error, until its end."""
    answer: object
    while True:
        try:
            text = pickle.load(sys.stdin.buffer)
        except EOFError:
            return
        try:
            answer = parse_text(text, Plan)
        except PlanningError as error:
            answer = error
        pickle.dump(answer, sys.stdout.buffer)
        sys.stdout.buffer.flush()


class ReaderProcess:
    """A process that runs `serve`, started by the first text. Not safe for several threads."""

    def __init__(self) -> None:
        self._process: subprocess.Popen[bytes] | None = None

    def read(self, text: str) -> tuple[Plan, str]:
        """
        Return the plan and the name of its frame in a text; the process runs parse_text.

        :raises PlanFileError: if the text contains no plan, or the process has ended.
        """
        if self._process is None:
            # Ctrl+C signals a whole process group. In a session of its own, the reader is not
            # signalled and prints no traceback.
            self._process = subprocess.Popen(
                [sys.executable, '-c', _SERVE], stdin=subprocess.PIPE, stdout=subprocess.PIPE,
                start_new_session=True)
        process = self._process
        assert process.stdin is not None and process.stdout is not None
        try:
            pickle.dump(text, process.stdin)
            process.stdin.flush()
            answer = pickle.load(process.stdout)
        except (OSError, EOFError):
            self.close()
            raise PlanFileError('the process that reads long plans has ended') from None
        if isinstance(answer, PlanningError):
            raise answer
        plan, frame_id = answer
        return plan, frame_id

    def close(self) -> None:
        """Kill the process, if one runs; the next `read` starts another one."""
        process, self._process = self._process, None
        if process is not None:
            process.kill()
            process.communicate()
