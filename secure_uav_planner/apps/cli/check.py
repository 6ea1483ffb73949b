"""The part `check`: say all that is wrong with a mission, and what an autopilot needs for it."""

import argparse
from collections.abc import Iterator

from .missions import loaded
from .status import DONE
from ...mission.scenario import Scenario
from ...output.autopilot_limits import changes


def run(options: argparse.Namespace) -> int:
    """Check a mission; return the exit status."""
    scenario = loaded(options.mission)
    jammers = len(scenario.uavs) - 1
    print(f'{options.mission}: {scenario.uavs[0].name} transmits, {jammers} '
          f'jam{"s" if jammers == 1 else ""}, {len(scenario.eavesdroppers)} '
          f'listen{"s" if len(scenario.eavesdroppers) == 1 else ""}; {scenario.slots} slots of '
          f'{scenario.slot_duration:g} s. It can be flown.')
    if options.autopilot:
        print(*_advice(options.autopilot, scenario), sep='\n')
    return DONE


def _advice(autopilot: str, scenario: Scenario) -> Iterator[str]:
    """Yield in words what an autopilot needs to follow each UAV's plan."""
    alike: dict[tuple[float, float | None], list[str]] = {}
    for uav in scenario.uavs:
        alike.setdefault((uav.max_speed, uav.max_acceleration), []).append(uav.name)
    for (speed, acceleration), names in alike.items():
        uavs = f'{", ".join((autopilot, *names))} at {speed:g} m/s'
        if acceleration is None:
            yield f'{uavs}: no autopilot follows a plan without max_acceleration'
            continue
        uavs += f' and {acceleration:g} m/s^2'
        found = changes(autopilot, speed, acceleration)
        if not found:
            yield f'{uavs}: the defaults suffice'
        for parameter, value in found:
            text = f'set {parameter.name} to {value:g} {parameter.unit}'
            if (least := parameter.least(speed, acceleration)) > value:
                text = (f'{parameter.name} would have to be {least:.0f} {parameter.unit}; lower '
                        'max_speed or max_acceleration')
            yield f'{uavs}: {text} (default {parameter.default:g}, at most {parameter.most:g})'
