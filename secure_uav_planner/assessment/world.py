"""How the world may differ from what a plan was made for."""

from dataclasses import dataclass
import math
from typing import Any

import numpy as np

from ..errors import OptionError, quote, ScenarioError
from ..mission import Place, PLACES
from ..mission.propagation import Channel
from ..mission.scenario import Point
from ..mission.validation import (
    Array, checked_block, checked_fields, checked_number, checked_point, set_checked)

CONFIDENCE = 0.95
"""Probability of the disc where a normal place has no covariance of its own, as in the planner."""


@dataclass(frozen=True)
class World:
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

    place: Place = 'disc'
    covariance: tuple[Point, Point] | None = None
    beyond: float = 0.0
    positions: tuple[Point, ...] | None = None
    channel: Channel | None = None
    los_distance: float | None = 50.0
    speed_factor: float = 1.0
    receiver_db: float = 0.0
    tracking_std: float = 0.0
    tracking_time: float = 2.0

    def __post_init__(self) -> None:
        try:
            self._check()
        except ScenarioError as error:
            raise OptionError(str(error), error.place) from None

    def _check(self) -> None:
        if self.place not in PLACES:
            raise OptionError(f'place is {quote(self.place)}; it must be one of '
                              f'{", ".join(PLACES)}', ('place',))
        set_checked(self, '', checked_number,
                    'beyond', 'speed_factor', 'receiver_db', 'tracking_std', 'tracking_time')
        set_checked(self, '', checked_number, 'los_distance', optional=True)
        if self.channel is not None:
            object.__setattr__(self, 'channel', checked_block('channel', self.channel, Channel))
        for field, count in (('positions', None), ('covariance', 2)):
            value = getattr(self, field)
            if value is None:
                continue
            if not isinstance(value, (tuple, list, np.ndarray)) or not 0 < len(value) or (
                    count and len(value) != count):
                raise OptionError(f'{field} is {quote(value)}; it must be a list of '
                                  f'{f"{count} " if count else ""}pairs', (field,))
            object.__setattr__(self, field, tuple(
                checked_point('', field, point, number) for number, point in enumerate(value)))
        for field, place in (('beyond', 'beyond'), ('positions', 'fixed'),
                             ('covariance', 'normal')):
            value = getattr(self, field)
            if value and self.place != place:
                raise OptionError(f'{field} is {quote(value)} and place is {self.place!r}; it '
                                  f'counts only with the place {place!r}', (field,))
        if self.place == 'beyond' and not self.beyond:
            raise OptionError("beyond is 0.0; with the place 'beyond' it must be above 0 m",
                              ('beyond',))
        if self.covariance is not None:
            (xx, xy), (yx, yy) = self.covariance
            if xy != yx or min(xx, yy) < 0 or xy**2 > xx * yy:
                raise OptionError(f'covariance is {quote(self.covariance)}; it must be symmetric '
                                  'and positive semidefinite', ('covariance',))

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
