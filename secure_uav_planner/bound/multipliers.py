"""What the certificate is made from: any numbers are valid, good ones make it tight."""

from __future__ import annotations

from dataclasses import dataclass

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
    :param ground: theta, the jammers' shares at the ground node for every node and every division
        rho, (K, R, G, J), with the sum 1.
    :param divisions: rho, the jammers' shares at an eavesdropper, (R, J), with the sum 1.
    :param known: what each UAV's terms of the nodes come close to, (U, K, R, G) in nats.
    :param still: the same where nothing is sent, (U, G) in nats.
    """

    slope: Array
    bend: Array
    prices: Array
    weights: Array
    shares: Array
    ground: Array
    divisions: Array
    known: Array
    still: Array
