"""Parameters of the channel, and whether eavesdroppers collude."""

from collections.abc import Mapping
from typing import Any

from .spec import Spec
from ..errors import ParameterError, shown
from ..mission.propagation import Channel, ENVIRONMENTS
from ..mission.scenario import LIMITS, Scenario

_NONE = 'none'
_NO_OUTAGE = 0.0

CHANNEL = {
    'channel.exponent': Spec(2.0, 'Path loss exponent alpha; 2 is free space.',
                             LIMITS['exponent']),
    'channel.los': Spec(_NONE, 'Environment that gives the probability of a line of sight; none '
                        'for a line of sight everywhere, or for channel.los_numbers.',
                        choices=(_NONE, *ENVIRONMENTS)),
    'channel.los_numbers': Spec(
        [], 'Numbers a, b per degree and extra loss in dB instead of an environment; empty for '
        'none.', (0.0, LIMITS['los_loss_db'][1]), length=(0, 3)),
    'channel.cautious': Spec(False, 'Whether what leaks and what interferes counts at the gain of '
                             'a line of sight, and what helps at the mean gain.'),
    'channel.rician_k_db': Spec(0.0, 'Rician factor of the fading in dB; it counts only with '
                                'channel.outage.', LIMITS['rician_k_db']),
    'channel.outage': Spec(_NO_OUTAGE, 'Largest probability with which the secrecy rate of a slot '
                           'may be lower than the guaranteed one because of fading; 0 for no '
                           'fading, otherwise at least 1e-6.', (_NO_OUTAGE, LIMITS['outage'][1])),
}
"""Parameters of the channel by name."""

COLLUDING = {
    'colluding': Spec(False, 'Whether the eavesdroppers put together what they hear.'),
}


def channel_from(values: Mapping[str, Any]) -> Channel:
    """
    Return the Channel that the parameter values describe.

    :raises PlanningError: for an environment and numbers at once, or wrong numbers.
    """
    los, numbers = values['channel.los'], values['channel.los_numbers']
    if numbers and los != _NONE:
        raise ParameterError(
            f'channel.los_numbers is {shown(numbers)}; it must be empty where channel.los is '
            f'{los}')
    outage = values['channel.outage'] or None
    return Channel(values['channel.exponent'], numbers or (None if los == _NONE else los),
                   values['channel.cautious'],
                   None if outage is None else values['channel.rician_k_db'], outage)


def values_of_channel(mission: Scenario) -> dict[str, Any]:
    """Return the values of parameters by name that the channel of a mission stands for."""
    channel = mission.channel
    named = isinstance(channel.los, str)
    return {
        'channel.exponent': channel.exponent, 'channel.cautious': channel.cautious,
        'channel.los': channel.los if named else _NONE,
        'channel.los_numbers': [] if named else list(channel.los or ()),
        'channel.rician_k_db': channel.rician_k_db or 0.0,
        'channel.outage': channel.outage or _NO_OUTAGE, 'colluding': mission.colluding}
