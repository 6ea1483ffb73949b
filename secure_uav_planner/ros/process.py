"""A node as a process: start, spin, stop on a signal, exit status."""

from collections.abc import Callable
import gc
import os
import signal
import sys
import threading
import time
from typing import Any

import rclpy
from rclpy.exceptions import NameValidationException, ParameterException
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos_overriding_options import InvalidQosOverridesError
from rclpy.signals import SignalHandlerOptions

from .topics import is_simulated
from ..errors import brief, describe_error, PlanningError

_LAST_ANSWERS = 0.3  # Time [s] after the end in which answers to clients are sent.
_LONGEST_END = 5  # Time [s] after a signal to end in; DDS may wait for processes that have died.
_AFTER_FAILURE = 0.01  # Pause [s] after a callback that failed.
# Largest speed of a clock against real time, and its error [s], without a jump.
_REAL_CLOCK, _SIMULATED_CLOCK = (1.0, 0.25), (10.0, 2.0)


class WorkingNode(Node):
    """A node whose work in other threads ends before it is destroyed."""

    def __init__(self, name: str, **options: Any) -> None:
        super().__init__(name, **options)
        self.is_closed = False
        self._clock_read = time.monotonic()  # Last call of find_longest_step.

    def post(self, function: Callable[[], None]) -> None:
        """Have a function run between callbacks; from any thread."""
        if not self.is_closed and self.executor is not None:
            self.executor.create_task(function)

    def find_longest_step(self) -> float:
        """
        Return how far [s] the node's clock may have moved since the last call without a jump.

        It is speed * (real time since the last call) + error, with speed 10 and error 2 s for
        simulated time, 1 and 0.25 s otherwise. To be called right before the clock is read.
        """
        before, self._clock_read = self._clock_read, time.monotonic()
        speed, error = _SIMULATED_CLOCK if is_simulated(self) else _REAL_CLOCK
        return speed * (self._clock_read - before) + error

    def close(self) -> bool:
        """Stop all work; return True if none is left."""
        self.is_closed = True
        return True


def run_node(make_node: Callable[[], WorkingNode], args: list[str] | None = None) -> None:
    """
    Run a node until SIGINT or SIGTERM, then exit the process with status 0, or 1 after an error.

    :param make_node: returns the node. The text of a PlanningError is shown to the user.
    """
    stop = threading.Event()
    # rclpy's own signal handlers race with the executor's wait set; an event does not.
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: stop.set())
    threading.Thread(target=_end_in_time, args=(stop,), daemon=True).start()
    try:
        rclpy.init(args=args, signal_handler_options=SignalHandlerOptions.NO)
        node = make_node()
    except (PlanningError, RuntimeError, OSError, ParameterException, NameValidationException,
            InvalidQosOverridesError, ValueError) as error:
        # rclpy raises a ValueError for some wrong arguments. Any other ValueError is a programming
        # error, so it is printed with its class name.
        is_unexpected = isinstance(error, ValueError) and not isinstance(error, PlanningError)
        print(f'cannot start: {describe_error(error) if is_unexpected else brief(error)}',
              file=sys.stderr, flush=True)
        rclpy.try_shutdown()
        sys.exit(1)
    gc.freeze()  # Garbage collection takes 0.1 s less if it skips the imported modules.
    finished, failure = spin(node, stop)
    signal.alarm(2 * _LONGEST_END)  # Ends the process where C++ hangs and no thread runs.
    if failure is not None:
        node.get_logger().fatal(describe_error(failure))
    node.destroy_node()
    rclpy.try_shutdown()
    if not finished:
        # A solver thread is still running and could crash during a normal exit: exit at once.
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(0 if failure is None else 1)
    sys.exit(0 if failure is None else 1)


def _end_in_time(stop: threading.Event) -> None:
    """Exit some seconds after a signal, even if the node hangs."""
    stop.wait()
    time.sleep(_LONGEST_END)
    os._exit(0)


def spin(node: WorkingNode, stop: threading.Event) -> tuple[bool, BaseException | None]:
    """
    Run the callbacks of a node until an event, then close the node.

    :return: whether close() left no thread at work, and the error by which the node's context
        became invalid, or None.
    """
    # A MultiThreadedExecutor polls tasks until their threads begin, and so blocks these threads.
    executor = SingleThreadedExecutor(context=node.context)
    executor.add_node(node)

    def spin_once(timeout: float) -> Exception | None:
        """Run a callback that is due within a time [s]; log and return its error, or None."""
        try:
            executor.spin_once(timeout_sec=timeout)
        except Exception as error:
            # Even rclpy's own services raise errors after a malformed request.
            node.get_logger().error(f'a callback failed: {describe_error(error)}',
                                    throttle_duration_sec=1.0)
            time.sleep(_AFTER_FAILURE)
            return error
        return None

    failure = None
    while failure is None and not stop.is_set():
        error = spin_once(0.2)
        failure = None if node.context.ok() else error
    finished = node.close()
    # Send the answers that clients are still waiting for.
    until = time.monotonic() + _LAST_ANSWERS
    while failure is None and time.monotonic() < until:
        spin_once(0.05)
    executor.shutdown(timeout_sec=0)
    return finished, failure
