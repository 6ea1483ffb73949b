"""Reads the plans of messages without a pause in the stream of setpoints."""

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import partial

from rclpy.task import Future

from ...errors import brief, PlanningError
from ...plan.file import parse_text
from ...plan.plan import Plan
from ...plan.reader import ReaderProcess

MOST_CHARACTERS = 250_000
"""Longest text that is read at once: 2,000 slots of two UAVs in about 10 ms."""


class PlanReader:
    """
    Reads one text after another, a long one in a process of its own.

    While that process reads, only the newest text waits. All methods belong to one thread.

    :param post: called from any thread with a function to run in that thread.
    :param take: called with each plan and its frame.
    :param refuse: called with the reason for which a text is not a plan.
    """

    def __init__(self, post: Callable[[Callable[[], None]], None],
                 take: Callable[[Plan, str], None], refuse: Callable[[str], None]) -> None:
        self._post, self._take, self._refuse = post, take, refuse
        self._pool, self._process = ThreadPoolExecutor(1, 'reader'), ReaderProcess()
        self._waiting = ''
        self._idle = Future()  # Done while nothing is read.
        self._idle.set_result(None)

    def read(self, text: str) -> None:
        """Read a text: at once, or in a while if it is long or another one is being read."""
        if not self._idle.done():
            self._waiting = text
        elif len(text) <= MOST_CHARACTERS:
            self._finish(partial(parse_text, text, Plan))
        else:
            self._idle = Future()
            self._pool.submit(self._process.read, text).add_done_callback(
                lambda reading: self._post(partial(self._end, reading.result)))

    async def wait(self) -> None:
        """Wait until everything that has come is read."""
        while not self._idle.done():
            await self._idle

    def close(self) -> None:
        """Stop reading."""
        self._pool.shutdown(wait=False)
        self._process.close()

    def _end(self, result: Callable[[], tuple[Plan, str]]) -> None:
        self._finish(result)
        idle, text, self._waiting = self._idle, self._waiting, ''
        idle.set_result(None)
        if text:
            self.read(text)

    def _finish(self, result: Callable[[], tuple[Plan, str]]) -> None:
        try:
            plan, frame_id = result()
        except PlanningError as error:
            self._refuse(brief(error))
            return
        self._take(plan, frame_id)
