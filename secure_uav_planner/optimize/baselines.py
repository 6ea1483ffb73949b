"""Fly-hover-fly with constant powers, Section IV: the baseline, and where the methods start."""

import math

import numpy as np

from ..scenario import Array, Scenario


def fly_hover_fly_positions(scenario: Scenario, hover: Array | None = None) -> Array:
    """
    Return straight flights at full speed to a hovering place and on to the goal, as late.

    A UAV without the time to reach its hovering place flies towards it and turns back at the
    last moment that still reaches the goal.

    :param hover: hovering places, (U, 2) in m; by default the paper's: the transmitter above the
        ground node, the jammers above the eavesdroppers in turn.
    :return: positions, (U, N+2, 2) in m.
    """
    if hover is None:
        eves = scenario.eavesdropper_positions
        jammers = np.arange(len(scenario.uavs) - 1)
        hover = np.concatenate([[scenario.ground_node], eves[jammers % len(eves)]])
    return np.stack([
        _fly_hover_fly(start, goal, place, step, scenario.slots)
        for start, goal, place, step in zip(
            scenario.starts, scenario.goals, hover, scenario.max_step.tolist(), strict=True)])


def constant_powers(scenario: Scenario, transmitting: float = 1.0,
                    jamming: float = 1.0) -> Array:
    """
    Return the same powers in every slot, (U, N) in W.

    :param transmitting: share of its average power that the transmitter has.
    :param jamming: share of theirs that the jammers have.
    """
    shares = np.full(len(scenario.uavs), jamming)
    shares[0] = transmitting
    return np.repeat((shares * scenario.average_powers)[:, None], scenario.slots, axis=1)


def _fly_hover_fly(start: Array, goal: Array, place: Array, step: float, slots: int) -> Array:
    """Return the points of one UAV, (N+2, 2)."""
    turn = _turning_place(start, goal, place, (slots + 1) * step)
    count = np.arange(slots + 2.0)
    outward = _along(start, turn, count * step)
    homeward = _along(goal, turn, (slots + 1 - count) * step)
    leaving = (slots + 1 - count) * step < math.dist(goal, turn)
    return np.where(leaving[:, None], homeward, outward)


def _turning_place(start: Array, goal: Array, place: Array, reach: float) -> Array:
    """Return the place nearest to `place` on the way there from which `goal` is in reach."""
    outward = math.dist(start, place)
    if outward + math.dist(place, goal) <= reach:
        return place
    # |start + s u - goal| = reach - s, solved for the s at which to turn.
    direction = (place - start) / outward if outward > 0 else np.zeros(2)
    back = start - goal
    denominator = 2 * (reach + float(back @ direction))
    slack = max(0.0, reach**2 - float(back @ back))
    # Straight towards the goal with no slack, turning earlier or later is the same flight.
    along = min(outward, reach, slack / denominator if denominator > 1e-12 * reach else reach)
    return start + along * direction


def _along(origin: Array, target: Array, distance: Array) -> Array:
    """Return the points at the distances from origin towards target, stopping there."""
    length = math.dist(origin, target)
    share = np.minimum(distance, length) / length if length > 0 else np.zeros(len(distance))
    return origin + share[:, None] * (target - origin)
