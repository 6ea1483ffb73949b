"""Shares of the slots for several ground nodes."""

import numpy as np

from ..mission.scenario import Array


def weigh_rates(rates: Array, weights: Array, shares: Array) -> float:
    """Return the least mean over weight of rates (G, N) in shares (G, N) of the slots."""
    return float(((shares * rates).mean(axis=1) / weights).min())


def find_shares(rates: Array, weights: Array) -> Array:
    """
    Return the shares of the slots, (G, N), with the largest least mean over weight.

    They are a vertex of a linear program, so that at most G - 1 slots are divided. A slot without
    a rate is nobody's, but for a single node, whose all are.

    :param rates: of each ground node, (G, N), at least 0.
    :param weights: of the ground nodes, (G,).
    """
    nodes, slots = rates.shape
    if nodes == 1:
        return np.ones((1, slots))
    scaled = rates / weights[:, None]
    best = np.eye(nodes)[scaled.argmax(axis=0)].T
    if scaled.any(axis=1).all():
        best = _solve_program(scaled / scaled.max())
    return np.where(rates.any(axis=0), best, 0.0)


def _solve_program(rates: Array) -> Array:
    # Here, because it takes half a second to import.
    from scipy.optimize import linprog
    from scipy.sparse import csr_array, eye_array, hstack, vstack
    nodes, slots = rates.shape
    least = hstack([csr_array(np.eye(nodes)[:, [node]] * -row) for node, row in enumerate(rates)])
    answer = linprog(
        np.append(np.zeros(nodes * slots), -1.0), method='highs-ds',
        A_ub=vstack([hstack([least, np.full((nodes, 1), float(slots))]),
                     hstack([*[eye_array(slots)] * nodes, csr_array((slots, 1))])]),
        b_ub=np.append(np.zeros(nodes), np.ones(slots)))
    shares = np.clip(answer.x[:-1].reshape(nodes, slots), 0.0, 1.0)
    # Slots that the program leaves over, because no node needs them, are nobody's.
    return shares / np.maximum(1.0, shares.sum(axis=0))
