"""Plan how two or more UAVs fly and radiate so that a transmission stays secret."""

from importlib.metadata import PackageNotFoundError, version
from typing import Any, TYPE_CHECKING

from .assessment import assess, Assessment, World
from .bound import shortest_duration, upper_bound
from .errors import PlanningError
from .mission.formats.airspace_file import read_zones
from .mission.geography import Origin
from .mission.participants import Propulsion
from .mission.propagation import reference_snr_db
from .mission.scenario import Channel, Eavesdropper, GroundNode, NoFlyZone, Scenario, Uav
from .optimize import fly_hover_fly, METHODS, solve
from .plan import Bound, Iteration, Plan

if TYPE_CHECKING:
    from .apps.campaigns import run_campaign

__all__ = ['Assessment', 'Bound', 'Channel', 'Eavesdropper', 'GroundNode', 'Iteration', 'METHODS',
           'NoFlyZone', 'Origin', 'Plan', 'PlanningError', 'Propulsion', 'Scenario', 'Uav',
           'World', 'assess', 'fly_hover_fly', 'read_zones', 'reference_snr_db', 'run_campaign',
           'shortest_duration', 'solve', 'upper_bound']

try:
    __version__ = version(__name__)
except PackageNotFoundError:
    __version__ = 'unknown'


def __getattr__(name: str) -> Any:
    """Import run_campaign when it is used, since nodes do not need the modules of the command."""
    if name != 'run_campaign':
        raise AttributeError(f'module {__name__!r} has no attribute {name!r}')
    from .apps.campaigns import run_campaign
    return run_campaign
