"""What the certificate is made from: any numbers are valid, good ones make it tight."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .conjugate import Array


@dataclass(frozen=True, eq=False)
class Multipliers:
    """
    The multipliers of speed, power and leakage.

    :param slope: u of every UAV's potential, (U, G + 1, 2) in nats per unit of its lens.
    :param bend: S of every UAV's potential, (U, G + 1, 3) in nats per unit^2.
    :param prices: lam, (U,) in nats per W, not negative.
    :param weights: w0 at the nodes, rising, (K, G), within (0, 1].
    :param shares: v at the nodes, (K, G, E), not negative, with a sum of at most w0.
    :param theta: with two jammers, the first one's share at the ground node, for every node and
        every division, (K, R, G).
    :param divisions: with two jammers, the nodes of rho, the first one's share at the
        eavesdropper, rising from 0 to 1, (R,).
    :param helpers: lam of the helpers, in nats per W.
    :param known: what each UAV's terms of the nodes come close to, (U, K, R, G) in nats.
    :param still: the same where nothing is sent, (U, G) in nats.
    :param needed: whether a node has maxima of its own, (K, G), the last one always; the others
        are put on the chords of their neighbours.
    :param slack: what the maxima may be too large, where nothing is sent and at every node,
        (K + 1, G) in nats.
    """

    slope: Array
    bend: Array
    prices: Array
    weights: Array
    shares: Array
    theta: Array
    divisions: Array
    helpers: Array
    known: Array
    still: Array
    needed: NDArray[np.bool_]
    slack: Array
