"""
Section III-B: trajectories for given powers, as a convex problem.

The restriction is valid for free space only. It needs a gain whose inverse is affine in the
squared distance, 1 / g = (d^2 + H^2) / beta_0, which a square's tangent then bounds from below.
"""

from collections.abc import Sequence
from typing import Any, ClassVar, Literal

import cvxpy as cp
import numpy as np

from . import clarabel
from ...mission.scenario import Array, Eavesdropper, Scenario
from ...model.channel import ground_squared_distances, guaranteed_squared_distances
from ...model.channel.links import FreeSpace, link_of
from ...model.limits import limits_of
from ...model.limits.base import ConvexVariables


class TrajectoryProblem:
    """
    The convex restriction (18) of problem (14), built once for a scenario.

    Its variables are displacements from the local point in units of a typical distance, and
    zeta, xi and tau are logarithms of the paper's, zero at the local point. A logarithm is only
    defined above zero, so the paper's lower bounds (15d) are not needed.

    :cvar step: what a solve is called in the history of a plan.
    :cvar block: which block of the variables a solve improves.
    :ivar problem: the cvxpy.Problem, which minimises the loss of rate since the local point in
        nats, up to a constant, summed over the slots.
    :ivar moves: its variables, the displacements of every UAV, (N+2, 2) in units of `unit`.
    :ivar unit: the typical distance of the last solve, in m.
    :ivar compile_time: the time that CVXPY took in the last solve in s, None before the first.
    """

    step: ClassVar[str] = 'trajectory'
    block: ClassVar[Literal['positions']] = 'positions'

    def __init__(self, scenario: Scenario) -> None:
        self.scenario = scenario
        self.compile_time: float | None = None
        self.unit = 1.0
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

        x, y = (cp.vstack([move[1:-1, axis] for move in self.moves]) for axis in (0, 1))
        eves = len(scenario.eavesdroppers)
        self._received = _ReceivedLoss(x, y)
        # y_k is the logarithm of zeta of (17a).
        self._interference = _LogOfSumBound(x[1:], y[1:]) if len(paths) > 1 else None
        # y_k is the logarithm of xi of (17b) for the transmitter, of tau of (17c) for jammers.
        every = np.tile(np.eye(len(paths)), (eves, 1))
        self._leakage = _LogOfSumBound(every @ x, every @ y, eves)
        self._local_leakage = cp.Parameter((eves, slots))
        bounds: Any = self._local_leakage + self._leakage.value
        constraints += self._leakage.constraints
        loss: Any = self._received.value
        if self._interference is not None:
            self._jamming = _JammingBound(
                scenario.eavesdroppers, [path[1:-1] for path in paths[1:]], self._scale)
            bounds += self._jamming.value
            loss += self._interference.value[0]
            constraints += [*self._interference.constraints, *self._jamming.constraints]
        largest = cp.Variable((1, slots))
        constraints.append(np.ones((eves, 1)) @ largest >= bounds)
        self.problem = cp.Problem(cp.Minimize(cp.sum(loss) + cp.sum(largest)), constraints)

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
        gains, inverse = _gains(link_of(self.scenario, 'ground_node'), squared)
        self.unit = unit = float(1 / np.sqrt(np.median(inverse)))
        self._scale.value = 1 / unit
        for parameter, path in zip(self._local, positions, strict=True):
            parameter.value = path / unit

        inverse *= unit**2
        offset = positions[:, 1:-1] - np.array(self.scenario.ground_node)
        slopes = 2 * offset / unit * inverse[..., None]
        received = gains * powers
        self._received.set_local_point(received, slopes, inverse)
        if self._interference is not None:
            self._interference.set_local_point(received[1:], slopes[1:])
        self._set_local_leakage(
            positions, powers, _directions(offset, np.array([1.0, 0.0])))
        solved, seconds, self.compile_time = clarabel.solve_problem(self.problem, time_left)
        if not solved:
            return None, seconds
        return positions + unit * np.stack([move.value for move in self.moves]), seconds

    def _set_local_leakage(self, positions: Array, powers: Array, away: Array) -> None:
        """
        Set the parameters of what the eavesdroppers receive.

        :param positions: (U, N+2, 2) in m.
        :param powers: (U, N) in W.
        :param away: unit vectors, (U, N, 2), that stand for a direction from an eavesdropper
            where there is none.
        """
        squared = guaranteed_squared_distances(self.scenario, positions)
        gains, inverse = _gains(
            link_of(self.scenario, 'eavesdropper').for_receivers(
                self.scenario.receiver_advantages[:, None, None]), squared)
        received, inverse = gains * powers, inverse * self.unit**2
        distances = np.sqrt(squared) / self.unit
        # (d + eps)^2 has a kink at d = 0. Any direction gives a subgradient there, and the one
        # away from the ground node lets the jammer see a gain in leaving. Of the transmitter,
        # [d - eps]^+ is linearised: that is valid inside the disc, unlike (17b).
        centres = np.array([eve.position for eve in self.scenario.eavesdroppers])
        slopes = 2 * (distances * inverse)[..., None] * _directions(
            positions[:, 1:-1] - centres[:, None, None], away)
        self._leakage.set_local_point(
            received.reshape(-1, received.shape[-1]), slopes.reshape(-1, *slopes.shape[2:]))
        jamming = 1 + received[:, 1:].sum(axis=1)
        self._local_leakage.value = np.log1p(received[:, 0] / jamming)
        if self._interference is not None:
            self._jamming.set_local_point(
                received[:, 1:] / jamming[:, None] * inverse[:, 1:], distances[:, 1:])


def _gains(link: FreeSpace, squared: Array) -> tuple[Array, Array]:
    """
    Return the gains at squared distances, and 1 / (d^2 + H^2).

    The latter is -g' / g, in free space and only there.

    :param squared: (..., U, N) in m^2.
    :return: (..., U, N) in 1/W and (..., U, N) in 1/m^2.
    """
    gains, slopes = link.gain(squared), link.slope(squared)
    return gains, -slopes / gains


class _ReceivedLoss:
    """
    An upper bound of the loss of log(1 + sum_i g_i p_i) at the ground node.

    Its terms are those of the paper with a and b.

    :param x: displacements of the UAVs, (U, N) in units.
    :param y: likewise.
    :ivar value: the convex CVXPY expression, (N,) in nats.
    """

    def __init__(self, x: Any, y: Any) -> None:
        self._slopes = _Slopes(x, y)
        self._weights = cp.Parameter(x.shape, nonneg=True)
        self.value: Any = cp.sum(
            self._slopes.value + cp.multiply(self._weights, cp.square(x) + cp.square(y)), axis=0)

    def set_local_point(self, received: Array, slopes: Array, inverse: Array) -> None:
        """
        Set the parameters.

        :param received: powers over the noise power, (U, N).
        :param slopes: gradients of log(d^2 + H^2), (U, N, 2) in 1/unit.
        :param inverse: 1 / (d^2 + H^2), (U, N) in 1/unit^2.
        """
        shares = received / (1 + received.sum(axis=0))
        self._slopes.set_values(shares[..., None] * slopes)
        self._weights.value = shares * inverse


class _LogOfSumBound:
    """
    Upper bounds of log(1 + sum_k s_k exp(-y_k)), less their values at the local point.

    s_k is a received power there, and y_k a lower bound of the change of log(d_k^2 + H_k^2): the
    logarithm of one of the paper's zeta, xi and tau, whose squares are linearised.

    :param x: displacements of whoever sends, all of the first receiver, then all of the next,
        (R K, N) in units.
    :param y: likewise.
    :param receivers: R.
    :ivar value: the CVXPY variable, (R, N) in nats.
    :ivar constraints: what makes it an upper bound.
    """

    def __init__(self, x: Any, y: Any, receivers: int = 1) -> None:
        senders, slots = x.shape
        self._receivers = receivers
        self._slopes = _Slopes(x, y)
        self._noise = cp.Parameter((receivers, slots), nonneg=True)
        self._weights = cp.Parameter((senders, slots), nonneg=True)
        self.value: Any = cp.Variable((receivers, slots))
        logarithms = cp.Variable((senders, slots))
        of_receiver = np.kron(np.eye(receivers), np.ones((1, senders // receivers)))
        parts = cp.exp(-logarithms - of_receiver.T @ self.value)
        self.constraints: list[Any] = [
            cp.exp(logarithms) <= 1 + self._slopes.value,
            cp.multiply(self._noise, cp.exp(-self.value))
            + of_receiver @ cp.multiply(self._weights, parts) <= 1]

    def set_local_point(self, received: Array, slopes: Array) -> None:
        """
        Set the parameters.

        :param received: s_k, (R K, N).
        :param slopes: gradients of y_k, (R K, N, 2) in 1/unit.
        """
        each = received.reshape(self._receivers, -1, received.shape[-1])
        total = 1 + each.sum(axis=1)
        self._noise.value = 1 / total
        self._weights.value = (each / total[:, None]).reshape(received.shape)
        self._slopes.set_values(slopes)


class _JammingBound:
    """
    Upper bounds of -log(1 + sum of jamming) for every eavesdropper, with c of the paper.

    They are weights of (d + eps)^2, less their values at the local point.

    :param positions: of every jammer, (N, 2) in units.
    :param scale: units in a metre.
    :ivar value: the convex CVXPY expression, (E, N) in nats.
    :ivar constraints: what makes it an upper bound.
    """

    def __init__(self, eavesdroppers: Sequence[Eavesdropper], positions: list[Any],
                 scale: Any) -> None:
        slots, jammers = positions[0].shape[0], len(positions)
        shape = (len(eavesdroppers) * jammers, slots)
        self._weights = cp.Parameter(shape, nonneg=True)
        self._local_squares = cp.Parameter((len(eavesdroppers), slots))
        distances = cp.Variable(shape)
        centres = np.repeat([eve.position for eve in eavesdroppers], jammers, axis=0)
        radii = np.repeat([eve.error_radius for eve in eavesdroppers], jammers)
        every = np.tile(np.eye(jammers), (len(eavesdroppers), 1))
        offsets = [
            cp.vec(every @ cp.vstack([position[:, axis] for position in positions])
                   - scale * np.tile(centres[:, [axis]], (1, slots)), order='F')
            for axis in (0, 1)]
        self.constraints: list[Any] = [
            cp.vec(distances, order='F') >= scale * np.tile(radii, slots)
            + cp.norm(cp.vstack(offsets), axis=0)]
        of_eavesdropper = np.kron(np.eye(len(eavesdroppers)), np.ones((1, jammers)))
        self.value: Any = of_eavesdropper @ cp.multiply(
            self._weights, cp.square(distances)) - self._local_squares

    def set_local_point(self, weights: Array, distances: Array) -> None:
        """
        Set the parameters.

        :param weights: of (d + eps)^2, (E, U - 1, N) in 1/unit^2.
        :param distances: d + eps, (E, U - 1, N) in units.
        """
        self._weights.value = weights.reshape(-1, weights.shape[-1])
        self._local_squares.value = (weights * distances**2).sum(axis=1)


class _Slopes:
    """
    Scalar products of displacements with gradients that are parameters.

    :param x: displacements, (K, N) in units.
    :param y: likewise.
    :ivar value: the affine CVXPY expression, (K, N).
    """

    def __init__(self, x: Any, y: Any) -> None:
        self._parameters = [cp.Parameter(x.shape), cp.Parameter(y.shape)]
        self.value: Any = sum(cp.multiply(parameter, one) for parameter, one in zip(
            self._parameters, (x, y), strict=True))

    def set_values(self, slopes: Array) -> None:
        """Set the gradients, (K, N, 2) in 1/unit."""
        for parameter, slope in zip(self._parameters, np.moveaxis(slopes, -1, 0), strict=True):
            parameter.value = slope


def _directions(offset: Array, otherwise: Array) -> Array:
    """Return the offsets (..., 2) as unit vectors, and `otherwise` for those of length zero."""
    distance = np.linalg.norm(offset, axis=-1, keepdims=True)
    return np.where(distance > 0, offset / np.where(distance > 0, distance, 1), otherwise)
