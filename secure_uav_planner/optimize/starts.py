"""Where the search begins: flights to various hovering places."""

import itertools

import numpy as np


def hovering_places(scenario):
    """
    Return the hovering places of several fly-hover-fly flights, (S, U, 2) in m.

    Above the ground node and the eavesdroppers as in the paper, beside them on either side,
    behind and before them; and every sensible way to share the eavesdroppers among the jammers.
    """
    ground = np.array(scenario.ground_node)
    eves = np.array([eve.position for eve in scenario.eavesdroppers])
    radii = np.array([eve.error_radius for eve in scenario.eavesdroppers])
    altitude = float(np.mean([uav.altitude for uav in scenario.uavs]))
    jammers = len(scenario.uavs) - 1
    away = ground - eves.mean(axis=0)
    away = away / max(np.linalg.norm(away), 1e-9)
    side = np.array([-away[1], away[0]])
    transmit = [ground + shift * altitude for shift in
                (0 * away, 0.7 * away, 0.7 * side, -0.7 * side)]

    def jam(eve, kind):
        out = eves[eve] - ground
        distance = np.linalg.norm(out)
        out = out / distance if distance > 1e-9 else -away
        left = np.array([-out[1], out[0]])
        reach = 0.7 * altitude + radii[eve]
        return eves[eve] + reach * {
            'above': 0 * out, 'behind': out, 'left': left, 'right': -left, 'far': 3 * out}[kind]

    # The eavesdropper of each jammer: in turn, rotated, or all on the nearest to the ground node.
    order = np.argsort(np.linalg.norm(eves - ground, axis=1))
    turns = [[order[(jammer + shift) % len(eves)] for jammer in range(jammers)]
             for shift in range(len(eves) if jammers else 1)]
    if jammers > 1 and len(eves) > 1:
        turns += [[order[0]] * jammers]
        turns += [[turn[j] for j in range(jammers)][::-1] for turn in turns[:2]]
    kinds = [('above',) * jammers, ('behind',) * jammers, ('left', 'right') * jammers,
             ('right', 'left') * jammers, ('far',) * jammers]
    places = []
    for turn, kind in itertools.product(turns, kinds):
        places.append([transmit[0]] + [jam(*pair) for pair in zip(turn, kind)])
    for shift in transmit[1:]:
        places.append([shift] + [jam(eve, 'above') for eve in turns[0]])
    return np.unique(np.array(places), axis=0)
