"""Plan how two or more UAVs fly and radiate so that a transmission stays secret."""

from .apps import cli
from .apps.campaigns import run_campaign
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

__all__ = ['Assessment', 'Bound', 'Channel', 'Eavesdropper', 'GroundNode', 'Iteration', 'METHODS',
           'NoFlyZone', 'Origin', 'Plan', 'PlanningError', 'Propulsion', 'Scenario', 'Uav',
           'World', 'assess', 'fly_hover_fly', 'read_zones', 'reference_snr_db',
           'run_campaign', 'shortest_duration', 'solve', 'upper_bound']

__version__ = cli.VERSION
