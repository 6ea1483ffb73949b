"""Limits of autopilots: their defaults, and the values that a plan needs."""

from collections.abc import Mapping
from dataclasses import dataclass
import math

_GRAVITY = 9.81  # In m/s^2.
_DRAG = 0.036  # Of a multicopter: its deceleration over the square of its speed, in 1/m.
# In ArduPilot's simulator, 30 degrees carried 2 and not 3 m/s^2 at 10 m/s: 0.027 to 0.037.

_RESERVE = 4 / 3  # Least ratio of a limit to the plan's: without it a delay is never made up.
_SPEED, _ACCELERATION = 1.5, 1.6  # Recommended ratios, as flown with 3 m/s^2.
_STEPS = {'speed': 0.5, 'acceleration': 0.5, 'lean': 5.0}  # Of recommended values.


def lean(speed: float, acceleration: float, reserve: float = 1.0) -> float:
    """Return the lean in degrees for an acceleration in m/s^2 and the drag at a speed in m/s."""
    return math.degrees(math.atan2(reserve * (acceleration + _DRAG * speed**2), _GRAVITY))


@dataclass(frozen=True)
class Parameter:
    """A parameter of an autopilot that limits how it follows setpoints."""

    name: str  # As in the autopilot's documentation.
    limits: str  # 'speed', 'acceleration' or 'lean'.
    unit: str  # Of its values.
    factor: float  # 1 m/s, 1 m/s^2 or 1 degree in that unit.
    default: float
    most: float  # The largest value that the documentation allows.

    def least(self, speed: float, acceleration: float) -> float:
        """Return the least value, with a reserve, for a plan with limits in m/s and m/s^2."""
        return self.factor * {
            'speed': _RESERVE * speed, 'acceleration': _RESERVE * acceleration,
            'lean': lean(speed, acceleration, _RESERVE)}[self.limits]

    def recommended(self, speed: float, acceleration: float) -> float:
        """Return a round value, at most `most`, with which the vehicle makes up for a delay."""
        value = {'speed': _SPEED * speed, 'acceleration': _ACCELERATION * acceleration,
                 'lean': lean(speed, acceleration, _RESERVE)}[self.limits]
        step = _STEPS[self.limits]
        return min(self.most, self.factor * step * math.ceil(value / step))


AUTOPILOTS: Mapping[str, tuple[Parameter, ...]] = {
    # In GUIDED the first two limit what corrects an error, beside the plan's own.
    'ardupilot': (Parameter('WPNAV_SPEED', 'speed', 'cm/s', 100, 1000, 2000),
                  Parameter('WPNAV_ACCEL', 'acceleration', 'cm/s^2', 100, 250, 500),
                  Parameter('ANGLE_MAX', 'lean', 'cdeg', 100, 3000, 8000)),
    # In OFFBOARD the first limits the sum of the plan's velocity and its correction.
    'px4': (Parameter('MPC_XY_VEL_MAX', 'speed', 'm/s', 1, 12, 20),
            Parameter('MPC_TILTMAX_AIR', 'lean', 'deg', 1, 45, 89)),
}
"""Parameters that limit a flight along setpoints, by the name of the autopilot."""


def changes(autopilot: str, speed: float,
            acceleration: float) -> tuple[tuple[Parameter, float], ...]:
    """
    Return the parameters to raise above their defaults for a plan, each with its value.

    With a value below the parameter's `least`, the autopilot cannot follow the plan.

    :param autopilot: a name in AUTOPILOTS.
    :param speed: the plan's limit in m/s.
    :param acceleration: likewise in m/s^2.
    """
    limits, parameters = (speed, acceleration), AUTOPILOTS[autopilot]
    if all(parameter.default >= parameter.least(*limits) for parameter in parameters):
        return ()
    return tuple((parameter, parameter.recommended(*limits)) for parameter in parameters
                 if parameter.default < parameter.recommended(*limits))
