"""Keeps the nodes of a program from other ROS programs."""

from collections.abc import Iterator
from contextlib import contextmanager, nullcontext
import os
from pathlib import Path
import socket

# Linux assigns the ports of these domains to no program. Tests and users have lower domains.
_DOMAINS = range(215, 233)


@contextmanager
def isolated(out: Path) -> Iterator[None]:
    """
    Keep the ROS graph of a block on this host, in a domain of its own, and logs in a folder.

    Environment variables of ROS that are set already are left alone. When the block ends, all
    variables are as before.
    """
    before = {name: os.environ.get(name) for name in (
        'ROS_AUTOMATIC_DISCOVERY_RANGE', 'ROS_LOG_DIR', 'ROS_DOMAIN_ID')}
    os.environ.setdefault('ROS_AUTOMATIC_DISCOVERY_RANGE', 'LOCALHOST')
    os.environ.setdefault('ROS_LOG_DIR', str((out / 'log').resolve()))
    try:
        with nullcontext() if before['ROS_DOMAIN_ID'] else free_domain() as domain:
            if domain is not None:
                os.environ['ROS_DOMAIN_ID'] = str(domain)
            yield
    finally:
        for name, value in before.items():
            if value is None:
                os.environ.pop(name, None)
            else:
                os.environ[name] = value


@contextmanager
def free_domain() -> Iterator[int]:
    """Reserve a ROS domain without a participant, or raise an OSError if all are in use."""
    first = os.getpid() % len(_DOMAINS)
    for domain in (*_DOMAINS[first:], *_DOMAINS[:first]):
        port = 7400 + 250 * domain
        with socket.socket(type=socket.SOCK_STREAM) as reserved, \
                socket.socket(type=socket.SOCK_DGRAM) as probe:
            try:
                # DDS uses UDP only. Demos reserve a domain by binding the TCP port of this number.
                reserved.bind(('127.0.0.1', port))
                # The first participant of a domain binds this UDP port.
                probe.bind(('', port + 10))
            except OSError:
                continue
            probe.close()
            yield domain
            return
    raise OSError(f'the domains {_DOMAINS[0]} to {_DOMAINS[-1]} are taken; '
                  'set ROS_DOMAIN_ID to another one')
