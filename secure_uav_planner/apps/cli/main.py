"""From the command line to an exit status."""

from collections.abc import Sequence
from importlib import import_module
import os
import signal
import sys

from .parser import make_parser
from .status import BAD_INPUT, DONE, FAILED, STOPPED
from ...errors import (
    MissingPackageError, MissionFileError, OptionError, PlanFileError, PlanningError,
    ScenarioError, StoppedError)


def main(argv: Sequence[str] | None = None) -> int:
    """
    Run the command.

    :param argv: the arguments, by default those of the process.
    :return: the exit status: 0 done, 1 failed on the way, 2 bad input, 130 stopped by a signal.
    """
    argv = sys.argv[1:] if argv is None else list(argv)
    if argv[:1] == ['node'] and len(argv) > 1 and not argv[1].startswith('-'):
        return _run_node(argv[1], argv[2:])
    parser = make_parser()
    _offer_completion(parser)
    options = parser.parse_args(argv)
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        return import_module(f'.{options.module}', __package__).run(options)
    except MissionFileError as error:
        for line, text in error.problems:
            _tell(f'{options.mission}{"" if line is None else f":{line}"}: {text}')
        return BAD_INPUT
    except (MissingPackageError, OptionError, PlanFileError, ScenarioError) as error:
        _tell(str(error))
        return BAD_INPUT
    except BrokenPipeError:
        # Whoever read has gone; Python must not try again when it ends.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return FAILED
    except StoppedError as error:
        _tell(str(error))
        return STOPPED
    except (PlanningError, OSError, MemoryError) as error:
        _tell(str(error) or type(error).__name__)
        return FAILED
    except KeyboardInterrupt:
        _tell('stopped')
        return STOPPED


def _tell(text: str) -> None:
    print(f'secure_uav_planner: {text}', file=sys.stderr)


def _offer_completion(parser) -> None:
    """Answer a shell that asks for completions; see argcomplete."""
    if '_ARGCOMPLETE' in os.environ:
        import argcomplete
        argcomplete.autocomplete(parser)


def _run_node(name: str, arguments: list[str]) -> int:
    """Run a node in this process, with all that follows its name for ROS."""
    from .nodes import NODES
    if name not in NODES:
        _tell(f'there is no node {name}; there are {", ".join(NODES)}')
        return BAD_INPUT
    try:
        import_module(f'...ros.{name}', __package__).main([sys.argv[0], *arguments])
    except ModuleNotFoundError as error:
        if (error.name or '').startswith(__package__.partition('.')[0]):
            raise
        _tell(f'the nodes need ROS, and {error.name} is not installed; '
              'pip install "secure_uav_planner[ros]", or source an installed ROS')
        return BAD_INPUT
    return DONE
