"""The part `show`: draw a saved plan, and print its rates."""

import argparse
from pathlib import Path

from .missions import loaded_plan
from .status import DONE
from ...errors import OptionError
from ...output.table import table

_SUFFIXES = ('.png', '.svg', '.pdf', '.html')


def run(options: argparse.Namespace) -> int:
    """Draw a plan; return the exit status."""
    plan = loaded_plan(options.plan)
    file = Path(options.out) if options.out else Path(options.plan).with_suffix('.png')
    if file.suffix.lower() not in _SUFFIXES:
        raise OptionError(f'{file} has the suffix {file.suffix!r}; it must be one of '
                          f'{", ".join(_SUFFIXES)}')
    print(table([plan]))
    try:
        if file.suffix.lower() == '.html':
            from ...output.page import save_page as save
        else:
            from ...output.picture import save_picture as save
    except ModuleNotFoundError as error:
        raise OptionError(f'{error.name} is not installed; pip install '
                          '"secure_uav_planner[view]"') from None
    save(plan, file)
    print(f'written: {file}')
    return DONE
