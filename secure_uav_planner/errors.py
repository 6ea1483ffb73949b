"""
The one tree of errors: a class for every kind of outcome, each with a one-word code.

Every class is a ValueError, where the caller can mend what was given, or a RuntimeError as well.
Programming errors are none of them, so that nobody catches those by mistake.
"""

import reprlib
from typing import Any, ClassVar


class PlanningError(Exception):
    """
    The root of all errors of this package.

    :cvar code: one word for programs; the planner publishes it as `outcome.code`.
    """

    code: ClassVar[str] = 'failed'


class ScenarioError(PlanningError, ValueError):
    """A field of a scenario has a wrong value; the text says which and what is allowed."""

    code = 'invalid_scenario'


class InfeasibleMissionError(ScenarioError):
    """No flight keeps the limits; the text names the shortest duration that allows one."""

    code = 'infeasible'


class MissionFileError(ScenarioError):
    """
    A file does not hold a mission; the text has the file, the line and what is wrong first.

    :ivar problems: all that is wrong, each with its line (or None) and a text.
    """

    code = 'invalid_mission_file'

    def __init__(self, text: str, problems: tuple[tuple[int | None, str], ...] = ()) -> None:
        super().__init__(text)
        self.problems = problems


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


class LateError(PlanningError, RuntimeError):
    """A new plan came after the moment at which it was to take effect."""

    code = 'late'


class SupersededError(PlanningError, RuntimeError):
    """A new plan continues one that another plan has replaced in the meantime."""

    code = 'superseded'


class NumericalError(PlanningError, RuntimeError):
    """No step could be computed in floating-point numbers; methods keep their best iterate."""

    code = 'numerical_trouble'


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
        try:
            return super().repr1(x, level)
        except ValueError:  # an integer of more digits than Python converts
            return f'<{type(x).__name__} of {x.bit_length()} bits>'


shown = _Short().repr
"""Return any value as text for an error message, cut to a few dozen characters."""
