"""Run the command, as `secure_uav_planner` or as `python -m secure_uav_planner`."""

import sys


def main() -> int:
    """Run the command; return the exit status."""
    try:
        from .apps.cli import main as run
    except KeyboardInterrupt:  # Ctrl-C while it is imported.
        return 130
    return run()


if __name__ == '__main__':
    sys.exit(main())
