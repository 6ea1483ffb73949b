"""The eavesdroppers that the bound uses: any subset leaves it valid."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from ...mission.validation import Array

if TYPE_CHECKING:
    from ...mission.scenario import Scenario

RAYS = 16
"""Points on every disc's circle, to choose from; its centre is one more."""


def unit_circle(count: int) -> Array:
    """Return points on the unit circle at equal angles, (count, 2)."""
    angle = np.arange(count) * 2 * np.pi / count
    return np.stack([np.cos(angle), np.sin(angle)], -1)


@dataclass(frozen=True, eq=False)
class EavesdropperSubset:
    """
    Places of eavesdroppers.

    The leak is the largest over all eavesdroppers, so leaving some out lowers no plan's rate. And
    the leak to the worst point of a disc is at least that to any chosen point: for problem (P1)
    eavesdroppers without an error radius at chosen points do as well, and with them the
    objectives of (P1) and (P2) are the same.

    :param places: (E, 2) in m.
    :param radii: (E,) in m.
    :param advantages: by what factor the SNR is larger than at the ground node's receiver, (E,).
    :param owners: index of the eavesdropper of each place, (E,).
    """

    places: Array
    radii: Array
    advantages: Array
    owners: NDArray[np.intp]

    @classmethod
    def of(cls, scenario: Scenario, objective: str) -> EavesdropperSubset:
        """Return all candidates: discs for 'guaranteed', points of them for 'worst_case'."""
        centres = np.array([eve.position for eve in scenario.eavesdroppers])
        radii = np.array([eve.error_radius for eve in scenario.eavesdroppers])
        if objective == 'guaranteed':
            return cls(centres, radii, scenario.receiver_advantages, np.arange(len(centres)))
        offsets = np.concatenate([[[0.0, 0.0]], unit_circle(RAYS)])
        # A little inside, so that rounding puts no point outside.
        within = np.maximum(radii * (1 - 1e-9) - 1e-15 * np.abs(centres).max(1), 0.0)
        points = [centre + reach * offsets if reach > 0 else centre[None]
                  for centre, reach in zip(centres, within)]
        places = np.concatenate(points)
        owners = np.repeat(np.arange(len(points)), [len(group) for group in points])
        return cls(places, np.zeros(len(places)), scenario.receiver_advantages[owners], owners)

    def compute_leaks(self, scenario: Scenario, positions: Array, powers: Array) -> Array:
        """
        Return the leak to every eavesdropper by the guarantee's formula, (E, N) in nats.

        :param positions: of a plan, (U, N + 2, 2) in m.
        :param powers: of the plan, (U, N) in W.
        """
        offset = positions[None, :, 1:-1] - self.places[:, None, None]
        distance = np.hypot(offset[..., 0], offset[..., 1])
        distance[:, 0] = np.maximum(distance[:, 0] - self.radii[:, None], 0.0)
        distance[:, 1:] += self.radii[:, None, None]
        altitude = np.array([[uav.altitude] for uav in scenario.uavs])
        snr = scenario.reference_snr * self.advantages[:, None, None]
        received = snr * np.maximum(powers, 0.0) / (distance**2 + altitude**2)
        return np.asarray(np.log1p(received[:, 0] / (1.0 + received[:, 1:].sum(1))))

    def select_loudest(self, leaks: Array, most: int) -> EavesdropperSubset:
        """
        Return at most `most` places, one in every disc before a second one in any.

        The first is the place with the largest leak over all slots, each further one raises the
        largest leak most. A plan may leak little into a disc just because its jammer sees to
        that, so no disc is left out for further places in a disc.

        :param leaks: of the plan, (E, N).
        """
        chosen: list[int] = []
        largest = np.zeros(leaks.shape[1])
        for _ in range(min(most, len(leaks))):
            gain = np.maximum(leaks, largest).sum(1)
            gain[chosen] = -np.inf
            fresh = ~np.isin(self.owners, self.owners[chosen])
            chosen.append(int(np.where(fresh | ~fresh.any(), gain, -np.inf).argmax()))
            largest = np.maximum(largest, leaks[chosen[-1]])
        keep = sorted(chosen)
        return EavesdropperSubset(self.places[keep], self.radii[keep], self.advantages[keep],
                                  self.owners[keep])
