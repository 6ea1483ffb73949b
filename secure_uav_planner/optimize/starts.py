"""Where the joint method begins: flights to various hovering places."""

import numpy as np

from .fly_hover_fly import constant_powers, fly_hover_fly_positions
from ..channel import guaranteed_rates

_BESIDE = 0.7  # In altitudes.
_QUIETER = (0.1, 0.01, 0.001, 0.0)


def hovering_places(scenario):
    """
    Return hovering places of fly-hover-fly flights, the paper's first, (S, U, 2) in m.

    The transmitter above the ground node or beside it; the jammers above the eavesdroppers,
    beside, behind or far behind them, as the ground node sees them; the eavesdroppers shared
    among the jammers in turn, in every rotation, or all on the nearest.
    """
    ground = np.array(scenario.ground_node)
    eves = np.array([eve.position for eve in scenario.eavesdroppers])
    radii = np.array([eve.error_radius for eve in scenario.eavesdroppers])
    altitude = float(np.mean([uav.altitude for uav in scenario.uavs]))
    jammers = len(scenario.uavs) - 1
    out = eves - ground
    distance = np.linalg.norm(out, axis=1)
    away = -out.mean(axis=0)
    away = away / np.linalg.norm(away) if np.linalg.norm(away) > 1e-9 else np.array([1.0, 0.0])
    out = np.where(distance[:, None] > 1e-9, out / np.maximum(distance, 1e-9)[:, None], -away)
    left = out @ np.array([[0.0, 1.0], [-1.0, 0.0]])
    reach = (_BESIDE * altitude + radii)[:, None]
    around = {'above': eves, 'behind': eves + reach * out, 'left': eves + reach * left,
              'right': eves - reach * left, 'far': eves + 3 * reach * out}

    order = np.argsort(distance)
    shares = [[order[(jammer + turn) % len(eves)] for jammer in range(jammers)]
              for turn in range(len(eves))]
    if jammers > 1 and len(eves) > 1:
        shares.append([order[0]] * jammers)
        shares += [share[::-1] for share in shares[:2]]
    patterns = [('above',), ('behind',), ('left', 'right'), ('right', 'left'), ('far',)]
    places = [[ground] + [around[pattern[jammer % len(pattern)]][eve]
                          for jammer, eve in enumerate(share)]
              for pattern in patterns for share in shares]
    side = np.array([-away[1], away[0]])
    for shift in (away, side, -side):
        places.append([ground + _BESIDE * altitude * shift] + [eves[eve] for eve in shares[0]])
    places = np.array(places)
    first = np.unique(places.round(6), axis=0, return_index=True)[1]
    return places[np.sort(first)]


def several_starts(scenario, model, slots):
    """
    Return strictly feasible starts (S, slots, U, 3) and the mu to start each with, (S,).

    Each of four kinds is spread over the hovering places: with jammers on; with jammers all but
    silent, which lets the transmitter find its flight first; the same closer to the boundary,
    which finds the few slots worth talking in a mission that is nearly lost; and with jammers
    off and the transmitter on where it needs none, closer still.
    """
    places = hovering_places(scenario)
    starts, levels = [], []
    for number, jamming, level in ((4, 0.9, 0.02), (8, 0.05, 0.02), (4, 0.05, 0.003),
                                   (3, 0.0, 1e-4)):
        spread = np.linspace(0, len(places) - 1, min(number, len(places)))
        for hover in places[np.unique(spread.round().astype(int))]:
            positions = fly_hover_fly_positions(scenario, hover)
            powers = constant_powers(scenario, 0.9, jamming)
            if jamming:
                x = interior(scenario, model, positions, powers, slots)
                if len(powers) > 2:
                    # Jammers can be too many: one may do better alone.
                    powers[2:] *= 1e-3
                    starts.append(interior(
                        scenario, model, positions, powers, slots, least=1e-5))
                    levels.append(level)
            else:
                winning = guaranteed_rates(scenario, positions, powers) > 0
                if not winning.any():
                    continue
                powers[0] *= winning / winning.mean()
                x = interior(scenario, model, positions, powers, slots, least=1e-5)
            starts.append(x)
            levels.append(level)
    return np.array(starts), np.array(levels)


def offer_quieter(run):
    """
    Offer less jamming to a Run, and none with the power of slots that lose given to the others.

    Powers have local optima, and those of loud jamming are usually the worse.
    """
    loud = run.powers
    for share in _QUIETER:
        run.offer(powers=np.concatenate([loud[:1], share * loud[1:]]))
    alone = np.zeros_like(loud)
    alone[0] = run.scenario.uavs[0].average_power
    winning = guaranteed_rates(run.scenario, run.positions, alone) > 0
    if winning.any():
        alone[0] *= winning / winning.mean()
        run.offer(powers=alone)


def interior(scenario, model, positions, powers, slots, share=0.05, least=None):
    """
    Return strictly feasible variables near a plan on another grid, (slots, U, 3).

    :param positions: feasible, (U, N+2, 2) in m.
    :param powers: feasible, (U, N) in W.
    :param share: by which to go from the plan into the interior.
    :param least: powers in units of the average power, by default a fifth of the share.
    """
    points = np.linspace(0, 1, slots + 2)
    old = np.linspace(0, 1, positions.shape[1])
    line = positions[:, :1] + points[:, None] * (positions[:, -1:] - positions[:, :1])
    path = np.stack([np.stack([np.interp(points, old, axis) for axis in place.T], axis=-1)
                     for place in positions])
    path += share * (line - path)
    average = np.array([uav.average_power for uav in scenario.uavs])[:, None]
    peak = np.array([uav.peak_power for uav in scenario.uavs])[:, None]
    power = np.stack([np.interp(points[1:-1], old[1:-1], power) for power in powers])
    low = (0.2 * share if least is None else least) * average
    power = np.clip(power, low, (1 - 0.2 * share) * peak)
    power *= np.minimum(1, (1 - 0.2 * share) * average / power.mean(axis=1, keepdims=True))
    return model.variables(path[:, 1:-1], power)


def refined(mission, x, slots):
    """
    Return variables (N, U, 3) that are strictly feasible for a Mission on another grid.

    Interpolation keeps the speed; the mean of the powers is kept by scaling.
    """
    points = np.linspace(0, 1, slots + 2)[1:-1]
    old = np.linspace(0, 1, len(x) + 2)
    whole = np.concatenate([x[:1], x, x[-1:]])
    whole[0, :, 1:] = mission.starts
    whole[-1, :, 1:] = mission.goals
    fine = np.stack([np.interp(points, old, column)
                     for column in whole.reshape(len(whole), -1).T], axis=-1)
    fine = fine.reshape(slots, *x.shape[1:])
    fine[..., 0] *= np.minimum(1, x[..., 0].mean(axis=0) / fine[..., 0].mean(axis=0))
    return fine
