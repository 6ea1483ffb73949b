"""The part `check`: say all that is wrong with a mission."""

import argparse

from .missions import loaded
from .status import DONE


def run(options: argparse.Namespace) -> int:
    """Check a mission; return the exit status."""
    scenario = loaded(options.mission)
    jammers = len(scenario.uavs) - 1
    print(f'{options.mission}: {scenario.uavs[0].name} transmits, {jammers} '
          f'jam{"s" if jammers == 1 else ""}, {len(scenario.eavesdroppers)} '
          f'listen{"s" if len(scenario.eavesdroppers) == 1 else ""}; {scenario.slots} slots of '
          f'{scenario.slot_duration:g} s. It can be flown.')
    return DONE
