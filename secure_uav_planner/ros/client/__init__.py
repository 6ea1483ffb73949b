"""
A client of the planner and the replay, for programs that plan and fly from Python.

It uses their topics and services like any other program. `node_process` starts a node as a process
of its own.
"""

from .client import ClientError, make_clients, SecurePlanner
from .local import node_process

__all__ = ('ClientError', 'make_clients', 'node_process', 'SecurePlanner')
