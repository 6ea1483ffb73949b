"""Signals that come while Clarabel runs: none is lost, and none ends what goes on."""

from itertools import chain
import queue
import random
import signal
import subprocess
import sys
import threading
import time

import pytest
from secure_uav_planner.optimize.initial.signals import deferred_signals

WAIT = 120.0
PROGRAM = """
from dataclasses import replace
import signal, sys
from secure_uav_planner import NoFlyZone, Scenario
from secure_uav_planner.model.grid import Grid
from secure_uav_planner.optimize.initial.flights import direct_flights
from secure_uav_planner.optimize.initial.projection import projected

wall = NoFlyZone(((50.0, -50.0), (150.0, -50.0), (150.0, 50.0), (50.0, 50.0)))
scenario = replace(Scenario.paper(200.0), no_fly_zones=(wall,))
grid, flights = Grid.of(scenario), next(direct_flights(scenario, lambda: None))
number = getattr(signal, sys.argv[1])
signal.signal(number, signal.default_int_handler)
while True:
    try:
        print('working', flush=True)
        while True:
            projected(grid, flights, 1e-3, lambda: None)
    except KeyboardInterrupt:
        print('stopped', flush=True)
"""


@pytest.mark.parametrize('name', ['SIGINT', 'SIGTERM'])
def test_a_signal_at_any_time_of_a_projection_raises_its_error(name):
    process = subprocess.Popen([sys.executable, '-c', PROGRAM, name], text=True,
                               stdout=subprocess.PIPE, stderr=subprocess.PIPE)
    lines, rng = queue.Queue(), random.Random(0)
    threading.Thread(target=lambda: [*map(lines.put, chain(process.stdout, ['']))],
                     daemon=True).start()
    try:
        for _ in range(30):
            assert lines.get(timeout=WAIT) == 'working\n'
            time.sleep(rng.uniform(0.0, 0.1))
            process.send_signal(getattr(signal, name))
            assert lines.get(timeout=WAIT) == 'stopped\n'
    finally:
        process.kill()
        _, errors = process.communicate()
    assert not errors


def test_a_handler_that_lets_the_work_go_on_is_called_once_at_the_end():
    calls = []

    def note(number, frame):
        calls.append(number)

    before = signal.signal(signal.SIGINT, note)
    try:
        with deferred_signals() as came:
            signal.raise_signal(signal.SIGINT)
            assert came == [signal.SIGINT] and not calls
        assert calls == [signal.SIGINT] and signal.getsignal(signal.SIGINT) is note
        threaded = []
        thread = threading.Thread(target=lambda: threaded.append(_handler_within()))
        thread.start()
        thread.join()
        assert threaded == [note]
    finally:
        signal.signal(signal.SIGINT, before)


def _handler_within():
    with deferred_signals():
        return signal.getsignal(signal.SIGINT)


def test_a_signal_that_ends_processes_still_does():
    program = ('import signal\n'
               'from secure_uav_planner.optimize.initial.signals import deferred_signals\n'
               'with deferred_signals():\n'
               '    signal.raise_signal(signal.SIGTERM)\n'
               '    print("later", flush=True)\n'
               'print("never", flush=True)\n')
    ended = subprocess.run([sys.executable, '-c', program], capture_output=True, text=True,
                           timeout=WAIT)
    assert (ended.returncode, ended.stdout) == (-signal.SIGTERM, 'later\n')
