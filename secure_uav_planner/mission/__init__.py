"""A mission: its participants, limits and files, and the names of what a user can choose."""

from pkgutil import resolve_name
from typing import Any, get_args, Literal, TypeAlias

from ..errors import name_missing_package

Objective: TypeAlias = Literal['guaranteed', 'worst_case']
"""What is maximised: 'guaranteed' is the paper's problem (P2), 'worst_case' its (P1)."""

OBJECTIVES: tuple[Objective, ...] = get_args(Objective)

Method: TypeAlias = Literal['joint', 'alternating']
"""A method of solve."""

METHODS: tuple[Method, ...] = get_args(Method)

Place: TypeAlias = Literal['disc', 'normal', 'beyond', 'fixed']
"""The law by which an assessment draws the places of eavesdroppers."""

PLACES: tuple[Place, ...] = get_args(Place)

Power: TypeAlias = Literal['constant', 'optimised']
"""The powers of fly_hover_fly."""

_makers: dict[str, str] = {}


def register_views(package: str, **makers: str) -> None:
    """
    Register the functions that make views: pictures, tables and recordings.

    They lie in rooms that import this one and need optional packages, so that they are imported
    by name, such as `.output.picture:draw_plan`, when a view is made.
    """
    _makers.update({name: f'{package}{maker}' for name, maker in makers.items()})


def make_view(name: str, *arguments: Any, **options: Any) -> Any:
    """Make a registered view, or raise MissingPackageError naming the package that it needs."""
    with name_missing_package():
        return resolve_name(_makers[name])(*arguments, **options)


def import_view(name: str) -> None:
    """Import the function of a view, before long work that ends with it; raise as make_view."""
    with name_missing_package():
        resolve_name(_makers[name])
