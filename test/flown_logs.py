"""Logs of a flight of the paper's mission, with a known delay and offset, in any format."""

from dataclasses import replace
from functools import cache

import numpy as np
from secure_uav_planner import Scenario, solve
from strategies import with_uavs
from studies.flown.logs import (
    fly, write_bag, write_csv, write_dataflash, write_telemetry, write_tum, write_ulog)

DELAY, OFFSET = 0.3, 0.8
START_NS = 1_795_743_002_000_000_000
ORIGINS = {'uav1': (100.0, 500.0), 'uav2': (120.0, 500.0)}


@cache
def make_plan():
    """Return a plan of the paper's UAVs, with a limit of acceleration and a start."""
    mission = with_uavs(replace(Scenario.paper(110.0, slots=55, error_radius=10.0),
                                separation=10.0), max_acceleration=2.0)
    return replace(solve(mission, objective='guaranteed'), start_ns=START_NS)


@cache
def make_flight():
    """Return the track of a flight of make_plan, DELAY s late and OFFSET m left of its way."""
    return fly(make_plan(), DELAY, OFFSET)


def write_logs(flight, kind, folder, **options):
    """Write the logs of all UAVs in a format; return what read_flight takes."""
    uavs = flight.plan.scenario.uavs
    if kind == 'csv':
        write_csv(flight, folder / 'flight.csv', START_NS * 1e-9)
        return folder / 'flight.csv'
    if kind == 'mcap':
        write_bag(flight, folder / 'bag')
        return folder / 'bag'
    files = {uav.name: folder / f'{uav.name}.{kind}' for uav in uavs}
    for index, (name, file) in enumerate(files.items()):
        if kind == 'tum':
            write_tum(flight, index, file)
        else:
            write = {'ulg': write_ulog, 'BIN': write_dataflash, 'tlog': write_telemetry}[kind]
            write(flight, index, file, ORIGINS[name], 100.0 + 3.0 * index, START_NS * 1e-9,
                  **options)
    return files


def fly_twice(flight, later=None):
    """Return the track of a flight that is flown again some s later, by default 0.1 s after it."""
    once = fly(flight.plan, 0.0, 0.0)
    later = later or once.times[-1] - once.times[0] + 0.1
    return replace(once, times=np.append(once.times, once.times + later), **{
        name: np.concatenate([getattr(once, name)] * 2, axis=1)
        for name in ('positions', 'velocities', 'powers')})
