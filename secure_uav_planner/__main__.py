"""Run the command, as `secure_uav_planner` or as `python -m secure_uav_planner`."""

import os
import signal
import sys


def main() -> int:
    """Run the command; return the exit status."""
    # While modules are imported, the exception of Python's own handler may be lost.
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:
        signal.signal(signal.SIGINT, lambda *_: os._exit(130))
    from .apps.cli import main as run
    return run()


if __name__ == '__main__':
    sys.exit(main())
