"""The effect of each tuned number of the joint method on rate and time."""

import argparse
from dataclasses import fields, replace
import statistics
import sys
import time

import numpy as np

from .missions import random_mission
from ..optimize.baselines import constant_powers, fly_hover_fly_positions
from ..optimize.joint.method import improve
from ..optimize.joint.schedule import Schedule
from ..optimize.search import Search
from ..scenario import Scenario


def main(arguments=None):
    """Measure and print a line for each changed number; return the exit status."""
    parser = argparse.ArgumentParser(prog='python -m secure_uav_planner.bench.sweep',
                                     description=sys.modules[__name__].__doc__)
    parser.add_argument('--missions', type=int, default=24, help='number of random missions')
    parser.add_argument('--slots', type=int, default=100, help='slots of each random mission')
    parser.add_argument('--fields', nargs='*', help='names of the numbers, by default all')
    options = parser.parse_args(arguments)
    scenarios = [Scenario.paper(duration) for duration in (102.0, 120.0, 200.0)]
    scenarios += [random_mission(seed, options.slots) for seed in range(options.missions)]
    reference = _measured(Schedule(), scenarios)
    print('number, change: rate in the mean and in the worst mission, time in the median')
    for name, change, schedule in variants(options.fields):
        rates, times = _measured(schedule, scenarios)
        gains = rates / np.maximum(reference[0], 1e-9) - 1
        print(f'{name} {change}: {gains.mean():+.2%} {gains.min():+.2%}, '
              f'{statistics.median(times / reference[1]):.2f} times', flush=True)
    return 0


def variants(names=None):
    """
    Yield (field, change, Schedule) for every number of Schedule, halved and doubled.

    For a field that is a tuple, one member at a time is left out instead.
    """
    for field in fields(Schedule):
        if names and field.name not in names:
            continue
        value = field.default
        if isinstance(value, tuple):
            for index in range(len(value)):
                rest = value[:index] + value[index + 1:]
                yield field.name, f'without member {index}', replace(
                    Schedule(), **{field.name: rest})
            continue
        for factor in (0.5, 2.0):
            changed = value * factor
            if isinstance(value, int):
                changed = max(1, round(changed))
            elif value < 1 < changed or field.name == 'boundary':
                changed = 1 - (1 - value) / factor  # For a share, the distance from 1 is changed.
            yield field.name, f'{value:g} to {changed:g}', replace(
                Schedule(), **{field.name: changed})


def _measured(schedule, scenarios):
    """Return the rates in bit/s/Hz and the processor times in s."""
    rates, times = [], []
    for scenario in scenarios:
        started = time.process_time()
        search = Search(scenario, fly_hover_fly_positions(scenario), constant_powers(scenario))
        improve(search, schedule)
        rates.append(search.rate)
        times.append(time.process_time() - started)
    return np.array(rates), np.array(times)


if __name__ == '__main__':
    sys.exit(main())
