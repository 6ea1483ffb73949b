"""Mission files as all parts of the command read them."""

from collections.abc import Callable
from typing import TypeVar

from ...errors import PlanFileError, PlanningError, ScenarioError
from ...mission.scenario import Scenario
from ...plan.plan import Plan

_Content = TypeVar('_Content')


def loaded(path: str) -> Scenario:
    """
    Return the mission of a file.

    :raises ScenarioError: when it holds none, or cannot be read.
    """
    return _loaded(path, Scenario.load, ScenarioError)


def loaded_plan(path: str) -> Plan:
    """
    Return the plan of a file.

    :raises PlanFileError: when it holds none, or cannot be read.
    """
    return _loaded(path, Plan.load, PlanFileError)


def _loaded(path: str, load: Callable[[str], _Content], kind: type[PlanningError]) -> _Content:
    try:
        return load(path)
    except OSError as error:
        raise kind(f'{path} cannot be read: {error.strerror or error}') from None
