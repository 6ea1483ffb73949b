"""
Section III-B: trajectories for given powers, as a convex problem.

The restriction is valid for free space only. It needs a gain whose inverse is affine in the
squared distance, 1 / g = (d^2 + H^2) / beta_0, which a square's tangent then bounds from below.
"""

from typing import Any, ClassVar, Literal

import cvxpy as cp
import numpy as np

from .clarabel import solve_problem
from ...mission.scenario import Array, Scenario
from ...model.channel import ground_squared_distances, guaranteed_squared_distances
from ...model.channel.links import FreeSpace, link_of

_Bound = tuple[Any, list[Any]]  # A CVXPY expression, and the constraints that make it a bound.


class TrajectoryProblem:
    """
    The convex restriction (18) of problem (14).

    Its variables are displacements from the local point in units of a typical distance, and
    zeta, xi and tau are logarithms of the paper's, zero at the local point. A logarithm is only
    defined above zero, so the paper's lower bounds (15d) are not needed.

    :cvar step: what a solve is called in the history of a plan.
    :cvar block: which block of the variables a solve improves.
    :ivar problem: the last cvxpy.Problem, which minimises the loss of rate since the local point
        in nats, up to a constant, summed over the slots.
    :ivar moves: its variables, the displacements of every UAV, (N+2, 2) in units of `unit`.
    :ivar unit: the typical distance of the last solve, in m.
    :ivar compile_time: the time that CVXPY took in the last solve in s, None before the first.
    """

    step: ClassVar[str] = 'trajectory'
    block: ClassVar[Literal['positions']] = 'positions'

    def __init__(self, scenario: Scenario) -> None:
        self._scenario = scenario
        self.compile_time: float | None = None

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
        scenario = self._scenario
        offset = positions[:, 1:-1] - np.array(scenario.ground_node)
        gains, inverse = _gains(link_of(scenario, 'ground_node'),
                                ground_squared_distances(scenario, positions))
        self.unit = unit = float(1 / np.sqrt(np.median(inverse)))
        self.moves: list[Any] = [cp.Variable(path.shape) for path in positions]
        paths = [path / unit + move for path, move in zip(positions, self.moves, strict=True)]
        constraints = [cp.hstack([
            end for move in self.moves for end in (move[0], move[-1])]) == 0]
        constraints += [cp.norm(path[1:] - path[:-1], axis=1) <= longest / unit
                        for path, longest in zip(paths, scenario.max_step, strict=True)]

        x, y = (cp.vstack([move[1:-1, axis] for move in self.moves]) for axis in (0, 1))
        received, inverse = gains * powers, inverse * unit**2
        slopes = 2 * offset / unit * inverse[..., None]
        # What the ground node receives, with the paper's a and b.
        shares = received / (1 + received.sum(axis=0))
        loss = cp.sum(_along(shares[..., None] * slopes, x, y) + cp.multiply(
            shares * inverse, cp.square(x) + cp.square(y)), axis=0)
        if len(paths) > 1:  # y_k is the logarithm of zeta of (17a).
            interference, needed = _log_of_sum_bound(received[1:], slopes[1:], x[1:], y[1:])
            loss += interference[0]
            constraints += needed
        bounds, needed = self._leakage_bounds(
            positions, powers, _directions(offset, np.array([1.0, 0.0])), x, y, paths)
        largest = cp.Variable((1, scenario.slots))
        constraints += [*needed, np.ones((bounds.shape[0], 1)) @ largest >= bounds]
        self.problem = cp.Problem(cp.Minimize(cp.sum(loss) + cp.sum(largest)), constraints)
        solved, seconds, self.compile_time = solve_problem(self.problem, time_left)
        if not solved:
            return None, seconds
        return positions + unit * np.stack([move.value for move in self.moves]), seconds

    def _leakage_bounds(self, positions: Array, powers: Array, away: Array, x: Any, y: Any,
                        paths: list[Any]) -> _Bound:
        """
        Return upper bounds of what each eavesdropper receives, (E, N) in nats.

        The unit vectors `away` (U, N, 2) stand for a direction from it where there is none.
        """
        scenario, unit = self._scenario, self.unit
        centres, count = scenario.eavesdropper_positions, len(scenario.eavesdroppers)
        squared = guaranteed_squared_distances(scenario, positions)
        gains, inverse = _gains(
            link_of(scenario, 'eavesdropper').for_receivers(
                scenario.receiver_advantages[:, None, None]), squared)
        received, inverse = gains * powers, inverse * unit**2
        distances = np.sqrt(squared) / unit
        # (d + eps)^2 has a kink at d = 0. Any direction gives a subgradient there, and the one
        # away from the ground node lets the jammer see a gain in leaving. Of the transmitter,
        # [d - eps]^+ is linearised: that is valid inside the disc, unlike (17b).
        slopes = 2 * (distances * inverse)[..., None] * _directions(
            positions[:, 1:-1] - centres[:, None, None], away)
        # y_k is the logarithm of xi of (17b) for the transmitter, of tau of (17c) for jammers.
        every = np.tile(np.eye(len(positions)), (count, 1))
        bounds, constraints = _log_of_sum_bound(
            np.concatenate(received), np.concatenate(slopes), every @ x, every @ y, count)
        jamming = 1 + received[:, 1:].sum(axis=1)
        bounds += np.log1p(received[:, 0] / jamming)
        if len(positions) > 1:
            found, needed = _jamming_bound(
                received[:, 1:] / jamming[:, None] * inverse[:, 1:], distances[:, 1:],
                [path[1:-1] for path in paths[1:]], centres / unit, scenario.error_radii / unit)
            bounds += found
            constraints += needed
        return bounds, constraints


def _gains(link: FreeSpace, squared: Array) -> tuple[Array, Array]:
    """Return the gains, and 1 / (d^2 + H^2), which is -g' / g in free space and only there."""
    gains, slopes = link.gain(squared), link.slope(squared)
    return gains, -slopes / gains


def _log_of_sum_bound(received: Array, slopes: Array, x: Any, y: Any,
                      receivers: int = 1) -> _Bound:
    """
    Return upper bounds of log(1 + sum_k s_k exp(-y_k)), less their values at the local point.

    s_k is a received power there, and y_k a lower bound of the change of log(d_k^2 + H_k^2): the
    logarithm of one of the paper's zeta, xi and tau, whose squares are linearised.

    :param received: s_k, all of the first receiver, then all of the next, (R K, N).
    :param slopes: gradients of y_k, (R K, N, 2) in 1/unit.
    :param x: displacements of whoever sends, (R K, N) in units, as y.
    :param receivers: R.
    :return: a variable, (R, N) in nats, and what makes it an upper bound.
    """
    senders, slots = x.shape
    of_receiver = np.kron(np.eye(receivers), np.ones((1, senders // receivers)))
    total = 1 + of_receiver @ received
    value: Any = cp.Variable((receivers, slots))
    logarithms = cp.Variable((senders, slots))
    parts = cp.exp(-logarithms - of_receiver.T @ value)
    weights = received / (of_receiver.T @ total)
    return value, [
        cp.exp(logarithms) <= 1 + _along(slopes, x, y),
        cp.multiply(1 / total, cp.exp(-value)) + of_receiver @ cp.multiply(weights, parts) <= 1]


def _jamming_bound(weights: Array, distances: Array, positions: list[Any], centres: Array,
                   radii: Array) -> _Bound:
    """
    Return upper bounds of -log(1 + sum of jamming), with c of the paper, (E, N) in nats.

    They are weights of (d + eps)^2, less their values at the local point.

    :param weights: (E, U - 1, N) in 1/unit^2.
    :param distances: d + eps at the local point, (E, U - 1, N) in units.
    :param positions: of every jammer, (N, 2) in units, as centres (E, 2) and radii (E,) of discs.
    """
    count, jammers, slots = weights.shape
    found = cp.Variable((count * jammers, slots))
    every = np.tile(np.eye(jammers), (count, 1))
    of_each = np.kron(np.eye(count), np.ones((1, jammers)))
    offsets = [
        cp.vec(every @ cp.vstack([position[:, axis] for position in positions])
               - np.outer(of_each.T @ centres[:, axis], np.ones(slots)), order='F')
        for axis in (0, 1)]
    value = of_each @ cp.multiply(np.concatenate(weights), cp.square(found)) - (
        weights * distances**2).sum(axis=1)
    return value, [cp.vec(found, order='F') >= np.tile(of_each.T @ radii, slots)
                   + cp.norm(cp.vstack(offsets), axis=0)]


def _along(slopes: Array, x: Any, y: Any) -> Any:
    """Return scalar products of gradients (K, N, 2) with displacements, (K, N)."""
    return cp.multiply(slopes[..., 0], x) + cp.multiply(slopes[..., 1], y)


def _directions(offset: Array, otherwise: Array) -> Array:
    """Return the offsets (..., 2) as unit vectors, and `otherwise` for those of length zero."""
    distance = np.linalg.norm(offset, axis=-1, keepdims=True)
    return np.where(distance > 0, offset / np.where(distance > 0, distance, 1), otherwise)
