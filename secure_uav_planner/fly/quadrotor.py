"""A quadrotor of rotorpy with an autopilot that follows setpoints."""

import math

import numpy as np
from rotorpy.controllers.quadrotor_control import SE3Control
from rotorpy.vehicles.hummingbird_params import quad_params
from rotorpy.vehicles.multirotor import Multirotor

STEP = 0.01
"""Time between two commands of the autopilot to its motors, in s."""

# AscTec Hummingbird: 0.5 kg, drag of rotors and frame, thrust of 10 times its weight. Its motors
# answer within 5 ms; here within 50 ms, like those of larger vehicles and of PX4's simulator.
_VEHICLE = {**quad_params, 'tau_m': 0.05}
# One step of the integrator for each of ours, which is short against all time constants.
_INTEGRATOR = {'method': 'RK23', 'first_step': STEP, 'rtol': 1e-2, 'atol': 1e-2}
# Autopilots remove what wind and drag leave of the error by an integral of it, in 1/s^3, within
# what they may ask of the vehicle, in m/s^2.
_INTEGRAL_GAIN = 4.0
_MOST = 40.0
# Autopilots turn the nose no faster than so, in rad/s, whatever the setpoint says.
_TURN_RATE = 1.0


class Quadrotor:
    """
    A vehicle under control of position: rotorpy's SE(3) controller with an integral term.

    :param place: where it hovers at first, (x, y, z) in m.
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

    @property
    def place(self):
        """Return where it is, (3,) in m."""
        return self._state['x']

    def follow(self, setpoint, seconds):
        """
        Fly for some time after one setpoint, as an autopilot does until the next one comes.

        :param setpoint: a secure_uav_planner.autopilots.Setpoint with velocity and acceleration.
        """
        for _ in range(round(seconds / STEP)):
            error = np.array(setpoint.position) - self._state['x']
            self._correction = np.clip(
                self._correction + _INTEGRAL_GAIN * STEP * error, -_MOST, _MOST)
            turn = math.remainder(setpoint.yaw - self._yaw, 2 * math.pi)
            self._yaw += float(np.clip(turn, -_TURN_RATE * STEP, _TURN_RATE * STEP))
            wanted = {
                'x': np.array(setpoint.position), 'x_dot': np.array(setpoint.velocity),
                'x_ddot': np.array(setpoint.acceleration) + self._correction,
                'yaw': self._yaw, 'yaw_dot': 0.0}
            self._state['wind'] = self._gusts.step()
            self._state = self._body.step(
                self._state, self._control.update(0.0, self._state, wanted), STEP)
