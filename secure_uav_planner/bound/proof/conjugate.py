"""Lemma 1, which separates the UAVs, and lemma 3, which prices the transmit power."""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def softplus(z: Array) -> Array:
    """Return phi(z) = log(1 + exp(z)): a rate in nats as a function of the SINR's logarithm."""
    return np.logaddexp(0.0, z)


def sigmoid(z: Array) -> Array:
    """Return phi'(z) = 1 / (1 + exp(-z)), without overflow."""
    return 1.0 / (1.0 + np.exp(-np.clip(z, -700.0, 700.0)))


def entropy(weight: Array) -> Array:
    """
    Return the binary entropy H(w) = -w log w - (1 - w) log(1 - w), in nats; 0 at 0 and at 1.

    Lemma 1. Let z0 be the logarithm of the SINR at the ground node and z_e that at eavesdropper
    e. phi is convex with phi(z) = max over 0 <= w <= 1 of w z + H(w), attained at w = phi'(z).
    For every v >= 0 with s = sum_e v_e <= 1,

        max_e phi(z_e) >= sum_e v_e z_e + H(s),

    because max_e z_e is at least the mean of the z_e with the weights v_e / s, phi increases, and
    phi(z) >= s z + H(s). Hence, for any choice of v(w0) >= 0 with s(w0) <= w0,

        phi(z0) - max_e phi(z_e)
            <= max over w0 in [0, 1] of w0 z0 + H(w0) - sum_e v_e(w0) z_e - H(s(w0)).

    z0 and z_e are sums of one term of each UAV, so the bracket is, too: the UAVs separate.
    """
    weight = np.clip(weight, 0.0, 1.0)
    rest = 1.0 - weight
    return -(weight * np.log(np.maximum(weight, 1e-300)) + rest * np.log(np.maximum(rest, 1e-300)))


def transmit_power(weight: Array, price: float, peak: float) -> tuple[Array, Array]:
    """
    Return max over 0 < p <= peak of weight log p - price p, and the p where it is attained.

    Lemma 3. In lemma 1 the logarithm of the transmit power comes with w0 - s >= 0, and its mean
    over the slots is limited: for every price lam >= 0 the Lagrangian's term is this one. Its
    maximum is at p = weight / lam, or at the peak where that is larger; for weight = 0 the
    supremum is 0, as p goes to 0.

    :param weight: w0 - s, at least 0.
    :param price: lam in nats per W, at least 0.
    :param peak: in W.
    """
    # Whatever p is returned, the value is exact for it only at the maximiser; p below 1e-300
    # has a weight below 1e-300 * price, and the value is then 0 in this arithmetic.
    power = np.minimum(weight / max(price, 1e-300), peak)
    return weight * np.log(np.maximum(power, 1e-300)) - price * power, power
