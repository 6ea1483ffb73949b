"""The variables of the optimisation: units that keep numbers moderate, on a grid of slots."""

from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from .airspace import Airspace
from .channel import find_rate_scale
from .channel.links import FreeSpace, make_links
from .channel.rates import compute_sinr
from .cone_program import LeastFlights
from .curve import add_end_moves, evaluate_spline
from ..mission.scenario import Array, read_only, Scenario

_LONGEST_STEP = 0.25  # Largest characteristic step length as a share of a mission's extent.
_NO_SLACK = 1e-7  # Share of its limits below which a flight is fixed.


@dataclass(frozen=True, eq=False)
class Grid:
    """
    A scenario's flight divided into slots, and the variables of the optimisation in grid units.

    Variables are (power, x, y) of every UAV in every slot, x (..., N, U, 3): powers in units of
    the UAV's average power, positions in units of `length` around the ground node. A path has
    positions in these units with start and goal, point by point, (N+2, U, 2).

    :param airspace: Airspace of the scenario, whose duration does not depend on the grid.
    :param slots: N on this grid.
    :param is_fixed: whether only the powers are variables.
    :param least_flights: flights of least utilisation, a cache that all grids of a flight share.
    """

    airspace: Airspace
    slots: int
    is_fixed: bool = False
    least_flights: LeastFlights = field(default_factory=LeastFlights)

    @property
    def scenario(self) -> Scenario:
        """Scenario of the flight."""
        return self.airspace.scenario

    @cached_property
    def fixed(self) -> NDArray[np.bool_]:
        """Whether each UAV's path is no variable, (U,): it has no time to spare, or is_fixed."""
        return self.is_fixed | (
            self.least_flights.find_utilisations(self.scenario) > 1 - _NO_SLACK)

    @cached_property
    def reference_flight(self) -> Array:
        """Flights of least utilisation, (U, N+2, 2) in m; read-only."""
        scenario = self.scenario
        flights = np.stack([
            uav.start + self.least_flights.find(uav.vehicle, self.slots, self.slot_duration)[1]
            for uav in scenario.uavs])
        flights[:, -1] = scenario.goals
        return read_only(flights)

    def with_slots(self, slots: int) -> 'Grid':
        """Return the grid of the same flight with another number of slots."""
        return replace(self, slots=slots)

    @cached_property
    def length(self) -> float:
        """Length that is the unit, the geometric mean of the altitudes, in m."""
        return float(np.exp(np.log(self.scenario.altitudes).mean()))

    @property
    def power(self) -> Array:
        """Power that is the unit of every UAV, its average power, (U,) in W."""
        return self.scenario.average_powers

    @cached_property
    def rate(self) -> float:
        """Rate that is the unit, in nats; see find_rate_scale."""
        return find_rate_scale(self.scenario)

    @cached_property
    def weight(self) -> float:
        """Weight that is the unit of the ground nodes' weights, their median."""
        return float(np.median(self.scenario.node_weights))

    @cached_property
    def origin(self) -> Array:
        """Position of the first ground node, (2,) in m."""
        return np.array(self.scenario.ground_nodes[0].position)

    @cached_property
    def starts(self) -> Array:
        """Where the UAVs start, (U, 2) in units of `length` from `origin`."""
        return (self.scenario.starts - self.origin) / self.length

    @cached_property
    def goals(self) -> Array:
        """Where the UAVs end, (U, 2) in units of `length` from `origin`."""
        return (self.scenario.goals - self.origin) / self.length

    @cached_property
    def slot_duration(self) -> float:
        """Length of a slot of this grid in s: the flight has one move more than slots."""
        scenario = self.scenario
        return scenario.slot_duration * (scenario.slots + 1) / (self.slots + 1)

    @cached_property
    def times(self) -> Array:
        """Time of each of the points 1 to N from point 0, (N,) in s."""
        return np.arange(1.0, self.slots + 1) * self.slot_duration

    @cached_property
    def step_lengths(self) -> Array:
        """Distances at full speed in a slot, at most _LONGEST_STEP * extent, (U,) in m."""
        scenario = self.scenario
        # Diagonal of the box that contains the landmarks and has the largest altitude.
        extent = np.linalg.norm([*np.ptp(scenario.landmarks, axis=0), scenario.altitudes.max()])
        return np.minimum(scenario.max_speeds * self.slot_duration, _LONGEST_STEP * extent)

    def variables(self, positions: Array, powers: Array) -> Array:
        """Return x (..., N, U, 3) of positions (..., U, N, 2) in m and powers (..., U, N) in W."""
        scaled = np.concatenate([(powers / self.power[:, None])[..., None],
                                 (positions - self.origin) / self.length], axis=-1)
        return np.swapaxes(scaled, -3, -2)

    def powers(self, x: Array) -> Array:
        """Return the powers of x in W, (..., U, N)."""
        return np.swapaxes(x[..., 0], -1, -2) * self.power[:, None]

    def positions(self, x: Array) -> Array:
        """Return the positions of x (N, U, 3) with start and goal, (U, N+2, 2) in m."""
        return self.to_positions(self.path(x))

    def path(self, x: Array) -> Array:
        """Return starts, points of x (N, U, 3) and goals, (N+2, U, 2) in units of `length`."""
        return np.concatenate([self.starts[None], x[..., 1:], self.goals[None]])

    def to_path(self, positions: Array) -> Array:
        """Return positions (U, N+2, 2) in m as a path (N+2, U, 2) in units of `length`."""
        return (np.swapaxes(positions, 0, 1) - self.origin) / self.length

    def to_positions(self, path: Array) -> Array:
        """Return a path (N+2, U, 2) as positions (U, N+2, 2) in m, with exact starts and goals."""
        positions: Array = np.swapaxes(path, 0, 1) * self.length + self.origin
        positions[:, 0], positions[:, -1] = self.scenario.starts, self.scenario.goals
        return positions

    def refine(self, x: Array, slots: int) -> Array:
        """Return x (N, U, 3) interpolated to another number of slots; mean powers do not rise."""
        path = self.refine_path(self.path(x), slots)
        power = resample(x[..., 0], slots, inner=True)
        power *= np.minimum(1, x[..., 0].mean(axis=0) / power.mean(axis=0))
        return np.concatenate([power[..., None], path[1:-1]], axis=-1)

    def refine_path(self, path: Array, slots: int) -> Array:
        """
        Return a path (N+2, U, 2) of this grid interpolated to another number of slots.

        Without a limit of acceleration the largest speed does not rise. With one, the new points
        follow the flown curve, and the largest speed and acceleration rise little.
        """
        if not self.scenario.limits_acceleration:
            return resample(path, slots + 2)
        points = np.swapaxes(path, 0, 1)
        moves = add_end_moves(np.diff(points, axis=1), (
            self.scenario.end_velocities * self.slot_duration / self.length))
        return np.swapaxes(resample_curve(points, moves, slots + 2), 0, 1)


def resample_curve(points: Array, moves: Array, count: int) -> Array:
    """
    Return the control points (U, count, 2) of nearly the same B-spline with other slots.

    A B-spline begins half a slot before its first control point and ends half a slot after its
    last one. Time is warped so that both B-splines begin together and end together; the velocities
    at both ends are kept. Times here are in slots of the given B-spline, `slot` is a new slot.

    :param points: control points of the given B-spline, (U, M, 2).
    :param moves: differences of the points with both ends, (U, M+1, 2), see add_end_moves.
    """
    last, first_move, last_move = points.shape[1] - 1, moves[:, :1], moves[:, -1:]
    slot = last / (count - 1)
    times: Array = np.arange(float(count)) * slot
    warped: Array = (times + slot / 2) * (last + 1) / (last + slot) - 0.5
    share = (times / last)[:, None]
    # Distance by which the warped time lags behind, at velocities from the first to the last move.
    drift = (times - warped)[:, None] * ((1 - share) * first_move + share * last_move)
    velocities = [evaluate_spline(points, moves, np.clip(warped + by, -0.5, last + 0.5))[1]
                  for by in (-slot / 2, slot / 2)]
    inside = np.clip(warped, -0.5, last + 0.5)
    position, velocity, _ = evaluate_spline(points, moves, inside)
    # Beyond its ends the curve is extended along the tangent. A control point is the curve's
    # position minus 1/8 of the second difference, which is slot * (change of velocity).
    controls = (position + (warped - inside)[:, None] * velocity + drift
                - slot / 8 * (velocities[1] - velocities[0]))
    controls[:, [0, -1]] = points[:, [0, -1]]
    return controls


def resample(values: Array, count: int, inner: bool = False) -> Array:
    """
    Return values (M, ...) at equidistant points of a flight interpolated linearly, (count, ...).

    :param inner: True for values of slots, which lie between start and goal. Before the first and
        after the last given slot the value is constant. False for values from start to goal.
    """
    if count == len(values):
        return values.copy()
    last, more = len(values) - 1, int(inner)
    # Index, with a fraction, of each new point among the given points.
    place = np.clip(np.arange(more, count + more) * (
        (last + 2 * more) / max(1, count - 1 + 2 * more)) - more, 0, last)
    before = place.astype(np.intp)
    share = (place - before).reshape(-1, *[1] * (values.ndim - 1))
    lower = values[before]
    return lower + share * (values[np.minimum(before + 1, last)] - lower)


def resample_flights(positions: Array, slots: int) -> Array:
    """Return positions (U, M+2, 2) of M slots interpolated linearly to N slots, (U, N+2, 2)."""
    return np.swapaxes(resample(np.swapaxes(positions, 0, 1), slots + 2), 0, 1)


@dataclass(frozen=True, eq=False)
class Receivers:
    """
    Receivers in units of a Grid: G ground nodes, E eavesdroppers and L listening nodes.

    An untrusted ground node listens to what other nodes are sent. It appears twice: K = G + E + L.

    :param positions: positions at the points of the slots, (N, K, 2).
    :param radii: epsilon, (N, K). The guarantee adds it to the distance of a jammer, and subtracts
        it from the distance of the transmitter.
    :param link: links from the UAVs, for arrays (..., K, U).
    :param weights: weights of the ground nodes, (G,). In units of Grid.weight, so that a common
        factor of the weights changes no plan.
    :param offsets: head starts of the nodes' mean rates, (G,) in nats.
    :param listeners: indices of the listening nodes among the ground nodes, (L,).
    """

    positions: Array
    radii: Array
    link: FreeSpace
    weights: Array
    offsets: Array
    listeners: tuple[int, ...]

    @classmethod
    def of(cls, grid: Grid, elevation_offset: float = 0.0) -> 'Receivers':
        """Return the receivers of a grid's scenario; make_links explains elevation_offset."""
        grounds, centres, radii = grid.scenario.receivers_at(grid.times)
        listeners = grid.scenario.listeners
        listening = grounds[list(listeners)]
        positions = np.concatenate([grounds, centres, listening]).swapaxes(0, 1) - grid.origin
        radii = np.concatenate(
            [np.zeros(grounds.shape[:2]), radii, np.zeros(listening.shape[:2])]).T
        link = make_links(grid.scenario, grid.length, grid.power, elevation_offset)
        return cls(positions / grid.length, radii / grid.length, link,
                   grid.scenario.node_weights / grid.weight,
                   np.log(2) * grid.scenario.node_offsets, listeners)

    def at_places(self, places: Array) -> 'Receivers':
        """Return receivers with P points (N, E P, 2) in place of each disc; all radii are 0."""
        nodes, listeners = len(self.weights), len(self.listeners)
        eves = self.radii.shape[1] - nodes - listeners
        copies = np.repeat(np.arange(self.radii.shape[1]), [
            *[1] * nodes, *[places.shape[1] // eves] * eves, *[1] * listeners])
        positions = np.concatenate([
            self.positions[:, :nodes], places, self.positions[:, nodes + eves:]], axis=1)
        return replace(self, positions=positions, radii=np.zeros(positions.shape[:2]),
                       link=self.link.select_receivers(copies))

    def rates(self, x: Array) -> tuple[Array, Array, Array]:
        """
        Return rates [nats] of nodes (N, G), eavesdroppers (N, E) and listeners (N, L) at x.

        Radii are ignored: an eavesdropper listens at its position. UAV 0 transmits to all nodes.

        :param x: power, x and y of each UAV in each slot in units of the Grid, (N, U, 3).
        """
        offset = x[:, None, :, 1:] - self.positions[:, :, None]
        received = self.link.gain(offset[..., 0]**2 + offset[..., 1]**2) * x[:, None, :, 0]
        rates = np.log1p(compute_sinr(np.moveaxis(received, -1, 0)))
        grounds, leaks, heard = np.split(
            rates, [len(self.weights), rates.shape[1] - len(self.listeners)], axis=1)
        return grounds, leaks, heard
