"""Reads plans from messages without a pause in the stream of setpoints."""

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import partial

from rclpy.task import Future

from ...errors import brief, PlanningError
from ...plan.file import parse_text
from ...plan.plan import Plan
from ...plan.reader import ReaderProcess

MOST_CHARACTERS = 250_000
"""Longest text that is read in this process: 2,000 slots of two UAVs take about 10 ms."""


class PlanReader:
    """
    Reads one text after another, a long one in a process of its own.

    While a long text is read, only the newest other text waits. All methods must be called from
    one thread.

    :param post: called from any thread with a function, which it runs in the reader's thread.
    :param take: called with each plan and its frame.
    :param refuse: called with the reason why a text is not a plan.
    """

    def __init__(self, post: Callable[[Callable[[], None]], None],
                 take: Callable[[Plan, str], None], refuse: Callable[[str], None]) -> None:
        self._post, self._take, self._refuse = post, take, refuse
        self._pool, self._process = ThreadPoolExecutor(1, 'reader'), ReaderProcess()
        self._waiting = ''  # The newest text that waits; empty if none does.
        self._idle = Future()  # Done while no text is being read.
        self._idle.set_result(None)

    def read(self, text: str) -> None:
        """Read a short text at once, a long one in a process; meanwhile only the newest waits."""
        if not self._idle.done():
            self._waiting = text
        elif len(text) <= MOST_CHARACTERS:
            self._finish(partial(parse_text, text, Plan))
        else:
            self._idle = Future()
            self._pool.submit(self._process.read, text).add_done_callback(
                lambda reading: self._post(partial(self._end, reading.result)))

    async def wait(self) -> None:
        """Wait until all texts are read."""
        while not self._idle.done():
            await self._idle

    def close(self) -> None:
        """Stop reading."""
        self._pool.shutdown(wait=False)
        self._process.close()

    def _end(self, result: Callable[[], tuple[Plan, str]]) -> None:
        """Pass on the result of a long text, then read the text that waits."""
        self._finish(result)
        idle, text, self._waiting = self._idle, self._waiting, ''
        idle.set_result(None)
        if text:
            self.read(text)

    def _finish(self, result: Callable[[], tuple[Plan, str]]) -> None:
        """Pass the plan and the frame that `result` returns to _take, or its error to _refuse."""
        try:
            plan, frame_id = result()
        except PlanningError as error:
            self._refuse(brief(error))
            return
        self._take(plan, frame_id)
