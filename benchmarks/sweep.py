"""The effect of each tuned number of the joint method on rate and time."""

import argparse
from contextlib import contextmanager
from dataclasses import fields
import sys
import time

import numpy as np
from secure_uav_planner.mission.scenario import Scenario
from secure_uav_planner.model.problem import Problem
from secure_uav_planner.optimize.incumbent import Incumbent
from secure_uav_planner.optimize.initial import constant_powers, fly_hover_fly_positions
from secure_uav_planner.optimize.joint import settings
from secure_uav_planner.optimize.joint.method import improve

from .missions import random_mission

_GROUPS = {name: group for name, group in vars(settings).items() if name.isupper()}
_LOW = 0.01  # bit/s/Hz, of which changes are shares where a rate is lower: some are nearly 0.


def main(arguments=None):
    """Measure and print a line for each changed number; return the exit status."""
    parser = argparse.ArgumentParser(prog='python -m benchmarks.sweep',
                                     description=sys.modules[__name__].__doc__)
    parser.add_argument('--missions', type=int, default=100, help='number of random missions')
    parser.add_argument('--slots', type=int, default=60, help='slots of each random mission')
    parser.add_argument('--seed', type=int, default=0, help='seed of the first of them')
    parser.add_argument('--numbers', nargs='*', help='names of the numbers, by default all')
    options = parser.parse_args(arguments)
    scenarios = [Scenario.paper(duration) for duration in (102.0, 120.0, 200.0)]
    scenarios += [random_mission(options.seed + index, options.slots)
                  for index in range(options.missions)]
    reference_rates, reference_times = _measure_rates(scenarios)
    print('number, change: rate in the mean and in the worst mission, time in all')
    for name, value, changed in list_variants(options.numbers):
        with _change(name, changed):
            rates, times = _measure_rates(scenarios)
        gains = (rates - reference_rates) / np.maximum(reference_rates, _LOW)
        print(f'{name}, {value} to {changed}: {gains.mean():+.2%} {gains.min():+.2%}, '
              f'{times.sum() / reference_times.sum():.2f} times', flush=True)
    return 0


def list_variants(names=None):
    """Yield (name, value, changed value) for each number of the settings, halved and doubled."""
    for group, numbers in _GROUPS.items():
        for field in fields(numbers):
            name = f'{group}.{field.name}'
            if not names or name in names:
                value = getattr(numbers, field.name)
                for factor in (0.5, 2.0):
                    yield name, value, _scale(value, factor)


@contextmanager
def _change(name, value):
    """Change a number of the settings; a default of an argument keeps its own."""
    group, _, field = name.partition('.')
    before = getattr(_GROUPS[group], field)
    object.__setattr__(_GROUPS[group], field, value)
    try:
        yield
    finally:
        object.__setattr__(_GROUPS[group], field, before)


def _scale(value, factor):
    """Scale a number, of a share near 1 its distance from 1."""
    if isinstance(value, tuple):
        numbers = [_scale(number, factor) for number in value]
        return type(value)(*numbers) if hasattr(value, '_fields') else tuple(numbers)
    if isinstance(value, int):
        return max(1, round(value * factor))
    return 1 - (1 - value) / factor if 0.5 < value < 1 else value * factor


def _measure_rates(scenarios):
    """Return the rates in bit/s/Hz and the processor times in s."""
    rates, times = [], []
    for scenario in scenarios:
        started = time.process_time()
        problem = Problem(scenario)
        incumbent = Incumbent(
            problem, fly_hover_fly_positions(problem), constant_powers(scenario))
        improve(incumbent)
        rates.append(incumbent.rate)
        times.append(time.process_time() - started)
    return np.array(rates), np.array(times)


if __name__ == '__main__':
    sys.exit(main())
