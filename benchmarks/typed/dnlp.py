"""The paper's mission, problem (P2), in CVXPY's disciplined nonlinear programming with Uno."""

import sys

import cvxpy as cp
import numpy as np

T, N, TIME_LIMIT = 120.0, int(sys.argv[1]), float(sys.argv[2])
START, GOAL, NODE, EVE = (np.array(place) / 100 for place in (
    (100, 500), (100, -500), (0, 0), (200, 0)))  # Lengths are in units of 100 m.
HEIGHTS, STEP, RADIUS, SNR = (1.0, 1.1), 0.1 * T / N, 0.1, 10**(80 / 10) / 100**2
AVERAGE, PEAK = 1.0, 4.0
GUESS = np.vstack([np.linspace(START, NODE, N // 2 + 1),
                   np.linspace(NODE, GOAL, N + 1 - N // 2)])  # By way of the ground node.
places = [cp.Variable((N, 2)) for _ in HEIGHTS]
powers = [cp.Variable(N, bounds=[0, PEAK]) for _ in HEIGHTS]


def snr(uav, place, error):
    squares = cp.sum(cp.square(places[uav] - place), axis=1)
    if error:
        squares = cp.square(cp.sqrt(squares + 1e-8) + error)
    return SNR * powers[uav] / (squares + HEIGHTS[uav]**2)


signal, jamming = snr(0, NODE, 0), snr(1, NODE, 0)
leak, cover = snr(0, EVE, -RADIUS), snr(1, EVE, RADIUS)
rates = (cp.log(1 + signal + jamming) - cp.log(1 + jamming)
         - cp.log(1 + leak + cover) + cp.log(1 + cover))
limits = [cp.sum(power) <= N * AVERAGE for power in powers]
for place, power in zip(places, powers):
    flight = cp.vstack([START[None], place, GOAL[None]])
    limits.append(cp.sum(cp.square(flight[1:] - flight[:-1]), axis=1) <= STEP**2)
    place.value = GUESS[1:-1]
    power.value = np.full(N, AVERAGE)
problem = cp.Problem(cp.Maximize(cp.sum(rates) / N), limits)
problem.solve(nlp=True, solver='uno_sqp', time_limit=TIME_LIMIT)
positions = [100 * np.vstack([START, place.value, GOAL]) for place in places]
powers, status = [power.value for power in powers], problem.status
