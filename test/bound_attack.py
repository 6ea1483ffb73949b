"""Attacks on the bound: feasible plans, and places and powers in every slot."""

from dataclasses import replace
import math

from benchmarks.missions import random_mission
import numpy as np
from random_cities import random_city_mission
from secure_uav_planner import Channel, Eavesdropper, fly_hover_fly, Plan, solve, upper_bound
from secure_uav_planner.bound.proof.certificate import certify
from secure_uav_planner.bound.proof.detours import DetourSearch
from secure_uav_planner.bound.proof.reachable_set import Team
from secure_uav_planner.bound.proof.relaxation import EavesdropperSubset
from secure_uav_planner.bound.search.multipliers import build_multipliers, MultiplierSearch
from secure_uav_planner.errors import PlanningError
from secure_uav_planner.mission import OBJECTIVES
from secure_uav_planner.model.airspace import Airspace
from secure_uav_planner.model.problem import Problem


def certify_plan(plan, most=400, curved=False):
    """Return the team and the certificate of a plan's scenario, for the plan's objective."""
    team = Team.of(plan.scenario, EavesdropperSubset.of(plan.scenario, plan.objective),
                   DetourSearch(Airspace(plan.scenario)).detours, most)
    search = MultiplierSearch(team, plan.positions, plan.powers)
    for tau in (0.3, 0.1, 0.03, 0.01):
        search.minimise(tau, 6)
    if curved:
        search.add_quadratic_part()
        search.minimise(0.01, 12)
    return team, certify(team, build_multipliers(search))


def slot_groups(groups):
    """Return the group of every slot, (N,)."""
    return np.repeat(np.arange(len(groups.count)), groups.count)


def slot_rates(team, places, powers):
    """
    Return R-bar in nats by the plain formula.

    :param places: in every UAV's frame, (U, K, 2).
    :param powers: (U, K).
    """
    ground, leaks = [], []
    for region, place, power in zip(team.regions, places, powers):
        gain = np.exp(region.log_gain)
        distance = np.linalg.norm(place[:, None] - region.eavesdroppers, axis=-1)
        distance = (np.maximum(distance - region.radii, 0) if region.transmits
                    else distance + region.radii)
        square = region.altitude**2
        ground.append(power * gain / (((place - region.ground)**2).sum(-1) + square))
        leaks.append(power[:, None] * gain * np.exp(region.log_advantages) / (
            distance**2 + square))
    sinr = leaks[0] / (1 + sum(leaks[1:], 0 * leaks[0]))
    leak = np.log1p(sum(sinr[:, places].max(-1) for places in team.adversaries))
    return np.log1p(ground[0] / (1 + sum(ground[1:], 0 * ground[0]))) - leak


def lagrangian(team, certificate, group, places, powers):
    """Return the Lagrangian that B of a group bounds, at K places and powers."""
    value = slot_rates(team, places, powers) - certificate.prices @ powers
    for potential, place in zip(certificate.potentials, places):
        slope, curvature = (part[group] for part in potential.change)
        x, y = place.T
        value = value + place @ slope + curvature @ np.array([x * x / 2, x * y, y * y / 2])
        for share, edge, move_slopes in zip(
                team.groups.means, (group, group + 1), potential.move_slopes):
            u, (a, b, c) = move_slopes[group], potential.curvature[edge]
            speed_cost = np.hypot(u[0] + a * x + b * y, u[1] + b * x + c * y)
            largest = np.linalg.eigvalsh([[a, b], [b, c]])[1]
            step = potential.region.steps[group]
            value = value + share[group] * (
                step * speed_cost + step**2 / 2 * max(0.0, largest)
                + potential.region.max_move_change * np.hypot(*potential.acceleration[edge]))
    return value


def climb(team, certificate, group, starts, rng, count, rounds=60):
    """
    Return the largest Lagrangian that points climbing in a group reach.

    :param starts: place (2,) and power of every UAV, where a third of the points begin.
    """
    regions = team.regions
    index = np.full(count, group)
    places, powers = [], []
    for i, region in enumerate(regions):
        low, high = (corner[group] for corner in region.bounding_box)
        tried = rng.uniform(low, high, (40 * count, 2))
        good = tried[region.contains(tried, np.full(len(tried), group))][:count]
        middle = region.find_farthest(np.array([[[1.0, 0.0]]]))[group]
        good = np.concatenate([good, np.repeat(middle, count, 0)])[:count]
        good[:count // 3] = starts[0][i]
        places.append(good)
        power = region.peak * np.exp(rng.uniform(-9, 0, count))
        power[rng.random(count) < 0.1] = 0.0
        power[:count // 3] = starts[1][i]
        powers.append(power)
    powers = np.array(powers)
    best = lagrangian(team, certificate, group, places, powers)
    size = np.exp(rng.uniform(-7, 0, count))
    for _ in range(rounds):
        moves = [size[:, None] * np.subtract(*region.bounding_box)[group].min()
                 * rng.normal(0, 0.5, (count, 2)) for region in regions]
        moved = [np.where(region.contains(place + move, index)[:, None], place + move, place)
                 for region, place, move in zip(regions, places, moves)]
        watts = np.clip(powers * np.exp(size * rng.normal(0, 2, powers.shape)), 0.0,
                        [[region.peak] for region in regions])
        value = lagrangian(team, certificate, group, moved, watts)
        better = value > best
        places = [np.where(better[:, None], new, old) for new, old in zip(moved, places)]
        powers = np.where(better, watts, powers)
        best = np.where(better, value, best)
        size = np.where(better, size * 1.5, size * 0.8).clip(1e-7, 1)
    return best.max()


def largest_excess(plan, most=400, curved=False, count=60):
    """Return the largest excess of climbing points over their group's bound."""
    team, proof = certify_plan(plan, most, curved)
    rng, excess = np.random.default_rng(7), []
    for group in range(len(team.groups.count)):
        slot = team.groups.first[group]
        starts = ([region.local(positions[slot]) for region, positions in zip(
            team.regions, plan.positions)], plan.powers[:, slot - 1])
        excess.append(climb(team, proof, group, starts, rng, count) - proof.groups[group])
    return max(excess)


def random_plans(scenario, rng, count):
    """Return feasible plans: paths bent at random or towards receivers, powers at random."""
    slots, uavs = scenario.slots, len(scenario.uavs)
    receivers = np.array([scenario.ground_node, *(e.position for e in scenario.eavesdroppers)])
    time = np.linspace(0, 1, slots + 2)[:, None]
    plans = []
    for _ in range(count):
        paths = []
        for uav in scenario.uavs:
            target = receivers[rng.integers(len(receivers))] + rng.normal(0, 20, 2)
            straight = np.array(uav.start) + (np.array(uav.goal) - uav.start) * time
            pull = np.minimum(1, np.minimum(time, 1 - time) * rng.uniform(1, 20))
            paths.append(straight + (target - straight) * pull * rng.choice([0.3, 1.0]))
        peaks = np.array([[uav.peak_power] for uav in scenario.uavs])
        powers = peaks * rng.uniform(0, 1, (uavs, slots)) * (
            rng.random((uavs, slots)) > rng.uniform(0, 0.9))
        problem = Problem(scenario)
        plans.append(Plan(
            scenario, problem.retract(np.array(paths)), problem.retract_powers(powers)))
    return plans


def any_mission(seed):
    """
    Return a random mission of a kind that `upper_bound` takes, of few slots.

    Its UAVs are free, have limits of acceleration, or fly in a city; powers are from a hundredth
    to a hundred times the usual ones; eavesdroppers may be many, collude, and fading may count.
    """
    rng = np.random.default_rng(seed)
    slots = int(rng.integers(3, 13))
    options = {'colluding': seed % 3 == 0, 'channel': Channel(
        rician_k_db=10.0, outage=0.3) if seed % 5 == 0 else Channel()}
    if seed % 4 == 3:
        city = random_city_mission(seed, slots=12, slack=float(rng.uniform(0.3, 2.0)))
        return replace(city, uavs=city.uavs[:2], **options)
    mission = random_mission(seed, slots=slots, jammers=int(rng.integers(0, 2)))
    factor = 10.0 ** rng.uniform(-2, 2) if seed % 7 < 2 else 1.0
    uavs = tuple(replace(uav, average_power=factor * uav.average_power,
                         peak_power=factor * uav.peak_power) for uav in mission.uavs)
    more = tuple(Eavesdropper(tuple(rng.uniform(-400, 400, 2)), float(rng.uniform(0, 60)))
                 for _ in range(int(rng.integers(0, 3))))
    mission = replace(mission, uavs=uavs, eavesdroppers=(*mission.eavesdroppers, *more), **options)
    if seed % 4 < 2:
        return mission
    # In short slots velocities matter; a UAV may be at rest, moving, or free at its ends.
    ends = [None, (0.0, 0.0), tuple(rng.uniform(-3, 3, 2))]
    uavs = tuple(replace(
        uav, max_acceleration=float(rng.uniform(0.3, 3)),
        start_velocity=ends[rng.integers(3)], goal_velocity=ends[rng.integers(3)])
        for uav in mission.uavs)
    return replace(mission, uavs=uavs, duration=2.0 * mission.duration, slots=2 * slots)


def least_gap(seed, time_limit):
    """
    Return a bound less the best rate that was found, infinite without a plan.

    The attack plans for both objectives, from random starts and from what it has found.
    """
    rng = np.random.default_rng(seed)
    objective = OBJECTIVES[seed // 4 % 2]
    try:
        scenario = any_mission(seed)
        plans = [solve(scenario, objective=objective)]
    except PlanningError:
        return math.inf

    def rate(plan):
        return getattr(plan, f'{objective}_rate')
    starts = [fly_hover_fly(scenario), *(
        random_plans(scenario, rng, 20) if not scenario.no_fly_zones else [])]
    plans += starts
    plans += [solve(scenario, objective=objective, initial=start) for start in starts]
    other = solve(scenario, objective=OBJECTIVES[1 - OBJECTIVES.index(objective)])
    plans += [other] + [solve(scenario, objective=objective, initial=start)
                        for start in (other, max(plans, key=rate))]
    bound = upper_bound(scenario, objective=objective, plan=plans[0], time_limit=time_limit)
    return bound.rate - max(map(rate, plans))
