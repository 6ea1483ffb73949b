"""
Section III-B: trajectories for given powers, as a convex problem.

The restriction is valid for free space only. It needs a gain whose inverse is affine in the
squared distance, 1 / g = (d^2 + H^2) / beta_0, which a square's tangent then bounds from below.
"""

from typing import Any, ClassVar, Literal

import cvxpy as cp
import numpy as np

from . import clarabel
from ...channel import ground_squared_distances, guaranteed_squared_distances
from ...channel.links import FreeSpace
from ...limits import limits_of
from ...limits.base import ConvexVariables
from ...scenario import Array, Eavesdropper, Scenario


class TrajectoryProblem:
    """
    The convex restriction (pro5) of problem (sub_2), built once for a scenario.

    Its variables are displacements from the local point in units of a typical distance, and
    zeta, xi and tau are logarithms of the paper's, zero at the local point. A logarithm is only
    defined above zero, so the paper's lower bounds (t1_1) are not needed.

    :cvar step: what a solve is called in the history of a plan.
    :cvar block: which block of the variables a solve improves.
    :ivar problem: the cvxpy.Problem, which minimises the loss of rate since the local point in
        nats, up to a constant, summed over the slots.
    :ivar moves: its variables, the displacements of every UAV, (N+2, 2) in units of `unit`.
    :ivar unit: the typical distance of the last solve, in m.
    """

    step: ClassVar[str] = 'trajectory'
    block: ClassVar[Literal['positions']] = 'positions'

    def __init__(self, scenario: Scenario) -> None:
        self.scenario = scenario
        self.unit = 1.0
        self._link = FreeSpace.of(scenario)
        self._limits = limits_of(scenario)
        slots = scenario.slots
        self.moves: list[Any] = [cp.Variable((slots + 2, 2)) for _ in scenario.uavs]
        self._local = [cp.Parameter((slots + 2, 2)) for _ in scenario.uavs]
        self._scale = cp.Parameter(nonneg=True)
        paths = [local + move for local, move in zip(self._local, self.moves, strict=True)]
        constraints = [constraint for limit in self._limits
                       for constraint in limit.convex_form(
                           ConvexVariables(paths=paths, scale=self._scale))]
        constraints.append(cp.hstack([
            end for move in self.moves for end in (move[0], move[-1])]) == 0)

        moves = [move[1:-1] for move in self.moves]
        self._received = _ReceivedLoss(moves)
        self._interference = _LogOfSum(moves[1:])  # y_k is the logarithm of zeta of (Ta_1).
        self._leakages = [
            _LeakageBound(eve, moves, [path[1:-1] for path in paths], self._scale)
            for eve in scenario.eavesdroppers]
        leakage = cp.Variable(slots)
        constraints += self._interference.constraints
        for bound in self._leakages:
            constraints += [*bound.constraints, leakage >= bound.value]
        self.problem = cp.Problem(cp.Minimize(cp.sum(
            self._interference.value + self._received.value + leakage)), constraints)

    def solve(self, positions: Array, powers: Array,
              time_left: float = np.inf) -> tuple[Array | None, float]:
        """
        Return the positions that maximise the restriction at a local point.

        :param positions: the local point q_i^(m)[n], (U, N+2, 2) in m.
        :param powers: p_i[n], (U, N) in W.
        :param time_left: the limit for compiling and solving in s.
        :return: positions, (U, N+2, 2) in m, nearly feasible, or None if none were found; and
            the time inside the solver in s.
        """
        for limit in self._limits:
            limit.set_local_point(positions, powers)
        squared = ground_squared_distances(self.scenario, positions)
        gains, inverse = self._gains(squared)
        self.unit = unit = float(1 / np.sqrt(np.median(inverse)))
        self._scale.value = 1 / unit
        for parameter, path in zip(self._local, positions, strict=True):
            parameter.value = path / unit

        inverse *= unit**2
        offset = positions[:, 1:-1] - np.array(self.scenario.ground_node)
        slopes = 2 * offset / unit * inverse[..., None]
        received = gains * powers
        self._received.set_local_point(received, slopes, inverse)
        self._interference.set_local_point(received[1:], slopes[1:])
        away = _directions(offset, np.array([1.0, 0.0]))
        for bound, squared in zip(
                self._leakages, guaranteed_squared_distances(self.scenario, positions),
                strict=True):
            gains, inverse = self._gains(squared)
            bound.set_local_point(
                positions[:, 1:-1], gains * powers, np.sqrt(squared) / unit, inverse * unit**2,
                away)
        solved, seconds = clarabel.solve(self.problem, time_left)
        if not solved:
            return None, seconds
        return positions + unit * np.stack([move.value for move in self.moves]), seconds

    def _gains(self, squared: Array) -> tuple[Array, Array]:
        """
        Return the gains at squared distances, and 1 / (d^2 + H^2).

        The latter is -g' / g, in free space and only there.

        :param squared: (U, N) in m^2.
        :return: (U, N) in 1/W and (U, N) in 1/m^2.
        """
        gains, slopes, _ = self._link.derivatives(squared)
        return gains, -slopes / gains


class _ReceivedLoss:
    """
    An upper bound of the loss of log(1 + sum_i g_i p_i) at the ground node.

    Its terms are those of the paper with a and b.

    :ivar value: the convex CVXPY expression, (N,) in nats.
    """

    def __init__(self, moves: list[Any]) -> None:
        self._moves = moves
        self._slopes = [cp.Parameter(move.shape) for move in moves]
        self._weights = [cp.Parameter(move.shape[0], nonneg=True) for move in moves]
        self.value: Any = sum(
            _dot(slope, move) + cp.multiply(weight, cp.sum(cp.square(move), axis=1))
            for slope, weight, move in zip(self._slopes, self._weights, moves, strict=True))

    def set_local_point(self, received: Array, slopes: Array, inverse: Array) -> None:
        """
        Set the parameters.

        :param received: powers over the noise power, (U, N).
        :param slopes: gradients of log(d^2 + H^2), (U, N, 2) in 1/unit.
        :param inverse: 1 / (d^2 + H^2), (U, N) in 1/unit^2.
        """
        shares = received / (1 + received.sum(axis=0))
        for uav, share in enumerate(shares):
            self._slopes[uav].value = share[:, None] * slopes[uav]
            self._weights[uav].value = share * inverse[uav]


class _LogOfSum:
    """
    An upper bound of log(1 + sum_k s_k exp(-y_k)), less its value at the local point.

    s_k is a received power there, and y_k a lower bound of the change of log(d_k^2 + H_k^2): the
    logarithm of one of the paper's zeta, xi and tau, whose squares are linearised.

    :ivar value: the CVXPY variable, (N,) in nats.
    :ivar constraints: what makes it an upper bound.
    """

    def __init__(self, moves: list[Any]) -> None:
        self.value: Any = 0.0
        self.constraints: list[Any] = []
        self._slopes = [cp.Parameter(move.shape) for move in moves]
        if not moves:
            return  # The logarithm of the noise alone does not change.
        slots = moves[0].shape[0]
        self._noise = cp.Parameter(slots, nonneg=True)
        self._weights = cp.Parameter((len(moves), slots), nonneg=True)
        self.value = cp.Variable(slots)
        logarithms = cp.Variable((len(moves), slots))
        tangents = cp.vstack([
            _dot(slope, move) for slope, move in zip(self._slopes, moves, strict=True)])
        parts = cp.exp(-logarithms - cp.vstack([self.value] * len(moves)))
        self.constraints += [
            cp.exp(logarithms) <= 1 + tangents,
            cp.multiply(self._noise, cp.exp(-self.value))
            + cp.sum(cp.multiply(self._weights, parts), axis=0) <= 1]

    def set_local_point(self, received: Array, slopes: Array) -> None:
        """
        Set the parameters.

        :param received: s_k, (K, N).
        :param slopes: gradients of y_k, (K, N, 2) in 1/unit.
        """
        if not self._slopes:
            return
        total = 1 + received.sum(axis=0)
        self._noise.value = 1 / total
        self._weights.value = received / total
        for parameter, slope in zip(self._slopes, slopes, strict=True):
            parameter.value = slope


class _LeakageBound:
    """
    An upper bound of r-tilde_e for one eavesdropper, exact at the local point.

    :param moves: of every UAV, (N, 2) in units.
    :param positions: of every UAV, (N, 2) in units.
    :param scale: units in a metre.
    :ivar value: the convex CVXPY expression, (N,) in nats.
    :ivar constraints: what makes it an upper bound.
    """

    def __init__(self, eve: Eavesdropper, moves: list[Any], positions: list[Any],
                 scale: Any) -> None:
        self._eve = eve
        slots = moves[0].shape[0]
        # y_k is the logarithm of xi of (Ta_2) for the transmitter, of tau of (Ta_3) for jammers.
        self._total = _LogOfSum(moves)
        self._local_value = cp.Parameter(slots)
        self.value: Any = self._local_value + self._total.value
        self.constraints: list[Any] = list(self._total.constraints)
        if len(moves) == 1:
            return
        # -log(1 + sum of jamming), with c of the paper: weights of (d + eps)^2.
        self._weights = cp.Parameter((len(moves) - 1, slots), nonneg=True)
        self._local_squares = cp.Parameter(slots)
        distances = cp.Variable((len(moves) - 1, slots))
        centre = np.tile(eve.position, (slots, 1))
        self.constraints.append(distances >= scale * eve.error_radius + cp.vstack([
            cp.norm(position - scale * centre, axis=1) for position in positions[1:]]))
        self.value += cp.sum(cp.multiply(self._weights, cp.square(distances)), axis=0)
        self.value -= self._local_squares

    def set_local_point(self, positions: Array, received: Array, distances: Array,
                        inverse: Array, away: Array) -> None:
        """
        Set the parameters.

        :param positions: (U, N, 2) in m.
        :param received: powers over the noise power, (U, N).
        :param distances: those of the guarantee, (U, N) in units.
        :param inverse: 1 / (d^2 + H^2) with these distances, (U, N) in 1/unit^2.
        :param away: unit vectors, (U, N, 2), that stand for a direction from the eavesdropper
            where there is none.
        """
        # (d + eps)^2 has a kink at d = 0. Any direction gives a subgradient there, and the one
        # away from the ground node lets the jammer see a gain in leaving. Of the transmitter,
        # [d - eps]^+ is linearised: that is valid inside the disc, unlike (Ta_2).
        directions = _directions(positions - np.array(self._eve.position), away)
        self._total.set_local_point(
            received, 2 * (distances * inverse)[..., None] * directions)
        jamming = 1 + received[1:].sum(axis=0)
        self._local_value.value = np.log1p(received[0] / jamming)
        if len(received) > 1:
            self._weights.value = weights = received[1:] / jamming * inverse[1:]
            self._local_squares.value = np.sum(weights * distances[1:]**2, axis=0)


def _dot(slope: Any, move: Any) -> Any:
    return cp.sum(cp.multiply(slope, move), axis=1)


def _directions(offset: Array, otherwise: Array) -> Array:
    """Return the offsets (..., 2) as unit vectors, and `otherwise` for those of length zero."""
    distance = np.linalg.norm(offset, axis=-1, keepdims=True)
    return np.where(distance > 0, offset / np.where(distance > 0, distance, 1), otherwise)
