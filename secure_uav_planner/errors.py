"""
The one tree of errors: a class for every kind of outcome, each with a one-word code.

Every class is a ValueError, where the caller can mend what was given, or a RuntimeError as well.
Programming errors are none of them, so that nobody catches those by mistake.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
import math
import reprlib
from typing import Any, ClassVar, TypeAlias

Place: TypeAlias = tuple[str | int, ...]
"""Where a value is: names of fields, and numbers in lists."""


def path_of(place: Place) -> str:
    """Return a place in one string, such as `uavs[1].max_speed`."""
    return ''.join(f'[{part}]' if isinstance(part, int) else f'.{part}'
                   for part in place).removeprefix('.')


class PlanningError(Exception):
    """
    The root of all errors of this package.

    :param text: what is wrong.
    :param place: where, if a field is to blame.
    :cvar code: one word for programs; the planner publishes it as `outcome.code`.
    """

    code: ClassVar[str] = 'failed'

    def __init__(self, text: object = '', place: Place = ()) -> None:
        super().__init__(text)
        self.place = place

    @property
    def field(self) -> str:
        """Return the path of the wrong field, such as `uavs[1].max_speed`, or nothing."""
        return path_of(self.place)


@contextmanager
def within(*place: str | int) -> Iterator[None]:
    """Put a place before that of an error which leaves the with statement."""
    try:
        yield
    except PlanningError as error:
        error.place = (*place, *error.place)
        raise


class ScenarioError(PlanningError, ValueError):
    """
    A field of a scenario has a wrong value; the text says which and what is allowed.

    :ivar others: what else does not fit together in the same scenario.
    """

    code = 'invalid_scenario'
    others: tuple['ScenarioError', ...] = ()


class InfeasibleMissionError(ScenarioError):
    """
    No flight keeps the limits; the text names the least duration of the straight line.

    Where the duration is longer, it names what is in the way, and the shortest duration with which
    flights were found, if any were.
    """

    code = 'infeasible'


class MissionFileError(ScenarioError):
    """
    A file does not hold a mission; the text has the file, the line and what is wrong first.

    :ivar problems: all that is wrong, each with its line (or None) and a text.
    :ivar rest: the Scenario of what is right in the file, with wide limits in place of what is
        wrong, where what it cannot fly could not be flown otherwise; or None.
    """

    code = 'invalid_mission_file'

    def __init__(self, text: str, problems: tuple[tuple[int | None, str], ...] = ()) -> None:
        super().__init__(text)
        self.problems = problems
        self.rest: Any = None


class OptionError(PlanningError, ValueError):
    """An argument of a function, such as a method or a time limit, has a wrong value."""

    code = 'invalid_option'


class PlanError(PlanningError, ValueError):
    """A plan breaks a limit of its scenario; the text has the UAV, slot, value and limit."""

    code = 'invalid_plan'


class PlanFileError(PlanningError, ValueError):
    """A file does not hold a plan that this version can read."""

    code = 'invalid_file'


class ParameterError(PlanningError, ValueError):
    """A parameter of a node has a wrong value."""

    code = 'invalid_parameter'


class PoseError(PlanningError, ValueError):
    """A pose cannot be used; the text names the field, its value and what is allowed."""

    code = 'invalid_pose'


class PoseMissingError(PoseError):
    """No pose has come on a topic that planning needs."""

    code = 'pose_missing'


class PoseStaleError(PoseError):
    """The last pose of a topic is older than planning allows."""

    code = 'pose_stale'


class WrongFrameError(PoseError):
    """A pose is in another frame than the planner's."""

    code = 'wrong_frame'


class BusyError(PlanningError, RuntimeError):
    """Another request is being answered."""

    code = 'busy'


class StoppedError(PlanningError, RuntimeError):
    """A solve was cancelled, or the planner is stopping."""

    code = 'cancelled'


class TimeLimitError(PlanningError, RuntimeError):
    """The time limit was over before flights that keep the limits were found."""

    code = 'time_limit'


class LateError(PlanningError, RuntimeError):
    """A new plan came after the moment at which it was to take effect."""

    code = 'late'


class SupersededError(PlanningError, RuntimeError):
    """A new plan continues one that another plan has replaced in the meantime."""

    code = 'superseded'


class NumericalError(PlanningError, RuntimeError):
    """No step could be computed in floating-point numbers; methods keep their best iterate."""

    code = 'numerical_trouble'


class MissingPackageError(PlanningError, RuntimeError):
    """An optional package, such as Matplotlib for pictures, is not installed."""

    code = 'missing_package'


_of_file: ContextVar[bool] = ContextVar('_of_file', default=False)


@contextmanager
def words_of_files() -> Iterator[None]:
    """Let messages have the words of YAML and JSON, such as null, where Python has others."""
    token = _of_file.set(True)
    try:
        yield
    finally:
        _of_file.reset(token)


_NOUNS = {'Scenario': 'mission', 'Uav': 'UAV', 'NoFlyZone': 'no-fly zone'}


def noun_of(kind: type[Any]) -> str:
    """Return what a class is called in Python or, within words_of_files, in a file."""
    name = kind.__name__
    return _NOUNS.get(name, name.lower()) if _of_file.get() else name


class _Short(reprlib.Repr):
    """Values as error messages show them: short, and NumPy's numbers as plain ones."""

    def __init__(self) -> None:
        super().__init__()
        self.maxstring = self.maxother = 60
        self.maxtuple = self.maxlist = 4
        self.maxlevel = 3

    def repr1(self, x: Any, level: int) -> str:
        if type(x).__module__ == 'numpy' and hasattr(x, 'tolist'):
            x = x.tolist()
        if _of_file.get() and (x is None or isinstance(x, bool)):
            return 'null' if x is None else str(x).lower()
        if _of_file.get() and isinstance(x, float) and not math.isfinite(x):
            return f'{x}'.replace('inf', '.inf').replace('nan', '.nan')
        try:
            return super().repr1(x, level)
        except ValueError:  # an integer of more digits than Python converts
            return f'<{type(x).__name__} of {x.bit_length()} bits>'

    def repr_tuple(self, x: tuple[Any, ...], level: int) -> str:
        return self.repr_list([*x], level) if _of_file.get() else super().repr_tuple(x, level)

    def repr_dict(self, x: dict[Any, Any], level: int) -> str:
        if not _of_file.get() or not x or level <= 0:
            return super().repr_dict(x, level)
        found = [f'{key}: {self.repr1(x[key], level - 1)}'[:self.maxother]
                 for key in [*x][:self.maxdict]]
        return f'{{{", ".join([*found, *["..."] * (len(x) > self.maxdict)])}}}'


shown = _Short().repr
"""Return any value as text for an error message, cut to a few dozen characters."""


def brief(text: object, most: int = 400) -> str:
    """Return a text, such as an error, in one line; of a long text the middle is cut out."""
    line = ' '.join(str(text).split())
    if len(line) <= most:
        return line
    half = (most - 5) // 2
    return f'{line[:half]} ... {line[-half:]}'


def with_type(error: BaseException) -> str:
    """Return the class and the text of an unexpected error in one line."""
    return brief(f'{type(error).__name__}: {error}')
