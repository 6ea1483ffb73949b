"""
The nodes' processes, and nodes in this process.

No wait here depends on the speed of the machine: each one is for a condition, and its patience
only ends a test that would otherwise wait forever. The report of a failed test contains the output
of its nodes; see conftest.py.
"""

from contextlib import contextmanager
import gc
from importlib import import_module
import os
import signal
import subprocess
import sys
import threading
import time

from processes import environment, ROOT
import pytest
import rclpy
from rclpy.context import Context
from rclpy.impl.implementation_singleton import rclpy_implementation
from secure_uav_planner.ros.process import run_node, spin

PATIENCE = 120.0
_SHOWN = 60  # Lines of a node's output in the report of a failed test.

clients = []  # Clients of the nodes, which see when nodes of this process begin and end.
_started = []  # (test, Popen) of every node process, until another test begins.


def wait_for(condition, patience=PATIENCE, what='the condition'):
    """Return the value of a condition once it is true; fail after the patience in s."""
    until = time.monotonic() + patience
    while not (value := condition()):
        assert time.monotonic() < until, f'{what} did not come true in {patience} s'
        time.sleep(0.01)
    return value


@contextmanager
def node_process(name, *arguments, namespace=None, **parameters):
    """Run a node, or a program by its path, in its own process; its output is in .lines."""
    process = subprocess.Popen(
        [sys.executable, str(ROOT / 'scripts' / name), *_ros_args(parameters, namespace),
         *arguments], text=True,
        stdout=subprocess.PIPE, stderr=subprocess.STDOUT, env=environment(PYTHONUNBUFFERED='1'))
    process.name, process.lines = name, []
    _note(process)
    reader = threading.Thread(target=lambda: process.lines.extend(process.stdout), daemon=True)
    reader.start()
    process.reader = reader
    try:
        yield process
    finally:
        if process.poll() is None:
            process.send_signal(signal.SIGINT)
            try:
                process.wait(timeout=PATIENCE)
            except subprocess.TimeoutExpired:
                process.kill()
        process.wait()
        reader.join(timeout=PATIENCE)


def _ros_args(parameters, namespace=None):
    return ['--ros-args', *(['-r', f'__ns:={namespace}'] if namespace else []),
            *(word for key, value in parameters.items()
              for word in ('-p', f'{key.replace("__", ".")}:={value}'))]


def refusal(capfd, name, **parameters):
    """Start a node in this process; return the line with the reason why it cannot start."""
    kind = getattr(import_module(f'secure_uav_planner.ros.{name}.node'), name.title())
    capfd.readouterr()
    handlers = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
    with pytest.raises(SystemExit) as ended:
        run_node(kind, _ros_args(parameters))
    for number, handler in handlers.items():
        signal.signal(number, handler)
    assert ended.value.code == 1
    del ended  # Its traceback holds the node, and with that its place in DDS.
    gc.collect()
    # Others in this process may write as well, such as what is left of the node before.
    lines = ''.join(capfd.readouterr()).splitlines()
    reasons = [line for line in lines if line.startswith('cannot start: ')]
    assert len(reasons) == 1, lines
    return reasons[0]


class _LocalProcess:
    """The process attributes of a node in this process."""

    def __init__(self, name):
        self.name, self.pid, self.lines, self.ended = name, os.getpid(), [], None

    def poll(self):
        return self.ended


@contextmanager
def _logged_in(lines):
    """Keep what is logged in this process. With capfd, lines get lost while it is read."""
    write = rclpy_implementation.rclpy_logging_rcutils_log

    def log(severity, name, message, *place):
        lines.append(f'[{severity.name}] [{name}]: {message}\n')
        write(severity, name, message, *place)

    rclpy_implementation.rclpy_logging_rcutils_log = log
    try:
        yield
    finally:
        rclpy_implementation.rclpy_logging_rcutils_log = write


@contextmanager
def node_here(name, *arguments, namespace=None, **parameters):
    """
    Run a node in this process, which takes a tenth of the time; its log is in .lines.

    For tests that ask a node of their own; tests of processes use node_process.
    """
    kind = getattr(import_module(f'secure_uav_planner.ros.{name}.node'), name.title())
    context, local = Context(), _LocalProcess(name)
    _note(local)
    rclpy.init(context=context, args=[*_ros_args(parameters, namespace), *arguments])
    with _logged_in(local.lines):
        node, stop = kind(context=context), threading.Event()
        full_name = node.get_fully_qualified_name()
        thread = threading.Thread(target=spin, args=(node, stop), daemon=True)
        thread.start()
        try:
            yield local
        finally:
            local.ended = 0
            stop.set()
            thread.join(PATIENCE)
            node.destroy_node()
            rclpy.shutdown(context=context)
            # The next node of this process is the same participant in DDS, which clients would not
            # discover before the end of this one.
            wait_for(lambda: not any(
                full_name in client.node.get_fully_qualified_node_names()
                for client in clients), what=f'the end of {full_name}')


def stopped(process, number=signal.SIGINT):
    """Send a signal to a process and return its exit status, however long it takes to end."""
    process.send_signal(number)
    return process.wait(timeout=PATIENCE)


def output_of(process):
    """Return all output of a process that has ended."""
    process.reader.join(timeout=PATIENCE)
    return ''.join(process.lines)


def wait_for_line(process, text):
    """Return the first line of a process's output that contains a text, once there is one."""
    def line():
        return next((line for line in list(process.lines) if text in line), None)
    return wait_for(line, what=f'{text!r} in the output of {process.name}')


def has_said(process, text, count=1):
    """Return whether a node has logged lines with a text, so many at least."""
    return sum(text in line for line in list(process.lines)) >= count


def outputs():
    """Return the last output of the node processes of this test, and their states."""
    lines = []
    for _, process in _started:
        status = process.poll()
        state = 'running' if status is None else f'ended with status {status}'
        lines += [f'--- {process.name} ({process.pid}), {state}\n', *process.lines[-_SHOWN:]]
    return ''.join(lines)


def _note(process):
    """Keep a process for the report of its test, and forget the ones of tests before."""
    test = os.environ.get('PYTEST_CURRENT_TEST', '').rpartition(' ')[0]
    _started[:] = [(name, earlier) for name, earlier in _started
                   if name == test or earlier.poll() is None]
    _started.append((test, process))


def running():
    return [process for _, process in _started if process.poll() is None]


def memory_settles(process, work):
    """
    Repeat a piece of work until a process's memory has settled; return it after each, in MB.

    Settled is when the last five rounds have added less than 0.5 MB together. What a process needs
    once, such as caches and the pools of its allocator, comes to an end; a leak does not, however
    fast the machine is.
    """
    sizes = []
    while len(sizes) <= 5 or sizes[-1] - sizes[-6] >= 0.5:
        assert len(sizes) <= 60, f'memory still rises: {sizes} MB'
        if sizes:
            work()
        with open(f'/proc/{process.pid}/statm', encoding='ascii') as file:
            pages = int(file.read().split()[1])  # That are resident.
        sizes.append(pages * os.sysconf('SC_PAGE_SIZE') / 1e6)
    return sizes
