"""
The first step of the executables: until the node is there, a signal ends the process at once.

This module imports nothing that takes time. Before it runs, Python's own handlers are active.
"""

from importlib import import_module
import os
import signal


def run_executable(module: str, node: str, args: list[str] | None = None, **options: object
                   ) -> None:
    """
    Import a node, run it until a signal, and exit the process.

    :param module: the name of the module of this package that contains the node.
    :param node: the name of the node's class.
    :param args: the command line, by default that of the process.
    :param options: further arguments of process.run_node.
    """
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: os._exit(0))
    kind = getattr(import_module(f'{__package__}.{module}'), node)
    import_module(f'{__package__}.process').run_node(kind, args, **options)
