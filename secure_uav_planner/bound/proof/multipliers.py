"""What the certificate is made from: any numbers are valid, good ones make it tight."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .conjugate import Array
from .jammer_shares import Splits


@dataclass(frozen=True, eq=False)
class Multipliers:
    """
    The multipliers of speed, acceleration, power and leakage.

    :param slope: u of every UAV's potential, (U, G + 1, 2) in nats per unit of its set.
    :param bend: S of every UAV's potential, (U, G + 1, 3) in nats per unit^2.
    :param turn: w of every UAV, (U, G + 1, 2) in nats per unit.
    :param prices: lam, (U,) in nats per W, not negative.
    :param weights: w0 at the breakpoints, rising, (K, G), within (0, 1].
    :param shares: v at the breakpoints, (K, G, E), not negative, with a sum of at most w0.
    :param splits: of the jammers' shares and powers into boxes, at each of the M breakpoints that
        are needed, in the order of np.nonzero(needed); see jammer_shares.
    :param theta: the shares of all jammers but the last one at the ground node: the sum over the
        eavesdroppers of what belongs to the corners of their simplices, (B, M, E, J, J - 1).
    :param mean: q of every box up to a factor, (B, M, E, J).
    :param helpers: lam of the helpers, in nats per W.
    :param known: what the terms come close to, in nats: of the transmitter, (K, G), and of every
        jammer at the corners of the boxes, (B, M, V).
    :param still: the same where nothing is sent, (U, G) in nats.
    :param needed: whether a breakpoint has maxima of its own, (K, G), the last one always; the
        others are put on the chords of their neighbours.
    :param slack: what the maxima may be too large, where nothing is sent and at every breakpoint,
        (K + 1, G) in nats.
    :param corner_slack: the same for every jammer at the corners of the boxes, (B, M, V).
    """

    slope: Array
    bend: Array
    turn: Array
    prices: Array
    weights: Array
    shares: Array
    splits: Splits
    theta: Array
    mean: Array
    helpers: Array
    known: tuple[Array, ...]
    still: Array
    needed: NDArray[np.bool_]
    slack: Array
    corner_slack: Array
