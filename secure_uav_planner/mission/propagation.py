"""The channel between UAVs and receivers on the ground, as it is asked for."""

from dataclasses import dataclass
from typing import Any, Literal, TypeAlias

from . import OBJECTIVES
from .validation import checked_choice, checked_number, set_checked
from ..errors import quote, ScenarioError

Environment: TypeAlias = Literal['suburban', 'urban', 'dense_urban', 'highrise']
"""A name for the numbers of a probability of line of sight."""

ENVIRONMENTS: dict[Environment, tuple[float, float, float]] = {
    'suburban': (4.88, 0.43, 21.0), 'urban': (9.61, 0.16, 20.0),
    'dense_urban': (12.08, 0.11, 23.0), 'highrise': (27.23, 0.08, 34.0)}
"""a, b and the extra loss without line of sight in dB (Al-Hourani, Kandeepan and Lardner 2014)."""

_LOS_NUMBERS = ('los_a', 'los_b', 'los_loss_db')


@dataclass(frozen=True)
class Channel:
    """
    How the gain of a link falls with the distance; by default the paper's free space.

    The mean gain is beta_0/sigma^2 / (d^2 + H^2)^(exponent/2) times P + (1 - P) kappa, where P =
    1 / (1 + a exp(-b (theta - a))) is the probability of a line of sight at the elevation theta in
    degrees, and kappa the extra loss without one. All values allowed give gains that fall with
    the horizontal distance d, on which every guarantee rests.

    :param exponent: alpha, the path loss exponent.
    :param los: None for a line of sight everywhere, the name of an environment, or the three
        numbers a, b per degree, and the extra loss in dB.
    :param cautious: whether what leaks (transmitter to eavesdroppers) and what interferes (jammers
        to the ground node) counts at the gain of a line of sight. What helps counts at the mean.
    :param rician_k_db: Rician factor of the fading in dB, or None for none.
    :param outage: largest probability with which the secrecy rate of a slot may be lower than
        the guaranteed one because of fading; needed with rician_k_db, and only then.
    :raises ScenarioError: naming the field, its value and what is allowed.
    """

    exponent: float = 2.0
    los: Environment | tuple[float, float, float] | None = None
    cautious: bool = False
    rician_k_db: float | None = None
    outage: float | None = None

    def __post_init__(self) -> None:
        set_checked(self, 'channel.', checked_number, 'exponent')
        object.__setattr__(self, 'los', _checked_los(self.los))
        if not isinstance(self.cautious, bool):
            raise ScenarioError(f'channel.cautious is {quote(self.cautious)}; it must be true or '
                                'false', ('cautious',))
        for field, other in (('rician_k_db', 'outage'), ('outage', 'rician_k_db')):
            set_checked(self, 'channel.', checked_number, field, optional=True)
            if getattr(self, field) is None and getattr(self, other) is not None:
                raise ScenarioError(f'channel.{field} is {quote(None)}; it must be a number, as '
                                    f'channel.{other} is one', (field,))

    @property
    def los_numbers(self) -> tuple[float, float, float] | None:
        """Return a, b and the extra loss in dB, or None for a line of sight everywhere."""
        return ENVIRONMENTS[self.los] if isinstance(self.los, str) else self.los

    @property
    def promise(self) -> str:
        """Name rates as 'guaranteed', perhaps with an outage, or by the gains they count with."""
        if self.los is None:
            return 'guaranteed'
        return 'at mean gains of the links that help' if self.cautious else 'at mean gains'

    @property
    def is_guarantee(self) -> bool:
        """Whether rates are guaranteed; with a probability of line of sight they are not."""
        return self.los is None

    def rate_name(self, objective: str) -> str:
        """
        Name the rate of an objective, such as 'guaranteed rate', as all views do.

        :raises OptionError: for another objective.
        """
        return rate_name(objective, self.promise)

    @property
    def is_inverse_square(self) -> bool:
        """Return whether the gain is a constant / (d^2 + H^2), as in free space."""
        return self.exponent == 2.0 and self.los is None

    @property
    def is_free_space(self) -> bool:
        """Return whether this is the paper's channel: free space without fading."""
        return self.is_inverse_square and self.outage is None


def rate_name(objective: str, promise: str) -> str:
    """Name the rate of an objective with the promise of a channel."""
    checked_choice('objective', objective, OBJECTIVES)
    if promise == 'guaranteed':
        return 'guaranteed rate' if objective == 'guaranteed' else 'worst-case rate'
    return f'{"lower bound" if objective == "guaranteed" else "worst-case rate"} {promise}'


def _checked_los(value: Any) -> Any:
    """Return the field `los`, three numbers as a tuple."""
    if value is None or (isinstance(value, str) and value in ENVIRONMENTS):
        return value
    if isinstance(value, (tuple, list)) and len(value) == len(_LOS_NUMBERS):
        try:
            return tuple(checked_number('channel.', field, number)
                         for field, number in zip(_LOS_NUMBERS, value, strict=True))
        except ScenarioError as error:
            raise ScenarioError(f'channel.los is {quote(value)}: {error}', ('los',)) from None
    raise ScenarioError(
        f'channel.los is {quote(value)}; it must be {quote(None)}, one of '
        f'{", ".join(ENVIRONMENTS)}, or three numbers: a, b and the extra loss in dB', ('los',))
