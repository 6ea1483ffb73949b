"""The part `new`: write an example of a mission."""

import argparse
from pathlib import Path

from .status import DONE
from ...errors import OptionError
from ...mission.files import atomic_file
from ...mission.formats.example import EXAMPLE


def run(options: argparse.Namespace) -> int:
    """Write the example; return the exit status."""
    path = Path(options.mission)
    if path.exists() and not options.force:
        raise OptionError(f'{path} is there already; --force replaces it')
    if path.suffix.lower() == '.json':
        raise OptionError(f'{path} cannot have comments as JSON; name it .yaml')
    try:
        with atomic_file(path) as file:
            file.write(EXAMPLE)
    except OSError as error:
        raise OptionError(f'{path} cannot be written: {error.strerror or error}') from None
    print(f'{path} is written; edit it, then: secure_uav_planner check {path}')
    return DONE
