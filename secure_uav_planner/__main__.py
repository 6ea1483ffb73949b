"""Run the command as `python -m secure_uav_planner`."""

import sys

from .apps.cli.main import main

if __name__ == '__main__':
    sys.exit(main())
