"""Plan how two or more UAVs fly and radiate so that a transmission stays secret."""

from importlib import import_module
from typing import TYPE_CHECKING

from .mission import register_views

if TYPE_CHECKING:
    from .assessment import assess, Assessment, World
    from .bound.method import upper_bound
    from .errors import PlanningError
    from .mission.participants import Propulsion
    from .mission.propagation import reference_snr_db
    from .mission.scenario import Channel, Eavesdropper, NoFlyZone, Scenario, Uav
    from .optimize.methods import fly_hover_fly, METHODS, solve
    from .plan.plan import Plan
    from .plan.results import Bound, Iteration
    __version__: str

__all__ = ['Assessment', 'Bound', 'Channel', 'Eavesdropper', 'Iteration', 'METHODS', 'NoFlyZone',
           'Plan', 'PlanningError', 'Propulsion', 'Scenario', 'Uav', 'World', 'assess',
           'fly_hover_fly', 'reference_snr_db', 'solve', 'upper_bound']

_HOMES = {'assessment': ('Assessment', 'World', 'assess'),
          'bound': ('upper_bound',),
          'errors': ('PlanningError',),
          'mission.participants': ('Propulsion',),
          'mission.propagation': ('reference_snr_db',),
          'mission.scenario': ('Channel', 'Eavesdropper', 'NoFlyZone', 'Scenario', 'Uav'),
          'optimize': ('fly_hover_fly', 'METHODS', 'solve'),
          'plan': ('Bound', 'Iteration', 'Plan')}

register_views(__name__, plot_plan='.output.picture:draw_plan',
               plot_assessment='.output.assessment_picture:draw_assessment',
               plot_scenario='.output.picture:draw_scenario',
               plan_to_dataframe='.output.tables:to_dataframe',
               save_mcap='.ros.recording:record')
import_module('.model.kernel', __name__)  # If it is not built, its error says what to do.


def __getattr__(name: str) -> object:
    """
    Import a public name, or a module of this package, when it is first used.

    Importing the package itself takes no time, so that an executable can set its signal handlers
    before its modules load.
    """
    if name == '__version__':
        metadata = import_module('importlib.metadata')
        try:
            return metadata.version(__name__)
        except metadata.PackageNotFoundError:
            return 'unknown'
    for home, names in _HOMES.items():
        if name in names:
            value = getattr(import_module(f'.{home}', __name__), name)
            globals()[name] = value
            return value
    try:
        return import_module(f'.{name}', __name__)
    except ModuleNotFoundError as error:
        if error.name != f'{__name__}.{name}':
            raise
    raise AttributeError(f'module {__name__!r} has no attribute {name!r}')


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
