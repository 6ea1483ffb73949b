"""
The ground nodes for the methods: plans do not depend on how they are listed or on a common start.

Methods judge rates relative to the best rate. A head start that all nodes have would hide the
differences between plans, so it is left out.
"""

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


def find_common_start(scenario: Scenario) -> float:
    """Return the least head start of a ground node over its weight, in bit/s/Hz."""
    return float((scenario.node_offsets / scenario.node_weights).min())


def reorder_nodes(scenario: Scenario, order: list[int]) -> Scenario:
    """
    Return a scenario with its ground nodes in an order of indices, without their common start.

    The scenario itself is returned if its order is sorted and there is no common start.
    """
    common = find_common_start(scenario) * scenario.duration
    if order == sorted(order) and not common:
        return scenario
    head_starts = scenario.head_starts and tuple(np.maximum(
        np.array(scenario.head_starts) - common * scenario.node_weights, 0.0)[order].tolist())
    return replace(scenario, head_starts=head_starts, ground_nodes=tuple(
        scenario.ground_nodes[number] for number in order))


def restore_nodes(plan: Plan, scenario: Scenario, order: list[int]) -> Plan:
    """Return the plan of reorder_nodes as a plan of `scenario`, with its order of nodes."""
    if plan.scenario is scenario:
        return plan
    return replace(plan, scenario=scenario, shares=plan.shares[np.argsort(order)])
