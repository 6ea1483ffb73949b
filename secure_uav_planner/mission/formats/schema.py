"""What a mission file may have, as instances of the classes that it describes."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True)
class Schema:
    """
    The classes of a mission, each as an instance in which any one field can be tried.

    This package imports none of them, so that Scenario can use it.

    :param scenario: a Scenario with limits so wide that any right value of a field fits.
    :param members: for each field of the scenario that is a list, such a Uav, Eavesdropper ...
    :param parts: for each field of the scenario that is an object of its own, such a Channel.
    """

    scenario: Any
    members: Mapping[str, Any]
    parts: Mapping[str, Any]


UNITS = {
    'ground_node': 'm', 'position': 'm', 'start': 'm', 'goal': 'm', 'vertices': 'm',
    'geofence': 'm', 'error_radius': 'm', 'altitude': 'm', 'separation': 'm', 'floor': 'm',
    'ceiling': 'm', 'tracking_margin': 'm', 'max_speed': 'm/s', 'start_velocity': 'm/s',
    'goal_velocity': 'm/s', 'max_acceleration': 'm/s^2', 'average_power': 'W',
    'peak_power': 'W', 'duration': 's', 'reference_snr_db': 'dB', 'receiver_advantage_db': 'dB',
    'blade_power': 'W', 'induced_power': 'W', 'tip_speed': 'm/s', 'induced_velocity': 'm/s',
    'air_density': 'kg/m^3', 'disc_area': 'm^2',
    'rician_k_db': 'dB',
}
"""The unit of every field that has one."""
