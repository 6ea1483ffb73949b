"""How the world may differ from what a plan was made for."""

from dataclasses import dataclass, field
import math
from typing import Any

import numpy as np

from ..errors import OptionError, quote, ScenarioError
from ..mission import LOCATION_MODELS, LocationModel
from ..mission.fields import (
    Block, Checked, checked_by, checked_fields, checked_point, Choice, FieldChecks, number, Point)
from ..mission.propagation import Channel
from ..mission.validation import Array

CONFIDENCE = 0.95
"""Probability of the disc where a normal place has no covariance of its own, as in the planner."""


def _checked_pairs(owner: str, name: str, value: Any) -> tuple[Point, ...]:
    """Return a list of pairs as tuples; a covariance has two."""
    count = 2 if name == 'covariance' else None
    if not isinstance(value, (tuple, list, np.ndarray)) or not 0 < len(value) or (
            count and len(value) != count):
        raise ScenarioError(f'{owner}{name} is {quote(value)}; it must be a list of '
                            f'{f"{count} " if count else ""}pairs', (name,))
    return tuple(checked_point(owner, name, pair, index) for index, pair in enumerate(value))


@dataclass(frozen=True)
class World(Checked):
    """
    How the world may differ from what a plan was made for; by default only within its promise.

    Every eavesdropper stays at one place, or at one offset from its track, for the whole mission.

    :param place: 'disc', uniformly in the disc of each eavesdropper; 'normal', around its centre;
        'beyond', uniformly in the ring around the disc; 'fixed', at `positions`.
    :param covariance: of a normal place, ((xx, xy), (xy, yy)) in m^2; by default round, with
        the disc as its region of CONFIDENCE.
    :param beyond: width of the ring in m.
    :param positions: of a fixed place, (x, y) in m for each eavesdropper; by default the centres.
    :param channel: a Channel instead of the scenario's.
    :param los_distance: distance in m flown by a UAV between draws of the lines of sight of its
        links; 0 draws them in each slot, None takes the mean gain instead. It counts where the
        channel has a probability of line of sight. The default is the correlation distance of
        urban cells in 3GPP TR 38.901, table 7.6.3.1-2.
    :param speed_factor: by what factor eavesdroppers move faster along their tracks than the plan
        assumes; below 1, slower.
    :param receiver_db: by how much in dB every eavesdropper's receiver is better than the
        scenario says.
    :param tracking_std: standard deviation in m, in x and in y, of the UAVs around their plan.
    :param tracking_time: in s, after which the correlation of these errors has fallen to 1/e.
    :raises OptionError: naming the field, its value and what is allowed.
    """

    place: LocationModel = field(default='disc', metadata=checked_by(Choice(LOCATION_MODELS)))
    covariance: tuple[Point, Point] | None = field(
        default=None, metadata=checked_by(_checked_pairs, 'm^2'))
    beyond: float = field(default=0.0, metadata=number(0.0, 1e6, 'm'))
    positions: tuple[Point, ...] | None = field(
        default=None, metadata=checked_by(_checked_pairs, 'm'))
    channel: Channel | None = field(default=None, metadata=checked_by(Block(Channel)))
    los_distance: float | None = field(default=50.0, metadata=number(0.0, 1e6, 'm'))
    speed_factor: float = field(default=1.0, metadata=number(0.0, 100.0))
    receiver_db: float = field(default=0.0, metadata=number(-100.0, 100.0, 'dB'))
    tracking_std: float = field(default=0.0, metadata=number(0.0, 1e4, 'm'))
    tracking_time: float = field(default=2.0, metadata=number(0.0, 1e6, 's'))

    def __post_init__(self) -> None:
        try:
            super().__post_init__()
        except ScenarioError as error:
            raise OptionError(str(error), error.place) from None

    @staticmethod
    def _check_together(checks: FieldChecks) -> None:
        item = checks.item
        for name, place in (('beyond', 'beyond'), ('positions', 'fixed'),
                            ('covariance', 'normal')):
            value = getattr(item, name)
            if checks.are_right(name, 'place') and value and item.place != place:
                checks.add(name, f'is {quote(value)} and place is {item.place!r}; it counts only '
                           f'with the place {place!r}')
        if item.place == 'beyond' and not item.beyond:
            checks.add('beyond', "is 0.0; with the place 'beyond' it must be above 0 m")
        if item.covariance is not None and checks.are_right('covariance'):
            (xx, xy), (yx, yy) = item.covariance
            if xy != yx or min(xx, yy) < 0 or xy**2 > xx * yy:
                checks.add('covariance', f'is {quote(item.covariance)}; it must be symmetric and '
                           'positive semidefinite')

    def deviations(self, radius: float) -> Array:
        """Return a root of the covariance of a normal place, (2, 2) in m, for an error radius."""
        if self.covariance is None:
            return np.eye(2) * (radius / math.sqrt(-2.0 * math.log1p(-CONFIDENCE)))
        variances, axes = np.linalg.eigh(np.array(self.covariance))
        return axes * np.sqrt(np.maximum(variances, 0.0))

    @classmethod
    def from_dict(cls, data: Any) -> 'World':
        """
        Return a World of plain values, as in a campaign file; missing fields take their defaults.

        :raises OptionError: for an unknown field or a wrong value.
        """
        try:
            return cls(**checked_fields(cls, data))
        except ScenarioError as error:
            raise OptionError(str(error), error.place) from None
