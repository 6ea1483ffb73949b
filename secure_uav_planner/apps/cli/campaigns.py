"""Campaigns: `sweep` plans all missions of a campaign."""

import argparse
from collections import Counter
import logging
from pathlib import Path
import sys

from .main import DONE, FAILED
from .missions import loaded, writable
from ..campaign.results import save_figure, save_tables
from ..campaign.run import failed, JOURNAL, run_campaign
from ..campaign.specification import load_campaign
from ...errors import OptionError, StoppedError
from ...mission.views import naming_what_is_missing


def sweep(options: argparse.Namespace) -> int:
    """Run a campaign; return the exit status."""
    campaign = loaded(options.mission, load_campaign, OptionError)
    out = writable(Path(options.out))
    # What it says of lost connections is said here in a line.
    logging.getLogger('distributed').setLevel(logging.CRITICAL)
    try:
        with naming_what_is_missing():
            rows = run_campaign(campaign.tasks, out, options.jobs, options.scheduler)
    except KeyboardInterrupt:
        file = out / JOURNAL
        count = len(file.read_bytes().splitlines()) if file.exists() else 0
        raise StoppedError(f'stopped; {file} keeps {count} missions, and the same command goes on '
                           'from there') from None
    written = save_tables(rows, out)
    try:
        save_figure(rows, out / 'summary.png')
        written.append(out / 'summary.png')
    except ModuleNotFoundError as error:
        print(f'{error.name} is not installed, so there is no figure', file=sys.stderr)
    outcomes = Counter(row['outcome'] for row in rows)
    print(', '.join(f'{outcomes[outcome]} {outcome}'
                    for outcome in sorted(outcomes, key=lambda name: (name != 'ok', name))))
    print(f'written: {", ".join(map(str, written))}')
    if again := failed(rows):
        print(f'secure_uav_planner: {len(again)} missions failed for reasons outside of them, and '
              f'the same command plans them again: {again[0]["reason"]}', file=sys.stderr)
        return FAILED
    return DONE
