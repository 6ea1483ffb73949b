"""What flying takes: the propulsion power of a rotary-wing UAV."""

from dataclasses import dataclass, fields
from typing import Any

import numpy as np

from .validation import Array, checked_array, checked_number, set_checked
from ..errors import OptionError, shown


@dataclass(frozen=True)
class Propulsion:
    """
    A rotary wing.

    It is equation (12) of Y. Zeng, J. Xu, R. Zhang, Energy Minimization for Wireless
    Communication with Rotary-Wing UAV, IEEE Trans. Wireless Commun. 18 (2019), whose numbers are
    the defaults. What changes of velocity take is left out there, and here.

    :param blade_power: P_0, the blade profile power while hovering, in W.
    :param induced_power: P_i, the induced power while hovering, in W.
    :param tip_speed: U_tip, of the rotor blades, in m/s.
    :param induced_velocity: v_0, mean rotor induced velocity while hovering, in m/s.
    :param fuselage_drag_ratio: d_0.
    :param air_density: rho, in kg/m^3.
    :param solidity: s, of the rotor.
    :param disc_area: A, of the rotor, in m^2.
    :raises ScenarioError: naming the field, its value and what is allowed.
    """

    blade_power: float = 79.8563
    induced_power: float = 88.6279
    tip_speed: float = 120.0
    induced_velocity: float = 4.03
    fuselage_drag_ratio: float = 0.6
    air_density: float = 1.225
    solidity: float = 0.05
    disc_area: float = 0.503

    def __post_init__(self) -> None:
        set_checked(self, 'propulsion.', checked_number, *(field.name for field in fields(self)))

    def power(self, speeds: Any) -> Array:
        """
        Return P(V), equation (12), in W at speeds V in m/s of any shape.

        :raises OptionError: for a speed that is not a number of at least 0.
        """
        given = checked_array('speeds', speeds)
        if not (given >= 0).all():
            raise OptionError(f'speeds is {shown(speeds)}; it must have numbers of at least 0 m/s',
                              ('speeds',))
        squared = np.square(given)
        ratio = squared / (2 * self.induced_velocity**2)
        # sqrt(1 + x^2) - x, without the loss of digits for a large x.
        induced = 1 / np.sqrt(np.hypot(1.0, ratio) + ratio)
        drag = 0.5 * self.fuselage_drag_ratio * self.air_density * self.solidity * self.disc_area
        return (self.blade_power * (1 + 3 * squared / self.tip_speed**2)
                + self.induced_power * induced + drag * squared**1.5)
