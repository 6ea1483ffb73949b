"""Plan how two or more UAVs fly and radiate so that a transmission stays secret."""

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from .bound.bound import Bound
    from .bound.upper_bound import upper_bound
    from .errors import PlanningError
    from .link_budget import reference_snr_db
    from .optimize.solve import fly_hover_fly, METHODS, solve
    from .plan import Iteration, Plan
    from .scenario import Eavesdropper, NoFlyZone, Scenario, Uav

__all__ = ['Bound', 'Eavesdropper', 'Iteration', 'METHODS', 'NoFlyZone', 'Plan', 'PlanningError',
           'Scenario', 'Uav', 'fly_hover_fly', 'reference_snr_db', 'solve', 'upper_bound']

_HOMES = {'bound': ('Bound', 'upper_bound'), 'errors': ('PlanningError',),
          'link_budget': ('reference_snr_db',),
          'optimize': ('fly_hover_fly', 'METHODS', 'solve'),
          'plan': ('Iteration', 'Plan'),
          'scenario': ('Eavesdropper', 'NoFlyZone', 'Scenario', 'Uav')}


def __getattr__(name: str) -> object:
    """
    Return a public name, or a module of this package, and import it only now.

    Importing the package itself takes no time, so that an executable can see to signals before
    its modules load.
    """
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
