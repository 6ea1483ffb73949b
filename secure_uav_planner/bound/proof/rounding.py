"""
What a Plan tolerates and what floating point loses: argued here, and nowhere else.

**Tolerances.** A Plan may exceed a step, or miss its ends in every coordinate, by
POSITION_TOLERANCE, and exceed every limit of power, the lower one too, by POWER_TOLERANCE. Steps,
discs and powers are widened by that much. What powers below zero can do is the subject of
`bound_negative_power`.

**Rounding.** Let eps = 2^-52. Lengths are in units of about the mission's extent, so that the
places of people and goals are numbers of at most about 2 with an absolute error of a few eps, and
d^2 + H^2 has a relative one of a few eps (1 + 1 / H); the logarithms' gradients are at most
1 / H. Every sum that bounds a box has fewer than 10 terms of each of the following kinds, each of
them wrong by at most a few eps of its size: logarithms (below 200 in size for every scenario that
is legal, weighted by w0 <= 1 and sum v <= 1), and the potentials' terms (at most |u| r + |S| r^2
and step (|u| + |S| r) in size, r being the farthest that the reachable set reaches). The terms
that `pressed` in bound_boxes.cpp adds are of that size, too: their factors are at most ten times
the slope, and they are for discs whose radius is at most twice the place's distance. Second
derivatives are wrong by a few eps of their terms; a negative one of the rates is at most 2 / H^2
and met only where a box is within H of a person, so that it is at most of the size of 2 over a
box. `margin` is 64 eps times the sum of these sizes, which is about ten times what the terms can
add up to, and it is added to every box, to every maximum and to every stage. It is of the order of
1e-11 nats for a mission like the paper's and grows with what is asked, up to RANGES; where it is
not finite, neither is the bound. Sums over the stages are exact but for one rounding (math.fsum).
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ...plan.plan import POSITION_TOLERANCE, POWER_TOLERANCE

if TYPE_CHECKING:
    from ...mission.scenario import Scenario

EPSILON = 64 * float(np.finfo(float).eps)
"""64 eps: the factor of every margin."""

COORDINATE_ROUNDING = 1e-12
"""Share by which discs are widened, against the rounding of squares that are compared."""


def end_tolerance(scenario: Scenario) -> float:
    """
    Return the tolerance of an end, in m.

    The tolerance is one of each coordinate, hence the factor; and coordinates that are compared in
    a UAV's own frame are off by a few eps of the mission's extent.
    """
    places = [scenario.ground_node, *(eve.position for eve in scenario.eavesdroppers),
              *(uav.start for uav in scenario.uavs), *(uav.goal for uav in scenario.uavs)]
    extent = float(np.abs(places).max())
    return 1.5 * POSITION_TOLERANCE + 1e-13 * extent


def margin(altitude: float, size: np.ndarray) -> np.ndarray:
    """
    Return the margin of a sum of logarithms and potentials, in nats.

    :param altitude: of the UAV, in units.
    :param size: of the potentials' terms, in nats.
    """
    return np.asarray(EPSILON * (200.0 + 10.0 / altitude + size))


def bound_negative_power(scenario: Scenario) -> tuple[float, np.ndarray]:
    """
    Return the largest rate of a slot without transmission, by powers below zero, in nats.

    Lemma 7. Let delta_i = POWER_TOLERANCE g a / H_i^2, the largest size of a negative received
    SNR, a being the largest advantage of an eavesdropper's receiver, or 1 if that is larger.
    A transmitter below zero makes the SINR at the ground node negative, so r_0 <= 0, and that at
    an eavesdropper at least -delta_0 / (1 - delta), delta being the sum of the jammers'. Hence the
    rate is at most -log(1 - delta_0 / (1 - delta)); no more than with a jammer that is
    off. The other powers are covered where they enter: lam_i p_i >= -lam_i POWER_TOLERANCE, and a
    jammer's term by its largest value at powers between -POWER_TOLERANCE and a small one. Nothing
    is bounded where delta reaches 1: the interference plus noise could then be zero.

    :return: that rate, infinite where nothing is bounded, and delta_i, (U,).
    """
    altitudes = np.array([uav.altitude for uav in scenario.uavs])
    delta = np.exp(np.log(POWER_TOLERANCE) + np.log(scenario.reference_snr)
                   + np.log(max(1.0, scenario.receiver_advantages.max()))
                   - 2 * np.log(altitudes)) * (1 + 1e-9)
    jammers = delta[1:].sum()
    if not jammers < 1 or not delta[0] < 1 - jammers:
        return np.inf, delta
    return float(-np.log1p(-delta[0] / (1 - jammers)) * (1 + 1e-9)), delta
