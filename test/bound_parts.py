"""Small random missions with their reachable sets, potentials and terms of the bound."""

import numpy as np
from secure_uav_planner import Eavesdropper, Scenario, Uav
from secure_uav_planner.bound.proof.reachable_set import ReachableSet
from secure_uav_planner.bound.proof.relaxation import EavesdropperSubset, SlotGroups
from secure_uav_planner.bound.proof.terms import Potential


def softplus(z):
    return np.logaddexp(0.0, z)


def mission(seed, slots=6, jammers=1, eavesdroppers=1, **options):
    """Return a small random mission in which everything happens."""
    rng = np.random.default_rng(seed)
    duration = float(rng.uniform(30, 120))
    uavs = []
    for i in range(1 + jammers):
        start, goal = rng.uniform(-400, 400, (2, 2))
        speed = float(np.hypot(*(goal - start)) / duration * rng.choice([1.0, 1.2, 2.5]) + 0.1)
        uavs.append(Uav(f'uav{i + 1}', tuple(start), tuple(goal), float(rng.uniform(40, 150)),
                        speed, 1.5, float(rng.uniform(1.5, 5))))
    return Scenario(tuple(rng.uniform(-100, 100, 2)), tuple(
        Eavesdropper(tuple(rng.uniform(-300, 300, 2)), float(rng.choice([0.0, 15.0, 80.0])))
        for _ in range(eavesdroppers)), tuple(uavs), duration, slots, float(rng.uniform(65, 90)),
        **options)


def region_of(seed, uav=0, **options):
    """Return the reachable set of a UAV of a random mission."""
    return reach(mission(seed, **options), uav=uav)


def reach(scenario, groups=None, uav=0):
    """Return the reachable set of a UAV, for discs and without obstacles."""
    return ReachableSet.of(scenario, uav, groups or SlotGroups.of(scenario.slots),
                           EavesdropperSubset.of(scenario, 'guaranteed'), None)


def places_in(region, group, rng, count=400):
    """Return random places in a reachable set and on its rim."""
    low, high = (corner[group] for corner in region.bounding_box)
    tried = rng.uniform(low, high, (20 * count, 2))
    tried = tried[region.contains(tried, np.full(len(tried), group))][:count]
    rim = region.find_farthest(rng.normal(size=(1, count, 2)))[group]
    return np.concatenate([tried, rim[region.contains(rim, np.full(count, group))]])


def random_potential(region, groups, rng, curved):
    count = len(groups.count) + 1
    return Potential(np.cumsum(rng.normal(0, 1, (count, 2)), 0),
                     np.cumsum(rng.normal(0, 0.5, (count, 3)), 0) * curved,
                     np.cumsum(rng.normal(0, 1, (count, 2)), 0) * (rng.random() < 0.7),
                     groups, region)


def potential_at(potential, group, places):
    """Return what a potential adds at places in a slot of a group, by the plain formulas."""
    x, y = places.T
    slope, curvature = (part[group] for part in potential.change)
    value = places @ slope + curvature @ [x * x / 2, x * y, y * y / 2]
    value += potential.constant()[group]
    f, u1, u2, s11, s12, s22 = potential.speed_cost()[group]
    return value + f * np.hypot(u1 + s11 * x + s12 * y, u2 + s12 * x + s22 * y)


def values(terms, k, places, powers):
    """Return the values of term k at places and powers, by the plain formulas."""
    region = terms.potential.region
    ground, leaks = region.log_squares(places)
    value = potential_at(terms.potential, terms.cell[k], places)
    if terms.powers is None:
        return value + terms.weight[k] * (region.log_gain - ground) + (
            leaks - region.log_gain) @ terms.v[k]
    z = np.log(powers) + region.log_gain
    return (value - terms.weight[k] * softplus(z - ground)
            + softplus(z[:, None] - leaks) @ terms.v[k] - terms.price * powers)
