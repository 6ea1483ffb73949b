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

    def __init_subclass__(cls, code: str | None = None) -> None:
        cls.code = code or cls.code

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


class ScenarioError(PlanningError, ValueError, code='invalid_scenario'):
    """
    A field of a scenario has a wrong value; the text says which and what is allowed.

    :ivar others: what else does not fit together in the same scenario.
    """

    others: tuple['ScenarioError', ...] = ()


class InfeasibleMissionError(ScenarioError, code='infeasible'):
    """
    No flight keeps the limits; the text names the least duration of the straight line.

    Where the duration is longer, it names what is in the way, and the shortest duration with which
    flights were found, if any were.
    """


class MissionFileError(ScenarioError, code='invalid_mission_file'):
    """
    A file does not hold a mission; the text has the file, the line and what is wrong first.

    :ivar problems: all that is wrong, each with its line (or None) and a text.
    :ivar rest: the Scenario of what is right in the file, with wide limits in place of what is
        wrong, where what it cannot fly could not be flown otherwise; or None.
    """

    def __init__(self, text: str, problems: tuple[tuple[int | None, str], ...] = ()) -> None:
        super().__init__(text)
        self.problems = problems
        self.rest: Any = None


class OptionError(PlanningError, ValueError, code='invalid_option'):
    """An argument of a function, such as a method or a time limit, has a wrong value."""


class PlanError(PlanningError, ValueError, code='invalid_plan'):
    """A plan breaks a limit of its scenario; the text has the UAV, slot, value and limit."""


class PlanFileError(PlanningError, ValueError, code='invalid_file'):
    """A file does not hold a plan that this version can read."""


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
    """The time limit was over before flights that keep the limits were found."""


class LateError(PlanningError, RuntimeError, code='late'):
    """A new plan came after the moment at which it was to take effect."""


class SupersededError(PlanningError, RuntimeError, code='superseded'):
    """A new plan continues one that another plan has replaced in the meantime."""


class NumericalError(PlanningError, RuntimeError, code='numerical_trouble'):
    """No step could be computed in floating-point numbers; methods keep their best iterate."""


class MissingPackageError(PlanningError, RuntimeError, code='missing_package'):
    """An optional package, such as Matplotlib for pictures, is not installed."""


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
