"""
The compiled kernel as Python sees it.

Arrays are contiguous, of float64 unless a type is given, and are read as they are: a wrong type,
shape or layout is a ValueError. The last arguments of a function are the arrays that it fills.
Lengths and powers are in the units of a Grid; in Discs they are in m and W. Rates are in nats
unless stated.

Letters: N slots, M = N + 2 points, U UAVs, K receivers (the G ground nodes first), E
eavesdroppers, P places or discs, S starts.
"""

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Indices = NDArray[np.int64]
Flags = NDArray[np.bool_]
Arguments = Mapping[str, Any]

TOLERANCE: float
"""Largest excess [bit/s/Hz] of a proven leak over the largest leak found, at a rate scale of 1."""

class LinkGains:
    """Gains over the noise power of K U links; link k U + u is from UAV u to receiver k."""

    def gain(self, link: int, squared: float) -> tuple[float, float, float, float]:
        """
        Return gain and derivatives at a squared distance: for tests.

        :return: the gain as computed alone, the gain as computed with derivatives, and its first
            and second derivative by the squared distance.
        """

class FreeSpace(LinkGains):
    def __init__(self, snr: Array, squared_altitudes: Array) -> None:
        """Make FreeSpace from SNRs at unit distance and power, (K, U), and H^2, (K, U)."""

class PathLoss(LinkGains):
    def __init__(self, snr: Array, squared_altitudes: Array, losses: Array, steepness: Array,
                 shift: Array, exponent: float, quantile: bool) -> None:
        """
        Make PathLoss from SNRs and H^2 as for FreeSpace, and parameters of its line of sight.

        :param losses: kappa, (K, U); 1 for links that always have a line of sight.
        :param steepness: slope of z per degree of elevation, (K, U).
        :param shift: offset of z = steepness theta - shift, (K, U).
        :param exponent: exponent alpha of the path loss.
        :param quantile: whether the gain is a quantile instead of a mean.
        """

    def bound_log_gain(self, link: int, near: float, far: float) -> tuple[float, float, float]:
        """
        Return upper bounds of |f'|, |f''| and |f'''| for the log gain f along any horizontal line.

        They hold at distances from `near` to `far` [m], and are infinite with a kink in between.
        """

class Vectors:
    """I vectors of flights, each a weighted sum of T points and a constant."""

    def __init__(self, varies: Flags, points: Indices, weights: Array, constants: Array,
                 differences: bool) -> None:
        """
        Make I vectors, each the sum of weight * point over its T points plus a constant.

        :param varies: which points vary, (M, U); first and last points must not.
        :param points: index U n + u of each point n of UAV u, (I, T).
        :param weights: weights of the points, (I, T).
        :param constants: constants of the vectors, (I, 2).
        :param differences: whether the weights of each UAV in each vector add up to 0.
        """

class Limit:
    """A limit c > 0 on flights, for `InteriorPointSolver`."""

    def __init__(self, vectors: Vectors, ignored: Flags, squares: Array) -> None:
        """
        Make the limit c = 1 - |d|^2 / r^2 of I vectors d.

        :param ignored: whether each vector is not limited, (I,).
        :param squares: r^2 of each vector, (I,).
        """

    def evaluate(self, path: Array, moves: Array) -> dict[str, Any]:
        """
        Return all that Newton's method asks of the limit: for tests.

        :param path: points with start and goal, (M, U, 2).
        :param moves: moves of the points along a step, (M, U, 2).
        :return: a dictionary: `slacks` c and their `slopes` along the step; `lengths`, the largest
            share of its step that each UAV may take, at most 1, (U,); `gradient` of -sum log c,
            (N, U, 3), and `band` of its Hessian, column by column from the diagonal down, with
            `height` entries in a column; `limits_moves`, whether lines limit moves.
        """

class Energies:
    """The energies of flights, each as a share of its limit."""

    def __init__(self, moves: Vectors, weights: Array, terms: Array, constants: Array) -> None:
        """
        Make a UAV's energy: the sum over its moves of weight * power(move), plus its constant.

        :param terms: coefficients of each UAV's power, (U, 4); see limits.energy. `moves` and
            `weights` are (U, S), `constants` (U,).
        """

    def find(self, path: Array, energies: Array) -> None:
        """Fill the energies (U,) of a path (M, U, 2) with start and goal, as shares of limits."""

class LineLimit(Limit):
    """
    A limit c = normal . p - offset of control points p, (M, G, K).

    There are M pieces of K points for each of G pairs of a UAV and an obstacle, or of two UAVs,
    where p is the difference of theirs. Ignored control points are not limited.
    """

    def choose_lines(self, path: Array, normals: Array, offsets: Array) -> None:
        """Fill the normals (M, G, 2) and offsets (M, G) of lines for a path (M, U, 2)."""

class ZoneLimit(LineLimit):
    def __init__(self, control_points: Vectors, ignored: Flags, polygons: Array) -> None:
        """Make it with Z polygons of V vertices for each of A UAVs, (A, Z, V, 2)."""

class SeparationLimit(LineLimit):
    def __init__(self, control_points: Vectors, ignored: Flags, radii: Array) -> None:
        """Make it with the radius (G,) of the disc that each pair's difference stays out of."""

class FenceLimit(LineLimit):
    def __init__(self, control_points: Vectors, ignored: Flags, normals: Array,
                 offsets: Array) -> None:
        """Make it with inward normals (G, 2) and offsets (G,): normal . p >= offset inside."""

class InteriorPointSolver:
    def __init__(self, arguments: Arguments, x: Array, shares: Array, mu: Array,
                 finished: Flags, over: Flags, prices: Array) -> None:
        """
        Make Newton's method on a barrier function, for starts that it changes in place.

        :param arguments: `slots`, `uavs`, `colluding`, `rate_unit` in nats, `limits` (list of
            Limit), `gains`, `starts` and `goals` (U, 2), `fixed` (whether each UAV's positions
            stay, (U,)), `peaks` of power (U,), `weights` of the ground nodes and `offsets` of
            their mean rates in nats (G,), `positions` of the receivers, as in a Grid's Receivers,
            (N, K, 2), their `radii`, which the guarantee adds to distances, (N, K), `listeners`
            (list of indices of ground nodes), `energies` (None if none is limited), and `places`.
            `places` is None for (P2), and for (P1) a dictionary: `moves_along`, whether each place
            moves along with the UAVs, (N, E P), `offsets` of the places from the centres of their
            discs (N, E P, 2) and the discs' `radii` (N, E P).
        :param x: powers and positions, (S, N, U, 3).
        :param shares: filled with shares of the slots for the ground nodes, (S, N, G).
        :param mu: barrier parameters in units of rates, (S,).
        :param finished: set to True when a start has converged or stalled, (S,).
        :param over: set to whether each energy has a price in place of a barrier term, (S, U).
        :param prices: first prices of the energies in units of rates per limit, (S, U). A price
            rises from step to step, and is then set to the dual of the limit.
        """

    def advance(self, steps: int, final: float, raise_if_over: Callable[[], None]
                ) -> tuple[int, int]:
        """
        Take `steps` steps from all starts, or fewer if steps are expensive.

        :param final: the least barrier parameter, at which a start may finish.
        :param raise_if_over: called now and then; if it raises, starts that have not yet stepped
            are left unchanged.
        :return: the number of steps, and the largest number of starts that failed in one step.
        """

    def evaluate_rates(self, rates: Array) -> None:
        """Fill each start's least weighted mean rate in nats, with 0 for negative rates, (S,)."""

    def evaluate(self, values: Array, gradients: Array, hessians: Array) -> None:
        """
        Fill the barrier function and its derivatives: for tests.

        :param values: values of the barrier function, (S,).
        :param gradients: derivatives by x and, behind x, by all shares except the first of each
            slot, (S, N (3 U + G - 1)).
        :param hessians: lower triangles of the objective's Hessian, slot by slot, (S, N, V, V)
            for V = 3 U + G - 1 variables.
        """

    def exchange_places(self, places: Arguments, positions: Array) -> None:
        """Replace the places, and the receivers' positions (N, K, 2), by the same number."""

def find_local_minima(discs: Arguments, minima: Array) -> None:
    """
    Find a local minimum of the inverse SINR in each disc, probably the least one.

    It bounds nothing: a smaller value may exist in the disc; see prove_leaks.

    :param discs: a disc for each slot and eavesdropper, slot by slot: UAVs' `x` and `y` from the
        disc's centre (U, P), `squared_altitudes` (U,), `noise` (P,), `radius` (P,) and `jamming`
        (U - 1, P). A `channel` is given unless it is free space. See struct Discs of
        inverse_sinr.hpp.
    :param minima: inverse SINR, x and y of the minima, (3, P).
    """

def bound_sectors(discs: Arguments, sectors: Arguments, bounds: Array, values: Array) -> None:
    """
    Bound the inverse SINR in a sector of each disc: for tests.

    :param sectors: `inner`, `outer`, `middle` and `half`, (P,) each; see struct Sector.
    :param bounds: lower bounds of the inverse SINR in the sectors, (P,).
    :param values: inverse SINR at one place of each sector, (P,).
    """

def prove_leaks(discs: Arguments, slots: Indices, most: Array, most_sectors: int,
                tolerance: float, leaks: Array, worst: Indices, places: Array) -> None:
    """
    Prove an upper bound of the leak over all places of each slot's discs.

    The bound holds inside the discs only. It is within the tolerance of the largest leak unless
    the number of sectors ends the search, and valid in any case.

    :param slots: slot of each disc, ascending from 0, (P,).
    :param most: upper bounds of the discs' leaks by a formula, (P,) in bit/s/Hz.
    :param most_sectors: number of sectors examined in a slot, after which its search ends.
    :param tolerance: largest excess of a bound over the largest leak found [bit/s/Hz].
    :param leaks: upper bounds, (slots,) in bit/s/Hz.
    :param worst: index of the disc with the largest leak found, (slots,).
    :param places: place of this leak, from the disc's centre, (slots, 2) in m.
    """

class Detours:
    def __init__(self, low: Array, size: Array, lengths: Array) -> None:
        """
        Make Detours of R x R cells.

        :param low: lower corner of the first cell, (2,).
        :param size: size of a cell, (2,).
        :param lengths: lower bounds of path lengths from the start, and to the goal, (2, R, R).
        """

class ReachableSet:
    """The geometry of a `bound.proof.reachable_set.ReachableSet`, by cell, not by group."""

    def __init__(self, distance: float, from_start: Array, to_goal: Array, corner: Array,
                 low: Array, high: Array, detours: Detours | None) -> None: ...

class Links:
    """The links of a `bound.proof.reachable_set.ReachableSet`, which has the shapes."""

    def __init__(self, altitude: float, log_gain: float, ground: Array, eavesdroppers: Array,
                 radii: Array, log_advantages: Array) -> None: ...

class Terms:
    """The functions of a UAV that `bound.proof.terms.Terms` describes, with their shapes."""

    def __init__(self, region: ReachableSet, links: Links, cell: Indices, weight: Array,
                 v: Array, slope: Array, curvature: Array, speed_cost: Array, margin: Array,
                 price: float, powers: tuple[float, float] | None) -> None: ...

    def bound_maxima(self, functions: NDArray[np.intp], bounds: Array, tolerance: Array,
                     budget: float, maximisers: Array) -> None:
        """
        Bound the maxima of functions over one cell by branch and bound.

        :param functions: indices of the functions to bound.
        :param bounds: incumbent of each of all functions, a guess of its maximum. Upper bounds of
            the maxima replace the incumbents of `functions`.
        :param tolerance: for each of all functions, how far its bound may exceed the larger of its
            maximum and its incumbent, unless the budget ends the search.
        :param budget: largest number of boxes for each function.
        :param maximisers: the place and log p of the best point that exceeds the incumbent,
            (M, 3). Rows of functions without such a point are left as they are.
        """

    def bound_box(self, function: int, centre: Array, half: Array) -> tuple[float, float]:
        """Return a function's value at a box's centre and its bound over the box: for tests."""

def smooth_maxima(columns: Arguments, values: Array, gradients: Array, hessians: Array) -> None:
    """
    Fill the smoothed maxima over a UAV's columns; see `search.columns.pack_columns`.

    :param values: smoothed maximum of each slot group, (G,).
    :param gradients: derivatives by the group's unknowns, (G, F), or empty to leave out.
    :param hessians: second derivatives, (G, F, F), or empty to leave out.
    """

def evaluate_columns(columns: Arguments, values: Array) -> None:
    """Fill the values of a UAV's columns, (G, C)."""

def minimise_slot_bounds(columns: Sequence[tuple[Array, ...]], adversaries: Indices,
                         price: float, peak: float, group: Indices, low: Array, high: Array,
                         weights: Array, v: Array, maxima: Array, bounds: Array) -> None:
    """
    Minimise the bounds of slots on columns over v approximately; for bound.search.slot_bounds.

    :param columns: for each UAV a tuple: places (G, C, 2), values without w0 and v (G, C), factors
        of w0 (G, C) and factors of v (G, C, E).
    :param adversaries: index of the adversary of each of E places, (E,).
    :param price: price of the transmit power.
    :param peak: peak of the transmit power [W].
    :param group: group of every cell of the last UAV, (C',).
    :param low: lower corners of the cells, (C', 2).
    :param high: upper corners of the cells, (C', 2).
    :param weights: w0, (K, C').
    :param v: start of the search, replaced by its result, (K, C', E).
    :param maxima: maxima of the UAVs' columns at the result, (U, K, C').
    :param bounds: bounds without H(w0) at the result, (K, C').
    """
