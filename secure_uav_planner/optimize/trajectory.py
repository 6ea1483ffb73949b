"""Section III-B: trajectories for given powers, as a convex problem."""

import cvxpy as cp
import numpy as np

from .conic import solve_with_clarabel
from ..channel import ground_gains, guaranteed_gains


class TrajectoryProblem:
    """
    The convex restriction (pro5) of problem (sub_2), built once for a shape.

    Its variables are displacements from the local point in units of a typical distance, and
    zeta, xi and tau are logarithms of the paper's, zero at the local point. A logarithm is only
    defined above zero, so the paper's lower bounds (t1_1) are not needed.

    :param count: U.
    :param eavesdroppers: E.
    :param slots: N.
    :ivar problem: the cvxpy.Problem.
    :ivar moves: its variables, displacements of every UAV, (N+2, 2) in units of `unit`.
    :ivar unit: the typical distance of the last solve, in m.
    """

    def __init__(self, count, eavesdroppers, slots):
        self.unit = 1.0
        self.moves = [cp.Variable((slots + 2, 2)) for _ in range(count)]
        self._steps = [cp.Parameter((slots + 1, 2)) for _ in range(count)]
        self._max_step = cp.Parameter(count, nonneg=True)
        constraints = []
        for move, step, limit in zip(self.moves, self._steps, self._max_step):
            constraints += [move[0] == 0, move[-1] == 0,
                            cp.norm(move[1:] - move[:-1] + step, axis=1) <= limit]
        moves = [move[1:-1] for move in self.moves]
        jammers = range(1, count)

        # -log(1 + sum of interference at the ground node), by zeta of (Ta_1)
        self._interference = _Sum(count - 1, slots)
        self._zeta_slope = [cp.Parameter((slots, 2)) for _ in jammers]
        zeta = [cp.Variable(slots) for _ in jammers]
        for variable, slope, jammer in zip(zeta, self._zeta_slope, jammers):
            constraints.append(cp.exp(variable) <= 1 + _dot(slope, moves[jammer]))
        constraints += self._interference.constraints(zeta)

        # log(1 + sum of everything at the ground node), a and b of the paper
        self._ground_slope = [cp.Parameter((slots, 2)) for _ in range(count)]
        self._ground_curvature = [cp.Parameter(slots, nonneg=True) for _ in range(count)]
        loss = sum(_dot(slope, move) + cp.multiply(curvature, _squared(move))
                   for slope, curvature, move in zip(
                       self._ground_slope, self._ground_curvature, moves))

        leak = cp.Variable(slots)
        self._leaks = [_Leak(moves, slots) for _ in range(eavesdroppers)]
        for one in self._leaks:
            constraints += one.constraints(leak)
        self.problem = cp.Problem(
            cp.Minimize(cp.sum(self._interference.logarithm + loss + leak)), constraints)

    def solve(self, scenario, positions, powers, time_left=np.inf):
        """
        Return the positions that maximise the restriction at a local point, and solver's time.

        :param positions: the local point q_i^(m)[n], (U, N+2, 2) in m.
        :param powers: p_i[n], (U, N) in W.
        :param time_left: limit for the solver in s.
        :return: positions, (U, N+2, 2) in m, nearly feasible, or None if none were found; time
            in s.
        """
        gains = ground_gains(scenario, positions)
        self.unit = unit = np.sqrt(scenario.reference_snr / np.median(gains))
        for parameter, step in zip(self._steps, np.diff(positions, axis=1)):
            parameter.value = step / unit
        self._max_step.value = scenario.max_step / unit

        received = gains * powers
        total = 1 + received.sum(axis=0)
        self._interference.set_value(received[1:])
        offset = positions[:, 1:-1] - np.array(scenario.ground_node)
        slope = 2 * unit * offset * (gains / scenario.reference_snr)[..., None]
        for parameter, value in zip(self._zeta_slope, slope[1:]):
            parameter.value = value
        share = received / total
        for uav in range(len(powers)):
            self._ground_slope[uav].value = share[uav][:, None] * slope[uav]
            self._ground_curvature[uav].value = (
                share[uav] * gains[uav] * unit**2 / scenario.reference_snr)

        away = _away_from(scenario.ground_node, positions[:, 1:-1])
        for leak, eve, gains in zip(
                self._leaks, scenario.eavesdroppers, guaranteed_gains(scenario, positions)):
            leak.set_value(eve, positions[:, 1:-1], powers, gains, unit,
                           scenario.reference_snr, away)
        solved, seconds = solve_with_clarabel(self.problem, time_left)
        if not solved:
            return None, seconds
        return positions + unit * np.stack([move.value for move in self.moves]), seconds


class _Sum:
    """log(1 + sum_k c_k exp(-y_k)) relative to its value at y = 0, as an upper bound."""

    def __init__(self, terms, slots):
        self.logarithm = cp.Variable(slots)
        self._constant = cp.Parameter(slots, nonneg=True)
        self._weights = [cp.Parameter(slots, nonneg=True) for _ in range(terms)]

    def constraints(self, exponents):
        terms = [cp.multiply(self._constant, cp.exp(-self.logarithm))]
        terms += [cp.multiply(weight, cp.exp(-exponent - self.logarithm))
                  for weight, exponent in zip(self._weights, exponents)]
        return [sum(terms) <= 1]

    def set_value(self, received):
        total = 1 + received.sum(axis=0)
        self._constant.value = 1 / total
        for weight, value in zip(self._weights, received):
            weight.value = value / total


class _Leak:
    """An upper bound of r-tilde_e for one eavesdropper, exact at the local point."""

    def __init__(self, moves, slots):
        self._moves = moves
        self._total = _Sum(len(moves), slots)
        self._value = cp.Parameter(slots)
        # log of squared distances: xi of (Ta_2) for the transmitter, tau of (Ta_3) for jammers
        self._distances = [cp.Variable(slots) for _ in moves]
        self._slopes = [cp.Parameter((slots, 2)) for _ in moves]
        # -log(1 + sum of jamming), c of the paper: ((d + eps)^2 - its local value) weighted
        jammers = moves[1:]
        self._reached = [cp.Variable(slots) for _ in jammers]
        self._radius = cp.Parameter(nonneg=True)
        self._offsets = [cp.Parameter((slots, 2)) for _ in jammers]
        self._weights = [cp.Parameter(slots, nonneg=True) for _ in jammers]
        self._weighted_squares = cp.Parameter(slots)

    def constraints(self, leak):
        lost_jamming = sum(cp.multiply(weight, cp.square(reached))
                           for weight, reached in zip(self._weights, self._reached))
        distances = [cp.exp(distance) <= 1 + _dot(slope, move) for distance, slope, move in zip(
            self._distances, self._slopes, self._moves)]
        reached = [cp.norm(move + offset, axis=1) + self._radius <= reached
                   for reached, offset, move in zip(
                       self._reached, self._offsets, self._moves[1:])]
        return distances + reached + self._total.constraints(self._distances) + [
            leak >= self._value + self._total.logarithm + lost_jamming - self._weighted_squares]

    def set_value(self, eve, places, powers, gains, unit, reference_snr, away):
        received = gains * powers
        total, jamming = 1 + received.sum(axis=0), 1 + received[1:].sum(axis=0)
        self._total.set_value(received)
        self._value.value = np.log(total / jamming)
        offset = places - np.array(eve.position)
        distance = np.linalg.norm(offset, axis=-1, keepdims=True)
        # (d + eps)^2 has a kink at d = 0. Any direction gives a subgradient there, away from the
        # ground node is the one that lets the jammer see a gain in leaving.
        direction = np.where(distance > 0, offset / np.where(distance > 0, distance, 1), away)
        reached = distance + eve.error_radius
        # Of the transmitter [d - eps]^+ is linearised: valid inside the disc, unlike (Ta_2).
        reached[0] = np.maximum(distance[0] - eve.error_radius, 0)
        scale = (gains / reference_snr)[..., None]
        for slope, value in zip(self._slopes, 2 * unit * reached * direction * scale):
            slope.value = value
        self._radius.value = eve.error_radius / unit
        weights = received[1:] / jamming * gains[1:] * unit**2 / reference_snr
        for jammer, weight in enumerate(weights):
            self._weights[jammer].value = weight
            self._offsets[jammer].value = offset[jammer + 1] / unit
        self._weighted_squares.value = np.sum(
            weights * (reached[1:, :, 0] / unit)**2, axis=0)


def _dot(slope, move):
    return cp.sum(cp.multiply(slope, move), axis=1)


def _squared(move):
    return cp.sum(cp.square(move), axis=1)


def _away_from(point, places):
    """Return unit vectors from the point to the places, or along x where they coincide."""
    offset = places - np.array(point)
    distance = np.linalg.norm(offset, axis=-1, keepdims=True)
    return np.where(distance > 0, offset / np.where(distance > 0, distance, 1), [1.0, 0.0])
