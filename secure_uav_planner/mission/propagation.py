"""The channel between UAVs and receivers on the ground, and the SNR of a radio in it."""

from dataclasses import dataclass, field
import math
from typing import Any, Literal, TypeAlias

from . import OBJECTIVES
from .fields import (
    check_argument, check_numbers, Checked, checked_by, checked_truth, Choice, FieldChecks, Number,
    number, refuse)
from ..errors import quote

Environment: TypeAlias = Literal['suburban', 'urban', 'dense_urban', 'highrise']
"""A name for the numbers of a probability of line of sight."""

ENVIRONMENTS: dict[Environment, tuple[float, float, float]] = {
    'suburban': (4.88, 0.43, 21.0), 'urban': (9.61, 0.16, 20.0),
    'dense_urban': (12.08, 0.11, 23.0), 'highrise': (27.23, 0.08, 34.0)}
"""a, b and the extra loss without line of sight in dB (Al-Hourani, Kandeepan and Lardner 2014)."""

SPEED_OF_LIGHT = 299792458.0  # m/s
BOLTZMANN = 1.380649e-23  # J/K
NOISE_TEMPERATURE = 290.0  # K; noise figures refer to this temperature (IEEE).

_LOS_NUMBERS = {'a': Number(0.01, 100.0), 'b': Number(0.001, 2.0),
                'loss_db': Number(0.0, 100.0, 'dB')}


def _checked_los(value: Any) -> Any:
    """Return a `los` other than None: an environment's name, or a tuple of three floats."""
    if isinstance(value, str) and value in ENVIRONMENTS:
        return value
    if isinstance(value, (tuple, list)) and len(value) == len(_LOS_NUMBERS):
        return check_numbers(value, _LOS_NUMBERS)
    raise refuse(value, f'{quote(None)}, one of {", ".join(ENVIRONMENTS)}, or three numbers: a, b '
                 'and the extra loss in dB')


@dataclass(frozen=True)
class Channel(Checked):
    """
    How the gain of a link falls with the distance; by default the paper's free space.

    The mean gain is beta_0/sigma^2 / (d^2 + H^2)^(exponent/2) times P + (1 - P) kappa, where P =
    1 / (1 + a exp(-b (theta - a))) is the probability of a line of sight at the elevation theta in
    degrees, and kappa the extra loss without one. With all allowed values, the gain falls with
    the horizontal distance d; every guarantee rests on this.

    :param exponent: alpha, the path loss exponent.
    :param los: None for a line of sight everywhere, the name of an environment, or the three
        numbers a, b per degree, and the extra loss in dB.
    :param cautious: whether what leaks (transmitter to eavesdroppers) and what interferes (jammers
        to the ground node) counts at the gain of a line of sight. What helps counts at the mean.
        Ignored with an outage.
    :param rician_k_db: Rician factor of the fading in dB, or None for none; needs an outage.
    :param outage: largest probability with which the secrecy rate of a slot may be lower than the
        guaranteed one, because of fading or because a link has a line of sight or has none. With
        None there is no fading, and a probability of line of sight enters by the mean gain.
    :raises ScenarioError: naming the field, its value and what is allowed.
    """

    exponent: float = field(default=2.0, metadata=number(2.0, 6.0))
    los: Environment | tuple[float, float, float] | None = field(
        default=None, metadata=checked_by(_checked_los))
    cautious: bool = field(default=False, metadata=checked_by(checked_truth))
    rician_k_db: float | None = field(default=None, metadata=number(-40.0, 40.0, 'dB'))
    outage: float | None = field(default=None, metadata=number(1e-6, 0.5))

    _OWNER = 'channel.'

    @staticmethod
    def _check_together(checks: FieldChecks) -> None:
        """Check that fading has an outage, and that an outage has fading or lines of sight."""
        item = checks.item
        if item.rician_k_db is not None and item.outage is None:
            checks.add('outage', f'is {quote(None)}; it must be a number, as channel.rician_k_db '
                       'is one')
        if item.outage is not None and item.rician_k_db is None and (
                item.los is None or not checks.are_right('los')):
            checks.add('rician_k_db', f'is {quote(None)}; it must be a number, or channel.los not '
                       f'{quote(None)}, as channel.outage is {quote(item.outage)}')

    @property
    def los_numbers(self) -> tuple[float, float, float] | None:
        """Numbers a, b and the extra loss in dB, or None for a line of sight everywhere."""
        return ENVIRONMENTS[self.los] if isinstance(self.los, str) else self.los

    @property
    def counts_sights(self) -> bool:
        """Whether an outage is stated, so that quantiles of the lines of sight are used."""
        return self.los is not None and self.outage is not None

    @property
    def promise(self) -> str:
        """Words for what rates promise: 'guaranteed', or at which mean gains they hold."""
        if self.is_guarantee:
            return 'guaranteed'
        return 'at mean gains of the links that help' if self.cautious else 'at mean gains'

    @property
    def is_guarantee(self) -> bool:
        """Whether rates are guaranteed: `los` is None, or an outage is stated."""
        return self.los is None or self.counts_sights

    def rate_name(self, objective: str) -> str:
        """
        Name the rate of an objective, such as 'guaranteed rate', as all views do.

        :raises OptionError: for another objective.
        """
        return rate_name(objective, self.promise)

    @property
    def is_inverse_square(self) -> bool:
        """Whether the gain is a constant / (d^2 + H^2), as in free space."""
        return self.exponent == 2.0 and self.los is None

    @property
    def is_free_space(self) -> bool:
        """Whether this is the paper's channel: free space without fading."""
        return self.is_inverse_square and self.outage is None


def rate_name(objective: str, promise: str) -> str:
    """Name an objective's rate by a Channel.promise, as 'worst-case rate at mean gains'."""
    check_argument('objective', objective, Choice(OBJECTIVES))
    if promise == 'guaranteed':
        return 'guaranteed rate' if objective == 'guaranteed' else 'worst-case rate'
    return f'{"lower bound" if objective == "guaranteed" else "worst-case rate"} {promise}'


def fading_quantiles(rician_k_db: float | None, share: float) -> tuple[float, float]:
    """
    Return the quantiles of the power gain of Rician fading at probabilities share and 1 - share.

    Both are 1 without fading, for rician_k_db None.
    """
    if rician_k_db is None:
        return 1.0, 1.0
    from scipy.stats import ncx2  # Here, because it takes half a second to import.
    # 2 (K + 1) |h|^2 is noncentral chi-square with 2 degrees of freedom, noncentrality 2 K.
    factor = 10.0**(rician_k_db / 10.0)
    low, high = (quantile(share, 2, 2 * factor) / (2 * (factor + 1))
                 for quantile in (ncx2.ppf, ncx2.isf))
    return float(low), float(high)


def reference_snr_db(carrier_hz: float, bandwidth_hz: float, noise_figure_db: float = 0.0,
                     transmit_gain_dbi: float = 0.0, receive_gain_dbi: float = 0.0) -> float:
    """
    Return the SNR at 1 m and 1 W, beta_0 / sigma^2, of a radio link in free space, in dB.

    The gain of the channel at 1 m is beta_0 = G_t G_r (c / (4 pi f))^2, by Friis' equation, and
    the noise power sigma^2 = k T_0 B F with T_0 = 290 K. It holds in the far field: at distances
    of many wavelengths, with a line of sight and without reflections.

    :param carrier_hz: f, the carrier's frequency in Hz.
    :param bandwidth_hz: B, the bandwidth of the receiver in Hz.
    :param noise_figure_db: F, of the receiver with its cable, in dB.
    :param transmit_gain_dbi: G_t, gain of the UAV's antenna towards the ground in dBi.
    :param receive_gain_dbi: G_r, gain of the ground node's antenna towards the UAV in dBi.
    :raises OptionError: naming the argument, its value and what is allowed.
    """
    for name, value, check in (
            ('carrier_hz', carrier_hz, Number(1e6, 1e12, 'Hz')),
            ('bandwidth_hz', bandwidth_hz, Number(1.0, 1e11, 'Hz')),
            ('noise_figure_db', noise_figure_db, Number(0.0, 60.0, 'dB')),
            ('transmit_gain_dbi', transmit_gain_dbi, Number(-60.0, 80.0, 'dBi')),
            ('receive_gain_dbi', receive_gain_dbi, Number(-60.0, 80.0, 'dBi'))):
        check_argument(name, value, check)
    path_gain = 20 * math.log10(SPEED_OF_LIGHT / (4 * math.pi * carrier_hz))
    noise = 10 * math.log10(BOLTZMANN * NOISE_TEMPERATURE * bandwidth_hz) + noise_figure_db
    return path_gain + transmit_gain_dbi + receive_gain_dbi - noise
