"""
The first step of the executables: until the node is there, a signal ends the process at once.

This module imports nothing that takes time. Before it runs, while the package is imported, the
executables in `scripts/` have handlers of their own, and `python -m` has Python's.
"""

from importlib import import_module
import os
import signal


def run_executable(name: str, args: list[str] | None = None, **options: object) -> None:
    """Import the node of a name, run it until a signal with process.run_node, and exit."""
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: os._exit(0))
    kind = getattr(import_module(f'{__package__}.{name}_node'), name.title())
    import_module(f'{__package__}.process').run_node(kind, args, **options)
