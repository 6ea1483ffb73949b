"""Hypothesis strategies: missions of all kinds, small enough to solve in a moment."""

from dataclasses import replace

from hypothesis import strategies as st
import numpy as np
from secure_uav_planner import (
    Channel, Eavesdropper, GroundNode, NoFlyZone, Origin, Scenario, Uav)
from secure_uav_planner.errors import ScenarioError
from secure_uav_planner.model.cone_program import minimise_utilisation
from secure_uav_planner.model.problem import Problem
from secure_uav_planner.optimize.initial import constant_powers, fly_hover_fly_positions
from secure_uav_planner.optimize.joint.starts import make_strictly_feasible

COORDINATE = st.floats(-500, 500)
PLACE = st.tuples(COORDINATE, COORDINATE)
SEEDS = st.integers(0, 2**32 - 1)
NAMES = ('base', 'north farm', 'Tower-1', 'Z\u00fcrich', 'tower a', 'tower_a', '7 Elms', 'x' * 90)
"""Names of all kinds, of which some cannot be parts of topics."""
PLACED = {'position': None, 'error_radius': None}
"""Fields of an eavesdropper whose places are those of a track."""


@st.composite
def scenarios(draw, max_uavs=3, max_eavesdroppers=2, max_slots=12):
    """Return feasible missions, some without slack and some with error radius zero."""
    slots = draw(st.integers(1, max_slots))
    duration = draw(st.floats(10, 300))
    slack = draw(st.sampled_from([1.0, 1.01, 1.3, 3.0]))
    uavs = []
    accelerate = draw(st.booleans())
    for index in range(draw(st.integers(1, max_uavs))):
        start, goal = draw(PLACE), draw(PLACE)
        shortest = np.hypot(goal[0] - start[0], goal[1] - start[1]) / (
            duration * (slots + 1) / slots)
        average = draw(st.sampled_from([0.1, 1.0]))
        uav = Uav(
            f'uav{index + 1}', start, goal, draw(st.sampled_from([30.0, 100.0, 300.0])),
            max(1.0, shortest * slack), average, average * draw(st.sampled_from([1.0, 4.0])))
        uavs.append(draw(limit_acceleration(uav, slots, duration / slots)) if accelerate else uav)
    if any(uav.max_acceleration is None for uav in uavs):
        uavs = [replace(uav, max_acceleration=None) for uav in uavs]
    eavesdroppers = [
        Eavesdropper(draw(PLACE), draw(st.sampled_from([0.0, 10.0, 60.0, 400.0])),
                     receiver_advantage_db=draw(st.sampled_from([0.0, 0.0, 10.0, -20.0])))
        for _ in range(draw(st.integers(1, max_eavesdroppers)))]
    return Scenario(draw(PLACE), tuple(eavesdroppers), tuple(uavs), duration, slots,
                    draw(st.sampled_from([60.0, 80.0, 100.0])))


@st.composite
def channels(draw):
    """Return channels of all kinds, each as often as another."""
    rng = np.random.default_rng(draw(SEEDS))
    los = (None, 'suburban', 'urban', 'dense_urban', 'highrise', (
        rng.uniform(1, 60), rng.uniform(0.01, 0.5), rng.uniform(0, 60)))[rng.integers(6)]
    fading = rng.choice([None, rng.uniform(-10, 20)])
    outage = None
    if fading is not None or los is not None and rng.random() < 0.5:
        outage = rng.uniform(0.01, 0.5)
    return Channel(rng.choice([2.0, rng.uniform(2, 6)]), los, rng.random() < 0.5, fading, outage)


@st.composite
def missions(draw, **options):
    """Return missions with channels of all kinds, a third in free space, and half colluding."""
    scenario, channel = draw(scenarios(**options)), draw(channels())
    rng = np.random.default_rng(draw(SEEDS))
    channel = rng.choice([Channel(), channel, channel])
    return replace(scenario, channel=channel, colluding=rng.random() < 0.5,
                   # As strong at 100 m as in free space.
                   reference_snr_db=scenario.reference_snr_db + 20 * (channel.exponent - 2))


@st.composite
def whole_missions(draw):
    """Return missions of up to 20 slots in which any features meet, as far as they fit."""
    scenario = draw(missions(max_slots=20))
    rng = np.random.default_rng(draw(SEEDS))

    def is_drawn(chance):
        return rng.random() < chance

    def place(half=400.0):
        return tuple(rng.uniform(-half, half, 2).tolist())

    def track(*radii):
        times = np.cumsum(rng.uniform(0.1, 0.6, rng.integers(2, 5))) * scenario.duration
        start, velocity = np.array(place()), rng.uniform(-8, 8, 2)
        return tuple((time, *(start + time * velocity).tolist(), *radii)
                     for time in (times - rng.random() * scenario.duration).tolist())

    nodes = tuple(GroundNode(
        *([None] if moves else [place()]), name=str(rng.choice(NAMES[:4])) + str(number)
        if is_drawn(0.7) else 'ground_node', weight=float(rng.choice([1.0, 2.0, 0.3, 1e3])),
        trusted=is_drawn(0.7), track=track() if moves else None)
        for number, moves in enumerate(rng.random(rng.choice([1, 1, 1, 2, 3, 5])) < 0.15))
    eavesdroppers = tuple(
        replace(eve, position=None, error_radius=None, track=track(float(rng.choice([0, 20]))))
        if is_drawn(0.15) else eve for eve in scenario.eavesdroppers)
    names = rng.permutation(NAMES).tolist()
    hovering = 168.5 * scenario.duration  # J
    uavs = tuple(replace(uav, name=name, max_energy=hovering * float(rng.uniform(0.7, 1.5))
                         if uav.max_acceleration and is_drawn(0.7) else None)
                 for name, uav in zip(names, scenario.uavs))
    zones = tuple(NoFlyZone(
        [np.add(corner, centre).tolist() for corner in ((-40, -30), (50, -30), (0, 60))],
        floor=float(rng.choice([0.0, 90.0])), ceiling=float(rng.choice([np.inf, 110.0])),
        name=str(rng.choice(['', *NAMES]))) for centre in map(place, range(rng.integers(1, 5))))
    for chance, fields in (
            (0.8, {'ground_nodes': nodes}),
            (0.5, {'head_starts': rng.uniform(0, 30, len(nodes)).tolist()}),
            (0.7, {'eavesdroppers': eavesdroppers}), (0.5, {'uavs': uavs}),
            (0.3, {'no_fly_zones': zones}),
            (0.2, {'geofence': ((-900, -900), (900, -900), (900, 900), (-900, 900))}),
            (0.3, {'separation': 5.0}), (0.2, {'tracking_margin': 2.0}),
            (0.5, {'origin': Origin(47.4, 8.5, str(rng.choice(['px4', 'ardupilot'])))})):
        if is_drawn(chance):
            try:
                scenario = replace(scenario, **fields)
            except ScenarioError:  # It does not fit what is there.
                continue
    return scenario


@st.composite
def limit_acceleration(draw, uav, slots, step):
    """Return a UAV with a feasible limit of acceleration, or without where none is."""
    share = st.floats(-0.5, 0.5)
    velocity = st.one_of(st.none(), st.just((0.0, 0.0)), st.tuples(share, share).map(
        lambda shares: (shares[0] * uav.max_speed, shares[1] * uav.max_speed)))
    uav = replace(uav, start_velocity=draw(velocity), goal_velocity=draw(velocity),
                  max_acceleration=uav.max_speed / step * draw(st.sampled_from([0.1, 0.5, 3.0])))
    while minimise_utilisation(uav.vehicle, slots, step)[0] > 1:
        if uav.max_acceleration > 100 * uav.max_speed / step:
            return replace(uav, max_acceleration=None)
        uav = replace(uav, max_acceleration=2 * uav.max_acceleration)
    return uav


def with_uavs(scenario, **fields):
    """Return a scenario with the same fields for all UAVs."""
    return replace(scenario, uavs=tuple(replace(uav, **fields) for uav in scenario.uavs))


def with_eavesdroppers(scenario, **fields):
    """Return a scenario with the same fields for all eavesdroppers."""
    return replace(scenario, eavesdroppers=tuple(
        replace(eve, **fields) for eve in scenario.eavesdroppers))


def random_powers(scenario, rng):
    """Return feasible powers, some of them zero, (U, N) in W."""
    peaks = np.array([[uav.peak_power] for uav in scenario.uavs])
    averages = np.array([[uav.average_power] for uav in scenario.uavs])
    powers = rng.uniform(0, 1, (len(scenario.uavs), scenario.slots)) * peaks
    powers *= rng.random(powers.shape) > 0.2
    return powers * np.minimum(1, averages / np.maximum(powers.mean(axis=1, keepdims=True), 1e-9))


def random_flight(scenario, rng):
    """Return infeasible positions (U, N+2, 2) and feasible powers."""
    positions = rng.uniform(-400, 400, (len(scenario.uavs), scenario.slots + 2, 2))
    return positions, random_powers(scenario, rng)


def rotate_map(scenario, angle, shift):
    """Return a scenario on a rotated and shifted map, and the function that moves its places."""
    rotation = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])

    def move(places):
        return np.asarray(places) @ rotation.T + shift

    return replace(
        scenario, ground_node=move(scenario.ground_node),
        eavesdroppers=tuple(replace(eve, position=move(eve.position))
                            for eve in scenario.eavesdroppers),
        uavs=tuple(replace(uav, start=move(uav.start), goal=move(uav.goal),
                           max_speed=uav.max_speed * (1 + 1e-9), max_acceleration=None)
                   for uav in scenario.uavs)), move


def make_crowd(uavs, eavesdroppers, slots):
    """Return a random scenario with these numbers of UAVs, eavesdroppers and slots."""
    rng = np.random.default_rng(0)
    return Scenario(
        (0.0, 0.0), tuple(Eavesdropper(tuple(place), 30.0)
                          for place in rng.uniform(-400, 400, (eavesdroppers, 2))),
        tuple(Uav(f'uav{number}', tuple(start), tuple(goal), 100.0 + number, 12.0)
              for number, (start, goal) in enumerate(rng.uniform(-500, 500, (uavs, 2, 2)))),
        400.0, slots)


def random_sectors(rng, radius):
    """Return sectors of discs of a radius (S,): both distances, the middle and half the angle."""
    count = len(radius)
    inner = radius * rng.random(count)
    outer = inner + (radius - inner) * 10**rng.uniform(-6, 0, count)
    half = 0.5 * np.pi * 10**rng.uniform(-6, 0, count)
    return inner, outer, rng.uniform(-np.pi, np.pi, count), half


def with_tracks(scenario, rng):
    """Return a mission whose receivers move, before, in and after its flight."""
    size = np.ptp(scenario.landmarks, axis=0).max() + 10

    def knots(place, *radius):
        times = np.sort(rng.uniform(-0.3, 1.3, rng.integers(2, 6))) * scenario.duration
        times += np.arange(len(times)) * max(1.0, 0.01 * size)
        return tuple((time, *(place + rng.normal(0, 0.3 * size, 2)), *(
            value * rng.uniform(0, 2) for value in radius)) for time in times.tolist())

    return replace(
        scenario, ground_node=None, ground_node_track=knots(np.array(scenario.ground_node)),
        eavesdroppers=tuple(
            replace(eve, **PLACED, track=knots(np.array(eve.position), eve.error_radius))
            for eve in scenario.eavesdroppers))


def find_interior(scenario, slots=None, share=0.2):
    """Return a grid and strictly feasible variables on it, (N, U, 3)."""
    problem = Problem(scenario)
    grid = problem.grid.with_slots(slots or scenario.slots)
    return grid, make_strictly_feasible(
        grid, fly_hover_fly_positions(problem), 0.7 * constant_powers(scenario), share)
