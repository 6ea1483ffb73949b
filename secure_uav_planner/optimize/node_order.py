"""The order of the ground nodes for the methods: plans do not depend on how they are listed."""

from dataclasses import replace
import math

import numpy as np

from ..mission.scenario import Scenario
from ..plan.plan import Plan


def order_nodes(scenario: Scenario) -> list[int]:
    """
    Return the indices of the ground nodes, sorted by bearing: the same order on a rotated map.

    A bearing [rad] is the counterclockwise angle, at the mean of all nodes' places at half time,
    from UAV 0's start to a node. Nodes of one bearing are sorted by distance, then by data.
    """
    grounds = scenario.receivers_at([scenario.duration / 2]).ground_nodes[:, 0]
    # The exact sum does not depend on the order.
    middle = np.array([math.fsum(column) for column in grounds.T.tolist()]) / len(grounds)
    x, y = scenario.starts[0] - middle

    def find_key(number: int) -> tuple[object, ...]:
        """Return bearing [rad], distance [m] and data of a node."""
        right, up = grounds[number] - middle
        node, head_starts = scenario.ground_nodes[number], scenario.head_starts
        return (math.atan2(x * up - y * right, x * right + y * up), math.hypot(right, up),
                node.weight, node.trusted, head_starts[number] if head_starts else 0.0,
                node.track or ())

    return sorted(range(len(grounds)), key=find_key)


def reorder_nodes(scenario: Scenario, order: list[int]) -> Scenario:
    """Return a scenario with its ground nodes in an order of indices; itself if it is sorted."""
    if order == sorted(order):
        return scenario
    nodes, head_starts = scenario.ground_nodes, scenario.head_starts
    return replace(scenario, ground_nodes=tuple(nodes[number] for number in order),
                   head_starts=tuple(head_starts[number] for number in order if head_starts))


def restore_nodes(plan: Plan, scenario: Scenario, order: list[int]) -> Plan:
    """Return the plan of a reordered scenario as a plan of `scenario`, with its order of nodes."""
    if order == sorted(order):
        return plan
    return replace(plan, scenario=scenario, shares=plan.shares[np.argsort(order)])
