"""Mission files as all parts of the command read them."""

from ..errors import PlanFileError, ScenarioError
from ..plan import Plan
from ..scenario import Scenario


def loaded(path: str) -> Scenario:
    """
    Return the mission of a file.

    :raises ScenarioError: when it holds none, or cannot be read.
    """
    try:
        return Scenario.load(path)
    except OSError as error:
        raise ScenarioError(f'{path} cannot be read: {_reason(error)}') from None


def loaded_plan(path: str) -> Plan:
    """
    Return the plan of a file.

    :raises PlanFileError: when it holds none, or cannot be read.
    """
    try:
        return Plan.load(path)
    except OSError as error:
        raise PlanFileError(f'{path} cannot be read: {_reason(error)}') from None


def _reason(error: OSError) -> str:
    return error.strerror or str(error)
