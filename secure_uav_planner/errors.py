"""
The tree of errors: a class for each kind of outcome, each with a one-word code.

Each class below the root is also a ValueError, if the caller can correct an argument, or a
RuntimeError. Programming errors are not in the tree, so that nobody catches them by mistake.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
import json
import reprlib
from typing import Any, ClassVar, TypeAlias

FieldPath: TypeAlias = tuple[str | int, ...]
"""Path of a value in a mission, such as ('uavs', 1, 'max_speed')."""


def format_path(path: FieldPath) -> str:
    """Format a path as a string, such as `uavs[1].max_speed`."""
    return ''.join(f'[{part}]' if isinstance(part, int) else f'.{part}'
                   for part in path).removeprefix('.')


class PlanningError(Exception):
    """
    The root of all errors of this package.

    :param text: the message, or a predicate such as 'is 5; it must be ...', to which add_path adds
        the subject.
    :param place: path of the wrong field, empty if no field is to blame.
    :param subject: path of the predicate's subject inside of the field, None if the message is
        whole.
    :cvar code: one word for programs; the planner publishes it as `outcome.code`.
    """

    code: ClassVar[str] = 'failed'

    def __init_subclass__(cls, code: str | None = None) -> None:
        cls.code = code or cls.code

    def __init__(self, text: object = '', place: FieldPath = (),
                 subject: FieldPath | None = None) -> None:
        super().__init__(text)
        self.place, self._subject, self._owner = place, subject, ''

    def __str__(self) -> str:
        subject = '' if self._subject is None else f'{format_path(self._subject)} '
        return f'{self._owner}{subject}{self.args[0]}'

    @property
    def field(self) -> str:
        """Path of the wrong field, such as `uavs[1].max_speed`, or an empty string."""
        return format_path(self.place)

    def add_path(self, *path: str | int, owner: str = '') -> None:
        """
        Put a path in front of `place`, and in front of a message that is not whole.

        A message is whole after a path that begins with the name of a field: 'is 5' becomes
        '[0] is 5' by add_path(0), and then 'vertices[0] is 5' by add_path('vertices').

        :param path: path of the value whose part has the error.
        :param owner: text to put in front of any message, such as 'relay.' or 'feature 2: '.
        """
        self.place = (*path, *self.place)
        if self._subject is not None:
            self._subject = (*path, *self._subject)
            if path and isinstance(path[0], str):
                owner, self._subject = f'{owner}{format_path(self._subject)} ', None
        self._owner = owner + self._owner


@contextmanager
def prefix_path(*path: str | int) -> Iterator[None]:
    """Put a path in front of a PlanningError that leaves the with statement, by add_path."""
    try:
        yield
    except PlanningError as error:
        error.add_path(*path)
        raise


class ScenarioError(PlanningError, ValueError, code='invalid_scenario'):
    """
    A field of a scenario has a wrong value; the text names field, value and what is allowed.

    :ivar further: the other errors of the same object or scenario.
    """

    further: tuple['ScenarioError', ...] = ()

    def add_path(self, *path: str | int, owner: str = '') -> None:
        """Add a path to this error and to each of its further errors."""
        for error in (self, *self.further):
            PlanningError.add_path(error, *path, owner=owner)


class InfeasibleMissionError(ScenarioError, code='infeasible'):
    """
    No flight keeps the limits; the text names the limits and a duration that suffices.

    The text names no duration if the search for one reached the time limit, or if none suffices.
    """


class MissionFileError(ScenarioError, code='invalid_mission_file'):
    """
    A mission, campaign or airspace file is wrong; the text has its path and first problem.

    :ivar problems: all errors of the file, each (line, text); None for an unknown line. Fields
        are checked against each other only if every field is right by itself.
    """

    problems: tuple[tuple[int | None, str], ...] = ()


class OptionError(PlanningError, ValueError, code='invalid_option'):
    """An argument of a function, such as a method or a time limit, has a wrong value."""


class PlanError(PlanningError, ValueError, code='invalid_plan'):
    """A plan breaks a limit of its scenario; the text has the UAV, slot, value and limit."""


class PlanFileError(PlanningError, ValueError, code='invalid_file'):
    """A file does not hold a plan that this version can read."""


class LogFileError(PlanningError, ValueError, code='invalid_log'):
    """A file is no readable log of a flight, or no log of this flight."""


class ParameterError(PlanningError, ValueError, code='invalid_parameter'):
    """A parameter of a node has a wrong value."""


class PoseError(PlanningError, ValueError, code='invalid_pose'):
    """A pose cannot be used; the text names the field, its value and what is allowed."""


class PoseMissingError(PoseError, code='pose_missing'):
    """No pose has come on a topic that planning needs."""


class PoseStaleError(PoseError, code='pose_stale'):
    """The last pose of a topic is older than planning allows."""


class WrongFrameError(PoseError, code='wrong_frame'):
    """A pose is in another frame than the planner's."""


class BusyError(PlanningError, RuntimeError, code='busy'):
    """Another request is being answered."""


class StoppedError(PlanningError, RuntimeError, code='cancelled'):
    """A solve was cancelled, or the planner is stopping."""


class TimeLimitError(PlanningError, RuntimeError, code='time_limit'):
    """The time limit passed before flights that keep the limits were found."""


class LateError(PlanningError, RuntimeError, code='late'):
    """A new plan came after the moment at which it was to take effect."""


class SupersededError(PlanningError, RuntimeError, code='superseded'):
    """A new plan continues a plan that was replaced in the meantime."""


class NumericalError(PlanningError, RuntimeError, code='numerical_trouble'):
    """No step could be computed in floating-point numbers; methods keep their best iterate."""


class MissingPackageError(PlanningError, RuntimeError, code='missing_package'):
    """An optional package, such as Matplotlib for pictures, is not installed."""


_EXTRAS = {'matplotlib': 'view', 'mcap': 'view', 'pandas': 'view', 'plotly': 'view',
           'dash': 'explore', 'distributed': 'campaign', 'joblib': 'campaign',
           'pymavlink': 'logs', 'pyulog': 'logs', 'rosbags': 'logs'}
# Required packages that may be missing: rosdep has no key for them that keeps the system's NumPy.
_REQUIRED = {'clarabel', 'cvxpy'}


@contextmanager
def name_missing_package() -> Iterator[None]:
    """Turn the error of a package that is not installed into a MissingPackageError."""
    try:
        yield
    except ModuleNotFoundError as error:
        missing = (error.name or '').partition('.')[0]
        wanted = (missing if missing in _REQUIRED
                  else f'"secure_uav_planner[{_EXTRAS.get(missing, "ros")}]"')
        raise MissingPackageError(
            f'{missing} is not installed; pip install {wanted}') from error


_yaml_notation: ContextVar[bool] = ContextVar('_yaml_notation', default=False)


@contextmanager
def yaml_notation() -> Iterator[None]:
    """Write null, true, false and nouns of classes in messages inside the with statement."""
    token = _yaml_notation.set(True)
    try:
        yield
    finally:
        _yaml_notation.reset(token)


_NOUNS = {'Scenario': 'mission', 'Uav': 'UAV', 'NoFlyZone': 'no-fly zone',
          'GroundNode': 'ground node'}


def describe_class(kind: type[Any]) -> str:
    """Return a class's Python name or, inside yaml_notation, its noun, such as 'UAV'."""
    name = kind.__name__
    return _NOUNS.get(name, name.lower()) if _yaml_notation.get() else name


class _Quote(reprlib.Repr):
    """Short representations for error messages; NumPy's numbers look like plain ones."""

    def __init__(self) -> None:
        super().__init__()
        self.maxstring = self.maxother = 60
        self.maxtuple = self.maxlist = 4
        self.maxlevel = 3

    def repr1(self, x: Any, level: int) -> str:
        """Return one line for `x`: NumPy as plain numbers, None as null inside yaml_notation."""
        if type(x).__module__.partition('.')[0] == 'numpy' and hasattr(x, 'tolist'):
            x = x.tolist()
        if _yaml_notation.get() and (x is None or isinstance(x, bool)):
            return json.dumps(x)
        try:
            return super().repr1(x, level).replace('\n', ' ')
        except ValueError:  # An integer may have more digits than Python converts.
            return f'<{type(x).__name__} of {x.bit_length()} bits>'


quote = _Quote().repr
"""Return the text of any value for an error message, cut to a few dozen characters."""


def brief(text: object, most: int = 400) -> str:
    """Return a text or an error as one line; its middle is cut out beyond `most` characters."""
    line = ' '.join(str(text).split())
    if len(line) <= most:
        return line
    half = (most - 5) // 2
    return f'{line[:half]} ... {line[-half:]}'


def describe_error(error: BaseException) -> str:
    """Return the class and the text of an unexpected error as one line."""
    return brief(f'{type(error).__name__}: {error}')
