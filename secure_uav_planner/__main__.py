"""Run the command, as `secure_uav_planner` or as `python -m secure_uav_planner`."""

import sys

from .apps.cli import main

if __name__ == '__main__':
    sys.exit(main())
