"""
The compiled kernel as Python sees it.

Arrays are contiguous, of float64 unless a type is given, and are read as they are: a wrong type,
shape or layout is a ValueError. Those that a function fills are its last arguments. Lengths and
powers are in the units of a Grid but in Discs, where they are in m and W; rates are in nats
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
"""How far in bit/s/Hz a proven leak may lie above the largest of the search."""

class LinkGains:
    """The gains of K U links over the noise power; link k U + u is from UAV u to receiver k."""

    def gain(self, link: int, squared: float) -> tuple[float, float, float, float]:
        """Return the gain twice, and its first and second derivative by the squared distance."""

class FreeSpace(LinkGains):
    def __init__(self, snr: Array, squared_altitudes: Array) -> None:
        """Make it from SNRs at unit distance and unit power, (K, U), and H^2, (K, U)."""

class PathLoss(LinkGains):
    def __init__(self, snr: Array, squared_altitudes: Array, losses: Array, steepness: Array,
                 shift: Array, exponent: float, quantile: bool) -> None:
        """Make it as FreeSpace; kappa, 1 in line of sight, steepness per degree, shift (K, U)."""

    def bound_log_gain(self, link: int, near: float, far: float) -> tuple[float, float, float]:
        """Return bounds of the first three derivatives of log gain between two distances."""

class Vectors:
    """I vectors of flights, each a weighted sum of T points and a constant."""

    def __init__(self, varies: Flags, points: Indices, weights: Array, constants: Array,
                 differences: bool) -> None:
        """
        Make them.

        :param varies: which points vary, (M, U), neither first ones nor last ones.
        :param points: U n + u of point n of UAV u, (I, T).
        :param weights: (I, T).
        :param constants: (I, 2).
        :param differences: whether the weights of each vector add up to 0.
        """

class Limit:
    """A limit c > 0 on flights, for `InteriorPointSolver`."""

    def __init__(self, vectors: Vectors, ignored: Flags, squares: Array) -> None:
        """Make c = 1 - |d|^2 / r^2 of vectors d; the flags and the squares r^2 are (I,)."""

    def evaluate(self, path: Array, moves: Array) -> dict[str, Any]:
        """
        Return all that Newton's method asks of the limit: for tests.

        :param path: points with start and goal, (M, U, 2).
        :param moves: of the points along a step, (M, U, 2).
        :return: `slacks` c and their `slopes` along the step; step `lengths`, (U,); the `gradient`
            of -sum log c, (N, U, 3), and its Hessian's `band` by columns, each from the diagonal
            down, of this `height`; whether lines limit moves, `limits_moves`.
        """

class EnergyCost:
    def __init__(self, moves: Vectors, weights: Array, terms: Array) -> None:
        """Make it from moves and weights, (U, S), and the numbers of PowerTerms, (U, 4)."""

class LineLimit(Limit):
    """
    A limit c = normal . p - offset of control points p (M, G, K), but for those that are ignored.

    There are M pieces of K points for each of G pairs of a UAV and an obstacle, or of two UAVs.
    """

    def choose_lines(self, path: Array, normals: Array, offsets: Array) -> None:
        """Choose for a path (M, U, 2) the normals (M, G, 2) and offsets (M, G) of lines."""

class ZoneLimit(LineLimit):
    def __init__(self, control_points: Vectors, ignored: Flags, polygons: Array) -> None:
        """Make it with polygons (A, Z, V, 2), for A UAVs Z of V vertices each."""

class SeparationLimit(LineLimit):
    def __init__(self, control_points: Vectors, ignored: Flags, radii: Array) -> None:
        """Make it with the radii of the discs to stay out of, (G,)."""

class FenceLimit(LineLimit):
    def __init__(self, control_points: Vectors, ignored: Flags, normals: Array,
                 offsets: Array) -> None:
        """Make it with the normals (G, 2) and offsets (G,) of sides."""

class InteriorPointSolver:
    def __init__(self, arguments: Arguments, x: Array, shares: Array, mu: Array,
                 finished: Flags) -> None:
        """
        Make Newton's method on a barrier function, for starts that it changes in place.

        :param arguments: `slots`, `uavs`, `colluding`, `rate_unit` in nats, `limits` (list of
            Limit), `gains`, `starts` and `goals` (U, 2), `fixed` UAVs (U,), `peaks` of power
            (U,), `weights` of the ground nodes and `offsets` of their mean rates in nats (G,),
            `positions` of the receivers, as in a Grid's Receivers, (N, K, 2), their `radii`, which
            the guarantee adds to distances, (N, K), the list of `listeners`, and `places`, None
            for (P2), or with `followed`, whether they move along with the UAVs, (N, E P), their
            `offsets` from the centres (N, E P, 2) and the discs' `radii` (N, E P); and `energy`,
            an EnergyCost, or None.
        :param x: powers and positions, (S, N, U, 3).
        :param shares: filled with shares of the slots for the ground nodes, (S, N, G).
        :param mu: barrier parameters in units of rates, (S,).
        :param finished: set where a start has converged or stalled, (S,).
        """

    def advance(self, steps: int, final: float, raise_if_over: Callable[[], None]
                ) -> tuple[int, int]:
        """
        Take up to `steps` steps from all starts, fewer where they are long.

        :param final: the barrier parameter at which a start may finish.
        :param raise_if_over: called now and then; if it raises, starts that have not yet stepped
            are left unchanged.
        :return: the number of steps, and of the starts that failed in the worst of them.
        """

    def evaluate_rates(self, rates: Array) -> None:
        """Fill the least means over weights, losing slots silenced, (S,)."""

    def evaluate(self, values: Array, gradients: Array, hessians: Array) -> None:
        """
        Fill the barrier function and its derivatives: for tests.

        :param values: (S,).
        :param gradients: by x and, behind it, the shares but the first, (S, N (3 U + G - 1)).
        :param hessians: lower triangles of the objective's, slot by slot, (S, N, V, V) for
            V = 3 U + G - 1 variables.
        """

    def exchange_places(self, places: Arguments, positions: Array) -> None:
        """Replace the places and the receivers' positions by as many."""

def find_local_minima(discs: Arguments, minima: Array) -> None:
    """
    Find a local minimum of the inverse SINR in each disc, probably the least.

    :param discs: a disc for each slot and eavesdropper, slot by slot: UAVs' `x` and `y` from its
        centre (U, P), `squared_altitudes` (U,), `noise` (P,), `radius` (P,), `jamming` (U - 1, P)
        and, but for free space, a `channel`; see struct Discs of inverse_sinr.hpp.
    :param minima: inverse SINR, x and y, (3, P).
    """

def bound_sectors(discs: Arguments, sectors: Arguments, bounds: Array, values: Array) -> None:
    """
    Bound the inverse SINR in a sector of each disc: for tests.

    :param sectors: `inner`, `outer`, `middle` and `half`, (P,) each; see struct Sector.
    :param bounds: lower bounds, (P,).
    :param values: at a place of the sector, (P,).
    """

def prove_leaks(discs: Arguments, slots: Indices, most: Array, most_sectors: int,
                tolerance: float, leaks: Array, worst: Indices, places: Array) -> None:
    """
    Prove what no place of a slot's discs leaks more than.

    :param slots: of each disc, ascending from 0, (P,).
    :param most: upper bounds of the leaks by a formula, (P,) in bit/s/Hz.
    :param most_sectors: examined in a slot, about; the bound is valid also if they end.
    :param tolerance: of the bounds, in bit/s/Hz.
    :param leaks: upper bounds, (slots,) in bit/s/Hz.
    :param worst: the disc with the largest leak, (slots,).
    :param places: where that is, from its centre, (slots, 2) in m.
    """

class Detours:
    def __init__(self, low: Array, size: Array, lengths: Array) -> None:
        """Make it from the corner and the size of the first of R x R cells, (2,), and lengths."""

class ReachableSet:
    """The geometry of a `bound.proof.reachable_set.ReachableSet`, which has the shapes."""

    def __init__(self, distance: float, from_start: Array, to_goal: Array, corner: Array,
                 low: Array, high: Array, detours: Detours | None) -> None: ...

class Links:
    """The links of a `bound.proof.reachable_set.ReachableSet`, which has the shapes."""

    def __init__(self, altitude: float, log_gain: float, ground: Array, eavesdroppers: Array,
                 radii: Array, log_advantages: Array) -> None: ...

class Terms:
    """The functions of a UAV that `bound.proof.terms.Terms` describes, with their shapes."""

    def __init__(self, region: ReachableSet, links: Links, group: Indices, weight: Array,
                 v: Array, slope: Array, curvature: Array, speed_cost: Array, margin: Array,
                 price: float, powers: tuple[float, float] | None) -> None: ...

    def bound_maxima(self, functions: NDArray[np.intp], bounds: Array, tolerance: Array,
                     budget: float) -> None:
        """
        Bound the maxima of functions of a slot group by branch and bound.

        :param functions: their numbers.
        :param bounds: of all functions; incumbents, which those of `functions` replace.
        :param tolerance: alike.
        :param budget: boxes for each function.
        """

    def bound_box(self, function: int, centre: Array, half: Array) -> tuple[float, float]:
        """Return a function's value at the centre of a box and its bound there: for tests."""

def smooth_maxima(columns: Arguments, values: Array, gradients: Array, hessians: Array) -> None:
    """
    Fill the smoothed maxima over a UAV's columns; see `search.columns.pack_columns`.

    :param values: of all slot groups, (G,).
    :param gradients: by a group's unknowns, (G, F), or empty.
    :param hessians: (G, F, F), or empty.
    """

def evaluate_columns(columns: Arguments, values: Array) -> None:
    """Fill the values of a UAV's columns, (G, C)."""

def minimise_slot_bounds(columns: Sequence[tuple[Array, ...]], listeners: Indices,
                         price: float, peak: float, group: Indices, low: Array, high: Array,
                         weights: Array, v: Array, maxima: Array, bounds: Array) -> None:
    """
    Minimise the bounds of slots on columns over v, nearly; `bound.search.slot_bounds` calls it.

    :param columns: of each UAV: places (G, C, 2), their values without w0 and v (G, C), and their
        factors of w0 (G, C) and of v (G, C, E).
    :param listeners: of the E places of eavesdroppers.
    :param price: of the transmit power.
    :param peak: of the transmit power in W.
    :param group: of every cell of the last UAV, (C',).
    :param low: lower corners of the cells, (C', 2).
    :param high: upper corners of the cells, (C', 2).
    :param weights: w0, (K, C').
    :param v: where the search begins, and what it finds, (K, C', E).
    :param maxima: of the UAVs' columns there, (U, K, C').
    :param bounds: without H(w0), (K, C').
    """
