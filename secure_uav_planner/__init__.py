"""
Plan how two or more UAVs fly and radiate so that a transmission stays secret.

The public names are loaded when one is first used: the command handles signals before that.
"""

from importlib import import_module
TYPE_CHECKING = False  # Type checkers know the name. To load typing takes longer than all of this.
if TYPE_CHECKING:
    from .apps.campaigns import run_campaign
    from .assessment import (
        assess, Assessment, compare, Comparison, FlownFlight, read_flight, World)
    from .bound import shortest_duration, upper_bound
    from .errors import PlanningError
    from .mission.formats.airspace_file import read_zones
    from .mission.geography import Origin
    from .mission.participants import Propulsion
    from .mission.propagation import reference_snr_db
    from .mission.scenario import Channel, Eavesdropper, GroundNode, NoFlyZone, Scenario, Uav
    from .optimize import fly_hover_fly, METHODS, solve
    from .plan import Bound, Iteration, Plan
    __version__: str

__all__ = ['Assessment', 'Bound', 'Channel', 'Comparison', 'Eavesdropper', 'FlownFlight',
           'GroundNode', 'Iteration', 'METHODS', 'NoFlyZone', 'Origin', 'Plan', 'PlanningError',
           'Propulsion', 'Scenario', 'Uav', 'World', 'assess', 'compare', 'fly_hover_fly',
           'read_flight', 'read_zones', 'reference_snr_db', 'run_campaign', 'shortest_duration',
           'solve', 'upper_bound']

_MODULES = ('apps.campaigns', 'assessment', 'bound', 'errors', 'mission.formats.airspace_file',
            'mission.geography', 'mission.participants', 'mission.propagation', 'mission.scenario',
            'optimize', 'plan')


def __getattr__(name: str) -> object:
    """Return the object of a public name; its first use loads all public names."""
    if not name.startswith('_') or name == '__version__':
        modules = [import_module(f'.{module}', __name__) for module in _MODULES]
        globals().update({public: getattr(module, public) for module in modules
                          for public in __all__ if hasattr(module, public)})
        globals()['__version__'] = import_module('.apps.cli', __name__).VERSION
    if name not in globals():
        raise AttributeError(f'module {__name__!r} has no attribute {name!r}')
    return globals()[name]


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
