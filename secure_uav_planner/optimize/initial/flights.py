"""Flights to hovering places and on to the goals, also around obstacles."""

from collections.abc import Callable, Iterator
from dataclasses import replace
from itertools import combinations, islice, pairwise, permutations, product
import math

import numpy as np

from ..deadline import DeadlineCheck
from ...mission.scenario import Array, Scenario, Uav
from ...model.airspace.routes import MOST_ROUTES, VisibilityGraph
from ...model.problem import Problem

_TURNS = 25  # Number of places on the way out at which a UAV may turn back.
_ALL_ORDERS = 3  # Largest number of ground nodes that are visited in all orders.
_LESS = 1e-9  # Relative rounding error of a length.
_HALVINGS = 12  # Number of bisections of the distance at which a UAV in a hurry passes its stops.


def list_hovering_places(scenario: Scenario) -> Array:
    """
    Return the hovering places of fly-hover-fly, (U, 2) in m, or (G, U, 2) for G > 1 ground nodes.

    The transmitter hovers above the ground nodes in the order of the shortest way, the jammers
    above the eavesdroppers in turn. Receivers that move are taken where they are at half time.
    """
    grounds, eves, _ = scenario.receivers_at([scenario.duration / 2])
    jammers = np.arange(len(scenario.uavs) - 1)
    places = np.stack([np.concatenate([ground, eves[jammers % len(eves), 0]])
                       for ground in grounds[list_orders(scenario, grounds[:, 0])[0]]])
    return places if len(places) > 1 else places[0]


def list_orders(scenario: Scenario, nodes: Array) -> list[list[int]]:
    """
    Return orders in which to visit ground nodes (G, 2) in m, the shortest way first.

    Up to three nodes have all orders. More nodes have four: nearest neighbour, its reverse, and
    both improved by 2-opt: parts are reversed as long as the way from start to goal gets shorter.
    """
    uav, count = scenario.uavs[0], len(nodes)

    def measure(order: list[int]) -> float:
        return _measure_length(np.stack([uav.start, *nodes[order], uav.goal]))

    if count <= _ALL_ORDERS:
        orders = [list(order) for order in permutations(range(count))]
    else:
        nearest: list[int] = []
        place = np.array(uav.start)
        while len(nearest) < count:
            left = [node for node in range(count) if node not in nearest]
            nearest.append(min(left, key=lambda node: math.dist(nodes[node], place)))
            place = nodes[nearest[-1]]
        orders = [nearest, nearest[::-1]]
        orders += [_exchange_parts(order, measure) for order in orders]
    return sorted(orders, key=measure)


def _exchange_parts(order: list[int], measure: Callable[[list[int]], float]) -> list[int]:
    """Return an order improved by 2-opt: parts are reversed as long as the measure falls."""
    while True:
        better = min((order[:i] + order[i:j][::-1] + order[j:]
                      for i, j in combinations(range(len(order) + 1), 2)), key=measure)
        if measure(better) >= measure(order) * (1 - _LESS):
            return order
        order = better


def build_flights(problem: Problem, hover: Array,
                  routes: tuple[tuple[int, int], ...] | None = None,
                  raise_if_over: DeadlineCheck = lambda: None) -> Array:
    """
    Return fly-hover-fly flights to hovering places.

    They may break the limits where a zone, a fence or another UAV is in the way.

    :param hover: hovering places, (U, 2) in m, or (H, U, 2) for several after each other.
    :param routes: indices of each UAV's routes out and back; by default 0, the shortest.
    :return: positions, (U, N+2, 2) in m.
    """
    scenario = problem.scenario
    positions = np.empty((len(scenario.uavs), scenario.slots + 2, 2))
    for number, uav in enumerate(scenario.uavs):
        raise_if_over()
        stops = hover[..., number, :].reshape(-1, 2)
        if len(stops) > 1 and np.ptp(stops, axis=0).any():
            positions[number] = _fly_over(problem, number, stops)
            continue
        place = stops[0]
        around = fly_around(problem, number, place, *(routes[number] if routes else ()))
        positions[number] = _fly_hover_fly(problem, uav, place) if around is None else around
    for limit in problem.limits:
        positions = limit.shape_start(positions)
    if scenario.limits_acceleration and problem.airspace.is_open:
        positions = problem.retract(positions)
    return positions


def fly_around(problem: Problem, index: int, place: Array, out: int = 0,
               back: int = 0) -> Array | None:
    """
    Return the flight of a UAV to a hovering place and on to its goal around obstacles.

    It may cut corners and need too much acceleration, which the projection corrects. A UAV
    without the time to reach its place turns back on the way, or flies by fly_direct.

    :param index: index of the UAV.
    :param out: index of the route to the place, 0 for the shortest.
    :param back: index of the route from the place to the goal, 0 for the shortest.
    :return: (N+2, 2) in m, or None without such routes or without obstacles.
    """
    scenario = problem.scenario
    uav, step = scenario.uavs[index], float(scenario.max_step[index])
    goal = np.array(uav.goal)
    graph, routes = problem.find_routes(index, (np.array(uav.start), place, goal),
                                        1 + max(out, back))
    if graph is None or len(routes[0]) <= out or len(routes[1]) <= back:
        return None
    legs = routes[0][out], routes[1][back]
    count = scenario.slots + 1
    # Slots that a leg takes longer because of the acceleration to full speed and back.
    lag = uav.max_speed / uav.vehicle.max_acceleration / scenario.slot_duration
    reach = (count - 2 * lag) * step
    if _measure_length(legs[0]) + _measure_length(legs[1]) > reach:
        shorter = _turn_back(graph, legs[0], goal, reach)
        if shorter is None:
            return fly_direct(problem, index, out)
        legs = shorter
    outward, homeward = map(_measure_length, legs)
    slot_times = np.arange(count + 1.0)
    covered = np.clip((slot_times - lag / 2) * step, 0, outward)
    left = np.clip((count - slot_times - lag / 2) * step, 0, homeward)
    return np.where((left < homeward)[:, None], _locate(legs[1], homeward - left),
                    _locate(legs[0], covered))


def fly_direct(problem: Problem, index: int, route: int = 0) -> Array | None:
    """
    Return the flight of least utilisation of a UAV from start to goal, (N+2, 2) in m.

    :param index: index of the UAV.
    :param route: index of the route around obstacles, 0 for the shortest. It is flown from rest to
        rest as if it were straight.
    :return: None without such a route. Without obstacles only route 0 exists.
    """
    scenario = problem.scenario
    uav = scenario.uavs[index]
    graph, [routes] = problem.find_routes(
        index, (np.array(uav.start), np.array(uav.goal)), 1 + route)
    if graph is None:
        return uav.start + problem.grid.least_flights.find(
            uav.vehicle, scenario.slots, scenario.slot_duration)[1] if route == 0 else None
    if len(routes) <= route:
        return None
    length = _measure_length(routes[route])
    vehicle = replace(uav.vehicle, displacement=(length, 0.0), start_velocity=(0.0, 0.0),
                      goal_velocity=(0.0, 0.0))
    return _locate(routes[route], vehicle.fly_straight(
        scenario.slots, scenario.slot_duration)[:, 0])


def _fly_over(problem: Problem, index: int, stops: Array) -> Array:
    """
    Return the flight of a UAV that hovers equally long at H stops, (N+2, 2) in m.

    If there is no time to reach all stops, each moves towards its place on the straight flight by
    the same share. If even this takes too long, the flight is fly_direct's or a straight line.
    With a limit of acceleration, points are averages over the slots of acceleration to full speed.

    :param stops: places to hover at in order, (H, 2) in m.
    """
    scenario = problem.scenario
    uav, step = scenario.uavs[index], float(scenario.max_step[index])
    start, goal = np.array(uav.start), np.array(uav.goal)
    width = math.ceil(uav.max_speed / uav.vehicle.max_acceleration / scenario.slot_duration)
    moves = scenario.slots + 1 - width  # Moves of the path before averaging, at full speed or 0.
    between = start + np.linspace(0, 1, len(stops) + 2)[1:-1, None] * (goal - start)

    def find_legs(share: float) -> list[Array]:  # Routes (K, 2) to the moved stops and the goal.
        places = [start, *(between + share * (stops - between)), goal]
        graph, routes = problem.find_routes(index, places, 1)
        return [leg for leg, *_ in routes] if graph is not None and all(routes) else [
            np.stack(pair) for pair in pairwise(places)]

    # Bisection for the largest share of the offsets to the stops that the time allows.
    possible, impossible = 0.0, 1.0
    for share in (1.0, *[None] * _HALVINGS):
        share = (possible + impossible) / 2 if share is None else share
        fits = sum(map(_measure_length, find_legs(share))) <= moves * step
        possible, impossible = (share, impossible) if fits else (possible, share)
    legs = find_legs(possible)
    lengths = np.array([_measure_length(leg) for leg in legs])
    if lengths.sum() > moves * step:
        direct = fly_direct(problem, index)
        return np.linspace(start, goal, scenario.slots + 2) if direct is None else direct
    wait = (moves - lengths.sum() / step) / len(stops)
    # Times [slots] and travelled distances [m] of arrivals at and departures from stops.
    arrivals = np.cumsum(lengths[:-1]) / step + wait * np.arange(len(stops))
    times = np.concatenate([[0.0], np.stack([arrivals, arrivals + wait], -1).ravel(), [moves]])
    covered = np.concatenate([[0.0], np.repeat(np.cumsum(lengths)[:-1], 2), [lengths.sum()]])
    slot_times = np.arange(-float(width), moves + width + 1)
    points = _locate(np.concatenate(legs), np.interp(slot_times, times, covered))
    sums = np.cumsum(np.pad(points, ((1, 0), (0, 0))), axis=0)
    points = (sums[width + 1:] - sums[:-width - 1]) / (width + 1)
    points[0], points[-1] = start, goal
    return points


def generate_direct_flights(problem: Problem, raise_if_over: DeadlineCheck) -> Iterator[Array]:
    """Yield flights (U, N+2, 2) in m of all UAVs by fly_direct, for combinations of routes."""
    choices = []
    for index in range(len(problem.scenario.uavs)):
        raise_if_over()
        flights = (fly_direct(problem, index, route) for route in range(MOST_ROUTES))
        choices.append([flight for flight in flights if flight is not None])
    # More than three UAVs have too many combinations: only the shortest routes are tried.
    for chosen in islice(product(*choices), None if len(choices) <= 3 else 1):
        yield np.stack(chosen)


def _turn_back(graph: VisibilityGraph, out: Array, goal: Array,
               reach: float) -> tuple[Array, Array] | None:
    """
    Return the longest beginning of a route from whose end the goal is in reach, and the way back.

    :param out: a route, (K, 2) in m, from whose end the goal is out of reach.
    :param reach: largest length of both parts together [m].
    :return: the beginning and the route from its end to the goal, (K', 2) each in m; None if the
        goal is in reach from none of _TURNS places along the route, the start apart.
    """
    covered = np.linspace(0, _measure_length(out), _TURNS)
    places = _locate(out, covered)
    late = covered + graph.measure_distances(places, goal) > reach
    last = int(late.argmax()) - 1
    if last < 1:
        return None
    back = graph.find_routes(places[last], goal, 1)
    if not back:
        return None
    kept = out[:-1][_measure_corners(out)[:-1] < covered[last]]
    return np.concatenate([kept, places[[last]]]), back[0]


def _measure_corners(route: Array) -> Array:
    """Return the distances of the corners of a route along it, (K,) in m."""
    return np.append(0.0, np.cumsum(np.linalg.norm(np.diff(route, axis=0), axis=1)))


def _measure_length(route: Array) -> float:
    """Return the length of a route [m]."""
    return float(np.linalg.norm(np.diff(route, axis=0), axis=1).sum())


def _locate(route: Array, covered: Array) -> Array:
    """Return the places at distances (M,) in m along a route, (M, 2)."""
    corners = _measure_corners(route)
    return np.stack([np.interp(covered, corners, column) for column in route.T], axis=-1)


def _fly_straight(start: Array, goal: Array, place: Array, step: float, slots: int) -> Array:
    """
    Return points (N+2, 2) of a flight to a place, of a hover there and of a flight to the goal.

    Both flights are straight and at full speed, without a limit of acceleration. A UAV without the
    time to reach the place turns to the goal earlier, and does not hover.
    """
    turn = _find_turning_place(start, goal, place, (slots + 1) * step)
    points = np.empty((slots + 2, 2))
    points[:] = start + (turn - start)  # Rounded like the points of the leg from the start.
    # Distances of points from the start; reversed points have the same distances from the goal.
    covered = np.arange(slots + 2.0) * step
    for end, leg in ((start, points), (goal, points[::-1])):
        length = math.dist(end, turn)
        moving = np.searchsorted(covered, length)
        if moving:
            leg[:moving] = end + (covered[:moving] / length)[:, None] * (turn - end)
    return points


def _fly_hover_fly(problem: Problem, uav: Uav, place: Array) -> Array:
    """
    Return the points of a UAV that flies straight to its hovering place and on, (N+2, 2) in m.

    With a limit of acceleration, moves are moving averages over as many slots as the acceleration
    to full speed takes. Where a UAV turns without hovering, Problem.retract must correct them. If
    there is no time for averages, the flight of least utilisation is returned.
    """
    slots, duration = problem.scenario.slots, problem.scenario.slot_duration
    start, goal = np.array(uav.start), np.array(uav.goal)
    step = uav.max_speed * duration
    if uav.max_acceleration is None:
        return _fly_straight(start, goal, place, step, slots)
    width = math.ceil(uav.max_speed / (uav.vehicle.max_acceleration * duration))
    # Moves [m] at the end velocities, with which the flight in between is averaged.
    first, last = (np.array(velocity or (0.0, 0.0)) * duration
                   for velocity in (uav.start_velocity, uav.goal_velocity))
    begin, end = start + first * (width - 1) / 2, goal - last * (width - 1) / 2
    if width > slots or math.dist(begin, end) > (slots + 2 - width) * step:
        return start + problem.grid.least_flights.find(uav.vehicle, slots, duration)[1]
    moves = np.concatenate([
        np.tile(first, (width - 1, 1)),
        np.diff(_fly_straight(begin, end, place, step, slots + 1 - width), axis=0),
        np.tile(last, (width - 1, 1))])
    sums = np.concatenate([np.zeros((1, 2)), np.cumsum(moves, axis=0)])
    means = (sums[width:] - sums[:-width]) / width
    points = start + np.concatenate([np.zeros((1, 2)), np.cumsum(means, axis=0)])
    return points + np.linspace(0, 1, slots + 2)[:, None] * (goal - points[-1])


def _find_turning_place(start: Array, goal: Array, place: Array, reach: float) -> Array:
    """Return the last place from start to `place` by which a way to goal is <= reach [m] long."""
    outward = math.dist(start, place)
    if outward + math.dist(place, goal) <= reach:
        return place
    # |start + s u - goal| = reach - s with u = direction, solved for the s at which to turn.
    direction = (place - start) / outward if outward > 0 else np.zeros(2)
    back = start - goal
    denominator = 2 * (reach + float(back @ direction))
    slack = max(0.0, reach**2 - float(back @ back))
    # Without slack, a UAV that flies straight to the goal may turn anywhere on its way.
    along = min(outward, reach, slack / denominator if denominator > 1e-12 * reach else reach)
    return start + along * direction
