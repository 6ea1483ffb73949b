"""
The first step of the executables: a signal ends the process at once while its modules load.

Nothing that takes time is imported here. Before this module runs, the handlers are Python's own.
"""

from importlib import import_module
import os
import signal
from typing import Any


def run(module: str, node: str, args: list[str] | None = None, **options: Any) -> None:
    """
    Import a node and run it until a signal, and exit the process.

    :param module: of this package, in which the node is.
    :param node: the class.
    :param args: command line, by default that of the process.
    :param options: of process.run_node.
    """
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: os._exit(0))
    kind = getattr(import_module(f'{__package__}.{module}'), node)
    import_module(f'{__package__}.process').run_node(kind, args, **options)
