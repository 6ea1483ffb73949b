"""Run the command, as `secure_uav_planner` or as `python -m secure_uav_planner`."""

from importlib import import_module
import os
import signal
import sys
from types import FrameType

_STOPPED = 130


def main() -> int:
    """Run the command; return its exit status."""
    _end_on_signals()
    return int(import_module('.apps.cli', __package__).main())


def run_node(name: str) -> None:
    """Run a node, as `ros2 run` does."""
    _end_on_signals()
    import_module(f'.ros.{name}.node', __package__).main()


def _end_on_signals() -> None:
    """End on SIGINT and SIGTERM while modules load, which may turn an exception into another."""
    for number in (signal.SIGINT, signal.SIGTERM):
        if signal.getsignal(number) is not signal.SIG_IGN:
            signal.signal(number, _end)


def _end(number: int, frame: FrameType | None) -> None:
    os.write(2, b'secure_uav_planner: stopped\n')
    os._exit(_STOPPED)


if __name__ == '__main__':
    sys.exit(main())
