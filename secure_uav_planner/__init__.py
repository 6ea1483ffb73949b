"""Plan how two or more UAVs fly and radiate so that a transmission stays secret."""

from collections.abc import Sequence
from importlib import import_module
from importlib.abc import Loader, MetaPathFinder
from importlib.machinery import ModuleSpec
from importlib.util import find_spec
import sys
from types import CodeType, ModuleType
from typing import TYPE_CHECKING

from .mission import views

if TYPE_CHECKING:
    from .assessment import assess, Assessment, World
    from .bound.method import upper_bound
    from .errors import PlanningError
    from .mission.link_budget import reference_snr_db
    from .mission.propulsion import Propulsion
    from .mission.scenario import Channel, Eavesdropper, NoFlyZone, Scenario, Uav
    from .optimize.solve import fly_hover_fly, METHODS, solve
    from .plan.bound import Bound
    from .plan.plan import Iteration, Plan
    __version__: str

__all__ = ['Assessment', 'Bound', 'Channel', 'Eavesdropper', 'Iteration', 'METHODS', 'NoFlyZone',
           'Plan', 'PlanningError', 'Propulsion', 'Scenario', 'Uav', 'World', 'assess',
           'fly_hover_fly', 'reference_snr_db', 'solve', 'upper_bound']

_HOMES = {'assessment': ('Assessment', 'World', 'assess'),
          'bound': ('upper_bound',),
          'errors': ('PlanningError',),
          'mission.link_budget': ('reference_snr_db',),
          'mission.propulsion': ('Propulsion',),
          'mission.scenario': ('Channel', 'Eavesdropper', 'NoFlyZone', 'Scenario', 'Uav'),
          'optimize': ('fly_hover_fly', 'METHODS', 'solve'),
          'plan': ('Bound', 'Iteration', 'Plan')}

_MOVED = {
    **{name: f'apps.{name}' for name in ('bench', 'campaign', 'cli', 'demo', 'fly', 'study')},
    **{name: f'mission.{name}' for name in (
        'files', 'kinematics', 'link_budget', 'polygons', 'scenario')},
    **{name: f'model.{name}' for name in (
        'airspace', 'channel', 'clearance', 'curve', 'grid', 'kernel', 'limits', 'quadratics')},
    'autopilots': 'output.autopilots', 'choices': 'mission', 'export': 'output',
    'fields': 'mission.validation', 'members': 'mission.participants',
    'plan_file': 'plan.file', 'playback': 'plan.playback', 'tracking': 'plan.tracking',
    'view': 'output'}
"""Modules that stood here before, and where they are now: their old names still import them."""


class _Moved(MetaPathFinder):
    """Finds modules by their old names."""

    def find_spec(self, fullname: str, path: Sequence[str] | None = None,
                  target: ModuleType | None = None) -> ModuleSpec | None:
        package, _, name = fullname.partition('.')
        first, _, rest = name.partition('.')
        if package != __name__ or first not in _MOVED:
            return None
        spec = find_spec('.'.join(filter(None, (package, _MOVED[first], rest))))
        return spec and ModuleSpec(fullname, _Alias(spec), origin=spec.origin,
                                   is_package=spec.submodule_search_locations is not None)


class _Alias(Loader):
    """
    Loads a module by its old name: the same module, not a copy.

    :param spec: of the module.
    """

    def __init__(self, spec: ModuleSpec) -> None:
        self._spec = spec

    def create_module(self, spec: ModuleSpec) -> ModuleType:
        return import_module(self._spec.name)

    def exec_module(self, module: ModuleType) -> None:
        module.__spec__ = self._spec  # It has got that of the old name.

    def get_code(self, fullname: str) -> CodeType:
        """Return what runs the module, for `python -m`."""
        name = self._spec.name.removesuffix('.__main__')
        return compile(f'import runpy; runpy.run_module({name!r}, None, "__main__", True)',
                       fullname, 'exec')


sys.meta_path.insert(0, _Moved())
views.offer(__name__, plot_plan='.output.picture:draw_plan',
            plot_assessment='.output.assessment_picture:draw_assessment',
            plot_scenario='.output.picture:draw_scenario',
            plan_to_dataframe='.output.spreadsheet:to_dataframe',
            save_mcap='.ros.recording:record')
import_module('.model.kernel', __name__)  # Where it is not built, its error says what to do.


def __getattr__(name: str) -> object:
    """
    Return a public name, or a module of this package, and import it only now.

    Importing the package itself takes no time, so that an executable can see to signals before
    its modules load.
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
