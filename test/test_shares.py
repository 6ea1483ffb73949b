"""Shares of the slots are the best for the least mean, by a linear program as the oracle."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import linprog
from secure_uav_planner import GroundNode, Scenario
from secure_uav_planner.model.channel.rates import find_least_rate
from secure_uav_planner.model.channel.shares import find_shares


def make_mission(weights, head_starts=()):
    """Return a mission with ground nodes of some weights."""
    nodes = tuple(GroundNode((float(number), 0.0), f'node{number}', weight)
                  for number, weight in enumerate(weights))
    return replace(Scenario.paper(100.0), ground_node=None, ground_nodes=nodes,
                   head_starts=head_starts)


def find_best(scenario, rates):
    """Return the largest least mean over weight by SciPy's linear program."""
    nodes, slots = rates.shape
    matrix = np.zeros((nodes + slots, rates.size + 1))
    matrix[:nodes, -1] = 1.0
    for node in range(nodes):
        matrix[node, node * slots:(node + 1) * slots] = (
            -rates[node] / scenario.node_weights[node] / slots)
    for slot in range(slots):
        matrix[nodes + slot, slot:rates.size:slots] = 1.0
    tight = {'primal_feasibility_tolerance': 1e-10, 'dual_feasibility_tolerance': 1e-10}
    return -linprog(
        np.append(np.zeros(rates.size), -1.0), matrix,
        np.append(scenario.node_offsets / scenario.node_weights, np.ones(slots)),
        bounds=[(0, None)] * rates.size + [(None, None)], options=tight).fun


@pytest.mark.parametrize('seed', range(24))
def test_shares_are_a_best_vertex_of_the_linear_program(seed):
    rng = np.random.default_rng(seed)
    nodes, slots = int(rng.integers(2, 9)), int(rng.integers(1, 40))
    rates = 3 * rng.random((nodes, slots)) * 10.0**rng.uniform(-4, 0, (nodes, 1))
    if seed % 4 == 1:
        rates = np.round(rates, 1)  # Ties, and nodes without a rate.
    elif seed % 4 == 2:
        rates[:, rng.random(slots) < 0.6] = rates[:, :1]  # A hovering UAV.
    elif seed % 4 == 3:
        rates *= rng.random(rates.shape) < 0.4
    scenario = make_mission(rng.choice([0.5, 1.0, 3.0], nodes).tolist(), tuple(
        (rng.choice([0.0, 30.0], nodes) * rng.random(nodes)).tolist()) if seed % 3 == 0 else ())
    shares = find_shares(scenario, rates)
    assert shares.min() >= 0
    assert shares.sum(axis=0).max() <= 1 + 1e-12
    assert ((shares > 0) & (shares < 1)).any(axis=0).sum() < nodes
    assert not shares[:, ~rates.any(axis=0)].any()
    best = find_best(scenario, rates)
    assert find_least_rate(scenario, (shares * rates).mean(axis=1)) == pytest.approx(
        best, rel=1e-8, abs=1e-9)


def pass_in_jumps(rng, slots):
    """Return rates of nodes in a row that are passed in jumps, so that many slots are the same."""
    places, times = np.linspace(0, 1, 16)[:, None], np.round(np.linspace(0, 1, slots), 1)
    return np.exp(-20 * (places - times)**2) * rng.uniform(0.1, 3, (16, 1))


def pass_smoothly(rng, slots):
    """Return rates of nodes that are passed smoothly, so that no two slots are the same."""
    places, times = rng.random((16, 1)), np.linspace(0, 1, slots)
    rates = np.log1p(rng.uniform(0.01, 0.3, (16, 1)) / (0.05 + (places - times)**2)) - 0.03
    return np.maximum(rates, 0)


@pytest.mark.parametrize('slots', [40, 2_000, 20_000])
@pytest.mark.parametrize('make_rates', [pass_in_jumps, pass_smoothly])
def test_shares_of_any_number_of_slots_take_few_steps(slots, make_rates, monkeypatch):
    rng, steps, solve = np.random.default_rng(0), [], np.linalg.solve
    monkeypatch.setattr(np.linalg, 'solve', lambda *args: steps.append(1) or solve(*args))
    rates = make_rates(rng, slots)
    shares = find_shares(make_mission([1.0] * 16), rates)
    assert len(steps) <= 60
    assert ((shares > 0) & (shares < 1)).any(axis=0).sum() < 16
    assert np.ptp((shares * rates).mean(axis=1)) < 1e-8
