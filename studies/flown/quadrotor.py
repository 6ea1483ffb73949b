"""A quadrotor of rotorpy with an autopilot that follows setpoints, in wind with gusts."""

import math

import numpy as np
from rotorpy.controllers.quadrotor_control import SE3Control
from rotorpy.vehicles.hummingbird_params import quad_params
from rotorpy.vehicles.multirotor import Multirotor
from secure_uav_planner.plan.tracking import GAIN

STEP = 0.01
"""Time between two commands of the autopilot to its motors, in s."""

# AscTec Hummingbird: 0.5 kg, drag of rotors and frame, thrust of 10 times its weight. Its motors
# answer within 5 ms; here within 50 ms, like those of larger vehicles and of PX4's simulator.
# rotorpy's gains of attitude, 310 and 57, leave these hardly any phase margin: they fell by 30 m.
_VEHICLE = {**quad_params, 'tau_m': 0.05, 'kp_att': 120.0, 'kd_att': 25.0}
# One step of the integrator for each of ours, which is short against all time constants.
_INTEGRATOR = {'method': 'RK23', 'first_step': STEP, 'rtol': 1e-2, 'atol': 1e-2}
# Autopilots remove what wind and drag leave of the error by an integral of it, in 1/s^3, within
# what they may ask of the vehicle, in m/s^2.
_INTEGRAL_GAIN = 4.0
_MOST = 40.0
# Autopilots fly back to a setpoint that is far away, in m, within limits of their own: in m/s and
# m/s^2, and towards it with a speed of GAIN times the distance.
_FAR = 15.0
_SPEED, _ACCELERATION = 12.0, 4.0
_BACK = 0.3  # m and m/s; so near, it follows the setpoint itself again
# Autopilots turn the nose no faster than so, in rad/s, whatever the setpoint says.
_TURN_RATE = 1.0
_FOOT = 0.3048  # m


class Gusts:
    """
    A steady wind and gusts of it, by the Dryden model of MIL-F-8785C at low altitude.

    The gusts are those at a place that the wind carries past: white noise through the forming
    filter of the Dryden model, first order, with its length scale at the altitude. They are the
    same for every run with one seed. (rotorpy's own need PyTorch.)

    :param steady: the steady wind, (x, y) in m/s; not zero.
    :param deviation: the standard deviation of each horizontal component of the gusts, in m/s;
        that of the vertical one is half of it.
    :param step: time between two calls of step, in s.
    """

    def __init__(self, steady, deviation, altitude, step, seed):
        feet = altitude / _FOOT
        vertical = min(max(feet, 10.0), 1000.0)
        level = vertical / (0.177 + 0.000823 * vertical)**1.2
        scales = _FOOT * np.array([level, level, vertical])
        self._steady = np.array([*steady, 0.0])
        self._deviations = deviation * np.array([1.0, 1.0, 0.5])
        # Exact at the steps: a first-order process of the length scale over the wind speed.
        self._kept = np.exp(-step * math.hypot(*steady) / scales)
        self._noise = np.random.default_rng(seed)
        self._gust = self._deviations * self._noise.standard_normal(3)

    def step(self):
        """Return the wind of the next step, (3,) in m/s."""
        new = self._deviations * np.sqrt(1 - self._kept**2)
        self._gust = self._kept * self._gust + new * self._noise.standard_normal(3)
        return self._steady + self._gust


class Quadrotor:
    """
    A vehicle under control of position: rotorpy's SE(3) controller with an integral term.

    :param place: the initial position, (x, y, z) in m.
    :param yaw: in rad.
    :param gusts: a Gusts with the step STEP.
    """

    def __init__(self, place, yaw, gusts):
        self._gusts = gusts
        self._body = Multirotor(_VEHICLE, integrator_kwargs=_INTEGRATOR)
        self._control = SE3Control(_VEHICLE)
        speed = np.sqrt(_VEHICLE['mass'] * 9.81 / (4 * _VEHICLE['k_eta']))
        self._state = {
            'x': np.array(place, float), 'v': np.zeros(3), 'w': np.zeros(3),
            'q': np.array([0.0, 0.0, np.sin(yaw / 2), np.cos(yaw / 2)]),
            'wind': np.zeros(3), 'rotor_speeds': np.full(4, speed)}
        self._correction = np.zeros(3)
        self._yaw = yaw
        self._way = None  # Place and velocity on the way back to a setpoint, or None.

    @property
    def place(self):
        """Return its position, (3,) in m."""
        return self._state['x']

    @property
    def velocity(self):
        """Return its velocity, (3,) in m/s."""
        return self._state['v']

    def carry(self, velocity, seconds):
        """Move with a velocity (3,) in m/s regardless of the rotors, as in a squall."""
        self._way = None
        self._state['v'] = np.array(velocity, float)
        self._state['x'] = self._state['x'] + seconds * self._state['v']

    def follow(self, setpoint, seconds):
        """
        Follow a setpoint for some time, as an autopilot does until the next setpoint.

        :param setpoint: a Setpoint of the autopilots with velocity and acceleration.
        """
        for _ in range(round(seconds / STEP)):
            place, velocity, acceleration = self._find_target(setpoint)
            error = place - self._state['x']
            self._correction = np.clip(
                self._correction + _INTEGRAL_GAIN * STEP * error, -_MOST, _MOST)
            turn = math.remainder(setpoint.yaw - self._yaw, 2 * math.pi)
            self._yaw += float(np.clip(turn, -_TURN_RATE * STEP, _TURN_RATE * STEP))
            target = {
                'x': place, 'x_dot': velocity, 'x_ddot': acceleration + self._correction,
                'yaw': self._yaw, 'yaw_dot': 0.0}
            self._state['wind'] = self._gusts.step()
            self._state = self._body.step(
                self._state, self._control.update(0.0, self._state, target), STEP)

    def _find_target(self, setpoint):
        """Return the target position, velocity and acceleration, on the way or at the setpoint."""
        goal = [np.array(vector) for vector in (
            setpoint.position, setpoint.velocity, setpoint.acceleration)]
        if self._way is None and np.linalg.norm(goal[0] - self._state['x']) <= _FAR:
            return goal
        place, velocity = self._way or (self._state['x'], self._state['v'])
        offset = goal[0] - place
        change = _clip_norm(goal[1] + GAIN * offset, _SPEED) - velocity
        acceleration = _clip_norm(change / STEP, _ACCELERATION)
        velocity = velocity + STEP * acceleration
        place = place + STEP * velocity
        is_back = np.linalg.norm(offset) < _BACK and np.linalg.norm(change) < _BACK
        self._way = None if is_back else (place, velocity)
        return place, velocity, acceleration


def _clip_norm(vector, most):
    return vector * min(1.0, most / max(np.linalg.norm(vector), 1e-9))
