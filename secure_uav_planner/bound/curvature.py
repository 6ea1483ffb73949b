"""
The rates' part of lemma 5: values, gradients and largest second derivatives over boxes.

With q = d^2 + H^2 at a person's distance d, the eigenvalues of the second derivatives are

    of -log q:                      -2 / q across and 2 (d^2 - H^2) / q^2 along the radius; the
                                    second is the larger one,
    of log q:                       those with the other sign, at most 2 / q,
    of log([d - eps]+^2 + H^2):     at most 2 / q with [d - eps]+ for d (it is C^1 at d = eps),
    of -log((d + eps)^2 + H^2):     at most 2 (x^2 - H^2) / (x^2 + H^2)^2, x = d + eps; its kink at
                                    d = 0 points upwards, so any supergradient serves there.

A jammer's term is taken in pi = log p, with y = p b(q) and z = log y, so that phi' = y / (1 + y)
and phi'' = y / (1 + y)^2. -w0 phi(z0) adds at most w0 phi'(z0) 2 / q, because -phi'' is not
positive. v phi(z_e) adds v phi'' (|dpi| + G |dq|)^2, G being the largest gradient of z_e,
2 x / (x^2 + H^2), and v phi' times the eigenvalue above, with the largest phi' where that is
positive and the smallest where it is not. -lam e^pi adds no more than -lam times its least value.
Every factor is taken at the end of its range over the box where it is largest.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from .conjugate import Array

if TYPE_CHECKING:
    from .boxes import Terms


@dataclass(frozen=True, eq=False)
class Curve:
    """
    What the rates add to a function over boxes.

    :param value: at the centres, (K,) in nats.
    :param ga: derivative by the first coordinate, alike.
    :param gb: derivative by the second coordinate.
    :param gp: derivative by log p; empty without a power.
    :param bend: with bend_power, numbers such that bend |dq|^2 + bend_power dpi^2 is at least the
        second derivative along (dq, dpi) anywhere in the box.
    :param bend_power: see bend; empty without a power.
    :param sizes: sums of the sizes of the terms of bend and bend_power, (2, K).
    """

    value: Array
    ga: Array
    gb: Array
    gp: Array
    bend: Array
    bend_power: Array
    sizes: Array


def channel(terms: Terms, function: NDArray[np.intp], centre: Array, half: Array,
            rho: Array) -> Curve:
    """
    Return the rates' part of boxes.

    :param function: of every box, (K,).
    :param centre: (2, K), or (3, K) with log p.
    :param half: half the sides, alike.
    :param rho: half the diagonals in the plane, (K,).
    """
    if terms.powers is None:
        return _transmitter(terms, function, centre, rho)
    return _jammer(terms, function, centre, half, rho)


def _transmitter(terms: Terms, function: NDArray[np.intp], centre: Array, rho: Array) -> Curve:
    lens, weight = terms.lens, terms.weight[function]
    square = lens.altitude**2
    da, db = centre[0] - lens.ground[0], centre[1] - lens.ground[1]
    d = np.sqrt(da * da + db * db)
    q = d * d + square
    value = weight * (terms.log_gain - np.log(q))
    factor = -2 * weight / q
    ga, gb = factor * da, factor * db
    bend = weight * _radial(np.maximum(d - rho, 0.0), d + rho, lens.altitude)
    size = np.abs(bend)
    for e, (place, radius) in enumerate(zip(lens.eavesdroppers, lens.radii)):
        share = terms.shares[function, e]
        ea, eb = centre[0] - place[0], centre[1] - place[1]
        d = np.sqrt(ea * ea + eb * eb)
        x = np.maximum(d - radius, 0.0)
        q = x * x + square
        value += share * (np.log(q) - (terms.log_gain + lens.log_advantages[e]))
        factor = share * 2 * x / (q * np.maximum(d, 1e-300))
        ga += factor * ea
        gb += factor * eb
        more = share * 2 / (np.maximum(d - radius - rho, 0.0)**2 + square)
        bend += more
        size += more
    none = np.zeros(0)
    return Curve(value, ga, gb, none, bend, none, size[None])


def _jammer(terms: Terms, function: NDArray[np.intp], centre: Array, half: Array,
            rho: Array) -> Curve:
    lens, weight = terms.lens, terms.weight[function]
    square = lens.altitude**2
    width = half[2]
    watts, more = np.exp(centre[2]), np.exp(width)
    cost = terms.price * watts
    da, db = centre[0] - lens.ground[0], centre[1] - lens.ground[1]
    d2 = da * da + db * db
    q = d2 + square
    gain = np.exp(terms.log_gain) * watts
    y = gain / q
    value = -weight * np.log1p(y) - cost
    use = weight * (y / (1 + y))
    factor = 2 * use / q
    ga, gb = factor * da, factor * db
    gp = -use - cost
    near = np.maximum(np.sqrt(d2) - rho, 0.0)**2 + square
    top = gain * more / near
    bend = weight * (top / (1 + top)) * 2 / near
    bend_power = -cost / more
    sizes = np.stack([bend, -bend_power])
    for e, (place, radius) in enumerate(zip(lens.eavesdroppers, lens.radii)):
        share = terms.shares[function, e]
        gain = np.exp(terms.log_gain + lens.log_advantages[e]) * watts
        ea, eb = centre[0] - place[0], centre[1] - place[1]
        d = np.sqrt(ea * ea + eb * eb)
        x = d + radius
        q = x * x + square
        y = gain / q
        value += share * np.log1p(y)
        use = share * (y / (1 + y))
        factor = -use * 2 * x / (q * np.maximum(d, 1e-300))
        ga += factor * ea
        gb += factor * eb
        gp += use
        low, high = np.maximum(d - rho, 0.0) + radius, x + rho
        top = gain * more / (low * low + square)
        least = gain / more / (high * high + square)
        # phi'' is y / (1 + y)^2, largest at y = 1.
        at = np.minimum(np.maximum(least, 1.0), top)
        twice = share * at / (1 + at)**2
        at = np.minimum(np.maximum(lens.altitude, low), high)
        steep = 2 * at / (at * at + square)
        # (|dpi| + G |dq|)^2: the two squares and the product are shared out.
        product = twice * np.stack([steep * (steep + width / np.maximum(rho, 1e-300)),
                                    1 + steep * rho / np.maximum(width, 1e-300)])
        radial = _radial(low, high, lens.altitude)
        at = np.where(radial > 0, top, least)
        along = share * (at / (1 + at)) * radial
        bend += product[0] + along
        bend_power += product[1]
        sizes += product
        sizes[0] += np.abs(along)
    return Curve(value, ga, gb, gp, bend, bend_power, sizes)


def _radial(low: Array, high: Array, altitude: float) -> Array:
    """
    Return the largest second derivative of -log(x^2 + H^2) for low <= x <= high.

    It is 2 (x^2 - H^2) / (x^2 + H^2)^2, which rises up to x = sqrt(3) H and falls beyond.
    """
    x2 = np.minimum(np.maximum(low, 3**0.5 * altitude), high)**2
    square = altitude * altitude
    return 2 * (x2 - square) / (x2 + square)**2
