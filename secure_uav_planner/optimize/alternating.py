"""
The paper's algorithm, Section III: powers and trajectories in turn, as convex restrictions.

CVXPY states the restrictions and Clarabel solves them. Only this module imports CVXPY, because
the import takes a second. The restriction of trajectories is valid for free space only: it needs
a gain whose inverse is affine in the squared distance, 1 / g = (d^2 + H^2) / beta_0. The tangent
of the square then bounds 1 / g from below.
"""

from collections.abc import Callable
import logging
import math
from typing import Any, NamedTuple
import warnings

import cvxpy as cp
import numpy as np

from .incumbent import Incumbent
from ..mission.scenario import Array, Scenario
from ..model.channel import (
    ground_gains, ground_squared_distances, guaranteed_gains, guaranteed_squared_distances)
from ..model.channel.links import FreeSpace, make_link
from ..model.cone_program import is_solver_failure
from ..plan.plan import Status

TOLERANCE = 1e-5
"""Gain [bit/s/Hz] of a round of all steps below which the method has converged."""
MAX_ROUNDS = 100
POWER_STEPS = 3
"""Power steps (III-A) before each trajectory step (III-B), which costs five times as much."""
STRETCH = 2.0
"""
Factor by which a step is lengthened while the true rate rises.

Without it, as in the paper, solves take 3.6 times as long and end lower.
"""

_LOG = logging.getLogger(__name__)

_Bound = tuple[Any, list[Any]]  # A CVXPY expression, and constraints that make it a bound.


class Restriction(NamedTuple):
    """
    A convex restriction at a local point.

    :param problem: a cvxpy.Problem, whose objective is the sum of rates in nats plus a constant.
    :param variables: variables of the problem, in units of `unit`.
    :param unit: unit of the variables, in W or m.
    :param get_answer: returns the powers or positions of the solved problem, in W or m.
    """

    problem: Any
    variables: list[Any]
    unit: Any
    get_answer: Callable[[], Array]


def alternate(incumbent: Incumbent) -> Status:
    """Improve an incumbent in rounds until one gains less than TOLERANCE; return the status."""
    for _ in range(MAX_ROUNDS):
        before = incumbent.rate
        solved = True
        for step in (*['power'] * POWER_STEPS, 'trajectory'):
            incumbent.deadline.raise_if_over()
            solved &= _improve(incumbent, step)
        if incumbent.rate - before < TOLERANCE:
            incumbent.deadline.raise_if_over()
            return 'converged' if solved else 'numerical_trouble'
    return 'iteration_limit'


def _improve(incumbent: Incumbent, step: str) -> bool:
    """Try a step's answer, 'power' or 'trajectory', and longer moves; return True if solved."""
    positions, powers = incumbent.positions, incumbent.powers
    restrict = restrict_powers if step == 'power' else restrict_trajectories
    restriction = restrict(incumbent.scenario, positions, powers)
    solved, seconds = solve_problem(restriction.problem, incumbent.deadline.time_left)
    incumbent.solver_time += seconds
    if solved:
        name, local = ('powers', powers) if step == 'power' else ('positions', positions)
        move = restriction.get_answer() - local
        # The restriction bounds the rate from below. Beyond its optimum the rate may still rise.
        stretch = 1.0
        while incumbent.try_improve(**{name: local + stretch * move}):
            stretch *= STRETCH
    incumbent.report(step)
    return solved


def restrict_powers(scenario: Scenario, positions: Array, powers: Array) -> Restriction:
    """
    Return the convex restriction (13) of problem (11), which maximises the sum of rates.

    Its objective, plus a constant, is a lower bound of the sum of rates in nats at the given
    positions, exact at the local point. The concave logarithms have the argument 1 at the local
    point, and powers are in units of the average power: values near 1 keep the solver accurate.

    :param positions: q_i[n], (U, N+2, 2) in m.
    :param powers: the local point p_i^(m)[n], (U, N) in W.
    """
    unit = scenario.average_powers[:, None]
    local, gains = powers / unit, ground_gains(scenario, positions) * unit
    variable: Any = cp.Variable(powers.shape)
    leakage = cp.Variable(powers.shape[1])
    interference = _drop_transmitter(gains)
    rate = (_log_of_sum(gains, local, variable) - leakage
            - _dot(interference / _total(interference, local), variable))
    constraints = [
        variable >= 0, variable <= scenario.peak_powers[:, None] / unit
        @ np.ones((1, powers.shape[1])), cp.sum(variable, axis=1) <= powers.shape[1]]
    constraints += [leakage >= _leakage_bound(gains * unit, local, variable)
                    for gains in guaranteed_gains(scenario, positions)]
    return Restriction(cp.Problem(cp.Maximize(cp.sum(rate)), constraints), [variable], unit,
                       lambda: variable.value * unit)


def restrict_trajectories(scenario: Scenario, positions: Array, powers: Array) -> Restriction:
    """
    Return the convex restriction (18) of problem (14), which minimises the loss of rate.

    It holds in free space only. Its variables are displacements of each UAV from the local point,
    (N+2, 2), in units of a typical distance. Its zeta, xi and tau are the logarithms of the
    paper's variables of these names, and are 0 at the local point. A logarithm is only defined
    above zero, so the paper's lower bounds (15d) are not needed.

    :param positions: the local point q_i^(m)[n], (U, N+2, 2) in m.
    :param powers: p_i[n], (U, N) in W.
    """
    offset = positions[:, 1:-1] - scenario.receivers.ground_nodes[0]
    gains, inverse = _evaluate_link(make_link(scenario, 'ground_node'),
                                    ground_squared_distances(scenario, positions))
    unit = float(1 / np.sqrt(np.median(inverse)))
    moves: list[Any] = [cp.Variable(path.shape) for path in positions]
    paths = [path / unit + move for path, move in zip(positions, moves, strict=True)]
    constraints = [cp.hstack([end for move in moves for end in (move[0], move[-1])]) == 0]
    constraints += [cp.norm(path[1:] - path[:-1], axis=1) <= longest / unit
                    for path, longest in zip(paths, scenario.max_step, strict=True)]

    x, y = (cp.vstack([move[1:-1, axis] for move in moves]) for axis in (0, 1))
    received, inverse = gains * powers, inverse * unit**2
    slopes = 2 * offset / unit * inverse[..., None]
    # The rate at the ground node, with the paper's a and b.
    shares = received / (1 + received.sum(axis=0))
    loss = cp.sum(_along(shares[..., None] * slopes, x, y) + cp.multiply(
        shares * inverse, cp.square(x) + cp.square(y)), axis=0)
    if len(paths) > 1:  # The y_k of _log_of_sum_bound is the logarithm of zeta of (17a).
        interference, needed = _log_of_sum_bound(received[1:], slopes[1:], x[1:], y[1:])
        loss += interference[0]
        constraints += needed
    bounds, needed = _leakage_bounds(scenario, unit, positions, powers, x, y, paths)
    largest = cp.Variable((1, scenario.slots))
    constraints += [*needed, np.ones((bounds.shape[0], 1)) @ largest >= bounds]
    return Restriction(
        cp.Problem(cp.Minimize(cp.sum(loss) + cp.sum(largest)), constraints), moves, unit,
        lambda: positions + unit * np.stack([move.value for move in moves]))


def _leakage_bounds(scenario: Scenario, unit: float, positions: Array, powers: Array, x: Any,
                    y: Any, paths: list[Any]) -> _Bound:
    """
    Return convex upper bounds of each eavesdropper's rate, and constraints that make them bounds.

    The rate is log(1 + all received power) - log(1 + received jamming), each logarithm bounded.

    :param unit: unit of lengths in the restriction [m].
    :param positions: the local point q_i^(m)[n], (U, N+2, 2) in m.
    :param powers: p_i[n], (U, N) in W.
    :param x: x-coordinates of the displacements of the UAVs, (U, N) in units.
    :param y: y-coordinates of the displacements, (U, N) in units.
    :param paths: displaced positions of each UAV, (N+2, 2) in units.
    :return: bounds (E, N) in nats, and the constraints that make them upper bounds.
    """
    (grounds, centres, radii), count = scenario.receivers, len(scenario.eavesdroppers)
    squared = guaranteed_squared_distances(scenario, positions)
    gains, inverse = _evaluate_link(
        make_link(scenario, 'eavesdropper').for_receivers(
            scenario.receiver_advantages[:, None, None]), squared)
    received, inverse = gains * powers, inverse * unit**2
    distances = np.sqrt(squared) / unit
    # (d + eps)^2 has a kink at d = 0, where any direction gives a subgradient. The direction away
    # from the ground node is chosen, so that it pays for the jammer to leave. For the transmitter
    # [d - eps]^+ is linearised, which is valid inside the disc, unlike (17b).
    away = _normalise(positions[:, 1:-1] - grounds[0], np.array([1.0, 0.0]))
    slopes = 2 * (distances * inverse)[..., None] * _normalise(
        positions[:, 1:-1] - centres[:, None], away)
    # The y_k of _log_of_sum_bound is the logarithm of xi of (17b) for the transmitter, and the
    # logarithm of tau of (17c) for jammers.
    repeat = np.tile(np.eye(len(positions)), (count, 1))  # (U, N) to (E U, N).
    bounds, constraints = _log_of_sum_bound(
        np.concatenate(received), np.concatenate(slopes), repeat @ x, repeat @ y, count)
    jamming = 1 + received[:, 1:].sum(axis=1)
    bounds += np.log1p(received[:, 0] / jamming)
    if len(positions) > 1:
        jamming_bounds, needed = _jamming_bound(
            received[:, 1:] / jamming[:, None] * inverse[:, 1:], distances[:, 1:],
            [path[1:-1] for path in paths[1:]], centres / unit, radii / unit)
        bounds += jamming_bounds
        constraints += needed
    return bounds, constraints


def solve_problem(problem: Any, time_left: float = math.inf) -> tuple[bool, float]:
    """
    Solve a CVXPY problem by Clarabel.

    A failure of the solver is not raised, because the callers keep their best iterate. A problem
    that breaks CVXPY's rules raises CVXPY's error, because the program is wrong.

    :param time_left: time limit for Clarabel [s].
    :return: whether the variables hold a solution, and the time [s] that Clarabel took.
    """
    # Without solver_opts, CVXPY 1.9 fails when it unpacks the results.
    data, chain, inverse_data = problem.get_problem_data(cp.CLARABEL, solver_opts={})
    options = {} if math.isinf(time_left) else {'time_limit': time_left}
    try:
        # A warm start would update the solver of the last call. Clarabel refuses this when an
        # entry of a matrix becomes zero or nonzero, and CVXPY 1.6.7 to 1.8.1 raise the refusal.
        solution = chain.solve_via_data(
            problem, data, warm_start=False, verbose=False, solver_opts=options)
    except BaseException as error:
        if not is_solver_failure(error):
            raise
        _LOG.debug('Clarabel failed', exc_info=True)
        return False, 0.0
    with warnings.catch_warnings():
        # An inaccurate solution is accepted: the caller judges it by the true objective.
        warnings.filterwarnings('ignore', message='Solution may be inaccurate')
        try:
            problem.unpack_results(solution, chain, inverse_data)
        except cp.SolverError:
            return False, solution.solve_time
    return problem.status in (cp.OPTIMAL, cp.OPTIMAL_INACCURATE), solution.solve_time


def _log_of_sum(gains: Array, local: Array, powers: Any) -> Any:
    """Return the concave log(1 + sum_i g_i p_i) minus its value at the local point, (N,)."""
    total = _total(gains, local)
    return cp.log(1 / total + _dot(gains / total, powers))


def _leakage_bound(gains: Array, local: Array, powers: Any) -> Any:
    """
    Return a convex upper bound of an eavesdropper's rate in nats, exact at the local point, (N,).

    The rate is log(1 + sum_i g_i p_i) - log(1 + sum_{i > 0} g_i p_i), where UAV 0 transmits. The
    tangent at the local point replaces the first logarithm. Minus the second one is convex.
    """
    total, jamming = _total(gains, local), _drop_transmitter(gains)
    constant = np.log(total / _total(jamming, local)) - (total - 1) / total
    return constant + _dot(gains / total, powers) - _log_of_sum(jamming, local, powers)


def _dot(slopes: Array, powers: Any) -> Any:
    return cp.sum(cp.multiply(slopes, powers), axis=0)


def _total(gains: Array, local: Array) -> Array:
    """Return noise, whose power is 1, plus the power received at the local point, (N,)."""
    return np.asarray(1 + (gains * local).sum(axis=0))


def _drop_transmitter(gains: Array) -> Array:
    """Return the gains (U, N) with zeros for UAV 0, the transmitter."""
    return np.concatenate([np.zeros_like(gains[:1]), gains[1:]])


def _evaluate_link(link: FreeSpace, squared: Array) -> tuple[Array, Array]:
    """Return gains g and 1 / (d^2 + H^2), which is -dg/d(d^2) / g in free space only."""
    return link.gain(squared), 1 / (squared + link.squared_altitudes)


def _log_of_sum_bound(received: Array, slopes: Array, x: Any, y: Any,
                      receivers: int = 1) -> _Bound:
    """
    Return upper bounds of log(1 + sum_k s_k exp(-y_k)) minus their values at the local point.

    s_k is the power received from sender k at the local point. y_k is a lower bound of the change
    of log(d_k^2 + H_k^2): the logarithm of one of the paper's zeta, xi and tau, whose squares are
    linearised.

    :param received: s_k of the K senders at receiver 1, then at receiver 2, ..., (R K, N).
    :param slopes: gradients of y_k, (R K, N, 2) in 1/unit.
    :param x: x-coordinates of the displacements of the senders, (R K, N) in units.
    :param y: y-coordinates of the displacements, (R K, N) in units.
    :param receivers: number R of receivers.
    :return: a variable, (R, N) in nats, and the constraints that make it an upper bound.
    """
    senders, slots = x.shape
    sums = np.kron(np.eye(receivers), np.ones((1, senders // receivers)))
    total = 1 + sums @ received
    value: Any = cp.Variable((receivers, slots))
    logarithms = cp.Variable((senders, slots))
    parts = cp.exp(-logarithms - sums.T @ value)
    weights = received / (sums.T @ total)
    return value, [
        cp.exp(logarithms) <= 1 + _along(slopes, x, y),
        cp.multiply(1 / total, cp.exp(-value)) + sums @ cp.multiply(weights, parts) <= 1]


def _jamming_bound(weights: Array, distances: Array, positions: list[Any], centres: Array,
                   radii: Array) -> _Bound:
    """
    Return upper bounds of -log(1 + received jamming) minus their values at the local point.

    A bound is sum_i c_i ((d_i + eps)^2 - its local value) over the jammers i, with the paper's c.

    :param weights: c_i, (E, U - 1, N) in 1/unit^2.
    :param distances: d + eps at the local point, (E, U - 1, N) in units.
    :param positions: positions of each jammer, (N, 2) in units.
    :param centres: centres of the eavesdroppers' discs, (E, N, 2) in units.
    :param radii: radii eps of the discs, (E, N) in units.
    :return: bounds (E, N) in nats, and the constraints that make them upper bounds.
    """
    count, jammers, slots = weights.shape
    farthest = cp.Variable((count * jammers, slots))  # The largest distances d + eps.
    repeat = np.tile(np.eye(jammers), (count, 1))
    sums = np.kron(np.eye(count), np.ones((1, jammers)))
    offsets = [
        cp.vec(repeat @ cp.vstack([position[:, axis] for position in positions])
               - sums.T @ centres[..., axis], order='F')
        for axis in (0, 1)]
    value = sums @ cp.multiply(np.concatenate(weights), cp.square(farthest)) - (
        weights * distances**2).sum(axis=1)
    return value, [cp.vec(farthest, order='F') >= (sums.T @ radii).ravel(order='F')
                   + cp.norm(cp.vstack(offsets), axis=0)]


def _along(slopes: Array, x: Any, y: Any) -> Any:
    """Return scalar products of gradients (K, N, 2) with displacements (x, y), (K, N)."""
    return cp.multiply(slopes[..., 0], x) + cp.multiply(slopes[..., 1], y)


def _normalise(offset: Array, fallback: Array) -> Array:
    """Return offsets (..., 2) as unit vectors; an offset of length 0 becomes the fallback."""
    distance = np.linalg.norm(offset, axis=-1, keepdims=True)
    return np.where(distance > 0, offset / np.where(distance > 0, distance, 1), fallback)
