"""Nodes as processes of a program."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
import signal
import subprocess
import sys


@contextmanager
def node_process(name: str, parameters: Sequence[str]) -> Iterator['subprocess.Popen[bytes]']:
    """Run a node in its own process; stop it with SIGINT, and kill it if it runs 5 s more."""
    started = subprocess.Popen(
        [sys.executable, '-m', f'secure_uav_planner.ros.{name}.node', '--ros-args', *parameters],
        start_new_session=True)
    try:
        yield started
    finally:
        started.send_signal(signal.SIGINT)
        try:
            started.wait(timeout=5)
        except subprocess.TimeoutExpired:
            started.kill()
            started.wait()
