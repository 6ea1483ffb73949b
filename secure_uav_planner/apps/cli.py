"""The command: its arguments, and the exit status of what they run."""

import argparse
from collections.abc import Callable, Iterable, Sequence
from contextlib import suppress
import difflib
from importlib import import_module
from importlib.metadata import PackageNotFoundError, version
import io
import os
from pkgutil import resolve_name
import signal
import sys
from typing import Any, NoReturn

from ..errors import (
    brief, LogFileError, MissingPackageError, MissionFileError, name_missing_package, OptionError,
    PlanFileError, PlanningError, quote, ScenarioError, StoppedError)
from ..mission import LOCATION_MODELS, METHODS, OBJECTIVES, TIME_SOURCES
from ..mission.formats.mission_file import EXAMPLES
from ..mission.propagation import ENVIRONMENTS
from ..output.autopilots import AUTOPILOTS

NAME = 'secure_uav_planner'

try:
    VERSION = version(NAME)
except PackageNotFoundError:
    VERSION = 'unknown'

NODES = ('planner', 'relay', 'replay')
"""Nodes that the command can run."""

DONE, FAILED, BAD_INPUT, UNCOVERED, STOPPED = 0, 1, 2, 3, 130

EXIT_STATUSES = {
    DONE: 'done',
    FAILED: 'failed on the way, for example because the disk is full; or a flight broke a '
            'promised slot',
    BAD_INPUT: 'bad input: a wrong option, mission or plan, or a folder that cannot be written',
    UNCOVERED: 'the logs do not cover the whole flight',
    STOPPED: 'stopped by Ctrl-C or SIGTERM; a plan that was under way is kept as far as it had '
             'come',
}
"""The meaning of each exit status."""

_BAD_INPUTS = LogFileError, MissingPackageError, OptionError, PlanFileError, ScenarioError

_ABOUT = """\
Plan how UAVs fly and radiate so that a transmission stays secret. ROS is not needed.

A first plan:
  secure_uav_planner new mission.yaml      write an example, to edit
  secure_uav_planner check mission.yaml    say all that is wrong with it
  secure_uav_planner plan mission.yaml     plan it; results in out/
  secure_uav_planner explore mission.yaml  drag it in a browser, and see its best plan
"""
_STATUS = 'exit status:\n' + '\n'.join(
    f'  {number:<5}{text}' for number, text in EXIT_STATUSES.items())
_COMPLETION = """

completion, in bash and zsh:
  eval "$(register-python-argcomplete secure_uav_planner)"
"""
_MISSION = 'mission file: YAML, or JSON if its name ends with .json'


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command with arguments, by default sys.argv[1:]; return one of EXIT_STATUSES."""
    argv = sys.argv[1:] if argv is None else list(argv)
    for name in ('stdout', 'stderr'):
        if getattr(sys, name) is None:  # The caller has closed the stream.
            setattr(sys, name, open(os.devnull, 'w', encoding='utf-8'))
    if isinstance(sys.stdout, io.TextIOWrapper):  # A name may not fit the terminal's encoding.
        sys.stdout.reconfigure(errors='backslashreplace')
    try:
        if argv[:1] == ['node'] and len(argv) > 1 and not argv[1].startswith('-'):
            _check_name('node', argv[1], NODES)
            if not {'-h', '--help'} & {*argv[2:3]}:
                return _run_node(argv[1], argv[2:])
        if argv and not argv[0].startswith('-'):
            _check_name('command', argv[0], (*_COMMANDS, 'node'))
        parser = make_parser()
        if '_ARGCOMPLETE' in os.environ:  # A shell asks for completions.
            import argcomplete
            argcomplete.autocomplete(parser)
        options = parser.parse_args(argv)
        os.environ['MPLBACKEND'] = 'Agg'  # A notebook's backend may not be installed.
        with name_missing_package():
            run = resolve_name(f'{__package__}.{options.run}')
        for number in (signal.SIGINT, signal.SIGTERM):
            if signal.getsignal(number) is not signal.SIG_IGN:
                signal.signal(number, signal.default_int_handler)
        status = run(options)
        sys.stdout.flush()  # A closed pipe is an error here, not at exit.
        return status or DONE
    except MissionFileError as error:
        for line, text in error.problems:
            _print_error(f'{options.mission}{"" if line is None else f":{line}"}: {text}')
        return BAD_INPUT
    except BrokenPipeError:
        _drop_output()
        return FAILED
    except OSError as error:
        target = error.filename or ('standard output' if _is_output_lost() else None)
        _print_error(
            str(error) if target is None or error.strerror is None else
            f'{target} cannot be written: {error.strerror}; what was written before is kept')
        return FAILED
    except (PlanningError, MemoryError) as error:
        _print_error(str(error) or type(error).__name__)
        return STOPPED if isinstance(error, StoppedError) else BAD_INPUT if isinstance(
            error, _BAD_INPUTS) else FAILED
    except KeyboardInterrupt:
        _print_error('stopped')
        return STOPPED


def _is_output_lost() -> bool:
    """Print an empty line; if that fails, discard all further output and return True."""
    try:
        print(flush=True)
    except OSError:
        _drop_output()
        return True
    return False


def _drop_output() -> None:
    """Prevent Python from writing buffered output again at exit."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def _print_error(text: str) -> None:
    print(f'secure_uav_planner: {text}', file=sys.stderr)


def _run_node(name: str, arguments: list[str]) -> int:
    """Run a node; return DONE, or BAD_INPUT without ROS; refuse arguments without --ros-args."""
    if arguments and arguments[0] != '--ros-args':  # ROS would ignore such arguments.
        first = arguments[0]
        hint = (arguments if first.startswith('-') else ['-p', first] if ':=' in first else
                ['-p', f'mission_file:={first}'])
        raise OptionError(f'the node {name} has no argument {quote(first)}; did you mean '
                          f'--ros-args {brief(" ".join(hint), 200)}?')
    try:
        import_module(f'..ros.{name}.node', __package__).main([sys.argv[0], *arguments])
    except ModuleNotFoundError as error:
        if (error.name or '').startswith(__package__.partition('.')[0]):
            raise
        _print_error(f'the nodes need ROS, and {error.name} is not installed; '
                     'pip install "secure_uav_planner[ros]", or source an installed ROS')
        return BAD_INPUT
    return DONE


def _check_name(kind: str, name: str, names: Iterable[str]) -> None:
    """Raise an OptionError unless a name is among names; it suggests the nearest one."""
    if name not in names:
        near = difflib.get_close_matches(name, names, 1)
        raise OptionError(f'there is no {kind} {quote(name)}; ' + (
            f'did you mean {near[0]}?' if near else f'there are {", ".join(names)}'))


def _make_type(convert: Callable[[str], Any], allowed: str,
               is_allowed: Callable[[Any], bool] = lambda _: True) -> Callable[[str], Any]:
    """Return a type for argparse: it converts the text of an argument, or says what is allowed."""
    def parse(text: str) -> Any:
        with suppress(ValueError):
            value = convert(text)
            if is_allowed(value):
                return value
        raise argparse.ArgumentTypeError(f'{quote(text)} must be {allowed}')
    return parse


_number = _make_type(float, 'a number, without its unit')
_whole = _make_type(int, 'a whole number')
_seconds = _make_type(float, 'a number above 0, in s and without a unit', lambda s: s > 0)
_seconds_or_0 = _make_type(
    float, '0 or a number above 0, in s and without a unit', lambda s: s >= 0)
_shard = _make_type(
    lambda text: tuple(map(int, text.split('/'))), 'K/N, such as 3/16, with K from 1 to N',
    lambda shard: len(shard) == 2 and 1 <= shard[0] <= shard[1])


def _number_option(metavar: Any, text: str, **more: Any) -> dict[str, Any]:
    return {'type': _number, 'metavar': metavar, 'help': text, **more}


_OUT, _PLAN = '-o --out', {'help': 'a plan file, such as out/plan.json'}

_COMMANDS: dict[str, tuple[str, str, str, dict[str, dict[str, Any]]]] = {
    'plan': ('planning:make_plan', 'plan a mission and write what it needs', """

It prints the plan's rates beside those of the baselines and a proven bound of what any plan can
reach, and writes plan.json, plan.csv, plan.png and plan.html, and plan.geojson where the mission
has an origin. Ctrl-C ends the search and keeps the best plan so far.""", {
        'mission': {'help': _MISSION},
        _OUT: {'default': 'out', 'metavar': 'FOLDER',
               'help': 'folder for the results, made if needed (default: %(default)s)'},
        '--method': {'choices': METHODS, 'default': METHODS[0],
                     'help': 'optimisation method (default: %(default)s)'},
        '--objective': {'choices': OBJECTIVES, 'help': 'rate to maximise: the lower bound by '
                        'formula, or the true worst case over the discs, only with the method '
                        'joint, of which it is the default'},
        '--deliver': _number_option('BITS', 'plan the shortest flight that delivers so many '
                                    "bit/Hz by the objective's rate; the mission's duration and "
                                    'slots then say how long a slot is'),
        '--time-limit': {
            'type': _seconds, 'metavar': 'S', 'help': 'end the search for a plan after so '
            'many seconds and keep the best plan so far (default: none)'},
        '--bound-time-limit': {
            'type': _seconds_or_0, 'default': 10.0, 'metavar': 'S',
            'help': 'the same for the bound; 0 for no bound (default: %(default)g)'},
        '--no-baselines': {'action': 'store_true', 'help': 'leave out fly-hover-fly, with which '
                           'the plan is compared'},
        '--mcap': {'action': 'store_true', 'help': 'write plan.mcap as well, the recording of a '
                   'flight for Foxglove and `ros2 bag`; needs ROS'}}),
    'check': ('missions:check_mission', 'say all that is wrong with a mission, line by line', '', {
        'mission': {'help': _MISSION},
        '--autopilot': {'choices': tuple(AUTOPILOTS), 'help': 'compare the speed and acceleration '
                        'of its UAVs with what this autopilot carries by default, and name the '
                        'parameters to change'}}),
    'new': ('missions:create_mission', 'write an example mission with every field explained', '', {
        'mission': {'help': 'file to write'},
        '--example': {'choices': tuple(EXAMPLES), 'help': 'another mission, which can be planned '
                      'as it is'},
        '--force': {'action': 'store_true', 'help': 'replace a file that is there'}}),
    'explore': ('explore:explore_mission', 'drag a mission and see its best plan', '', {
        'mission': {'nargs': '?', 'help': f'{_MISSION} (default: the example of `new`)'},
        '--port': {'type': _whole, 'default': 0, 'metavar': 'N',
                   'help': 'port of this computer that the page is at (default: a free one)'}}),
    'show': ('planning:show_plan', 'draw a saved plan and print its rates', '', {
        'plan': _PLAN,
        _OUT: {'metavar': 'FILE', 'help': 'picture (.png, .svg, .pdf), web page (.html) or, '
               'where the mission has an origin, map (.geojson) to write (default: a .png beside '
               'the plan, in place of the one that plan drew there)'}}),
    'assess': ('assessments:assess_plan', 'say what a plan is worth when the world differs', """

It draws worlds: places of the eavesdroppers, lines of sight, fading and errors of the UAVs. It
prints the secrecy rate of the mission, the outage of its slots and what is delivered in secret
beside what the plan promises, and draws them. Without options, the world differs only in what the
plan allows for. With --flown, it compares a flight with the plan instead.""", {
        'plan': _PLAN,
        '--flown': {'nargs': '+', 'metavar': 'LOG', 'help': 'compare this flight with the plan: a '
                    'bag (.mcap, .db3 or folder) or .csv with all UAVs, or a log of each, such as '
                    'uav1=a.ulg uav2=b.BIN (.ulg, .BIN, .tlog, .csv, .tum)'},
        '--at': {'choices': TIME_SOURCES, 'help': 'where the time of the plan in the logs '
                 'is taken from (default: the first of these that all logs have)'},
        '--shift': {'nargs': '+', 'metavar': 'UAV=X,Y', 'help': "place of the origin of a log's "
                    "frame in the plan's frame, in m (default: both are one)"},
        '--json': {'action': 'store_true', 'help': 'print the numbers of the flight as JSON'},
        _OUT: {'metavar': 'FILE', 'help': 'picture (.png, .svg, .pdf) to write, or for a flight a '
               'web page (.html) (default: a .assess.png or .flown.png beside the plan)'},
        '--draws': {'type': _whole, 'default': 1000, 'metavar': 'D',
                    'help': 'how many worlds (default: %(default)s)'},
        '--seed': {'type': _whole, 'default': 0, 'metavar': 'S',
                   'help': 'of the draws (default: %(default)s)'},
        '--place': {'choices': LOCATION_MODELS,
                    'help': 'where each eavesdropper is: anywhere in its disc '
                    '(the default), normal around its centre, in the ring of the width --beyond '
                    'around the disc, or at --positions'},
        '--beyond': _number_option('M', 'width of that ring'),
        '--covariance': _number_option(
            ('XX', 'XY', 'YY'), 'of the normal place in m^2 (default: the disc has a probability '
            'of 95%%)', nargs=3),
        '--positions': _number_option('X Y', 'fixed places (default: the centres)', nargs='+'),
        '--speed-factor': _number_option(
            'F', 'speed of eavesdroppers relative to their planned tracks'),
        '--receiver-db': _number_option(
            'DB', "by how much the eavesdroppers' receivers are better than stated"),
        '--tracking-std': _number_option(
            'M', 'standard deviation of the UAVs in x and in y around their plan'),
        '--tracking-time': _number_option('S', 'correlation time of these errors (default: 2)'),
        '--exponent': _number_option('A', "another path loss exponent than the plan's"),
        '--los': {'choices': ('none', *ENVIRONMENTS),
                  'help': 'another environment, for the probability of lines of sight'},
        '--rician-k-db': _number_option('DB', 'another Rician factor'),
        '--los-distance': _number_option(
            'M', 'way of a UAV after which its lines of sight are drawn anew (default: 50)'),
        '--mean-gain': {'action': 'store_true',
                        'help': 'draw no lines of sight, but take the mean gain'}}),
    'sweep': ('campaigns:run_sweep', 'plan all missions of a campaign', """

A campaign is a mission, fields to vary over lists, ranges or random laws, and methods and
objectives to compare. Every finished mission is written at once; a campaign that was stopped
goes on with the same command. A mission that fails is a row with its reason; if that lies outside
of it, such as too little memory, the same command plans it again.""", {
        'mission': {'metavar': 'campaign', 'help': 'campaign file: YAML or JSON'},
        _OUT: {'default': 'out/sweep', 'metavar': 'FOLDER',
               'help': 'folder for the results (default: %(default)s)'},
        '--jobs': {'type': _whole, 'default': -1, 'metavar': 'N',
                   'help': 'processes on this computer (default: as many as there are cores)'},
        '--shard': {'type': _shard, 'metavar': 'K/N', 'help': 'plan only the K-th of N '
                    'shares, as a job of an array; when all are finished, the same command '
                    'without it joins them'},
        '--scheduler': {'metavar': 'ADDRESS', 'help': 'a Dask scheduler, such as tcp://host:8786, '
                        'whose workers are used instead; they need this package'}}),
    'link-budget': ('missions:print_link_budget', 'compute reference_snr_db from data sheets', """

The SNR at 1 m and 1 W in free space: G_t + G_r + 20 log10(c / (4 pi f)) - 10 log10(k T_0 B) - F,
all in dB, with T_0 = 290 K. The receiver_advantage_db of an eavesdropper is by how much G_r - F
of its receiver is larger than that of the ground node's.""", {
        '--carrier-hz': _number_option('HZ', 'f, frequency of the carrier', required=True),
        '--bandwidth-hz': _number_option('HZ', 'B, bandwidth of the receiver', required=True),
        '--noise-figure-db': _number_option(
            'DB', 'F, noise figure of the receiver with its cable (default: 0)', default=0.0),
        '--transmit-gain-dbi': _number_option(
            'DBI', "G_t, gain of the UAV's antenna downwards (default: 0)", default=0.0),
        '--receive-gain-dbi': _number_option(
            'DBI', "G_r, gain of the ground node's antenna upwards (default: 0)", default=0.0)}),
}
"""Function `module:name`, summary, further description and arguments of each command."""


class _Parser(argparse.ArgumentParser):
    """A parser that reports an error in one line, since the usage may be longer than a screen."""

    def error(self, message: str) -> NoReturn:
        self.exit(BAD_INPUT, f'{self.prog}: {message}; see {self.prog} --help\n')


def make_parser() -> argparse.ArgumentParser:
    """Return the parser of the command."""
    parser = _Parser(
        prog=NAME, description=_ABOUT, epilog=_STATUS + _COMPLETION,
        formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument('--version', action='version', version=f'%(prog)s {VERSION}')
    commands = parser.add_subparsers(title='commands', metavar='command', required=True)
    for name, (run, about, more, arguments) in _COMMANDS.items():
        command = commands.add_parser(
            name, help=about, description=f'{about[0].upper()}{about[1:]}.{more}', epilog=_STATUS,
            formatter_class=argparse.RawDescriptionHelpFormatter)
        command.set_defaults(run=run)
        for names, options in arguments.items():
            command.add_argument(*names.split(), **options)
    node = commands.add_parser(
        'node', help='run a node, where there is no `ros2 run`', usage=f'{NAME} node '
        f'{{{",".join(NODES)}}} [--ros-args ...]', description='Run a node of this package. What '
        'follows its name is for ROS, as with `ros2 run secure_uav_planner <node>`, such as '
        '`--ros-args -p mission_file:=mission.yaml`.')
    node.add_argument('node', choices=NODES)
    return parser
