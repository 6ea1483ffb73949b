"""The paper's mission, problem (P2), in OpenSCvx."""

import sys

import numpy as np
import openscvx as ox

T, N, TIME_LIMIT = 120.0, int(sys.argv[1]), float(sys.argv[2])
START, GOAL, NODE, EVE = (np.array(place) / 100 for place in (
    (100, 500), (100, -500), (0, 0), (200, 0)))  # Lengths are in units of 100 m.
HEIGHTS, SPEED, RADIUS, SNR = (1.0, 1.1), 0.1, 0.1, 10**(80 / 10) / 100**2
AVERAGE, PEAK, END = 1.0, 4.0, T * (N + 1) / N
GUESS = np.vstack([np.linspace(START, NODE, N // 2 + 1),
                   np.linspace(NODE, GOAL, N + 1 - N // 2)])  # By way of the ground node.
place = ox.State('place', shape=(4,))
place.min, place.max = np.full(4, -8.0), np.full(4, 8.0)
place.initial, place.final = np.tile(START, 2), np.tile(GOAL, 2)
place.guess = np.tile(GUESS, 2)
energy = ox.State('energy', shape=(2,))
energy.min, energy.max = np.zeros(2), np.full(2, AVERAGE)
energy.initial, energy.final = np.zeros(2), [ox.Free(AVERAGE)] * 2
energy.guess = np.linspace(np.zeros(2), np.full(2, AVERAGE), N + 2)
rate = ox.State('rate', shape=(1,))
rate.min, rate.max = [-50.0], [50.0]
rate.initial, rate.final = [0.0], [ox.Maximize(1.0)]
rate.guess = np.linspace([0.0], [1.0], N + 2)
velocity = ox.Control('velocity', shape=(4,), parameterization='ZOH')
velocity.min, velocity.max = np.full(4, -SPEED), np.full(4, SPEED)
velocity.guess = np.tile(np.gradient(GUESS, T / N, axis=0), 2)
power = ox.Control('power', shape=(2,), parameterization='ZOH')
power.min, power.max = np.zeros(2), np.full(2, PEAK)
power.guess = np.full((N + 2, 2), AVERAGE)


def snr(uav, position, error):
    offset = place[2 * uav:2 * uav + 2] - position
    square = ox.Sum(offset**2)
    if error:
        square = (ox.Sqrt(square + 1e-8) + error)**2
    return SNR * power[uav] / (square + HEIGHTS[uav]**2)


signal, jamming = snr(0, NODE, 0), snr(1, NODE, 0)
leak, cover = snr(0, EVE, -RADIUS), snr(1, EVE, RADIUS)
secrecy = (ox.Log(1 + signal + jamming) - ox.Log(1 + jamming)
           - ox.Log(1 + leak + cover) + ox.Log(1 + cover))
limits = [(ox.linalg.Norm(velocity[2 * uav:2 * uav + 2]) <= SPEED).convex() for uav in (0, 1)]
limits.append((power <= 0.0).at([0]).convex())
problem = ox.Problem(
    dynamics={'place': velocity, 'energy': power / T, 'rate': secrecy / T},
    constraints=limits, states=[place, energy, rate], controls=[velocity, power], N=N + 2,
    time=ox.Time(0.0, END, 0.0, END, uniform_time_grid=True), float_dtype='float64',
    algorithm={'lam_cost': 1.0, 'lam_vc': 10.0},
    solver={'cvx_solver': 'CLARABEL', 'solver_args': {'ignore_dpp': True}})
problem.settings.dev.printing = False
problem.initialize()
result = problem.solve(time_limit=TIME_LIMIT)
positions = 100 * result.nodes['place'].reshape(N + 2, 2, 2).swapaxes(0, 1)
powers = result.nodes['power'][1:-1].T
status = 'converged' if result.converged else 'not converged'
