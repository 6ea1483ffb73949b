"""A link budget: the reference SNR of a radio, in free space."""

import math

from .validation import checked_number
from ..errors import OptionError, ScenarioError

SPEED_OF_LIGHT = 299792458.0  # In m/s.
BOLTZMANN = 1.380649e-23  # In J/K.
NOISE_TEMPERATURE = 290.0  # In K, to which noise figures refer (IEEE).


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
    given = {'carrier_hz': carrier_hz, 'bandwidth_hz': bandwidth_hz,
             'noise_figure_db': noise_figure_db, 'transmit_gain_dbi': transmit_gain_dbi,
             'receive_gain_dbi': receive_gain_dbi}
    try:
        for name, value in given.items():
            checked_number('', name, value)
    except ScenarioError as error:
        raise OptionError(str(error), error.place) from None
    path_gain = 20 * math.log10(SPEED_OF_LIGHT / (4 * math.pi * carrier_hz))
    noise = 10 * math.log10(BOLTZMANN * NOISE_TEMPERATURE * bandwidth_hz) + noise_figure_db
    return path_gain + transmit_gain_dbi + receive_gain_dbi - noise
