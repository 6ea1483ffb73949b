"""The part `link-budget`: the reference SNR of a radio."""

import argparse

from .status import DONE
from ...mission.link_budget import RANGES, reference_snr_db


def run(options: argparse.Namespace) -> int:
    """Print the reference SNR; return the exit status."""
    snr = reference_snr_db(**{name: getattr(options, name) for name in RANGES})
    print(f'reference_snr_db: {snr:.2f}')
    return DONE
