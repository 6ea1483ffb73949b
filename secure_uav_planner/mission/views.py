"""
Views of missions and plans as their methods: pictures, tables, recordings.

Rooms further down make the views, with packages that are optional. The package says where, by
`offer`, and they are imported when they are asked for.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from pkgutil import resolve_name
from typing import Any

from ..errors import MissingPackageError

_EXTRAS = {'matplotlib': 'view', 'mcap': 'view', 'pandas': 'view', 'plotly': 'view',
           'distributed': 'campaign', 'joblib': 'campaign', 'tqdm': 'campaign'}

_homes: dict[str, str] = {}


def offer(package: str, **homes: str) -> None:
    """Say which function of a package makes each view, such as `.output.picture:draw_plan`."""
    _homes.update({name: f'{package}{home}' for name, home in homes.items()})


def view(name: str, *arguments: Any, **options: Any) -> Any:
    """Return a view of these arguments, or raise MissingPackageError naming what it needs."""
    with naming_what_is_missing():
        return resolve_name(_homes[name])(*arguments, **options)


def check_view(name: str) -> None:
    """Import what makes a view, before the work that it will show; raise as view does."""
    with naming_what_is_missing():
        resolve_name(_homes[name])


@contextmanager
def naming_what_is_missing() -> Iterator[None]:
    """Let a package that is not installed be a MissingPackageError, which says how to get it."""
    try:
        yield
    except ModuleNotFoundError as error:
        missing = (error.name or '').partition('.')[0]
        raise MissingPackageError(
            f'{missing} is not installed; pip install '
            f'"secure_uav_planner[{_EXTRAS.get(missing, "ros")}]"') from error
