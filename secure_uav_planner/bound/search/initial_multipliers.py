"""First multipliers, from what a plan does."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..proof.conjugate import Array, sigmoid
from ..proof.team import Team

AUDIBLE = 1e-3
"""Share of the average power from which a slot counts as one with a transmission."""


@dataclass(frozen=True, eq=False)
class InitialMultipliers:
    """
    Where to begin the search.

    :param places: of every UAV in every stage, (U, G, 2) in units of its reachable set.
    :param powers: (U, G) in W; where the plan is silent, those of the nearest stage that is not.
    :param weight: w0, the derivative of the rate by log SINR at the ground node, (G,).
    :param shares: v, (G, E).
    :param prices: lam, (U,) in nats per W.
    """

    places: Array
    powers: Array
    weight: Array
    shares: Array
    prices: Array

    @classmethod
    def of(cls, team: Team, positions: Array, powers: Array) -> InitialMultipliers:
        """
        Return those from a plan's numbers, with the team's UAVs in its order.

        :param positions: (U, N + 2, 2) in m.
        :param powers: (U, N) in W.
        """
        middle = (team.stages.first + team.stages.last) // 2
        places = np.array([region.local(path[middle])
                           for region, path in zip(team.regions, positions)])
        power = np.maximum(powers[:, middle - 1], 0.0)
        on = power[0] > AUDIBLE * team.regions[0].average
        watts = np.repeat([[region.average] for region in team.regions], len(on), axis=1)
        if on.any():
            loud = np.flatnonzero(on)
            watts = power[:, loud[np.abs(loud - np.arange(len(on))[:, None]).argmin(1)]]
        ground, heard = [], []
        for region, place, p in zip(team.regions, places, watts):
            far, away = region.log_squares(place)
            ground.append(p * np.exp(region.log_gain - far))
            heard.append(p[:, None] * np.exp(region.log_gain - away))
        noise0 = 1.0 + sum(ground[1:], np.zeros_like(ground[0]))
        noise = 1.0 + sum(heard[1:], np.zeros_like(heard[0]))
        z0 = np.log(np.maximum(ground[0] / noise0, 1e-9))
        ze = np.log(np.maximum(heard[0] / noise, 1e-9))
        weight = np.clip(sigmoid(z0), 0.3, 1 - 1e-6)
        loudest = sigmoid(ze.max(-1))
        prices = np.full(len(team.regions), 1e-5)
        prices[0] = 1e-2
        if on.any():
            slope = (sigmoid(z0) - loudest) / np.maximum(power[0], 1e-9)
            prices[0] = max(float(np.median(slope[on])), 1e-6)
        room = prices[0] * np.maximum(watts[0], 0.1 * team.regions[0].average)
        total = np.clip(np.minimum(loudest, weight - room), 0.05, weight * (1 - 1e-7))
        share = np.exp(8 * (ze - ze.max(-1, keepdims=True)))
        share = share / share.sum(-1, keepdims=True) + 0.02
        share /= share.sum(-1, keepdims=True)
        return cls(places, watts, weight, total[:, None] * share, prices)
